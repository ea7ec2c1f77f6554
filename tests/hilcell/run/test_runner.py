"""A run's life: pause, stop, fault, resume, storage; the journal tells it all."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hilcell.run.runner as runner_module
from hilcell.cell import load_cell
from hilcell.clock import WallClock
from hilcell.devices import Devices
from hilcell.ports import DeviceError, DeviceRefused, NoReading
from hilcell.run.bench import Bench
from hilcell.run.journal import Journal, StorageError, read_journal
from hilcell.run.log import Log
from hilcell.run.procedure import Procedure
from hilcell.run.runner import Runner
from tests.hilcell.run.desk import DeskRail, DeskTracker, Points, desk, hang, procedure

CELL = load_cell("paper", {"settle.robot_s": "0.0", "settle.rail_s": "0.0"})
PLAN = {
    "procedure": "desk", "cell": {}, "digest": "", "seed": 1, "speed": None, "unattended": True,
    "operator": "", "job": "", "simulated": True, "versions": {}, "settings": {}, "steps": [],
    "points": 3, "duration_s": 1.0,
}  # fmt: skip


class Bed:
    """A runner on desk devices, run in a thread so that the test can command it."""

    def __init__(self, folder: Path, *, unattended: bool = True) -> None:
        self.path = folder / "journal.sqlite"
        self.devices: Devices = desk(CELL)
        self.unattended = unattended

    @property
    def tracker(self) -> DeskTracker:
        assert isinstance(self.devices.tracker, DeskTracker)
        return self.devices.tracker

    @property
    def rail(self) -> DeskRail:
        assert isinstance(self.devices.rail, DeskRail)
        return self.devices.rail

    def runner(self, what: Procedure) -> Runner:
        fresh = not self.path.exists()
        self.journal = Journal(self.path, "r", create=fresh)
        log = Log(read_journal(self.path))
        self.journal.listen(log.take)
        if fresh:
            self.journal.append("plan", "", PLAN)
        stop = threading.Event()
        return Runner(
            CELL, what, self.journal, log, devices=self.devices, clock=WallClock(stop),
            stop=stop, unattended=self.unattended,
        )  # fmt: skip

    def run(self, what: Procedure) -> int:
        code = self.runner(what).run()
        self.journal.close()
        return code

    def log(self) -> Log:
        return Log(read_journal(self.path))

    def states(self) -> list[str]:
        return [
            record.body["to"]
            for record in read_journal(self.path)
            if record.kind == "state" and record.body["machine"] == "run"
        ]


@pytest.fixture
def bed(tmp_path: Path) -> Bed:
    return Bed(tmp_path)


def started(runner: Runner) -> tuple[threading.Thread, list[int]]:
    codes: list[int] = []
    thread = threading.Thread(target=lambda: codes.append(runner.run()))
    thread.start()
    return thread, codes


def until(condition: Callable[[], bool], limit_s: float = 10.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.002)


def test_a_run_that_goes_well(bed: Bed) -> None:
    assert bed.run(procedure(Points(3))) == 0
    assert bed.states() == ["checking", "running", "finished"]
    end = read_journal(bed.path)[-1]
    assert end.kind == "end"
    assert end.body["exit"] == 0
    assert end.body["result"] == {"points": {"p": 3}, "simulated": True, "measured": 3}
    assert bed.rail.closed == 1


def test_a_verdict_that_does_not_hold_is_exit_1(bed: Bed) -> None:
    def judge(bench: Bench, number: int) -> None:
        bench.verdict("tolerance", holds=False, found_mm=0.3)

    assert bed.run(procedure(Points(1, judge))) == 1
    assert bed.states()[-1] == "finished"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (DeviceError("Rail", "move", "frozen"), 3),
        (DeviceRefused("Robot", "connect", "model X", wanted="model Y"), 2),
        (RuntimeError("a defect"), 5),
    ],
)
def test_a_fault_stops_everything_once_and_is_kept(bed: Bed, error: Exception, code: int) -> None:
    def fail(bench: Bench, number: int) -> None:
        if number == 2:
            raise error

    assert bed.run(procedure(Points(3, fail))) == code
    assert bed.states()[-1] == "faulted"
    assert bed.rail.stopped_s is not None
    assert bed.rail.closed == 1
    log = bed.log()
    assert log.fault == str(error)
    assert len(log.points) == 2
    assert read_journal(bed.path)[-1].body["exit"] == code


def test_resume_measures_only_what_is_missing(bed: Bed) -> None:
    def fail(bench: Bench, number: int) -> None:
        if number == 2:
            raise DeviceError("Tracker", "measure", "gone")

    assert bed.run(procedure(Points(4, fail))) == 3
    before = bed.tracker.measured
    assert bed.run(procedure(Points(4))) == 0
    assert bed.tracker.measured - before == 2
    keys = [record.key for record in read_journal(bed.path) if record.kind == "point"]
    assert keys == ["p/0", "p/1", "p/2", "p/3"]
    assert bed.states() == [
        "checking", "running", "faulted", "checking", "running", "finished"
    ]  # fmt: skip


def test_pause_finishes_the_point_in_flight_and_go_on(bed: Bed) -> None:
    entered, release = threading.Event(), threading.Event()
    bed.tracker.answer = hang(entered, release)
    runner = bed.runner(procedure(Points(2)))
    thread, codes = started(runner)
    assert entered.wait(10)
    runner.post("pause")
    until(lambda: runner.status()["state"] == "paused")
    assert runner.status()["points"] == 0
    release.set()
    until(lambda: runner.status()["points"] == 1)
    assert thread.is_alive()
    runner.post("proceed")
    thread.join(10)
    bed.journal.close()
    assert codes == [0]
    assert bed.states() == ["checking", "running", "paused", "running", "finished"]


def test_stop_works_while_a_device_hangs(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner_module, "WORKER_S", 0.2)
    entered, release = threading.Event(), threading.Event()
    bed.tracker.answer = hang(entered, release)
    runner = bed.runner(procedure(Points(2)))
    thread, codes = started(runner)
    assert entered.wait(10)
    asked_s = time.monotonic()
    runner.post("stop")
    thread.join(10)
    assert bed.rail.stopped_s is not None
    assert bed.rail.stopped_s - asked_s < 0.5
    release.set()
    assert codes == [3]
    assert bed.states()[-2:] == ["stopping", "faulted"]
    bed.journal.close()


def test_a_stop_while_paused_is_an_abort(bed: Bed) -> None:
    runner = bed.runner(procedure(Points(10**6)))
    thread, codes = started(runner)
    until(lambda: bool(runner.status()["points"]))
    runner.post("pause")
    until(lambda: runner.status()["state"] == "paused")
    runner.post("stop")
    thread.join(10)
    bed.journal.close()
    assert codes == [4]
    assert bed.states()[-2:] == ["stopping", "aborted"]
    assert read_journal(bed.path)[-1].body["exit"] == 4


def test_interrupt_pauses_first_and_stops_then(bed: Bed) -> None:
    runner = bed.runner(procedure(Points(10**6)))
    thread, codes = started(runner)
    until(lambda: runner.status()["state"] == "running")
    runner.post("interrupt")
    until(lambda: runner.status()["state"] == "paused")
    runner.post("interrupt")
    thread.join(10)
    bed.journal.close()
    assert codes == [4]


def broken_beam(times: int) -> Callable[[], None]:
    left = [times]

    def answer() -> None:
        if left[0]:
            left[0] -= 1
            raise NoReading("Tracker", "measure", "beam broken")

    return answer


def test_a_broken_beam_is_tried_again(bed: Bed) -> None:
    bed.tracker.answer = broken_beam(2)
    assert bed.run(procedure(Points(1))) == 0
    tries = [r.body["tries"] for r in bed.log().events if r.body["what"] == "no reading"]
    assert tries == [1, 2]


def test_unattended_a_lasting_break_is_a_fault(bed: Bed) -> None:
    bed.tracker.answer = broken_beam(3)
    assert bed.run(procedure(Points(1))) == 3
    assert "beam broken" in bed.log().fault


def test_attended_it_suspends_and_asks(tmp_path: Path) -> None:
    bed = Bed(tmp_path, unattended=False)
    bed.tracker.answer = broken_beam(3)
    runner = bed.runner(procedure(Points(1)))
    thread, codes = started(runner)
    until(lambda: runner.status()["state"] == "suspended")
    runner.post("proceed")
    thread.join(10)
    bed.journal.close()
    assert codes == [0]
    assert "suspended" in bed.states()


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


def test_a_command_that_makes_no_sense_is_journalled(bed: Bed) -> None:
    runner = bed.runner(procedure(Points(10**6)))
    thread, _ = started(runner)
    until(lambda: runner.status()["state"] == "running")
    runner.post("proceed")
    runner.post("stop")
    thread.join(10)
    bed.journal.close()
    refused = [r.body for r in bed.log().events if r.body["what"] == "command refused"]
    assert refused == [{"what": "command refused", "command": "proceed", "in": "running"}]
