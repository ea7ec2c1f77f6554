"""Measured targets of ``hilcell fit``, and their lists.

Measurements need commanded joints: those read back from a moving robot spoil a fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import CsvText, numbers
from hilcell.fit.columns import ORIENTATIONS, POSITION, WEIGHTS, Column, Columns, shortened
from hilcell.fit.robot_file import Robot
from hilcell.fit.tables import read_table
from hilcell.geometry.frames import cross_matrix, from_rotvec, from_zyx, unit
from hilcell.geometry.kinematics import Array
from hilcell.identification.measured_poses import SAME_RAD, count_poses
from hilcell.sanitize import counted

REFLECTOR, ANCHOR = "SMR", "anchor"  # of lists that name none


@dataclass(frozen=True, eq=False)
class Measurements:
    """N measured targets: labels, joints (N, n) in rad, positions (N, 3) in the tracker's frame.

    Values of prismatic joints are m. Messages name the rows by ``source``, a file, and by their
    ``lines`` (N) in it. ``covariance_mm2`` (N, 3, 3): of the positions, where known; ``R``
    (N, 3, 3): orientations of the measured body in the tracker's frame, NaN where not measured, and
    ``u_rad`` (N,) their standard uncertainties, where known; ``turns`` (N, 3 or 4) the columns that
    they were read of, in rad.

    Of distances, ``distance_mm`` (N,) from fixed points named by ``anchor`` (N), positions are NaN
    until `hilcell.fit.ranges.Anchors` locates them; then they are known ``along`` (N, 3) alone,
    unit vectors.
    """

    pose: list[str]
    target: list[str]
    joints_rad: Array
    xyz_mm: Array
    source: str = "the measurements"
    lines: Sequence[int] = ()
    covariance_mm2: Array | None = None
    R: Array | None = None
    u_rad: Array | None = None
    anchor: Sequence[str] = ()
    distance_mm: Array | None = None
    along: Array | None = None
    turns: Array | None = None

    @classmethod
    def from_arrays(
        cls,
        joints_rad: ArrayLike,
        xyz_mm: ArrayLike,
        target: str | Sequence[str] = REFLECTOR,
        pose: Sequence[str] | None = None,
    ) -> Self:
        """Measurements from arrays: commanded joints (N, n), positions (N, 3).

        ``target`` names the reflector of all rows, or of each; ``pose`` (N) labels rows measured in
        one pose, each its own by default. Raises `ValueError`.
        """
        joints, xyz = np.array(joints_rad, dtype=float), np.array(xyz_mm, dtype=float)
        width = joints.shape[-1] if joints.ndim else 0
        for name, values, size in (("joints_rad", joints, width), ("xyz_mm", xyz, 3)):
            if values.shape != (len(joints), size) or not np.isfinite(values).all():
                raise ValueError(
                    f"{name}: expected finite numbers ({len(joints)}, {size}), got shape "
                    f"{values.shape}"
                )
        targets = [target] * len(joints) if isinstance(target, str) else list(target)
        poses = list(map(str, range(1, len(joints) + 1))) if pose is None else list(pose)
        for name, labels in (("target", targets), ("pose", poses)):
            if len(labels) != len(joints):
                raise ValueError(f"{name}: expected {len(joints)} labels, got {len(labels)}")
        return cls(poses, targets, joints, xyz)

    @classmethod
    def unmeasured(cls, joints_rad: Array, target: str) -> Self:
        """Rows of a reflector at joints (N, n) whose positions are to be predicted."""
        labels = list(map(str, range(len(joints_rad))))
        return cls(labels, [target] * len(labels), joints_rad, np.full((len(labels), 3), np.nan))

    def __len__(self) -> int:
        return len(self.pose)

    def where(self, rows: Iterable[int]) -> str:
        lines = sorted(self.lines[n] for n in rows) if self.lines else []
        if not lines:
            return self.source
        named = 5
        listed = ", ".join(map(str, lines[:named])) + ", .." * (len(lines) > named)
        return f"{self.source} line{'s' * (len(lines) > 1)} {listed}"

    def of(self, target: str) -> list[int]:
        return [n for n, each in enumerate(self.target) if each == target]

    def once(self) -> Measurements:
        """The rows without duplicates: no reading repeats joints and position exactly."""
        measured = self.xyz_mm if self.distance_mm is None else self.distance_mm
        values = np.column_stack([self.joints_rad, measured]).tolist()
        first: dict[tuple[object, ...], int] = {}
        for n, (target, row) in enumerate(zip(self.target, values, strict=True)):
            anchor = self.anchor[n] if self.anchor else ""
            first.setdefault((target, anchor, *row), n)
        return self.at(first.values())

    def at(self, rows: Iterable[int]) -> Measurements:
        chosen = list(rows)

        def taken(values: Array | None) -> Array | None:
            return None if values is None else values[chosen]

        return Measurements(
            [self.pose[n] for n in chosen],
            [self.target[n] for n in chosen],
            self.joints_rad[chosen],
            self.xyz_mm[chosen],
            self.source,
            [self.lines[n] for n in chosen] if self.lines else (),
            taken(self.covariance_mm2),
            taken(self.R),
            taken(self.u_rad),
            [self.anchor[n] for n in chosen] if self.anchor else (),
            taken(self.distance_mm),
            taken(self.along),
            taken(self.turns),
        )

    def within_turns(self, middles_rad: Array) -> Measurements:
        """The rows with joints at most half a turn from the middles (n,), where these are not NaN:
        an arm, and the errors of its gears, repeat each turn.
        """
        turn = 2.0 * np.pi
        turns = np.nan_to_num(np.round((self.joints_rad - middles_rad) / turn))
        return replace(self, joints_rad=self.joints_rad - turn * turns)

    def seen_mm(self, missed_mm: Array) -> Array:
        """The part of misses (N, 3) that the rows show: of distances, along them."""
        if self.along is None:
            return missed_mm
        return np.asarray(np.sum(missed_mm * self.along, axis=1, keepdims=True) * self.along)

    def seen_mm2(self, covariance_mm2: Array) -> Array:
        """The same of covariances (N, 3, 3)."""
        if self.along is None:
            return covariance_mm2
        seen = self.along[:, :, None] * self.along[:, None, :]
        return np.asarray(seen @ covariance_mm2 @ seen)

    def joined(self, others: Measurements) -> Measurements:
        """These rows and others, without their orientations."""
        if not len(others):
            return self
        covariances_mm2 = [
            np.zeros((len(each), 3, 3)) if each.covariance_mm2 is None else each.covariance_mm2
            for each in (self, others)
        ]
        return Measurements(
            [*self.pose, *others.pose],
            [*self.target, *others.target],
            np.concatenate([self.joints_rad, others.joints_rad]),
            np.concatenate([self.xyz_mm, others.xyz_mm]),
            covariance_mm2=np.concatenate(covariances_mm2),
        )

    @property
    def counted(self) -> str:
        """The counts of rows and poses, and the reflectors, as text."""
        parts = [counted(len(self), "row"), counted(count_poses(self.joints_rad), "pose")]
        for what, labels in (("reflector", self.target), ("anchor", self.anchor)):
            names = sorted(set(labels))
            if names:
                parts.append(f"{what}{'s' * (len(names) > 1)} {shortened(names)}")
        return ", ".join(parts)


def read_measurements(
    path: Path | str,
    columns: Mapping[str, str] | None = None,
    *,
    robot: Robot | None = None,
    say: Callable[[str], None] | None = None,
) -> Measurements:
    """Read measured targets, the list of ``hilcell fit --train``: CSV, XLSX or Parquet.

    Columns by name in any order (`docs/fit.md`): joints as commanded, positions in the tracker's
    frame. ``columns``: names of the list by ours; ``robot``: whose joints they must be; ``say``
    gets what was understood. Raises `SettingsError` naming the invalid lines.
    """
    path = Path(path)
    text, sheet = read_table(path)
    layout = _layout(path, text, columns or {})
    if robot is not None:
        _refuse_other_joints(path, layout, robot)
    text = text.with_decimal(
        path, lambda cells: [cells[n] for n in layout.of_numbers if n < len(cells)]
    )
    problems: list[str] = []
    found: list[_Row] = []
    for line, cells in text.rows[1:]:
        try:
            found += _rows(layout, text, line, cells) if cells else []
        except ValueError as error:
            problems.append(f"line {line}: {error}")
    seen = [row for row in found if any(row.measured_mm)]
    zeros = len(found) - len(seen)  # some trackers write 0, 0, 0 for a reflector out of sight
    if not (seen or problems):
        problems.append("no measured target follows the header")
    if problems:
        raise SettingsError(str(path), problems)
    rows = _measurements(seen, layout, str(path))
    if say is not None:
        blank = len(text.rows) - 1 - len({row.line for row in seen})
        unseen = f" ({counted(blank, 'line')} without a measurement)" if blank else ""
        sheet = f"{sheet}: " if sheet else ""
        unseen += f" ({counted(zeros, 'position')} 0, 0, 0 taken as not seen)" if zeros else ""
        say(f"{path}: {sheet}{rows.counted}{unseen}; {layout.understood()}")
        for warning in _reused(rows):
            say(warning)
    return rows


def _reused(rows: Measurements) -> Iterator[str]:
    """Yield a warning where labels of poses are of several joints."""
    joints = dict[str, Array]()
    for n, pose in enumerate(rows.pose):
        first = joints.setdefault(pose, rows.joints_rad[n])
        if not np.abs(rows.joints_rad[n] - first).max() <= SAME_RAD:
            where = rows.where([n])
            yield (
                f"warning: {where}: pose {pose} has other joints than before; rows of equal joints "
                "are a pose, whatever its label"
            )
            return


class _Row(NamedTuple):
    """A reading of a list, in mm and rad: a position or a distance; ``turn`` by the columns of its
    orientation.
    """

    line: int
    pose: str
    target: str
    joints: list[float]
    measured_mm: list[float]
    u_mm: list[float]
    turn: list[float]
    u_rad: float
    anchor: str


def _layout(path: Path, text: CsvText, names: Mapping[str, str]) -> Columns:
    """The columns of the header; raises `SettingsError`."""
    header = text.header
    try:
        return Columns.of(header, names)
    except ValueError as error:
        line, problem = text.rows[0][0] if text.rows else 1, str(error)
    if not text.rows:
        problem = "expected a header, got an empty file"
    elif any("\t" in each for each in header):
        problem = "fields are separated by tabs; save it with commas or semicolons"
    for below, cells in text.rows[1:20]:
        with suppress(ValueError):
            Columns.of(cells, names)
            problem = f"the header is in line {below}; remove the lines before it"
            break
    raise SettingsError(str(path), [f"line {line}: {problem}"])


def _refuse_other_joints(path: Path, columns: Columns, robot: Robot) -> None:
    if columns.prismatic == robot.arm.prismatic and len(columns.joints) == len(robot.arm):
        return
    got = shortened([each.name for each in columns.joints])
    raise SettingsError(
        str(path), [f"expected joints {shortened(robot.joint_columns)} of {robot.name}, got {got}"]
    )


def _rows(columns: Columns, text: CsvText, line: int, cells: list[str]) -> list[_Row]:
    """The readings of a line: one, one a reflector of a wide list, or none that was seen."""
    if len(cells) != columns.width:
        more = text.surplus(len(cells), columns.width)
        raise ValueError(f"{len(cells)} fields, expected {columns.width}{more}")
    own = columns.own
    values = _Values(cells, text.decimal)
    pose = values.label(own["pose"]) if "pose" in own else ""
    joints = values.all(columns.joints)
    turned = [own[each] for each in ORIENTATIONS.get(columns.orientation, ())]
    turn = values.all(turned) if values.given(turned) else []
    quaternion, longest = 4, 0.01
    if len(turn) == quaternion and not abs(math.hypot(*turn) - 1.0) <= longest:
        raise ValueError(f"quaternion of length {math.hypot(*turn):.4g}, expected 1")
    u_rad = values.u(own["u_turn"]) if turn and "u_turn" in own else math.nan
    rows = []
    of_range = "distance" in own
    anchor = values.label(own["anchor"]) if "anchor" in own else ANCHOR
    for name, group in columns.groups.items() or [("", own)]:
        places = [own["distance"]] if of_range else [group[each] for each in POSITION]
        if not values.given(places):
            continue
        target = name or (values.label(own["target"]) if "target" in own else REFLECTOR)
        weights = group if {"u", *WEIGHTS} & {*group} else own
        u_mm = [values.u(weights.get(each, weights.get("u"))) for each in WEIGHTS]
        measured = values.all(places)
        if of_range and not measured[0] > 0.0:
            raise ValueError(f"{places[0].name} is {measured[0]:g}, expected more than 0")
        rows.append(_Row(line, pose, target, joints, measured, u_mm, turn, u_rad, anchor))
        if any(measured):
            turn = []  # of a wide list's pose: it counts once
    return rows


@dataclass(frozen=True, slots=True)
class _Values:
    """Values of a line's columns; each raises `ValueError`."""

    cells: list[str]
    decimal: str

    def given(self, columns: Sequence[Column]) -> bool:
        return any(self.cells[each.place].strip() for each in columns)

    def label(self, column: Column) -> str:
        label = self.cells[column.place].strip()
        if not label:
            raise ValueError(f"{column.name} is empty")
        return label

    def all(self, columns: Sequence[Column]) -> list[float]:
        names, cells = [each.name for each in columns], [self.cells[each.place] for each in columns]
        values = numbers(names, cells, self.decimal)
        return [value * each.scale for value, each in zip(values, columns, strict=True)]

    def u(self, column: Column | None) -> float:
        """A standard uncertainty; NaN where none is given."""
        if column is None:
            return math.nan
        value = self.all([column])[0]
        if not value > 0.0:
            raise ValueError(f"{column.name} is {value:g}, expected more than 0")
        return value


def _measurements(rows: list[_Row], columns: Columns, source: str) -> Measurements:
    u_mm, R, turns = np.array([row.u_mm for row in rows]), None, None
    measured_mm, of_range = np.array([row.measured_mm for row in rows]), "distance" in columns.own
    first: dict[tuple[float, ...], int] = {}
    if columns.orientation:
        size = len(ORIENTATIONS[columns.orientation])
        turns = np.array([row.turn or [math.nan] * size for row in rows])
        R = rotations(columns.orientation, turns)
    return Measurements(
        [row.pose or str(first.setdefault(tuple(row.joints), row.line)) for row in rows],
        [row.target for row in rows],
        np.array([row.joints for row in rows]),
        np.full((len(rows), 3), np.nan) if of_range else measured_mm,
        source,
        [row.line for row in rows],
        covariance_mm2=None if np.isnan(u_mm).any() else u_mm[:, :, None] ** 2 * np.eye(3),
        R=R,
        u_rad=np.array([row.u_rad for row in rows]) if "u_turn" in columns.own else None,
        anchor=[row.anchor for row in rows] if of_range else (),
        distance_mm=measured_mm[:, 0] if of_range else None,
        turns=turns,
    )


def rotations(kind: str, values: Array) -> Array:
    """Rotations (N, 3, 3) by a kind of `ORIENTATIONS`, of values (N, 3 or 4) in rad; NaN stays."""
    match kind:
        case "rotation vector":
            return from_rotvec(values)
        case "quaternion":
            q = unit(values)
            K = cross_matrix(q[:, 1:])
            return np.asarray(np.eye(3) + 2.0 * (q[:, 0, None, None] * K + K @ K))
        case "roll, pitch, yaw":
            values = values[:, ::-1]
    return from_zyx(np.degrees(values))
