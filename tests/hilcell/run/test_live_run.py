"""Commands to a run under way: pause, go on, abort, stop; screens that come and go; its status."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

import hilcell.run.runner as runner_module
from hilcell.model.events import AlarmsAcknowledged
from hilcell.run.cell_session import CellSession
from hilcell.run.control import DeviceStatus
from hilcell.run.states import RUN
from tests.hilcell.run.bed import Bed, Live, until
from tests.hilcell.run.rig import Points, hang, procedure

MANY = 10**6


@pytest.fixture
def attended(tmp_path: Path) -> Bed:
    return Bed(tmp_path, unattended=False)


class Measuring:
    """A run whose first measurement hangs until it is released."""

    def __init__(self, bed: Bed, points: int = 2) -> None:
        self.entered, self.release = threading.Event(), threading.Event()
        bed.tracker.answer = hang(self.entered, self.release)
        self.live = Live(bed, procedure(Points(points)))

    def __enter__(self) -> Live:
        live = self.live.__enter__()
        self.entered.wait()
        return live

    def __exit__(self, *error: object) -> None:
        self.release.set()
        self.live.__exit__(*error)


@pytest.fixture
def connecting(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> tuple[threading.Event, ...]:
    """Return when the tracker is being connected, and what lets it be."""
    entered, release = threading.Event(), threading.Event()
    connect, wait = bed.tracker.connect, hang(entered, release)
    monkeypatch.setattr(bed.tracker, "connect", lambda: (wait(), connect())[1])
    return entered, release


@pytest.fixture
def measuring(bed: Bed) -> Iterator[Measuring]:
    measuring = Measuring(bed)
    yield measuring
    measuring.release.set()


def test_pause_finishes_the_point_in_flight(bed: Bed, measuring: Measuring) -> None:
    with measuring as live:
        live.runner.post("pause")
        live.until("pausing", True)
        assert live.status("state") == "running"
        assert live.status("points") == 0
        measuring.release.set()
        live.until("state", "paused")
        assert live.status("points") == 1
        assert live.status("pausing") is False
        live.runner.post("proceed")
    assert live.code == 0
    assert bed.states() == ["checking", "running", "pausing", "paused", "running", "finished"]


def test_pause_and_go_on_in_any_haste(bed: Bed) -> None:
    with Live(bed, procedure(Points(MANY))) as live:
        live.until("state", "running")
        for _ in range(100):
            live.runner.post("pause")
            live.runner.post("proceed")
        live.runner.post("pause")
        live.until("state", "paused")
        points = live.status("points")
        live.runner.post("stop")
    assert live.code == 4
    assert len(bed.log().points) == points


def test_a_pause_while_connecting_holds_before_the_first_point(
    bed: Bed, connecting: tuple[threading.Event, ...]
) -> None:
    entered, release = connecting
    with Live(bed, procedure(Points(1))) as live:
        entered.wait()
        live.runner.post("pause")
        live.until("pausing", True)
        assert live.status("state") == "checking"
        release.set()
        live.until("state", "paused")
        assert live.status("points") == 0
        live.runner.post("proceed")
    assert live.code == 0


def test_an_abort_while_connecting_begins_nothing(
    bed: Bed, connecting: tuple[threading.Event, ...]
) -> None:
    entered, release = connecting
    with Live(bed, procedure(Points(1))) as live:
        entered.wait()
        live.runner.post("pause")
        live.runner.post("abort")
        live.runner.post("proceed")  # is refused: an abort is not taken back
        until(lambda: bool(bed.events("command refused")))
        assert (live.status("state"), live.status("pausing")) == ("checking", True)
        release.set()
    assert live.code == 4
    assert bed.states() == ["checking", "aborting", "stopping", "aborted"]
    assert bed.records("intent") == []


@pytest.mark.parametrize("state", ["idle", "running", "aborting", "faulted"])
def test_a_run_that_was_cut_off_in_any_state_is_resumed(bed: Bed, state: str) -> None:
    bed.open_journal()
    bed.journal.append("state", "", {"machine": "run", "to": state})
    bed.journal.close()
    assert bed.run(procedure(Points(1))) == 0
    assert bed.states() == [state, "checking", "running", "finished"]


def test_abort_finishes_the_point_in_flight(bed: Bed, measuring: Measuring) -> None:
    with measuring as live:
        live.runner.post("pause")
        live.runner.post("abort")
        live.runner.post("abort")
        until(lambda: bed.states()[-1] == "aborting")
        assert (live.status("state"), live.status("pausing")) == ("running", True)
        measuring.release.set()
    assert live.code == 4
    assert bed.states() == ["checking", "running", "pausing", "aborting", "stopping", "aborted"]
    assert bed.events("command refused") == []
    assert sorted(bed.log().points) == ["p/0"]
    assert bed.events("safe stop") == []  # all is at rest: nothing has to be braked
    assert bed.rail.stopped_s is None
    assert bed.rail.closed == 1
    bed.tracker.answer = lambda: None
    assert bed.run(procedure(Points(2))) == 0


def test_abort_ends_a_paused_run_at_once(bed: Bed) -> None:
    with Live(bed, procedure(Points(MANY))) as live:
        live.runner.post("pause")
        live.until("state", "paused")
        live.runner.post("abort")
    assert live.code == 4
    assert bed.states()[-4:] == ["paused", "aborting", "stopping", "aborted"]


def test_stop_works_while_a_device_hangs(
    bed: Bed, measuring: Measuring, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_module, "WORKER_S", 0.0)  # what hangs is never in time
    with measuring as live:
        live.runner.stop()
        until(lambda: live.code == 3)
        assert bed.rail.stopped_s is not None
    assert bed.states()[-2:] == ["stopping", "faulted"]


def test_stop_needs_neither_queue_nor_main_thread(bed: Bed) -> None:
    runner = bed.runner(procedure(Points(1)))  # never run: nobody takes messages
    runner.stop()
    until(lambda: bed.rail.stopped_s is not None and bed.robot.stopped == 1)
    bed.journal.close()


def test_every_device_is_stopped_once_however_often_it_is_asked(bed: Bed) -> None:
    with Live(bed, procedure(Points(MANY))) as live:
        live.until("state", "running")
        live.runner.stop()
        live.runner.stop()
        live.runner.post("stop")
    assert live.code == 4
    assert bed.robot.stopped == 1
    assert len(bed.events("safe stop")) == 1


def test_interrupt_pauses_first_and_stops_then(bed: Bed) -> None:
    with Live(bed, procedure(Points(MANY))) as live:
        live.until("state", "running")
        live.runner.post("interrupt")
        live.until("state", "paused")
        live.runner.post("interrupt")
    assert live.code == 4


def test_a_lost_screen_pauses_an_attended_run(attended: Bed) -> None:
    with Live(attended, procedure(Points(MANY))) as live:
        live.until("state", "running")
        live.runner.post("lost")
        live.until("state", "paused")
        live.runner.post("lost")  # nothing more to pause
        live.runner.post("stop")
    paused = attended.entered("paused")
    assert [body["reason"] for body in paused] == ["the screen was lost"]
    assert len(attended.events("screen lost")) == 2


def test_a_screen_that_comes_back_is_told(attended: Bed) -> None:
    with Live(attended, procedure(Points(MANY))) as live:
        live.until("state", "running")
        live.runner.watched(1)  # the first screen: nobody was lost before it
        live.runner.watched(-1)
        live.runner.post("lost")
        live.until("state", "paused")
        live.runner.watched(1)
        live.runner.watched(1)  # one more, when nobody is missed
        live.runner.post("stop")
    told = [r.body["what"] for r in attended.log().events if "screen" in r.body["what"]]
    assert told == ["screen lost", "screen back"]


def test_an_unattended_run_goes_on_without_a_screen(bed: Bed) -> None:
    with Live(bed, procedure(Points(3, lambda session, number: None))) as live:
        live.runner.post("lost")
    assert live.code == 0
    assert "paused" not in bed.states()


def test_an_acknowledgement_is_journalled_and_one_of_what_nobody_has_seen_is_refused(
    bed: Bed,
) -> None:
    with Live(bed, procedure(Points(MANY))) as live:
        live.until("state", "running")
        assert (
            live.runner.acknowledge(AlarmsAcknowledged(codes=["HC-R31", "HC-V04"], until=2)) == ""
        )
        until(lambda: bool(bed.events("acknowledged")))
        for codes, record in (["HC-R31"], 10**6), (["HC-R31"], 0), ([], 2):
            assert live.runner.acknowledge(AlarmsAcknowledged(codes=codes, until=record))
        live.runner.post("stop")
    facts = {"codes": ["HC-R31", "HC-V04"], "until": 2}
    assert bed.events("acknowledged") == [{"what": "acknowledged"} | facts]


STATUS = {
    "run", "state", "calibration", "points", "unattended", "screens", "pausing", "devices",
    "interlocks", "link", "prompt", "retakes",
}  # fmt: skip


def test_the_status_is_whole_from_the_first_moment(bed: Bed) -> None:
    runner = bed.runner(procedure(Points(1)))
    status = runner.status().answer()
    runner.run()
    bed.journal.close()
    assert status.pop("ok") is True
    assert set(status) == STATUS
    assert status["state"] in RUN.states
    unknown = dict.fromkeys(("rail", "strip", "robot", "tracker"), DeviceStatus())
    assert status["devices"] == unknown
    assert status["prompt"] is None


def test_a_paused_run_keeps_its_readings_fresh(bed: Bed) -> None:
    with Live(bed, procedure(Points(MANY))) as live:
        live.runner.post("pause")
        live.until("state", "paused")
        until(lambda: live.status("devices")["robot"]["state"] == "fresh")
        bed.rail.position_mm = 1234.5
        until(lambda: live.status("devices")["strip"]["text"] == "1234.50 mm")
        live.runner.post("stop")


def test_the_station_that_is_held_is_in_the_interlocks(bed: Bed) -> None:
    def hold(session: CellSession, number: int) -> None:
        session.hold_station(session.cell.station_named("S300"))

    with Live(bed, procedure(Points(MANY, hold))) as live:
        until(lambda: bool(live.status("points")))
        live.runner.post("pause")
        live.until("state", "paused")
        bed.rail.position_mm = 301.0
        until(lambda: "S300" in live.status("interlocks")[1]["blocked"])
        live.runner.post("stop")


def test_a_second_interrupt_does_not_wait_for_the_point(
    bed: Bed, measuring: Measuring, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner_module, "WORKER_S", 0.0)
    with measuring as live:
        live.runner.post("interrupt")
        live.runner.post("interrupt")
        until(lambda: bed.rail.stopped_s is not None)
        assert live.status("points") == 0
