"""Signatures of commands: classes whose fields are the arguments, and the readers of their texts.

A field is ``seed: Annotated[int, Argument("of random targets", "N", seed_of)] = 1``; the class is
the signature from which `hilcell.commands.parser` makes the parser. Readers raise
`argparse.ArgumentTypeError`.
"""

from __future__ import annotations

import argparse
import math
import re
import unicodedata
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple, Self, dataclass_transform, get_args, get_type_hints

from hilcell.clean import LONGEST, clean


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Signature:
    """A frozen dataclass of keywords; `dataclasses` itself would double the time of `--help`."""

    def __init__(self, **values: object) -> None:
        of = type(self)
        names = [name for each in of.__mro__ for name in vars(each).get("__annotations__", ())]
        defaults = {name: getattr(of, name) for name in names if hasattr(of, name)}
        vars(self).update(defaults | values)
        if vars(self).keys() != {*names}:
            raise TypeError(f"{of.__name__}: expected {', '.join(names)}, got {', '.join(values)}")

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__}.{name} cannot be changed")

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment] # as of any class that is compared by values

    def replace(self, **changes: object) -> Self:
        return type(self)(**(vars(self) | changes))

    @property
    def values(self) -> dict[str, object]:
        """Return the values by name, with those of signatures that are fields."""
        found: dict[str, object] = {}
        for name, value in vars(self).items():
            found |= value.values if isinstance(value, Signature) else {name: value}
        return found

    def words(self) -> list[str]:
        """Return the command line that is read as this, without the command's name."""
        values, words, options = self.values, list[str](), list[str]()
        for field in fields_of(type(self)):
            value = values[field.name]
            if value == field.default:
                continue
            if field.is_word:
                words.append(written(value))
            elif value is True:
                options.append(field.names[0])
            elif isinstance(field.argument, Switches):
                options.append(f"--{value}")
            else:
                given = value if isinstance(value, tuple) else (value,)
                options += [f"{field.names[0]}={written(each)}" for each in given]
        return [*words, *options]


class Argument(NamedTuple):
    """An option, or a ``word`` of the command line, read by ``read``.

    A field of ``bool`` is a switch, a tuple may be given repeatedly, a `Literal` is a choice. It is
    ``required`` where the field has no default. ``names`` take the place of the field's name.
    """

    help: str
    metavar: str | None = None
    read: Callable[[str], object] = str
    names: tuple[str, ...] = ()
    word: bool = False
    required: bool = True


Word = partial(Argument, word=True)
Output = partial(Argument, names=("-o", "--output"))


class Switches(NamedTuple):
    """A choice by one switch of several: their help by name."""

    help: dict[str, str]


MISSING = object()  # a default that there is not


class Field(NamedTuple):
    """A field of a signature: how it is given, its type, and its default, `MISSING` for none."""

    name: str
    kind: object
    argument: Argument | Switches
    default: object

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of an option, or of the switches of a choice."""
        if isinstance(self.argument, Switches):
            return tuple(f"--{word}" for word in self.argument.help)
        return self.argument.names or (f"--{self.name.replace('_', '-')}",)

    @property
    def is_word(self) -> bool:
        """Whether it is given by its place, without a name."""
        return isinstance(self.argument, Argument) and self.argument.word

    @property
    def needed(self) -> bool:
        """Whether it must be given."""
        return getattr(self.argument, "required", True) and self.default is MISSING


def fields_of(takes: type[Signature]) -> Iterator[Field]:
    """Yield the fields of a signature, and of the signatures that are its fields."""
    for name, hint in get_type_hints(takes, include_extras=True).items():
        if is_signature(hint):
            yield from fields_of(hint)
        else:
            kind, argument = get_args(hint)
            yield Field(name, kind, argument, getattr(takes, name, MISSING))


def is_signature(hint: object) -> bool:
    return isinstance(hint, type) and issubclass(hint, Signature)


STROKE_MM = 20.0
SIMULATED = ("rail", "robot", "tracker", "control")
# For the help: headers of `hilcell.compensation.targets` and `hilcell.programs.holes`.
TARGETS = "name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg"
HOLES = f"holes in {{W}}, header name,x_mm,y_mm,z_mm,nx,ny,nz; or targets, header {TARGETS}"


def written(value: object) -> str:
    if isinstance(value, tuple):
        return "=".join(map(str, value))
    return "max" if value == math.inf else str(value)


def _reader(fits: Callable[[float], bool], expected: str) -> Callable[[str], float]:
    """Return the reader of a number that fits; any other text is refused."""

    def read(text: str) -> float:
        with suppress(ValueError):
            if fits(value := float(text)):
                return value
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text[:80]!r}")

    return read


def _length(name: str, most_mm: float) -> Callable[[str], float]:
    return _reader(lambda mm: 0.0 < mm <= most_mm, f"{name} above 0 up to {most_mm:g} mm")


finite = _reader(math.isfinite, "a finite number")
days = _reader(lambda value: 0 <= value <= 36_500, "days of 0 .. 36500")
stroke, stroke_tolerance_of = _length("a length", 200.0), _length("a tolerance", 5.0)
standoff_of = _length("a stand-off", 1000.0)  # as in hilcell.cell.robot
_factor = _reader(
    lambda value: 1 <= value <= 1e6,
    "a factor of 1 .. 1e+06, or max (not slower than real time, in which the devices' watchdogs "
    "run)",
)


def speed_of(text: str) -> float:
    """Return a factor of real time, infinite for ``max``."""
    return math.inf if text == "max" else _factor(text)


def _whole(least: int, most: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        short = len(text) <= len(str(most))
        value = int(text) if text.isascii() and text.isdecimal() and short else -1
        if least <= value <= most:
            return value
        expected = f"a whole number of {least} .. {most}"
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text[:80]!r}")

    return read


seed_of, workers_of = _whole(0, 2**63 - 1), _whole(1, 1024)


def ports_of(text: str) -> dict[str, int]:
    """Return ports by the name of the simulated device."""
    found: dict[str, int] = {}
    for word in text.split(","):
        name, _, port = word.partition("=")
        number = int(port) if port.isascii() and port.isdecimal() and len(port) < 6 else 0
        if number and number in found.values():
            raise argparse.ArgumentTypeError(f"port {number} is given twice; each needs its own")
        if name not in SIMULATED or name in found or not 1 <= number <= 65535:
            raise argparse.ArgumentTypeError(
                f"expected rail=PORT,robot=PORT,... of {', '.join(SIMULATED)}, each once, with "
                f"ports of 1 .. 65535, got {word[:80]!r}"
            )
        found[name] = number
    return found


def run_name(text: str) -> str:
    """Return a name that a folder can have, in letters of any language."""
    text = unicodedata.normalize("NFC", text)
    if text == "last":
        raise argparse.ArgumentTypeError("'last' is reserved: it names the newest run")
    if not re.fullmatch(r"[^\W_][\w.-]{0,99}", text):
        raise argparse.ArgumentTypeError(
            "expected 1 to 100 letters, digits, '_', '.' and '-', the first a letter or digit, "
            f"got {text[:80]!r}"
        )
    return text


def noted(text: str) -> str:
    """Return words as a journal keeps them."""
    if len(text) > LONGEST:
        raise argparse.ArgumentTypeError(f"expected at most {LONGEST} characters, got {len(text)}")
    return clean(text)


def reason(text: str) -> str:
    """Return words that say why."""
    if not (found := noted(text)):
        raise argparse.ArgumentTypeError("expected words that say why, got none")
    return found


def folder(text: str) -> Path:
    return Path(name(text))


def name(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("expected a name, got ''")
    return text


def moment(text: str) -> datetime:
    """Return a time with its zone, local where it states none; a date is its beginning."""
    try:
        return datetime.fromisoformat(text).astimezone()
    except (ValueError, OverflowError, OSError):
        raise argparse.ArgumentTypeError(
            f"expected a date like 2026-11-22, or 2026-11-22T14:00, got {text[:80]!r}"
        ) from None


def assignment(text: str) -> tuple[str, str]:
    key, sign, value = text.partition("=")
    if not (key and sign) or "\n" in text:
        raise argparse.ArgumentTypeError(f"expected KEY=VALUE on one line, got {text[:80]!r}")
    return key.strip(), value.strip()


def scheduler_of(text: str) -> str:
    if not re.fullmatch(r"(?:tcp|tls)://(?:[\w.-]+|\[[\da-fA-F:.]+\]):\d{1,5}", text):
        raise argparse.ArgumentTypeError(f"expected tcp://HOST:PORT, got {clean(text[:80])!r}")
    return text


# -- arguments of several commands -----------------------------------------------------------------

CellName = Annotated[
    str, Argument("a built-in name or a TOML path (default: paper, simulated)", "CELL")
]
Settings = Annotated[
    tuple[tuple[str, str], ...],
    Argument("override one value of the cell file; may be repeated", "KEY=VALUE", assignment,
             names=("--set",)),
]  # fmt: skip
MachineSeed = Annotated[
    int | None,
    Argument(
        "of the simulated machine: robot, rail, tracker (default: the seed; where a run uses a "
        "calibration, that of the calibrated machine)",
        "N",
        seed_of,
    ),
]
Noted = Annotated[str, Argument("kept in the journal", "NAME", noted)]
RUNS = "folder of runs (default: HILCELL_RUNS, or one for each user)"
Runs = Annotated[Path, Argument(RUNS, "DIR", folder, required=False)]
RunName = Annotated[str, Word("a run's name, its beginning, or `last`", "RUN")]
Json = Annotated[bool, Argument("print JSON: one object")]
JsonLines = Annotated[bool, Argument("print JSON: one event a line, as journalled")]
OutOfTolerance = Annotated[
    bool,
    Argument("use a calibration whose validation failed, was not made or had another tolerance"),
]
NotCurrent = Annotated[
    bool, Argument("use a calibration that is revoked, superseded or out of date")
]
ToolName = Annotated[
    str,
    Argument(
        "the tool of the cell file at whose tip they are given, or `reflector` (default: the "
        "cell's only tool; the reflector where it has none)",
        "NAME",
    ),
]
Bounds = Annotated[
    str,
    Argument(
        "also write the 95 % bound of each target's error, and u of its coordinates", "FILE.csv"
    ),
]
