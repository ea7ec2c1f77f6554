"""Repeatability, and poses that are re-visited."""

from __future__ import annotations

import numpy as np
import pytest

from hilcell.calibration.diagnosis import CLOSING, REVISIT, SecondVisits
from hilcell.calibration.lost_motion import REVERSAL
from hilcell.cell.file import Cell, load_cell
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.point import Point, PointId
from hilcell.ports import Array
from procedures.repeatability import Repeatability
from tests.whole.bench import record_of
from tests.whole.golden import GoldenRuns

PLACES = 3
TRACKER_MM = (0.0075, 0.0105, 0.0105)


class Visits(Log):
    """Visits of three places: each coordinate's noise of robot and tracker in mm, 1 sigma."""

    def __init__(self, cell: Cell, robot_mm: float, seed: int) -> None:
        super().__init__()
        self._cell = cell
        rng = np.random.default_rng(seed)
        for place in range(len(Repeatability.places_mm(cell))):
            for visit in range(Repeatability.visits(cell) + cell.plan.quick):  # and the re-visit
                noise_mm = rng.standard_normal(3) * robot_mm
                noise_mm += rng.standard_normal(3) * np.array(TRACKER_MM)
                self.put(place, visit, noise_mm)

    def put(self, place: int, visit: int, off_mm: Array) -> None:
        id = PointId("repeatability", place=place, number=visit)
        self._take_point(_point(id, 1000.0 * place + off_mm), visit + 1)

    @property
    def cell(self) -> Cell:
        assert self._cell is not None
        return self._cell


def _point(id: PointId, xyz_mm: Array) -> Point:
    x, y, z = xyz_mm.tolist()
    return Point(
        id=id, key=id.key, group=id.group, station="S1100", reflector="",
        xyz_mm=(x, y, z), std_mm=TRACKER_MM, samples=1, temperature_c=23.0,
        pressure_mbar=1009.0, humidity_percent=45.0, session=1, frame="tracker",
    )  # fmt: skip


@pytest.fixture(scope="module", params=["false", "true"])
def logs(request: pytest.FixtureRequest) -> list[Visits]:
    cell = load_cell("paper", {"plan.quick": request.param})
    return [Visits(cell, 0.0166, seed) for seed in range(100)]


def test_the_pooled_radius_is_the_rp_of_very_many_visits(logs: list[Visits]) -> None:
    """16.6 um on each Cartesian axis is RP .06 (the distances are Maxwell's)."""
    found = [Repeatability.repeated(log) for log in logs]
    off_mm = 0.004 if logs[0].cell.plan.quick else 0.003  # s of few visits is a little low
    assert np.mean([each.pooled_radius_robot_mm for each in found]) == pytest.approx(
        0.060, abs=off_mm
    )
    whole_mm = float(np.sqrt(3 * 0.0166**2 + np.square(TRACKER_MM).sum()))
    assert np.mean([each.pooled_radius_mm for each in found]) == pytest.approx(
        0.060 * whole_mm / (0.0166 * np.sqrt(3)), abs=off_mm
    )


def test_rp_is_the_standards_at_its_worst_place_and_the_pooled_radius_another_figure() -> None:
    """By hand from ISO 9283:1998, 7.2.2, with the barycentres .01, 0 and 0 mm:

    P0: l = .01 (4 times), .04: mean .016, S = sqrt(.00072 / 4); RP = .05625 mm
    P1: l = .02 (4 times), 0: mean .016, S = sqrt(.00032 / 4); RP = .04283 mm
    P2: l = 0; RP = 0. Pooled: 15 distances, times sqrt(5 / 4): mean .01193, s .01300.
    """
    log = Visits(load_cell("paper", {"plan.quick": "true"}), 0.0, 1)
    along_mm = [(0, 0, 0, 0, 0.05), (-0.02, 0.02, -0.02, 0.02, 0), (0, 0, 0, 0, 0)]
    for place, offs_mm in enumerate(along_mm):
        for visit, off_mm in enumerate(offs_mm):
            log.put(place, visit, np.array([off_mm, 0.0, 0.0]))
    found = Repeatability.repeated(log)
    assert found.rp_mm == pytest.approx(0.0562492, abs=1e-7)
    assert found.pooled_radius_mm == pytest.approx(0.0509311, abs=1e-7)
    noise_mm2 = 0.0075**2 + 2 * 0.0105**2  # of a reading, of TRACKER_MM
    scatter_mm2 = (4 * 0.01**2 + 0.04**2) / 4
    wanted_mm = 0.0562492 * np.sqrt(1.0 - noise_mm2 / scatter_mm2)
    assert found.rp_robot_mm == pytest.approx(wanted_mm, abs=1e-7)


def test_the_floor_does_not_depend_on_few_visits(logs: list[Visits]) -> None:
    sigma_mm = np.sqrt((0.0166**2 * 3 + np.square(TRACKER_MM).sum()) / 3)
    mean_mm = 2 * sigma_mm * np.sqrt(2 / np.pi)  # of a Maxwell distribution
    assert np.mean([Repeatability.floor(log).mean for log in logs]) == pytest.approx(
        mean_mm, rel=0.02
    )


def test_a_robot_that_is_better_than_the_tracker_has_no_radius_of_its_own() -> None:
    logs = [Visits(load_cell("paper"), 0.0, seed) for seed in range(20)]
    found = [Repeatability.repeated(log).pooled_radius_robot_mm for log in logs]
    assert min(found) == 0.0
    assert max(found) < 0.03


# -- Poses are visited again later than they were first, whatever is re-measured in between --------


VERTEX = (1, 1, 0)  # one that is visited again


@pytest.fixture(scope="module")
def records(golden: GoldenRuns) -> list[Record]:
    return [record_of(event) for event in golden["small"].events]


def re_measured(log: Log, records: list[Record], key: str, off_mm: float = 0.0) -> None:
    """Take a point's record once more, as the newest, beside its first place."""
    (first,) = (each for each in records if each.kind == "point" and each.key == key)
    x, y, z = first.body["xyz_mm"]
    body = first.body | {"xyz_mm": (x + off_mm, y, z), "retaken": True}
    assert log.newest is not None
    log.take(Record(log.newest.seq + 1, first.t, "point", key, body))


def overtaken_of(log: Log, *kinds: str) -> list[Point]:
    seconds = [SecondVisits(log, kind) for kind in kinds]
    return [p for each in seconds for p in log.select(each.kind) if each.is_overtaken(p)]


def test_a_vertex_is_compared_with_a_later_visit_only(records: list[Record]) -> None:
    """A vertex that was re-measured after it was visited again has changed behind that visit."""
    judged = next(n for n, each in enumerate(records, 1) if each.key == "revisits")
    log = Log(records[:judged])
    before = len(SecondVisits(log, REVISIT).points)
    assert overtaken_of(log, REVISIT, REVERSAL) == []
    re_measured(log, records, "grid/1-1-0", off_mm=1.0)
    assert SecondVisits(log, REVISIT).change().suspicion is None
    assert len(SecondVisits(log, REVISIT).points) == before - 1
    assert {point.id.vertex for point in overtaken_of(log, REVISIT, REVERSAL)} == {VERTEX}
    re_measured(log, records, "revisit/1-1-0", off_mm=1.0)
    assert [point.id.vertex for point in SecondVisits(log, REVISIT).points][-1] == VERTEX
    assert {point.id.kind for point in overtaken_of(log, REVISIT, REVERSAL)} == {REVERSAL}
    assert SecondVisits(log, REVISIT).change().suspicion is None


def test_whatever_is_measured_after_the_closing_visits_overtakes_them(
    records: list[Record],
) -> None:
    log = Log(records)
    assert overtaken_of(log, CLOSING) == []
    re_measured(log, records, "held/S1100/1-0/P1")
    assert overtaken_of(log, CLOSING) == []
    re_measured(log, records, "validate/S300/chosen/001")
    assert overtaken_of(log, CLOSING) == log.select(CLOSING)
    first = log.select(CLOSING)[0]
    re_measured(log, records, first.key)
    assert overtaken_of(log, CLOSING) == log.select(CLOSING)[1:]
