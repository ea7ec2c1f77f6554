"""Clocks that a test drives: time passes by waits and by hand, never by itself."""

from __future__ import annotations


class DrivenClock:
    """Satisfies `hilcell.ports.Clock`; ``at_s`` is the cell's time, ``pc_at_s`` that of the PC."""

    def __init__(self, at_s: float = 0.0, pc_at_s: float = 0.0) -> None:
        self.at_s, self.pc_at_s = at_s, pc_at_s

    def now_s(self) -> float:
        return self.at_s

    def pc_s(self) -> float:
        return self.pc_at_s

    def wait(self, duration_s: float) -> None:
        self.at_s += duration_s
        self.pc_at_s += duration_s

    def check(self) -> None: ...
