"""Arguments of commands, declared as the fields of a class, and the parsers of their values.

A field is ``seed: int = option("seed of the targets", "N", parse_seed, default=1)``; from its class
`hilcell.commands.parser` builds the parser of the command. Parsers of values raise
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

from hilcell.sanitize import LONGEST, clean, encodable

T = TypeVar("T")
MISSING: Any = object()  # no default
RESERVED = {"last": "the newest run", "current": "the current calibration"}


class Argument(NamedTuple):
    """An argument of a command line, as `option` declares it, with its field's name and type.

    A field of ``bool`` is a switch, a tuple may be repeated, a `Literal` is a choice. ``flags``
    replace the field's name. ``switches`` replace the option of a choice: help by value. A
    ``positional`` argument has no option. `MISSING` is no default.
    """

    help: str
    metavar: str | None
    parse: Callable[[str], object]
    default: object
    flags: tuple[str, ...]
    positional: bool
    required: bool
    switches: Mapping[str, str]
    name: str = ""
    kind: object = str

    @property
    def names(self) -> tuple[str, ...]:
        """The names of an option, or of the switches of a choice."""
        if self.switches:
            return tuple(f"--{value}" for value in self.switches)
        return self.flags or (f"--{self.name.replace('_', '-')}",)

    @property
    def must_be_given(self) -> bool:
        return self.required and self.default is MISSING


def option(
    help: str = "",  # noqa: A002 - argparse's name
    metavar: str | None = None,
    parse: Callable[[str], object] = str,
    *,
    default: T = MISSING,
    flags: tuple[str, ...] = (),
    positional: bool = False,
    required: bool = True,
    switches: Mapping[str, str] = MappingProxyType({}),
) -> T:
    """Declare a field of a signature, an `Argument`; type checkers see the field's value."""
    declared = Argument(help, metavar, parse, default, flags, positional, required, switches)
    return cast("T", declared)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(option,))
class Signature:
    """A frozen dataclass of keywords; `dataclasses` itself would double the time of `--help`."""

    def __init__(self, **values: object) -> None:
        cls = type(self)
        names = [name for each in cls.__mro__ for name in vars(each).get("__annotations__", ())]
        declared = {name: getattr(cls, name, MISSING) for name in names}
        defaults = {
            name: each.default if isinstance(each, Argument) else each
            for name, each in declared.items()
        }
        given = {name: each for name, each in defaults.items() if each is not MISSING}
        vars(self).update(given | values)
        if vars(self).keys() != {*names}:
            raise TypeError(f"{cls.__name__}: expected {', '.join(names)}, got {', '.join(values)}")

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__}.{name} cannot be changed")

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    __hash__ = None  # type: ignore[assignment] # compared by value

    def replace(self, **changes: object) -> Self:
        return type(self)(**(vars(self) | changes))

    @property
    def values(self) -> dict[str, object]:
        """The values by name, with those of signatures that are fields."""
        flat: dict[str, object] = {}
        for name, value in vars(self).items():
            flat |= value.values if isinstance(value, Signature) else {name: value}
        return flat

    def command_line(self) -> list[str]:
        """Return the words that parse as this signature, without the command's name."""
        values, positional, options = self.values, list[str](), list[str]()
        for field in arguments_of(type(self)):
            value = values[field.name]
            if value == field.default:
                continue
            if field.positional:
                positional.append(argument_text(value))
            elif value is True:
                options.append(field.names[0])
            elif field.switches:
                options.append(f"--{value}")
            else:
                given = value if isinstance(value, tuple) else (value,)
                options += [f"{field.names[0]}={argument_text(each)}" for each in given]
        return [*positional, *options]


def arguments_of(signature: type[Signature]) -> Iterator[Argument]:
    """Yield the fields of a signature, and of the signatures that are its fields."""
    for name, kind in get_type_hints(signature).items():
        if is_signature(kind):
            yield from arguments_of(kind)
        else:
            yield getattr(signature, name)._replace(name=name, kind=kind)


def is_signature(hint: object) -> bool:
    return isinstance(hint, type) and issubclass(hint, Signature)


def argument_text(value: object) -> str:
    if isinstance(value, tuple):
        return "=".join(map(str, value))
    return "max" if value == math.inf else str(value)


# -- parsers of values -----------------------------------------------------------------------------


def _number(accepts: Callable[[float], bool], expected: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        with suppress(ValueError):
            if accepts(value := float(text)):
                return value
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text[:80]!r}")

    return parse


def _length(name: str, longest_mm: float) -> Callable[[str], float]:
    return _number(lambda mm: 0.0 < mm <= longest_mm, f"{name} above 0 up to {longest_mm:g} mm")


parse_finite = _number(math.isfinite, "a finite number")
parse_days = _number(lambda value: 0 <= value <= 36_500, "days of 0 .. 36500")
parse_stroke_mm = _length("a length", 200.0)
parse_stroke_tolerance_mm = _length("a tolerance", 5.0)
parse_standoff_mm = _length("a stand-off", 1000.0)  # as in hilcell.cell.robot
_parse_factor = _number(
    lambda value: 1 <= value <= 1e6,
    "a factor of 1 .. 1e+06 or max (watchdogs of devices run in real time, so no factor below 1)",
)


def parse_speed(text: str) -> float:
    """Return a factor of real time, infinite for ``max``."""
    return math.inf if text == "max" else _parse_factor(text)


def _whole(least: int, most: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        short = len(text) <= len(str(most))
        value = int(text) if text.isascii() and text.isdecimal() and short else -1
        if least <= value <= most:
            return value
        expected = f"a whole number of {least} .. {most}"
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text[:80]!r}")

    return parse


parse_seed, parse_workers = _whole(0, 2**63 - 1), _whole(1, 1024)
parse_port = _whole(1, 65535)


def parse_ports(text: str) -> dict[str, int]:
    devices, ports = ("rail", "robot", "tracker", "control"), dict[str, int]()
    for word in text.split(","):
        name, _, port = word.partition("=")
        number = int(port) if port.isascii() and port.isdecimal() and len(port) < 6 else -1
        if number and number in ports.values():
            raise argparse.ArgumentTypeError(f"port {number} is given twice")
        if name not in devices or name in ports or not 0 <= number <= 65535:
            raise argparse.ArgumentTypeError(
                f"expected rail=PORT,robot=PORT,... of {', '.join(devices)}, each once, with "
                f"ports of 0 .. 65535, got {word[:80]!r}"
            )
        ports[name] = number
    return ports


def parse_run_name(text: str) -> str:
    """Return a valid name of a folder, in letters of any language."""
    text = unicodedata.normalize("NFC", text)
    if text in RESERVED:
        raise argparse.ArgumentTypeError(f"{text!r} is reserved for {RESERVED[text]}")
    if not re.fullmatch(r"[^\W_][\w.-]{0,99}", text):
        raise argparse.ArgumentTypeError(
            "expected 1 to 100 letters, digits, '_', '.' and '-', the first a letter or digit, "
            f"got {text[:80]!r}"
        )
    return text


def parse_note(text: str) -> str:
    if len(text) > LONGEST:
        raise argparse.ArgumentTypeError(f"expected at most {LONGEST} characters, got {len(text)}")
    if encodable(text) != text:
        raise argparse.ArgumentTypeError(f"expected UTF-8 text, got {text!a}")
    return clean(text)


def parse_reason(text: str) -> str:
    if not (reason := parse_note(text)):
        raise argparse.ArgumentTypeError("must not be empty")
    return reason


def parse_name(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("expected a name, got ''")
    return text


def parse_folder(text: str) -> Path:
    return Path(parse_name(text))


def parse_time(text: str) -> datetime:
    """Return a time with its zone, local by default; a date is its first moment."""
    try:
        return datetime.fromisoformat(text).astimezone()
    except (ValueError, OverflowError, OSError):
        raise argparse.ArgumentTypeError(
            f"expected a date like 2026-11-22 or 2026-11-22T14:00, got {text[:80]!r}"
        ) from None


def parse_setting(text: str) -> tuple[str, str]:
    key, sign, value = text.partition("=")
    if not (key and sign) or "\n" in text:
        raise argparse.ArgumentTypeError(f"expected KEY=VALUE on one line, got {text[:80]!r}")
    return key.strip(), value.strip()


def parse_scheduler(text: str) -> str:
    if not re.fullmatch(r"(?:tcp|tls)://(?:[\w.-]+|\[[\da-fA-F:.]+\]):\d{1,5}", text):
        raise argparse.ArgumentTypeError(f"expected tcp://HOST:PORT, got {clean(text[:80])!r}")
    return text


# -- arguments of several commands -----------------------------------------------------------------

CELL = option("built-in cell or cell file (default: paper, simulated)", "CELL", default="paper")
SETTINGS = option(
    "override one value of the cell file; repeatable",
    "KEY=VALUE",
    parse_setting,
    default=(),
    flags=("--set",),
)
MACHINE_SEED = option(
    "seed of the simulated machine: robot, rail, tracker (default: that of the calibration in use, "
    "else --seed)",
    "N",
    parse_seed,
    default=None,
)
NOTED = option("recorded in the journal", "NAME", parse_note, default="")
RUNS_HELP = "folder of runs (default: HILCELL_RUNS, else the user's)"
RUNS: Path = option(RUNS_HELP, "DIR", parse_folder, required=False)
RUN: str = option("name of the run, its beginning, or `last`", "RUN", positional=True)
JSON = option("print one JSON object", default=False)
JSON_LINES = option("print each event as a line of JSON, as in the journal", default=False)
OUT_OF_TOLERANCE = option(
    "use a calibration that was validated out of tolerance, against another tolerance, or not at "
    "all",
    default=False,
)
NOT_CURRENT = option("use a calibration that is revoked, superseded or out of date", default=False)
OUTPUT = ("-o", "--output")
STROKE_MM = 20.0  # default of --allow-stroke
# For the help: headers of `hilcell.compensation.targets` and `hilcell.programs.holes`.
TARGETS = "name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg"
HOLES = f"holes in {{W}}, header name,x_mm,y_mm,z_mm,nx,ny,nz; or targets, header {TARGETS}"
TOOL = option(
    "tool of the cell file whose tip the targets refer to, or `reflector` (default: the cell's "
    "only tool, else the reflector)",
    "NAME",
    default="",
)
BOUNDS = option(
    "also write the 95 % bound of each target's error, and u of its coordinates",
    "FILE.csv",
    default="",
)
