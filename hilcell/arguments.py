"""Signatures of commands: classes whose fields are the arguments, and the readers of their texts.

A field is ``seed: int = option("of random targets", "N", seed_of, default=1)``; the class is the
signature from which `hilcell.commands.parser` makes the parser. Readers raise
`argparse.ArgumentTypeError`.
"""

from __future__ import annotations

import argparse
import math
import re
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self, TypeVar, cast, dataclass_transform, get_type_hints

from hilcell.sanitize import LONGEST, clean

T = TypeVar("T")
MISSING: Any = object()  # a default that there is not


class Argument(NamedTuple):
    """An argument of a command line, as `option` declares it: its field's name, type and default.

    A field of ``bool`` is a switch, a tuple may be given repeatedly, a `Literal` is a choice.
    ``flags`` take the place of the field's name, and ``switches`` that of a choice's option: their
    help by word. A ``word`` is given by its place. `MISSING` is no default.
    """

    help: str
    metavar: str | None
    read: Callable[[str], object]
    default: object
    flags: tuple[str, ...]
    word: bool
    required: bool
    switches: Mapping[str, str]
    name: str = ""
    kind: object = str

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of an option, or of the switches of a choice."""
        if self.switches:
            return tuple(f"--{word}" for word in self.switches)
        return self.flags or (f"--{self.name.replace('_', '-')}",)

    @property
    def needed(self) -> bool:
        """Whether it must be given."""
        return self.required and self.default is MISSING


def option(
    help: str = "",  # noqa: A002 - as argparse has it
    metavar: str | None = None,
    read: Callable[[str], object] = str,
    *,
    default: T = MISSING,
    flags: tuple[str, ...] = (),
    word: bool = False,
    required: bool = True,
    switches: Mapping[str, str] = MappingProxyType({}),
) -> T:
    """Declare a field of a signature, an `Argument`; for type checkers it is the field's value."""
    declared = Argument(help, metavar, read, default, flags, word, required, switches)
    return cast("T", declared)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(option,))
class Signature:
    """A frozen dataclass of keywords; `dataclasses` itself would double the time of `--help`."""

    def __init__(self, **values: object) -> None:
        of = type(self)
        names = [name for each in of.__mro__ for name in vars(each).get("__annotations__", ())]
        declared = {name: getattr(of, name, MISSING) for name in names}
        defaults = {
            name: each.default if isinstance(each, Argument) else each
            for name, each in declared.items()
        }
        given = {name: each for name, each in defaults.items() if each is not MISSING}
        vars(self).update(given | values)
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
            if field.word:
                words.append(written(value))
            elif value is True:
                options.append(field.names[0])
            elif field.switches:
                options.append(f"--{value}")
            else:
                given = value if isinstance(value, tuple) else (value,)
                options += [f"{field.names[0]}={written(each)}" for each in given]
        return [*words, *options]


def fields_of(takes: type[Signature]) -> Iterator[Argument]:
    """Yield the fields of a signature, and of the signatures that are its fields."""
    for name, kind in get_type_hints(takes).items():
        if is_signature(kind):
            yield from fields_of(kind)
        else:
            yield getattr(takes, name)._replace(name=name, kind=kind)


def is_signature(hint: object) -> bool:
    return isinstance(hint, type) and issubclass(hint, Signature)


OUTPUT = ("-o", "--output")
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

CELL = option("a built-in name or a TOML path (default: paper, simulated)", "CELL", default="paper")
SETTINGS = option(
    "override one value of the cell file; may be repeated",
    "KEY=VALUE",
    assignment,
    default=(),
    flags=("--set",),
)
MACHINE_SEED = option(
    "of the simulated machine: robot, rail, tracker (default: the seed; where a run uses a "
    "calibration, that of the calibrated machine)",
    "N",
    seed_of,
    default=None,
)
NOTED = option("kept in the journal", "NAME", noted, default="")
RUNS_HELP = "folder of runs (default: HILCELL_RUNS, or one for each user)"
RUNS: Path = option(RUNS_HELP, "DIR", folder, required=False)
RUN: str = option("a run's name, its beginning, or `last`", "RUN", word=True)
JSON = option("print JSON: one object", default=False)
JSON_LINES = option("print JSON: one event a line, as journalled", default=False)
OUT_OF_TOLERANCE = option(
    "use a calibration whose validation failed, was not made or had another tolerance",
    default=False,
)
NOT_CURRENT = option("use a calibration that is revoked, superseded or out of date", default=False)
TOOL = option(
    "the tool of the cell file at whose tip they are given, or `reflector` (default: the "
    "cell's only tool; the reflector where it has none)",
    "NAME",
    default="",
)
BOUNDS = option(
    "also write the 95 % bound of each target's error, and u of its coordinates",
    "FILE.csv",
    default="",
)
