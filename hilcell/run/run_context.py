"""The shared state of a run: cell, devices, clock, log, and the journal of its facts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hilcell.calibration.frames import Frames
from hilcell.cell.devices import Devices
from hilcell.cell.file import Cell
from hilcell.journal.log import Records
from hilcell.model.events import Event
from hilcell.model.frame import Frame, frame_type
from hilcell.model.point import Point, PointId
from hilcell.model.records import EVENTS
from hilcell.model.verdicts import Verdict, verdict_type
from hilcell.ports import Clock, NoReading
from hilcell.run.interlocks import R, fresh_reading
from hilcell.run.prompts import Prompt, Verification
from hilcell.run.states import CALIBRATION, StateMachine

Ask = Callable[[Prompt, Callable[[], Verification], NoReading | None], Verification]


class RunContext:
    """The state that all layers of a run share. Used by the worker thread alone.

    ``checkpoint`` pauses the run if requested, ``pause`` pauses an attended run, ``ask`` suspends
    it until the operator's answer, or that the cause is gone, is verified.
    """

    def __init__(
        self,
        cell: Cell,
        devices: Devices,
        clock: Clock,
        journal: Records,
        *,
        checkpoint: Callable[[], None],
        ask: Ask,
        pause: Callable[[str], None] = lambda reason: None,
    ) -> None:
        self.cell, self.devices, self.clock = cell, devices, clock
        self.log, self.frames = journal.log, Frames(cell, journal.log)
        self.checkpoint, self.pause, self.ask = checkpoint, pause, ask
        self._journal = journal
        self._calibration = StateMachine(CALIBRATION, journal)

    def reached(self, state: str) -> bool:
        """Whether the journal has this state of the calibration, or a later one."""
        order = CALIBRATION.states
        return order.index(self._calibration.state) >= order.index(state)

    def reach(self, trigger: str) -> None:
        """Take a transition of the calibration machine unless the journal has it."""
        target = next(row[2] for row in CALIBRATION.rows if row[0] == trigger)
        if not self.reached(target):
            self._calibration.fire(trigger)

    def fresh(self, read: Callable[[], R], taken: R | None) -> R:
        """Return ``taken``, or another reading where that is too old for a motion."""
        return fresh_reading(read, self.clock, self.cell.settle.reading_age_s, taken)

    def add(self, event: Event) -> None:
        self._journal.append("event", "", event)

    def event(self, what: str, **facts: object) -> None:
        """Journal a plug-in's event; raises `ValueError` for one of `hilcell.model.events`."""
        if what in EVENTS:
            raise ValueError(f"expected an event of another kind than {what!r}; add its type")
        self._journal.append("event", "", {"what": what} | facts)

    def intend(self, key: str, action: str, **facts: object) -> None:
        self._journal.append("intent", key, {"action": action, "session": self.log.session} | facts)

    def frame(self, key: str, frame: Frame) -> None:
        """Journal a frame; raises `ValueError` for a key that is not of its type."""
        if not frame.calibration and frame_type(key) is not type(frame):
            raise ValueError(f"{key!r} is no key of {type(frame).__name__}")
        self._journal.append("frame", key, frame)

    def verdict(self, key: str, *, holds: bool, **facts: object) -> None:
        """Journal a plug-in's verdict; raises `ValueError` for one of `hilcell.model.verdicts`."""
        if verdict_type(key) is not None:
            raise ValueError(f"expected a verdict of another key than {key!r}; judge by its type")
        self._journal.append("verdict", key, {"holds": holds} | facts)

    def judge(self, key: str, verdict: Verdict) -> None:
        """Journal a verdict; raises `ValueError` for a key that is not of its type."""
        if verdict_type(key) is not type(verdict):
            raise ValueError(f"{key!r} is no key of {type(verdict).__name__}")
        self._journal.append("verdict", key, verdict)

    @property
    def folder(self) -> Path:
        return self._journal.path.parent

    def point(self, id: PointId, **facts: object) -> Point:
        head = {"id": id, "group": id.group, "session": self.log.session}
        if self.log.set_ups.number:
            head["set_up"] = self.log.set_ups.number
        self._journal.append("point", id.key, head | facts)
        return self.log.point(id)
