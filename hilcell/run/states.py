"""The two state machines, as flat tables: the run's life and the calibration.

The state is what the journal proves: a transition is written first and taken then, so a resumed
run enters exactly the states that its journal ends with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from transitions import Machine

from hilcell.ports import HilcellError


class TransitionRefused(HilcellError):
    """A trigger that the machine's table does not allow in this state."""

    code = "HC-C06"


@dataclass(frozen=True, slots=True)
class Table:
    """A machine's name, its states (the first is initial) and its rows trigger, from, to."""

    name: str
    states: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...], str], ...]


ALIVE = ("checking", "running", "paused", "suspended")

RUN = Table(
    "run",
    (
        "idle",
        "checking",
        "running",
        "paused",
        "suspended",
        "stopping",
        "finished",
        "aborted",
        "faulted",
    ),
    (
        ("check", ("idle",), "checking"),
        ("start", ("checking",), "running"),
        ("pause", ("running",), "paused"),
        ("suspend", ("running",), "suspended"),
        ("proceed", ("paused", "suspended"), "running"),
        ("stop", ALIVE, "stopping"),
        ("abort", ("stopping",), "aborted"),
        ("fault", (*ALIVE, "stopping"), "faulted"),
        ("finish", ("running",), "finished"),
        ("resume", (*ALIVE, "idle", "stopping", "aborted", "faulted"), "checking"),
        ("reopen", ("finished",), "checking"),
    ),
)

CALIBRATION = Table(
    "calibration",
    (
        "unknown",
        "connected",
        "referenced",
        "world_framed",
        "station_held",
        "base_framed",
        "grid_measured",
        "stations_framed",
        "fitted",
        "validated",
    ),
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
    """One machine, owned by one thread. ``write`` makes a transition durable before it is taken."""

    def __init__(self, table: Table, state: str, write: Callable[[dict[str, Any]], object]) -> None:
        self.table = table
        self._write = write
        self._machine = Machine(
            model=None,
            states=list(table.states),
            initial=state,
            transitions=[
                {"trigger": trigger, "source": list(sources), "dest": target}
                for trigger, sources, target in table.rows
            ],
            auto_transitions=False,
        )
        self._model = _Model()
        self._machine.add_model(self._model, initial=state)

    @property
    def state(self) -> str:
        """Return the state's name."""
        return self._model.state

    def allows(self, trigger: str) -> bool:
        """Return whether ``trigger`` has a row for this state."""
        return bool(self._machine.get_transitions(trigger, self.state))

    def fire(self, trigger: str, **reason: object) -> None:
        """Write and take the transition; raises `TransitionRefused` where the table has none."""
        rows = self._machine.get_transitions(trigger, self.state)
        if not rows:
            raise TransitionRefused(
                f"{self.table.name} is {self.state}: {trigger!r} is not possible now"
            )
        body = {"machine": self.table.name, "from": self.state, "to": rows[0].dest}
        self._write(body | {"trigger": trigger} | reason)
        self._model.trigger(trigger)


class _Model:
    """What `transitions` decorates with the state."""

    state: str
    trigger: Callable[[str], bool]


def mermaid(table: Table) -> str:
    """Return the table as a Mermaid state diagram."""
    lines = ["stateDiagram-v2", f"    [*] --> {table.states[0]}"]
    lines += [
        f"    {source} --> {target}: {trigger}"
        for trigger, sources, target in table.rows
        for source in sources
    ]
    return "\n".join(lines)
