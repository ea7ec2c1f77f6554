"""The control protocol: each line is one request or one answer, in JSON.

A request may arrive late, when its sender has already reported that it failed: the engine's process
stood still, and reads now what was sent then. So an order states until when it holds.
"""

from __future__ import annotations

import math
import time
from typing import Literal, Self, TypedDict, Unpack, get_args

import msgspec

LONGEST_REQUEST = 4096  # bytes of a line
LONGEST_ANSWER = 1 << 16
ANSWER_S = 2.0  # a screen waits so long, which asks again and again
ORDER_S = 5.0  # a command waits so long, which asks once

Command = Literal[
    "status", "pause", "proceed", "stop", "abort", "answer", "retake", "acknowledge", "attend",
    "leave",
]  # fmt: skip
COMMANDS: tuple[Command, ...] = get_args(Command)
TIMELESS = ("stop", "status", "acknowledge", "attend", "leave")  # the others are orders: grow old


class Subject(TypedDict, total=False):
    """The parts of a `Request` that name its subject."""

    key: str
    codes: tuple[str, ...]
    until: int


class Request(msgspec.Struct, frozen=True, omit_defaults=True):
    """A client's request: ``key`` names the point of a ``retake``.

    ``codes`` and ``until`` are the alarms of an ``acknowledge``, and the last record it has seen;
    a ``proceed`` agrees to what was asked at its ``until``, where it states one.
    ``before`` is until when an order holds, in seconds of CLOCK_MONOTONIC, which is one clock for
    all processes of a machine; an order without it holds for ever.
    """

    command: Command
    key: str = ""
    before: str | None = None
    codes: tuple[str, ...] = ()
    until: int = 0

    @classmethod
    def within(cls, patience_s: float, command: Command, **subject: Unpack[Subject]) -> Self:
        """Return a request that holds for ``patience_s`` from now; to be sent at once."""
        before = None if command in TIMELESS else str(time.monotonic() + patience_s)
        return cls(command, before=before, **subject)

    def too_late(self) -> str:
        """Return why the order holds no more; "" where it holds."""
        if self.command in TIMELESS or self.before is None:
            return ""
        try:
            before_s = float(self.before)
        except ValueError:
            before_s = math.nan
        if not math.isfinite(before_s):
            return (
                f"before: a finite number of seconds is wanted, found {self.before[:80]!r}; "
                "nothing was done"
            )
        late_s = time.monotonic() - before_s
        return f"the order came {late_s:.1f} s too late; nothing was done" if late_s > 0 else ""


class DeviceStatus(msgspec.Struct, frozen=True):
    """A device's last reading and its age; ``reason`` is why it is lost."""

    state: str = "unknown"  # or fresh, moving, lost
    age_s: float | None = None
    text: str = ""
    reason: str = ""


class Interlock(msgspec.Struct, frozen=True):
    """One condition of motion; ``blocked`` says why it does not hold, ``code`` is its alarm's."""

    name: str
    blocked: str = ""
    code: str = ""


class PromptStatus(msgspec.Struct, frozen=True):
    """The question to the operator, and the tracker's look at it (tracker's frame)."""

    title: str
    text: str
    place: str = ""
    expected_mm: tuple[float, float, float] | None = None
    limit_mm: float | None = None
    seen_mm: float | None = None
    age_s: float | None = None
    ready: bool = False
    check: bool = True


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """The state of a run; every answer carries it that is no refusal."""

    run: str = ""
    state: str
    calibration: str = ""
    points: int = 0
    unattended: bool = False
    screens: int = 0
    pausing: bool = False
    devices: dict[str, DeviceStatus] = {}
    link: dict[str, int] = {}
    interlocks: list[Interlock] = []
    prompt: PromptStatus | None = None
    retakes: list[str] = []

    def answer(self) -> dict[str, object]:
        """Return the answer that carries it."""
        return {"ok": True} | msgspec.structs.asdict(self)


class Refusal(msgspec.Struct, frozen=True):
    """The answer to a request that is refused."""

    ok: bool = False
    error: str = "the engine refused without a reason"
