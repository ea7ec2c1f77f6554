"""All that the screen knows of one run: the journal so far, and the engine's last status.

A live run, a finished one and one left by a crash have the same view. A status grows old:
`RunView.status_age_s` is its age, and every line that shows it must check that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime
from enum import Enum
from typing import TYPE_CHECKING

from hilcell.errors import EXIT_REFUSED
from hilcell.journal.log import Log
from hilcell.model.events import StepBegun
from hilcell.model.point import CONTROL, Point
from hilcell.model.records import WAITING
from hilcell.run.control import PromptStatus, Status
from hilcell.run.states import RUN

if TYPE_CHECKING:
    from hilcell.alarms import Alarm
    from hilcell.journal.journal import Record
    from hilcell.run.forecast import RemainingSpan, SpanProgress

STALE_S = 2.0
MOST_RECORDS = 2000


class EngineState(Enum):
    """The engine of a run: one that has answered is never starting again."""

    UNKNOWN = "unknown"  # not looked up yet
    NONE = "none"
    STARTING = "starting"  # this screen has started it; it has not answered yet
    ANSWERING = "answering"
    SILENT = "silent"  # it lives but does not answer


@dataclass(slots=True)
class RunView:
    """The data behind every screen; filled by the session, read by the functions of `tui.text`."""

    run: str
    log: Log = field(default_factory=Log)
    trouble: str = ""  # why the journal cannot be read
    calibrated: bool = True  # whether a calibration has its file
    engine: EngineState = EngineState.NONE
    status: Status | None = None
    status_age_s: float = 0.0  # how old the status is
    now: datetime | None = None
    remaining_s: float | None = None
    elapsed_s: float = 0.0
    ahead: list[RemainingSpan] = field(
        default_factory=list
    )  # what is to come, while the run is live
    alarms: list[Alarm] = field(default_factory=list)
    records: list[Record] = field(default_factory=list)  # the newest, for the event log
    last: Point | None = None
    newest: Point | None = None  # that is no control point; drawn large
    newest_t: str = ""  # when its record was written
    span: SpanProgress | None = None  # progress of the part in work
    step: StepBegun | None = None
    measured: dict[int, set[str]] = field(default_factory=dict)  # keys of points by step

    def take(self, record: Record) -> None:
        self.log.take(record)
        self.records.append(record)
        if len(self.records) > 2 * MOST_RECORDS:
            del self.records[:-MOST_RECORDS]
        match record.fact:
            case Point():
                self.last = self.log.points[record.key]
                if self.last.id.group != CONTROL:
                    self.newest, self.newest_t = self.last, record.t
                    if self.step:
                        self.measured.setdefault(self.step.number, set()).add(record.key)
            case StepBegun() as step:
                self.step = step

    @property
    def simulated(self) -> bool:
        return self.log.plan is not None and self.log.plan.simulated

    @property
    def has_rail(self) -> bool:
        """Whether the run's cell has a rail; so it is taken before its plan is known."""
        return self.log.plan is None or self.log.cell.has_rail

    @property
    def newest_is_old(self) -> bool:
        key = self.newest.key if self.newest is not None else ""
        return self.step is not None and key not in self.measured.get(self.step.number, ())

    @property
    def newest_age_s(self) -> float:
        """Return the age of the newest point; infinite where there is none."""
        if not self.newest_t or self.now is None:
            return math.inf
        return max(0.0, (self.now - datetime.fromisoformat(self.newest_t)).total_seconds())

    @property
    def ended(self) -> bool:
        return self.log.over and self.log.end is not None

    @property
    def calibration_lost(self) -> bool:
        """Whether the run has ended with a calibration that has no file."""
        return not self.calibrated and self.log.calibrates

    @property
    def state(self) -> str:
        """Return the key of the state in `text.run.STATES`."""
        state = self.log.state
        if self.engine is EngineState.UNKNOWN:
            return "looking"
        if self.engine is EngineState.STARTING:
            return "checking"
        if self.engine is EngineState.NONE and not self.ended:
            if self.trouble and self.log.plan is None:
                return "unreadable"
            begun = self.log.plan is not None and self.log.end is None  # else it was refused
            return "gone" if begun else "idle"
        if self.engine is EngineState.SILENT and not self.ended:
            return "silent"
        if state == "finished":
            return "intolerant" if self.log.end and self.log.end.exit else "done"
        if state == "faulted":
            refused = self.log.end is not None and self.log.end.exit == EXIT_REFUSED
            return "refused" if refused else "fault"
        return "stopping" if state == "aborting" else state

    @property
    def live(self) -> bool:
        ended = self.state in ("done", "intolerant", "aborted", "fault", "refused")
        return self.engine is not EngineState.NONE and not ended

    @property
    def answers(self) -> bool:
        return self.engine is EngineState.ANSWERING

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves: no engine is at work, or it waits for the operator."""
        return not self.live or self.state in WAITING

    @property
    def stale(self) -> bool:
        return self.status is None or not self.status_age_s <= STALE_S

    @property
    def prompt(self) -> PromptStatus | None:
        """Return the prompt, while one is open and the cell is known."""
        if not self.live or self.status is None or self.log.plan is None:
            return None
        return self.status.prompt

    def allows(self, trigger: str) -> bool:
        state = self.log.state
        return any(name == trigger and state in sources for name, sources, _ in RUN.rows)
