"""How runs end: well, out of tolerance, by a fault, on a full disk; and how they resume."""

import signal
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from hilcell.errors import facts_of
from hilcell.journal.index import row_of
from hilcell.journal.journal import Record, StorageError, read_journal
from hilcell.journal.log import Log
from hilcell.model.events import LinkCounted
from hilcell.ports import DeviceError, DeviceRefused
from hilcell.run import stopping
from hilcell.run.cell_session import CellSession
from hilcell.run.runner import Runner
from tests.hilcell.run.bed import PLAN, Bed, broken_beam
from tests.hilcell.run.rig import Points, hang, procedure


def test_a_run_that_goes_well(bed: Bed) -> None:
    assert bed.run(procedure(Points(3))) == 0
    assert bed.states() == ["checking", "running", "finished"]
    end = read_journal(bed.path)[-1]
    assert end.kind == "end"
    assert end.body["exit"] == 0
    assert end.body["result"] == {"points": {"p": 3}, "simulated": True, "measured": 3}
    assert bed.rail.closed == 1


def test_a_verdict_that_does_not_hold_is_exit_1(bed: Bed) -> None:
    def judge(session: CellSession, number: int) -> None:
        session.verdict("tolerance", holds=False, found_mm=0.3)

    assert bed.run(procedure(Points(1, judge))) == 1
    assert bed.states()[-1] == "finished"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (DeviceError("HC-R31", "Rail", "move", "frozen"), 3),
        (DeviceRefused("HC-B05", "Robot", "connect", "model X", expected="model Y"), 2),
        (RuntimeError("a defect"), 5),
    ],
)
def test_a_fault_stops_everything_once_and_is_kept(bed: Bed, error: Exception, code: int) -> None:
    def fail(session: CellSession, number: int) -> None:
        if number == 2:
            raise error

    assert bed.run(procedure(Points(3, fail))) == code
    assert bed.states()[-1] == "faulted"
    assert bed.rail.stopped_s is not None
    assert bed.rail.closed == 1
    log = bed.log()
    assert log.fault == str(error)
    faulted = bed.records("state")[-1].body
    assert faulted["error"] == facts_of(error)
    assert len(log.points) == 2
    assert read_journal(bed.path)[-1].body["exit"] == code


def test_resume_measures_only_what_is_missing(bed: Bed) -> None:
    def fail(session: CellSession, number: int) -> None:
        if number == 2:
            raise DeviceError("HC-T02", "Tracker", "measure", "gone")

    assert bed.run(procedure(Points(4, fail))) == 3
    before = bed.tracker.measured
    assert bed.run(procedure(Points(4))) == 0
    assert bed.tracker.measured - before == 2
    keys = [record.key for record in read_journal(bed.path) if record.kind == "point"]
    assert keys == ["p/0", "p/1", "p/2", "p/3"]
    assert bed.states() == ["checking", "running", "faulted", "checking", "running", "finished"]


def test_a_broken_beam_is_tried_again(bed: Bed) -> None:
    bed.tracker.answer = broken_beam(2)
    assert bed.run(procedure(Points(1))) == 0
    tries = [r.body["tries"] for r in bed.log().events if r.body["what"] == "no reading"]
    assert tries == [1, 2]


def test_a_full_disk_stops_safely_with_exit_7(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
    runner = bed.runner(procedure(Points(5)))
    real = bed.journal.append

    def append(kind: Any, key: str, body: dict[str, Any]) -> Any:
        if key == "p/2":
            monkeypatch.setattr(bed.journal, "append", full)
        return real(kind, key, body) if key != "p/2" else full(kind, key, body)

    def full(kind: Any, key: str, body: dict[str, Any]) -> Any:
        raise StorageError("journal: disk full")

    monkeypatch.setattr(bed.journal, "append", append)
    assert runner.run() == 7
    assert bed.rail.stopped_s is not None
    assert bed.rail.closed == 1
    bed.journal.close()
    assert sorted(bed.log().points) == ["p/0", "p/1"]


def test_a_slide_that_cannot_be_left_held_is_reported(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    entered, release = threading.Event(), threading.Event()
    monkeypatch.setattr(stopping, "CLOSE_S", 0.0)
    monkeypatch.setattr(bed.rail, "close", hang(entered, release))
    runner = bed.runner(procedure(Points(10**6)))
    assert runner.run([signal.SIGTERM]) == 3
    release.set()
    bed.journal.close()
    assert [*runner.unclosed] == ["Rail"]
    assert [*bed.events("closed")[0]["problems"]] == ["Rail"]
    assert bed.states()[-1] == "faulted"


@pytest.mark.parametrize(
    ("device", "exit_code"), [("rail", 3), ("robot", 3), ("tracker", 0)], ids=str
)
def test_a_run_that_leaves_something_moving_has_not_finished(
    bed: Bed, monkeypatch: pytest.MonkeyPatch, device: str, exit_code: int
) -> None:
    gone = DeviceError("HC-R37", device.capitalize(), "close", "the drive keeps its power")

    def close() -> None:
        raise gone

    monkeypatch.setattr(getattr(bed, device), "close", close)
    assert bed.run(procedure(Points(1))) == exit_code
    end = read_journal(bed.path)[-1].body
    assert end["exit"] == exit_code
    if exit_code == 0:
        assert end["state"] == bed.log().state == "finished"
        return
    assert end["state"] == bed.log().state == "faulted"
    assert (end["result"], end["error"]["code"]) == ({}, "HC-C32")
    assert str(gone) in bed.log().fault
    monkeypatch.undo()
    assert bed.run(procedure(Points(1))) == 0
    assert bed.log().state == "finished"


def test_devices_are_closed_once_also_where_the_disk_fills_up_between(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = bed.runner(procedure(Points(1)))
    real = bed.journal.append

    def append(kind: Any, key: str, body: dict[str, Any]) -> Any:
        if isinstance(body, LinkCounted):
            raise StorageError("journal: disk full")
        return real(kind, key, body)

    monkeypatch.setattr(bed.journal, "append", append)
    assert runner.run() == 7
    bed.journal.close()
    assert bed.rail.closed == 1


def test_a_defect_of_the_main_thread_stops_everything_too(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(message: object) -> None:
        raise RuntimeError("a defect")

    runner = bed.runner(procedure(Points(10**6)))
    monkeypatch.setattr(runner, "_follow", broken)
    assert runner.run() == 5
    bed.journal.close()
    assert bed.rail.stopped_s is not None
    assert bed.rail.closed == 1
    assert bed.states()[-1] == "faulted"


@pytest.mark.parametrize(("since", "refused"), [(0, True), (3, True), (5, False)])
def test_an_agreement_holds_for_what_was_asked_last(since: int, refused: bool) -> None:
    log, time = Log(), "2026-01-01T00:00:00+00:00"
    announced = {"what": "announced", "motion": "the slide moves"}
    for seq, to in ((1, "paused"), (2, "running"), (3, "pausing"), (5, "paused")):
        if seq == 5:
            log.take(Record(4, time, "event", "", announced))
        log.take(Record(seq, time, "state", "", {"machine": "run", "from": "idle", "to": to}))
    engine: Any = SimpleNamespace(log=log)
    assert bool(Runner.proceed_refusal(engine, since)) is refused


# -- a run is a simulated one when its cell is, or when a device says that it is ------------------


SHOP = {"name": "shop", "serial": "7", "grid": {"station": "S1"}}


def run_of(
    folder: Path, monkeypatch: pytest.MonkeyPatch, *, cell: bool, device: bool
) -> tuple[Log, Bed]:
    monkeypatch.setitem(PLAN, "simulated", cell)
    monkeypatch.setitem(PLAN, "cell", SHOP)
    bed = Bed(folder)
    bed.rail.identity = msgspec.structs.replace(bed.rail.identity, simulated=device)
    for other in (bed.robot, bed.tracker):
        monkeypatch.setattr(other, "connect", list)
    assert bed.run(procedure(Points(1))) == 0
    return bed.log(), bed


@pytest.mark.parametrize(
    ("cell", "device"), [(False, False), (False, True), (True, False), (True, True)]
)
def test_what_a_device_says_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cell: bool, device: bool
) -> None:
    log, bed = run_of(tmp_path, monkeypatch, cell=cell, device=device)
    assert log.inputs.simulated is (cell or device)
    assert row_of(tmp_path).simulated is (cell or device)
    assert bed.records("plan")[0].body["simulated"] is cell  # frozen
