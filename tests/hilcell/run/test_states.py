"""The whole state x trigger matrix of both machines."""

from itertools import product
from pathlib import Path
from typing import Any

import pytest

from hilcell.journal.journal import Body, Record, StorageError
from hilcell.journal.log import Log, RunJournal
from hilcell.model.records import Kind
from hilcell.run.states import CALIBRATION, RUN, StateMachine, Table, TransitionRefused, mermaid

TRIGGERS = {table.name: sorted({row[0] for row in table.rows}) for table in (RUN, CALIBRATION)}
MATRIX = [
    (table, state, trigger)
    for table in (RUN, CALIBRATION)
    for state, trigger in product(table.states, TRIGGERS[table.name])
]


class Paper(RunJournal):
    """A journal without a file, of a run in a state."""

    def __init__(self, table: Table, state: str) -> None:
        self.log = Log()
        self.log.take(Record(1, "", "state", "", {"machine": table.name, "to": state}))
        self.written: list[dict[str, Any]] = []
        self.full = False

    def append(self, kind: Kind, key: str, body: Body) -> Record:
        if self.full:
            raise StorageError("disk full")
        assert isinstance(body, dict)
        record = Record(2, "", kind, key, body)
        self.written.append(body)
        self.log.take(record)
        return record


def allowed(table: Table, state: str, trigger: str) -> str | None:
    for name, sources, target in table.rows:
        if name == trigger and state in sources:
            return target
    return None


def test_every_state_and_trigger() -> None:
    for table, state, trigger in MATRIX:
        check(table, state, trigger)


def check(table: Table, state: str, trigger: str) -> None:
    journal = Paper(table, state)
    machine = StateMachine(table, journal)
    target = allowed(table, state, trigger)
    assert machine.may_trigger(trigger) == (target is not None)
    if target is None:
        with pytest.raises(TransitionRefused, match=state):
            machine.fire(trigger)
        assert machine.state == state
        assert journal.written == []
    else:
        machine.fire(trigger, reason="because")
        assert machine.state == target
        assert journal.written == [
            {
                "machine": table.name,
                "from": state,
                "to": target,
                "trigger": trigger,
                "reason": "because",
            }
        ]


@pytest.mark.parametrize("table", [RUN, CALIBRATION], ids=lambda table: table.name)
def test_no_trigger_has_two_targets_from_one_state(table: Table) -> None:
    pairs = [(name, source) for name, sources, _ in table.rows for source in sources]
    assert len(pairs) == len(set(pairs))


def test_a_state_that_cannot_be_written_is_not_entered() -> None:
    journal = Paper(RUN, "running")
    machine = StateMachine(RUN, journal)
    journal.full = True
    with pytest.raises(StorageError, match="disk full"):
        machine.fire("pause")
    assert machine.state == "running"


def test_stop_and_fault_are_possible_whenever_something_lives() -> None:
    for state in ("checking", "running", "pausing", "paused", "suspended", "aborting"):
        assert allowed(RUN, state, "stop") == "stopping"
        assert allowed(RUN, state, "fault") == "faulted"


def test_the_manual_shows_the_tables() -> None:
    page = (Path(__file__).parents[3] / "docs/architecture.md").read_text("utf-8")
    for table in (RUN, CALIBRATION):
        assert f"```mermaid\n{mermaid(table)}\n```" in page
