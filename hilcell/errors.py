"""The errors of hilcell: facts as data, which become one clear message only where one is shown.

Every error has the code of its entry in the catalogue of alarms (`hilcell.alarms`), and the exit
code that a run or a command ends with by it. Apart from `hilcell.ports`, so that an error can be
shown without loading arrays.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from traceback import extract_tb
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hilcell.decoding import Json


# Exit codes of commands and runs: how they ended.
EXIT_OK, EXIT_OUT_OF_TOLERANCE, EXIT_REFUSED, EXIT_FAULT = 0, 1, 2, 3
EXIT_ABORTED, EXIT_INTERNAL, EXIT_LOCKED, EXIT_STORAGE = 4, 5, 6, 7
DONE = (EXIT_OK, EXIT_OUT_OF_TOLERANCE)  # the run came to its end
RESUMABLE = (EXIT_FAULT, EXIT_ABORTED, EXIT_INTERNAL, EXIT_STORAGE)

MAX_LISTED = 10


def bounded(lines: Iterable[str], count: int | None = None, most: int = MAX_LISTED) -> list[str]:
    """Return the first lines of a list, and how many more there are of ``count``, or of its own."""
    listed = list(lines)
    more = (len(listed) if count is None else count) - most
    return [*listed[:most], *([f"and {more} more"] if more > 0 else [])]


def indented(lines: Iterable[str], count: int | None = None, most: int = MAX_LISTED) -> str:
    """Return the lines of `bounded` as text, each indented."""
    return "\n".join(f"  {each}" for each in bounded(lines, count, most))


def one_line(error: BaseException) -> str:
    """Return type and message of an unexpected error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def with_location(error: BaseException) -> str:
    """Return `one_line`, with the file and the line that raised the error."""
    steps = [step for step in extract_tb(error.__traceback__) if step.filename[:1] != "<"]
    at = steps[-1:]
    return one_line(error) + "".join(f" ({Path(s.filename).name}, line {s.lineno})" for s in at)


class HilcellError(Exception):
    """Anything that hilcell reports to its user in one clear message.

    ``code`` is its entry in the catalogue of alarms, ``exit_code`` what a run or a command ends
    with by it; a class may have one for all its errors.
    """

    code = "HC-C99"
    exit_code = EXIT_REFUSED

    def __init__(self, text: str = "", *, code: str = "") -> None:
        super().__init__(text)
        self.code = code or self.code

    def facts(self) -> Json:
        """Return the error as the journal records it, in JSON types."""
        return {"code": self.code, "found": str(self)}


class StoreUnavailable(HilcellError):
    """A store outside this PC cannot be used now; the same command may succeed later."""

    exit_code = EXIT_STORAGE


class DriverDefect(HilcellError):
    """A driver broke the contract of its port: a defect of the driver."""

    code = "HC-C07"
    exit_code = EXIT_INTERNAL

    def __init__(self, device: str, found: str) -> None:
        super().__init__(f"{device}: {found}; a defect of its driver, please report it there")


class Stopped(HilcellError):
    """The operator, or the program's end, asked everything to stop."""

    code = "HC-C05"
    exit_code = EXIT_ABORTED


class DeviceError(HilcellError):
    """A device failed: its code, the device, the operation, found and expected value, next act.

    ``fields`` are the values of its text, for programs: plain, with units in their names.
    ``causes`` are the errors of several devices that failed together.
    """

    exit_code = EXIT_FAULT

    def __init__(
        self,
        code: str,
        device: str,
        operation: str,
        found: str,
        *,
        expected: str = "",
        act: str = "",
        causes: Mapping[str, HilcellError] | None = None,
        fields: Mapping[str, object] | None = None,
    ) -> None:
        self.device, self.operation, self.found = device, operation, found
        self.expected, self.act = expected, act
        self.causes, self.fields = dict(causes or {}), dict(fields or {})
        super().__init__(code=code)

    @property
    def summary(self) -> str:
        """Return the message without the act, for callers that advise better."""
        expected = f", expected {self.expected}" if self.expected else ""
        return f"{self.device}: {self.operation}: {self.found}{expected}"

    def __str__(self) -> str:
        tree = "".join(f"\n  {name}\n    {error}" for name, error in self.causes.items())
        return self.summary + (f"; {self.act}" if self.act else "") + tree

    def facts(self) -> Json:
        return {
            "code": self.code,
            "device": self.device,
            "operation": self.operation,
            "found": self.found,
            "wanted": self.expected,
            "act": self.act,
            "fields": {name: _plain(value) for name, value in self.fields.items()},
            "causes": [cause.facts() for cause in self.causes.values()],
        }


class DeviceRefused(DeviceError):
    """The device answers, but is not the cell file's, or is not allowed to work."""

    exit_code = EXIT_REFUSED


class NoReading(DeviceError):
    """Only this one measurement failed, and it may be tried again."""

    def of_point(self, key: str) -> NoReading:
        """Return the same error, whose operation names the point that was measured."""
        return NoReading(
            self.code,
            self.device,
            f"{self.operation} {key}",
            self.found,
            expected=self.expected,
            act=self.act,
            fields=self.fields | {"point": key},
        )


class StripLost(NoReading):
    """The strip has no valid position: dirt, a gap, a head too far from it.

    The drive still brings the slide to rest and holds it. A strip is absolute: once it reads
    again, its position is right.
    """


def exit_code(error: Exception) -> int:
    """Return the exit code of a run or a command that ``error`` ended."""
    return error.exit_code if isinstance(error, HilcellError) else EXIT_INTERNAL


def facts_of(error: Exception) -> Json:
    """Return an error's facts; an unexpected error is a defect."""
    if isinstance(error, HilcellError):
        return error.facts()
    return {
        "code": "HC-C07",
        "device": "Cell",
        "operation": "internal error",
        "found": f"{type(error).__name__}: {error}",
    }


def _plain(value: object) -> object:
    """Return a value in JSON types; JSON has no NaN and no infinity."""
    if hasattr(value, "tolist"):  # arrays and their numbers
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, bool | int | float | str) or value is None:
        return value
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return str(value)
