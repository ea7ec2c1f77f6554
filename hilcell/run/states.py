"""The two state machines, as flat tables: the run's and the calibration's.

A transition is journalled before it is taken, and the log has the state: a resumed run continues
with the states of its journal.

The calibration's state also decides which points may be re-measured: those without a result that
would not be computed again. A request is an event; the point's next record fulfils it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast, get_args

from transitions import EventData, Machine, MachineError, Transition

from hilcell.journal.log import Log, Records
from hilcell.model.point import Point
from hilcell.model.records import CalibrationState, RunState
from hilcell.ports import HilcellError


class TransitionRefused(HilcellError):
    """A trigger that the machine's table does not allow in this state."""

    code = "HC-C06"


@dataclass(frozen=True, slots=True)
class Table:
    """A machine's name, its states (the first is initial), and rows of trigger, from, to."""

    name: str
    states: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...], str], ...]


ACTIVE: tuple[RunState, ...] = (
    "checking", "running", "pausing", "paused", "suspended", "aborting",
)  # fmt: skip

RUN = Table(
    "run",
    get_args(RunState),
    (
        ("check", ("idle",), "checking"),
        ("start", ("checking",), "running"),
        ("pause", ("running",), "pausing"),
        ("rest", ("pausing",), "paused"),
        ("suspend", ("running", "pausing"), "suspended"),
        ("proceed", ("pausing", "paused", "suspended"), "running"),
        ("abort", ("checking", "running", "pausing", "paused", "suspended"), "aborting"),
        ("stop", ACTIVE, "stopping"),
        ("abort", ("stopping",), "aborted"),
        ("fault", (*ACTIVE, "stopping"), "faulted"),
        ("finish", ("running", "pausing", "aborting"), "finished"),
        ("resume", (*ACTIVE, "idle", "stopping", "aborted", "faulted"), "checking"),
        ("reopen", ("finished",), "checking"),
    ),
)

CALIBRATION = Table(
    "calibration",
    get_args(CalibrationState),
    (
        ("connect", ("unknown",), "connected"),
        ("reference", ("connected",), "referenced"),
        ("frame_world", ("referenced",), "world_framed"),
        ("hold_station", ("world_framed",), "station_held"),
        ("frame_base", ("station_held",), "base_framed"),
        ("measure_grid", ("base_framed",), "grid_measured"),
        ("frame_stations", ("grid_measured",), "stations_framed"),
        ("fit", ("stations_framed",), "fitted"),
        ("validate", ("fitted",), "validated"),
    ),
)


class StateMachine:
    """Runs a table over a journal; fired by one thread, read by any."""

    trigger: Callable[..., bool]
    may_trigger: Callable[[str], bool]

    def __init__(self, table: Table, journal: Records) -> None:
        self.table, self._journal = table, journal
        Machine(
            self,
            states=[*table.states],
            initial=self.state,
            transitions=[[trigger, [*sources], to] for trigger, sources, to in table.rows],
            auto_transitions=False,
            send_event=True,
            before_state_change=self._write,
        )

    @property
    def state(self) -> str:
        return self._journal.log.states[self.table.name]

    @state.setter
    def state(self, state: str) -> None:
        """Required by `transitions`; the log has applied the record."""

    def fire(self, trigger: str, **facts: object) -> None:
        """Take a transition, with ``facts`` in its record.

        Raises `TransitionRefused` or `StorageError`; the state is then unchanged.
        """
        try:
            self.trigger(trigger, **facts)
        except MachineError as error:
            raise TransitionRefused(
                f"{self.table.name} is {self.state}: {trigger!r} is not possible in this state"
            ) from error

    def _write(self, event: EventData) -> None:
        transition, trigger = cast("Transition", event.transition), event.event  # one was found
        body = {"machine": self.table.name, "from": transition.source, "to": transition.dest}
        self._journal.append("state", "", body | {"trigger": trigger.name} | event.kwargs)


def mermaid(table: Table) -> str:
    edges = [(source, to, trigger) for trigger, sources, to in table.rows for source in sources]
    lines = [f"    {source} --> {target}: {trigger}" for source, target, trigger in edges]
    return "\n".join(["stateDiagram-v2", f"    [*] --> {table.states[0]}", *lines])


# -- points that may be measured again -------------------------------------------------------------


def retake_refusal(log: Log, key: str) -> str:
    """Return why a point may not be re-measured, else ""."""
    point = log.points.get(key)
    if point is None:
        return f"{key[:80]}: this run has no such point"
    if key in log.retakes:
        return f"{key}: is already requested"
    return remeasure_refusal(log, point)


def remeasure_refusal(log: Log, point: Point) -> str:
    """Return why a measured point may not be re-measured, else ""."""
    kind, repeatable = point.id.kind, point.commanded_deg is not None and bool(point.station)
    if not (repeatable and kind in ("grid", "repeatability", "validate")):
        return f"{point.key}: expected a grid, repeatability or validation point; start a new run"
    fitted = CALIBRATION.states[CALIBRATION.states.index("fitted") :]
    if kind != "validate" and log.calibration in fitted:
        return f"{point.key}: the correction was built with it; start a new run"
    return ""
