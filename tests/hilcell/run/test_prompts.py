"""A prompt is left only by an answer that a later look proves."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

import hilcell.run.worker as worker_module
from hilcell.cell.file import load_cell
from hilcell.model.point import PointId
from hilcell.ports import DeviceError, NoReading
from hilcell.run import device_status
from hilcell.run.cell_session import CellSession
from hilcell.run.meter import Meter
from hilcell.run.prompts import Prompt
from tests.hilcell.run.bed import Bed, Live, broken_beam, until
from tests.hilcell.run.rig import Points, failing, hang, procedure


@pytest.fixture
def bed(bed: Bed) -> Bed:
    bed.unattended = False
    bed.tracker.answer = blocked
    return bed


def blocked() -> None:
    raise NoReading("HC-T10", "Tracker", "measure", "the beam broke", act="clear the line of sight")


def gone() -> None:
    raise DeviceError("HC-T01", "Tracker", "measure", "link lost", act="check the cable")


def test_a_look_that_nobody_answered_grows_old(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_module, "POLL_S", 1000.0)  # looks once
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        until(lambda: live.status("prompt")["age_s"] is not None)
        bed.clock.pc_at_s += 2.5
        assert live.status("prompt")["age_s"] == 2.5
        assert live.status("prompt")["seen_mm"] is None
        assert live.status("prompt")["ready"] is False
        live.runner.stop()


def clear() -> None:
    """Let the beam through."""


def test_a_lasting_break_asks_and_goes_on_when_the_reflector_is_seen(bed: Bed) -> None:
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        prompt = live.status("prompt")
        assert prompt["place"] == "F1"
        assert len(prompt["expected_mm"]) == 3
        until(lambda: live.status("prompt")["age_s"] is not None)
        assert live.status("prompt")["ready"] is False
        assert live.status("prompt")["seen_mm"] is None
        assert "F1" in live.runner.answer()
        assert live.status("state") == "suspended"
        bed.tracker.answer = clear
        until(lambda: live.status("prompt")["ready"] is True)
        assert live.status("prompt")["seen_mm"] == 0.0
        assert live.status("state") == "suspended"  # seeing is not enough: he must say so
        assert live.runner.answer() == ""
        assert live.status("prompt") is None
    assert live.code == 0
    assert bed.states() == ["checking", "running", "suspended", "running", "finished"]
    (suspended,) = bed.asked()
    assert suspended["error"]["code"] == "HC-T10"
    assert suspended["error"]["operation"] == "measure p/0"
    assert suspended["prompt"]["place"] == "F1"
    assert len(bed.events("answer refused")) == 1


@pytest.mark.parametrize(
    ("error", "advice"),
    [
        (NoReading("HC-T05", "Tracker", "measure", "no air"), "Check the weather station"),
        (NoReading("HC-T10", "Tracker", "measure", "the beam broke"), "Clear the line of sight"),
        (NoReading("XY-T01", "Tracker", "measure", "odd", act="turn it round"), "Turn it round"),
        (NoReading("XY-T01", "Tracker", "measure", "odd"), "Check that nothing is in the line"),
    ],
)
def test_a_failed_reading_shows_the_steps_of_its_own_cause(error: NoReading, advice: str) -> None:
    cell = load_cell("paper")
    prompt = Prompt.failed_reading(cell, "grid/0-0-0", "flange", np.zeros(3), 20.0, error)
    assert prompt.text.partition("flange. ")[2].startswith(advice)
    assert prompt.text.endswith(".")
    assert not prompt.text.endswith("..")
    assert prompt.unanswered(error).act.casefold().startswith(advice.casefold())


def test_what_was_seen_before_the_answer_proves_nothing(bed: Bed) -> None:
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        bed.tracker.answer = clear
        until(lambda: live.status("prompt")["ready"] is True)
        bed.tracker.answer = blocked
        assert "the beam broke" in live.runner.answer()
        bed.tracker.answer = clear
        assert live.runner.answer() == ""


def test_a_look_under_way_does_not_count_for_an_answer_that_came_later(bed: Bed) -> None:
    entered, release = threading.Event(), threading.Event()
    answers: list[str] = []
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        bed.tracker.answer = hang(entered, release)
        entered.wait()
        asking = threading.Thread(target=lambda: answers.append(live.runner.answer()))
        asking.start()
        bed.tracker.answer = blocked  # from the next look on
        release.set()
        asking.join()
        assert "the beam broke" in answers[0]
        bed.tracker.answer = clear
        assert live.runner.answer() == ""


def test_a_reflector_far_off_is_refused_with_its_distance(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        bed.tracker.answer = clear
        monkeypatch.setattr(bed.tracker, "off_mm", np.array([0.0, 60.0, 0.0]))
        until(lambda: live.status("prompt")["seen_mm"] == 60.0)
        assert live.status("prompt")["ready"] is False
        assert "60.00 mm" in live.runner.answer()
        monkeypatch.setattr(bed.tracker, "off_mm", np.full(3, np.nan))
        assert "nan mm" in live.runner.answer()
        monkeypatch.setattr(bed.tracker, "off_mm", np.zeros(3))
        assert live.runner.answer() == ""


@pytest.mark.parametrize("command", ["stop", "abort"])
def test_a_prompt_is_left_by_stop_and_abort(bed: Bed, command: str) -> None:
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        live.runner.post(command)
    assert live.code == 4
    way = ["aborting"] if command == "abort" else []
    assert bed.states() == ["checking", "running", "suspended", *way, "stopping", "aborted"]


def test_an_answer_under_way_ends_with_the_run(bed: Bed) -> None:
    entered, release = threading.Event(), threading.Event()
    answers: list[str] = []
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        bed.tracker.answer = hang(entered, release)
        asking = threading.Thread(target=lambda: answers.append(live.runner.answer()))
        asking.start()
        entered.wait()
        live.runner.stop()
        release.set()
        asking.join()
    assert all(answers)
    assert live.code == 4


def test_a_pause_asked_for_before_a_prompt_comes_after_it(bed: Bed) -> None:
    entered, release = threading.Event(), threading.Event()
    bed.tracker.answer = hang(entered, release)
    with Live(bed, procedure(Points(2))) as live:
        entered.wait()
        live.runner.post("pause")
        live.until("pausing", True)
        bed.tracker.answer = blocked
        release.set()
        live.until("state", "paused")
        live.runner.post("proceed")
        live.until("state", "suspended")
        live.runner.post("stop")


def test_a_pause_asked_for_in_the_last_try_holds_after_the_prompt(bed: Bed) -> None:
    entered, release = threading.Event(), threading.Event()
    tries = iter([clear] * (Meter.TRIES - 1) + [hang(entered, release)])

    def answer() -> None:
        next(tries, clear)()
        blocked()

    bed.tracker.answer = answer
    with Live(bed, procedure(Points(2))) as live:
        entered.wait()
        live.runner.post("pause")
        live.until("pausing", True)
        release.set()
        live.until("state", "suspended")
        bed.tracker.answer = clear
        assert live.runner.answer() == ""
        live.until("state", "paused")
        live.runner.post("proceed")
    assert live.code == 0
    way = ["pausing", "suspended", "running", "pausing", "paused", "running"]
    assert bed.states() == ["checking", "running", *way, "finished"]


def until_asked(bed: Bed, times: int) -> None:
    until(lambda: len(bed.asked()) == times)


def test_a_beam_that_breaks_again_asks_again(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_module, "POLL_S", 1000.0)  # looks for answers alone
    good = [0]

    def answer() -> None:
        if not good[0]:
            blocked()
        good[0] -= 1

    bed.tracker.answer = answer
    with Live(bed, procedure(Points(1))) as live:
        for number, readings in ((1, 1), (2, 1), (3, 2)):
            until_asked(bed, number)
            until(lambda: live.status("prompt")["age_s"] is not None)
            good[0] = readings  # one proves the answer, another is the measurement
            assert live.runner.answer() == ""
    assert live.code == 0


def test_unattended_nobody_is_asked(bed: Bed) -> None:
    bed.unattended = True
    bed.tracker.answer = broken_beam(3)
    assert bed.run(procedure(Points(1))) == 3
    assert "suspended" not in bed.states()
    error = bed.log().life[-1].change.error
    assert (error["code"], error["fields"]) == ("HC-T10", {"point": "p/0"})
    end = bed.log().end
    assert end is not None
    assert end.error == error


def test_a_device_lost_while_the_run_asks_is_journalled_and_no_answer_is_taken(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(device_status.CellMonitor, "REFRESH_S", 0.0)
    read = bed.robot.read
    lost = DeviceError("HC-B02", "Robot", "read", "no answer", act="check its cable")
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        bed.tracker.answer = clear
        until(lambda: live.status("prompt")["ready"] is True)
        monkeypatch.setattr(bed.robot, "read", failing(lost))
        until(lambda: live.status("prompt")["ready"] is False)
        assert "robot" in live.runner.answer()
        assert live.status("state") == "suspended"
        monkeypatch.setattr(bed.robot, "read", read)
        until(lambda: live.status("prompt")["ready"] is True)
        assert live.runner.answer() == ""
    assert live.code == 0
    assert [body["error"]["code"] for body in bed.events("device lost")] == ["HC-B02"]
    assert [body["device"] for body in bed.events("device back")] == ["robot"]


def test_a_device_lost_at_the_answer_is_read_before_it_counts(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(device_status.CellMonitor, "REFRESH_S", 1e9)
    read, lost = bed.rail.read, DeviceError("HC-R01", "Rail", "read", "link lost")
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        bed.tracker.answer = clear
        monkeypatch.setattr(bed.rail, "read", failing(lost))
        assert "rail" in live.runner.answer()
        monkeypatch.setattr(bed.rail, "read", read)
        assert live.runner.answer() == ""


def test_proceed_is_proven_as_an_answer_is(bed: Bed) -> None:
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        live.runner.post("proceed")
        until(lambda: len(bed.events("answer refused")) == 1)
        assert live.status("state") == "suspended"
        bed.tracker.answer = clear
        live.runner.post("proceed")
    assert live.code == 0


# -- A reflector carried by hand is asked for where the journal says it is not ---------------------


QUICK = {"settle.robot_s": "0.0", "settle.rail_s": "0.0"}
BY_HAND = load_cell("paper", QUICK | {"layout.reflectors": "by_hand"})
S1100 = BY_HAND.station_named("S1100")
S1900 = BY_HAND.station_named("S1900")


@pytest.fixture
def hand_bed(tmp_path: Path) -> Bed:
    return Bed(tmp_path, unattended=False, cell=BY_HAND)


def slide(session: CellSession, number: int) -> None:
    """Measure P1 at two stations in turn, before the floor's first nest."""
    station = (S1100, S1900)[number % 2]
    id = PointId("s", number=number)
    session.slide_point(id, station, BY_HAND.layout.slide[0], samples=1)


def test_it_is_asked_for_once_a_place_and_where_it_rode_to(hand_bed: Bed) -> None:
    with Live(hand_bed, procedure(Points(2, slide))) as live:
        asked = []
        for _ in range(4):
            until(lambda: live.status("state") == "suspended")
            asked.append(live.status("prompt"))
            assert live.runner.answer() == ""
    assert live.code == 0
    assert [prompt["place"] for prompt in asked] == ["P1", "F1", "P1", "F1"]
    assert [prompt["limit_mm"] for prompt in asked] == [50.0, 50.0, 5.0, 5.0]
    rode_mm = np.array(asked[2]["expected_mm"]) - asked[0]["expected_mm"]
    assert np.linalg.norm(rode_mm) == pytest.approx(800.0, abs=0.01)
    assert asked[3]["expected_mm"] == pytest.approx(asked[1]["expected_mm"])
    assert [event["place"] for event in hand_bed.events("seated")] == [
        "P1",
        "F1",
        "P1",
        "F1",
    ]


def test_nobody_is_asked_to_come_while_the_slide_has_power(hand_bed: Bed) -> None:
    def power(session: CellSession, number: int) -> None:
        hand_bed.rail.powered = True

    assert hand_bed.run(procedure(Points(1, power))) == 3
    assert "F1" in hand_bed.log().fault
    assert "suspended" not in hand_bed.states()


def test_the_robot_is_parked_before_somebody_is_asked(hand_bed: Bed) -> None:
    def away(session: CellSession, number: int) -> None:
        if number:
            hand_bed.robot.joints_rad = np.radians(BY_HAND.robot.home_deg)
            slide(session, 0)

    with Live(hand_bed, procedure(Points(2, away))) as live:
        live.until("state", "suspended")
        assert live.runner.answer() == ""
        until(lambda: (live.status("prompt") or {}).get("place") == "P1")
        assert np.allclose(np.degrees(hand_bed.robot.joints_rad), BY_HAND.robot.safe_deg)
        live.runner.stop()


def test_a_mounted_cell_asks_nobody(tmp_path: Path) -> None:
    hand_bed = Bed(tmp_path)
    assert hand_bed.run(procedure(Points(2))) == 0
    assert hand_bed.events("seated") == []
