"""Columns of a list of measured targets, by their names, in any order.

A name is a quantity with its unit: ``x_mm``, ``j1_rad``, ``X [m]``. In a wide list each reflector
has a group of columns: ``SMR1_x_mm``. Unknown columns are ignored, and named.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Self

from hilcell.cell.settings import SettingsError, read_file

LENGTHS = {"mm": 1.0, "m": 1000.0, "in": 25.4}  # in mm
FINE = LENGTHS | {"um": 0.001}  # of uncertainties
ANGLES = {"deg": pi / 180.0, "rad": 1.0}  # in rad
JOINTS = tuple(f"j{n}" for n in range(1, 10))
POSITION = ("x", "y", "z")
WEIGHTS = ("u_x", "u_y", "u_z")
TEXTS = ("pose", "target", "anchor")
ZYX = ("a", "b", "c")
ORIENTATIONS = {
    "rotation vector": ("rx", "ry", "rz"),
    "quaternion": ("qw", "qx", "qy", "qz"),
    "Z-Y-X angles": ZYX,
    "roll, pitch, yaw": ("roll", "pitch", "yaw"),
}
# Units of each quantity, the first that of a name without one: "" for none.
UNITS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(TEXTS, ("",)),
    **dict.fromkeys(JOINTS, (*ANGLES, *LENGTHS)),
    **dict.fromkeys((*POSITION, "distance"), (*LENGTHS,)),
    **dict.fromkeys(WEIGHTS, (*FINE,)),
    "u": (*FINE, *ANGLES),
    **dict.fromkeys(ORIENTATIONS["quaternion"], ("",)),
    **dict.fromkeys(ZYX, (*ANGLES,)),
    # Robots give rotation vectors in either unit, so a name without one is not taken.
    **dict.fromkeys((*ORIENTATIONS["rotation vector"], "roll", "pitch", "yaw"), (*ANGLES,)),
}
NEEDS_UNIT = {*ORIENTATIONS["rotation vector"], *ORIENTATIONS["roll, pitch, yaw"]}
_OF_ROWS = re.compile(rf"({'|'.join(UNITS)})(?:_([a-z]+))?")
_OF_GROUPS = re.compile(rf"(.+?)_({'|'.join((*WEIGHTS, *POSITION, 'u'))})(?:_([a-z]+))?")


@dataclass(frozen=True, slots=True)
class Column:
    """A field: its place in a row, its name there, quantity, unit, and the reflector of its group.

    ``u`` of an angle is the quantity ``u_turn``; the group is "" for a column of whole rows.
    """

    place: int
    name: str
    quantity: str
    unit: str
    group: str = ""

    @classmethod
    def of(cls, place: int, field: str, name: str = "") -> Self | None:
        """The column that a field's name, or one of our ``name`` for it, means; else None."""
        plain = (name or field).strip().replace("\u00b0", "deg")
        for micro in "\u00b5\u03bc":
            plain = plain.replace(micro, "u")
        plain = re.sub(r"\s*[\[(]\s*(\w+)\s*[\])]$", r"_\1", plain)  # a unit in brackets
        lower = plain.lower()
        group, found = "", _OF_ROWS.fullmatch(lower)
        if found:
            quantity, unit = found.groups()
        elif found := _OF_GROUPS.fullmatch(lower):
            group, (_, quantity, unit) = plain[: found.end(1)], found.groups()
        else:
            return None
        if unit is None and quantity not in NEEDS_UNIT:
            unit = UNITS[quantity][0]
        if unit not in UNITS[quantity]:
            return None
        if quantity == "u" and unit in ANGLES:
            quantity = "u_turn"
        if quantity == "u_turn" and group:  # orientations are of whole rows
            return None
        return cls(place, field.strip(), quantity, unit, group)

    @property
    def scale(self) -> float:
        """Factor to mm, to rad, or of a joint to rad or m."""
        if self.unit in FINE:
            return FINE[self.unit] / (FINE["m"] if self.quantity in JOINTS else 1.0)
        return ANGLES.get(self.unit, 1.0)


ByQuantity = dict[str, Column]


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of whole rows, and of the groups of a wide list's reflectors, each by quantity.

    ``orientation``: kind of the rows' orientations, "" for none; ``ignored``: names not understood;
    ``width``: fields of a row.
    """

    own: ByQuantity
    groups: dict[str, ByQuantity]
    orientation: str
    ignored: list[str]
    width: int

    @classmethod
    def of(cls, header: Sequence[str], names: Mapping[str, str]) -> Self:
        """The columns of a header; ``names``: foreign names by ours. Raises `ValueError`."""
        found, ignored = _found(header, names)
        own = found.pop("", {})
        if {*POSITION} & {*own}:  # others are of other positions, such as nominal ones
            ignored += [each.name for group in found.values() for each in group.values()]
            found.clear()
        kinds = [kind for kind, each in ORIENTATIONS.items() if {*each} <= {*own}]
        orientation = kinds[0] if kinds else ""
        unused = ["anchor", "distance"] if found or {*POSITION} & {*own} else []
        unused += [] if kinds else ["u_turn"]
        for kind, quantities in ORIENTATIONS.items():
            bare = [each for each in quantities if each in own and own[each].name.lower() == each]
            unused += quantities if kind in kinds[1:] else bare if kind not in kinds else []
        ignored += [own.pop(each).name for each in unused if each in own]
        if missing := _missing(own, found):
            more = f"; not understood: {shortened(ignored)}" if ignored else ""
            raise ValueError(f"missing: {', '.join(missing)}{more}")
        _refuse_double(own, found)
        return cls(own, found, orientation, ignored, len(header))

    @property
    def joints(self) -> list[Column]:
        return [self.own[each] for each in JOINTS if each in self.own]

    @property
    def prismatic(self) -> tuple[int, ...]:
        """Rows of the arm, from 0, whose joints have a unit of length."""
        return tuple(n for n, each in enumerate(self.joints) if each.unit in LENGTHS)

    @property
    def of_numbers(self) -> list[int]:
        """Places of the columns of numbers."""
        return [each.place for each in self._all if each.quantity not in TEXTS]

    def understood(self) -> str:
        """Units, weights, orientation and ignored columns, for a person."""
        ranges = "distance" in self.own
        wanted = ["distance"] if ranges else POSITION
        places = [group[each] for group in self.groups.values() or [self.own] for each in wanted]
        weights = [each for each in self._all if each.quantity[0] == "u"]
        parts = [
            f"{len(self.joints)} joints {_in_units(self.joints)}",
            f"{'distances' if ranges else 'positions'} {_in_units(places)}",
        ]
        if self.orientation:
            turned = [self.own[each] for each in ORIENTATIONS[self.orientation]]
            parts.append(f"orientation: {self.orientation} {_in_units(turned)}".strip())
        if weights:
            parts.append(f"standard uncertainty: {shortened([each.name for each in weights])}")
        if self.ignored:
            parts.append(f"ignored columns: {shortened(self.ignored)}")
        return "; ".join(parts)

    @property
    def _all(self) -> list[Column]:
        return [each for group in (self.own, *self.groups.values()) for each in group.values()]


def read_names(text: str) -> dict[str, str]:
    """Foreign names of columns by ours, of ``ours=theirs,..`` or a TOML file; raises
    `SettingsError`.
    """
    source, names = "--columns", dict[str, object]()
    if "=" in text:
        pairs = (each.partition("=") for each in text.split(","))
        names |= {ours.strip(): theirs.strip() for ours, _, theirs in pairs}
    else:
        source = text
        try:
            names |= tomllib.loads(read_file(Path(text)).decode("utf-8-sig"))
        except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise SettingsError(source, [f"not valid TOML: {error}"]) from error
    problems, foreign = [], {}
    for ours, theirs in names.items():
        if Column.of(0, ours) is None:
            problems.append(f"expected a column such as x_mm, j1_deg or target, got {ours!r}")
        elif isinstance(theirs, str) and theirs:
            foreign[ours] = theirs
        else:
            problems.append(f"{ours}: expected a column of the list, got {theirs!r}")
    if problems:
        raise SettingsError(source, problems)
    return foreign


def shortened(names: Sequence[str]) -> str:
    most, longest = 8, 40
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(each[:longest] for each in names[:most]) + more


def _found(
    header: Sequence[str], names: Mapping[str, str]
) -> tuple[dict[str, ByQuantity], list[str]]:
    """Columns by group and quantity, and names not understood; raises `ValueError`."""
    fields = [field.strip() for field in header]
    ours = {}
    for name, theirs in names.items():
        if theirs not in fields:
            raise ValueError(f"{name}: no column {theirs!r} among {shortened(fields)}")
        ours[fields.index(theirs)] = name
    given = [column for name in names if (column := Column.of(0, name))]
    taken = {(each.group, each.quantity) for each in given}
    found, ignored = dict[str, ByQuantity](), list[str]()
    for place, field in enumerate(fields):
        column = Column.of(place, field, ours.get(place, ""))
        if column is None or (place not in ours and (column.group, column.quantity) in taken):
            ignored.append(field or f"column {place + 1}")
            continue
        first = found.setdefault(column.group, {}).setdefault(column.quantity, column)
        if first is not column:
            raise ValueError(f"{first.name} and {field} are one quantity; keep one of them")
    return found, ignored


def _missing(own: ByQuantity, groups: Mapping[str, ByQuantity]) -> list[str]:
    last = max((JOINTS.index(each) for each in JOINTS if each in own), default=0)
    wanted = [*JOINTS[: last + 1]]
    if not groups:
        wanted += () if "distance" in own else POSITION
    for quantities in ORIENTATIONS.values():
        wanted += quantities if {*quantities} & {*own} else ()
    missing = [_full(each) for each in wanted if each not in own]
    for name, group in groups.items():
        missing += [f"{name}_{_full(each)}" for each in POSITION if each not in group]
    return missing


def _full(quantity: str) -> str:
    return "_".join(filter(None, (quantity, UNITS[quantity][0])))


def _refuse_double(own: ByQuantity, groups: Mapping[str, ByQuantity]) -> None:
    turned = [own[each] for kind in ORIENTATIONS.values() for each in kind if each in own]
    if "distance" in own and turned:
        raise ValueError(f"{turned[0].name} of a distance: orientations need positions")
    if "target" in own and groups:
        raise ValueError(f"the rows ({own['target'].name}) and columns both name reflectors")
    for group in (own, *groups.values()):
        both = [group[each].name for each in WEIGHTS if "u" in group and each in group]
        if both:
            raise ValueError(f"{group['u'].name} and {both[0]} are one quantity; keep one of them")


def _in_units(columns: Iterable[Column]) -> str:
    names = dict[str, list[str]]()
    for each in columns:
        names.setdefault(each.unit, []).append(each.name)
    if len(names) == 1:
        return "".join(f"in {unit}" for unit in names if unit)
    return ", ".join(f"{shortened(each)} in {unit}" for unit, each in names.items())
