"""An engine without a process and a socket: what it answers is up to the test."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Self

import msgspec

from hilcell.errors import HilcellError
from hilcell.run.control import Status
from tests.hilcell.tui.engine_peer import STATUS


class ScriptedEngine:
    """Stands in the place of `EngineClient`, its class and its only client."""

    def __init__(self) -> None:
        self.answer: HilcellError | None = None  # raised by each question; None: all is well
        self.asked: list[str] = []
        self.timeout_s: list[float | None] = []  # of each client
        self.open = 0
        self.opening, self.may_open = threading.Event(), threading.Event()
        self.may_open.set()

    def of_run(self, _: Path, timeout_s: float | None = None) -> Self:
        """Connect, when it may."""
        self.opening.set()
        self.may_open.wait()
        self.timeout_s.append(timeout_s)
        self.open += 1
        return self

    def ask(self, command: str, **_: object) -> Status:
        """Answer, or fail."""
        self.asked.append(command)
        if self.answer is not None:
            raise self.answer
        return msgspec.convert(STATUS, Status)

    def leave(self) -> None:
        """Hear that a screen leaves on purpose."""
        self.asked.append("leave")

    def close(self) -> None:
        """Hang up."""
        self.open -= 1
