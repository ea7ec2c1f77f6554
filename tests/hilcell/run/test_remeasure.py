"""A point is re-measured while nothing was built on it, at once or when a run is resumed."""

from typing import Any

import numpy as np
import pytest

from hilcell.cell.file import Cell
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId
from hilcell.run.cell_session import CellSession
from hilcell.run.states import CALIBRATION, remeasure_refusal, retake_refusal
from tests.hilcell.run.bed import Bed, Live, until
from tests.hilcell.run.rig import procedure

POINT = {
    "id": {"kind": "grid", "target": "key"},
    "reflector": "SMR",
    "xyz_mm": (0.0, 0.0, 0.0),
    "std_mm": (0.0, 0.0, 0.0),
    "samples": 1,
    "temperature_c": 20.0,
    "pressure_mbar": 1000.0,
    "humidity_percent": 50.0,
    "session": 1,
    "frame": "tracker",
    "group": "",
}
SIX = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)


def log_with(kind: str, calibration: str, **facts: object) -> Log:
    point = POINT | {"id": {"kind": kind}, "station": "S1100", "commanded_deg": SIX} | facts
    state = {"machine": "calibration", "from": "unknown", "to": calibration}
    return Log(
        [
            Record(1, "", "state", "", state),
            Record(2, "", "point", "key", point),
        ]
    )


FITTED = CALIBRATION.states[CALIBRATION.states.index("fitted") :]
BEFORE = CALIBRATION.states[: CALIBRATION.states.index("fitted")]


@pytest.mark.parametrize(
    ("kind", "allowed_in"),
    [
        ("grid", BEFORE),
        ("repeatability", BEFORE),
        ("validate", CALIBRATION.states),
        *((kind, ()) for kind in ("base", "sign", "frames", "campaign")),
    ],
)
def test_what_may_be_retaken_when(kind: str, allowed_in: tuple[str, ...]) -> None:
    for state in CALIBRATION.states:
        refused = retake_refusal(log_with(kind, state), "key")
        assert (refused == "") == (state in allowed_in), refused


@pytest.mark.parametrize("facts", [{"station": ""}, {"commanded_deg": None}])
def test_only_what_the_robot_can_go_to_again(facts: dict[str, object]) -> None:
    assert retake_refusal(log_with("grid", "base_framed", **facts), "key")


def test_a_point_never_measured_is_refused_and_one_that_waits() -> None:
    log = log_with("grid", "base_framed")
    assert "other" in retake_refusal(log, "other")
    log.take(Record(3, "", "event", "", {"what": "retake asked", "key": "key"}))
    assert list(log.retakes) == ["key"]
    assert "key" in retake_refusal(log, "key")
    assert remeasure_refusal(log, log.points["key"]) == ""
    log.take(Record(4, "", "point", "key", POINT | {"station": "S1100"}))
    assert list(log.retakes) == []


class Flange:
    """A part that measures flange points and judges them; ``act`` is called before each."""

    name = "flange"
    needs = moves = measures = yields = ""

    def __init__(self, count: int, kind: str, act: Any = None) -> None:
        self.count, self.kind, self.act = count, kind, act

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        return PlannedStep(self.name, self.count, 1.0)

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        home = np.radians(session.cell.robot.home_deg)
        for number in range(self.count):
            if self.act is not None:
                self.act(session, number)
            station = session.cell.station[number % len(session.cell.station)]
            session.flange_point(
                PointId(self.kind, number=number),
                station,
                home + 0.001 * number,
                nominal_mm=np.array([1.0, 2.0, number]),
            )
        session.verdict("judged", holds=True, points=len(session.log.points))

    def result(self, log: Log) -> dict[str, Any]:
        return {}


def keys(bed: Bed) -> list[str]:
    return [record.key for record in bed.records("point")]


def test_a_live_run_measures_it_at_its_next_flange_point(bed: Bed) -> None:
    runner: list[Any] = []

    def act(session: CellSession, number: int) -> None:
        if number == 3 and not session.log.points["validate/001"].retaken:
            assert runner[0].retake("validate/001") == ""
            assert runner[0].status().retakes == ["validate/001"]

    runner.append(bed.runner(procedure(Flange(4, "validate", act))))
    assert runner[0].run() == 0
    bed.journal.close()
    assert keys(bed) == [f"validate/00{number}" for number in (0, 1, 2, 1, 3)]
    log = bed.log()
    first, again = (r.body for r in bed.records("point") if r.key == "validate/001")
    assert (first["retaken"], again["retaken"]) == (False, True)
    assert log.points["validate/001"].retaken
    for fact in ("group", "station", "nominal_mm", "commanded_deg", "joints_deg"):
        assert again[fact] == pytest.approx(first[fact]) if fact != "group" else first[fact]
    assert log.retakes == {}


def test_one_asked_for_behind_the_last_point_is_judged_too(bed: Bed) -> None:
    asked: list[str] = []

    class Late(Flange):
        def perform(self, session: CellSession) -> None:
            super().perform(session)
            if not asked:
                asked.append(runner.retake("validate/000"))

    runner = bed.runner(procedure(Late(2, "validate")))
    assert runner.run() == 0
    bed.journal.close()
    assert asked == [""]
    assert keys(bed) == ["validate/000", "validate/001", "validate/000"]
    assert [r.kind for r in bed.records("verdict")] == ["verdict"] * 2


def test_a_finished_run_is_opened_again(bed: Bed) -> None:
    what = procedure(Flange(2, "validate"))
    assert bed.run(what) == 0
    runner = bed.runner(what)
    assert runner.retake("validate/001") == ""
    assert runner.run() == 0
    bed.journal.close()
    assert bed.states() == ["checking", "running", "finished"] * 2
    assert keys(bed) == ["validate/000", "validate/001", "validate/001"]
    assert len(bed.records("end")) == 2
    assert bed.log().session == 2


def test_one_that_came_too_late_is_refused_and_told(bed: Bed) -> None:
    def act(session: CellSession, number: int) -> None:
        if number == 1:
            assert runner.retake("grid/000") == ""
            for record in [row[0] for row in CALIBRATION.rows]:
                session.reach(record)

    runner = bed.runner(procedure(Flange(2, "grid", act)))
    assert runner.run() == 0
    bed.journal.close()
    assert keys(bed) == ["grid/000", "grid/001"]
    (refused,) = bed.events("retake refused")
    assert refused["key"] == "grid/000"


def test_a_refusal_reaches_who_asked(bed: Bed) -> None:
    with Live(bed, procedure(Flange(10**6, "base"))) as live:
        until(lambda: live.status("points") > 0)
        assert live.runner.retake("x" * 5000)
        assert "base/000" in live.runner.retake("base/000")
        live.runner.stop()
    assert bed.events("retake asked") == []
