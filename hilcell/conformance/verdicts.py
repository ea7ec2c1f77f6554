"""The findings that a promise may have, and how a check states them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from hilcell.errors import DeviceError, HilcellError, Stopped, with_place

Port = Literal["rail", "robot", "tracker"]
Verdict = Literal["held", "broken", "not applicable", "needs a person"]
PORTS: tuple[Port, ...] = ("rail", "robot", "tracker")


class Broken(HilcellError):
    """The driver does not keep the promise."""


class NeedsPerson(HilcellError):
    """Nobody is there to do, or to agree to, what the promise needs."""


class NotApplicable(HilcellError):
    """The promise is none of this driver's; the text says why."""


def need(holds: bool, why: str) -> None:
    """Raise `Broken` unless ``holds``; a comparison with NaN does not."""
    if not holds:
        raise Broken(why)


def fails(what: str, call: Callable[[], object]) -> DeviceError:
    """Return the error with which a call fails; raises `Broken` where it does not, or wrongly."""
    try:
        found = call()
    except DeviceError as error:
        return error
    except Stopped:
        raise
    except Exception as error:
        raise Broken(f"{what}: {with_place(error)}; wanted a DeviceError") from error
    raise Broken(f"{what}: returned {found}; wanted a DeviceError")
