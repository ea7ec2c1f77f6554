"""What a whole run lets suspect: a cause is named where no larger one explains the figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.calibration.causes import LARGE_AXES, patterns, zero_columns
from hilcell.calibration.diagnosis import (
    TargetDeviations,
    misplaced_base,
    suspected_causes,
    worse_than_stated,
)
from hilcell.calibration.frames import world_motion
from hilcell.calibration.lost_motion import REVERSAL
from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.frames import from_rotvec, inverse
from hilcell.journal.journal import Record, read_journal
from hilcell.journal.log import Log, commanded_rad
from hilcell.journal.runs import JOURNAL
from hilcell.model.frame import Frame, MeasuredBase
from hilcell.model.plan import PreviousReference
from hilcell.model.point import Point
from hilcell.model.verdicts import Cause, Revisited, Suspicion
from hilcell.ports import Array
from procedures.plan import joints_for
from procedures.validate import targets
from tests.hilcell.verdicts import BASE
from tests.whole.golden import GoldenRuns


@pytest.fixture(scope="module")
def records(golden: GoldenRuns) -> list[Record]:
    return list(read_journal(golden["small"].folder / JOURNAL))


def move(log: Log, points: Iterable[Point], off_mm: Array) -> None:
    """Move what was measured by (N, 3), axes of {B}."""
    R_L_B = (inverse(log.matrix("world")) @ log.matrix("base"))[:3, :3]
    for point, by_mm in zip(points, off_mm @ R_L_B.T, strict=True):
        x, y, z = (np.array(log.points[point.key].xyz_mm) + by_mm).tolist()
        log.points[point.key] = msgspec.structs.replace(log.points[point.key], xyz_mm=(x, y, z))


def robot_changes(cause: int, size_mm: float, *, after: float | None) -> Callable[[Log], None]:
    """Let a pattern move all poses by a mean of ``size_mm``: after a share of the run; slowly
    where that is None.
    """

    def disturb(log: Log) -> None:
        points = sorted((p for p in log.points.values() if p.commanded_deg), key=log.recorded)
        off_mm = patterns(log.cell.robot.arm(), commanded_rad(points))[cause].columns[:, :1]
        off_mm = off_mm.reshape(-1, 3) * size_mm / np.sqrt(np.square(off_mm).mean() * 3.0)
        seen = np.array([log.recorded(p) for p in points], dtype=float)
        share = (seen - seen[0]) / (seen[-1] - seen[0])
        move(log, points, off_mm * (share if after is None else share > after)[:, None])

    return disturb


def scattered(kind: str, std_mm: float) -> Callable[[Log], None]:
    def disturb(log: Log) -> None:
        points = log.select(kind)
        move(log, points, np.random.default_rng(1).normal(0.0, std_mm, (len(points), 3)))

    return disturb


def tracker_drifts(log: Log) -> None:
    for point in [*log.points.values()]:
        move(log, [point], np.array([[2e-3 * log.recorded(point), 0.0, 0.0]]))


def room_warms(log: Log) -> None:
    key = log.select("grid")[-1].key
    log.points[key] = msgspec.structs.replace(log.points[key], temperature_c=45.0)


def axis_2_loses_motion(log: Log) -> None:
    points, arm = log.select(REVERSAL), log.cell.robot.arm()
    J = zero_columns(arm, commanded_rad(points))
    move(log, points, -200e-6 * J[:, :, 1])


def wider_circle(log: Log) -> None:
    base = log.frame(MeasuredBase, "base")
    first, text_width_mm = base.radius_mm
    log.frames["base"] = msgspec.structs.replace(base, radius_mm=[first, text_width_mm + 4.0])


def nest_rises(log: Log) -> None:
    then, up = log.matrix("base"), log.matrix("world")[:3, :3].T[:, 2]
    moved = world_motion(log, then[:3, 3], 1, 2.0 * up)
    then[:3, 3] -= moved[:3]
    then[:3, :3] = from_rotvec(-moved[3:]) @ then[:3, :3]
    base = Frame(matrix=then.tolist(), covariance=log.frames["base"].covariance)
    before = PreviousReference("c1", {}, None, base, alike=True)
    log.plan = msgspec.structs.replace(log.inputs, floor_before=before)


DISTURBANCES: dict[str, tuple[Callable[[Log], None], ...]] = {
    "none": (),
    "slip": (robot_changes(0, 2.0, after=0.5),),
    "zero": (robot_changes(3, 2.0, after=0.9),),
    "slow": (robot_changes(2, 0.5, after=None),),
    "tracker": (tracker_drifts,),
    "targets": (scattered("validate", 0.4),),
    "visits": (scattered("repeatability", 0.6), room_warms),
    "mount": (wider_circle, axis_2_loses_motion, scattered("validate", 0.4)),
    "nest": (nest_rises, tracker_drifts),
    "all": (nest_rises, room_warms, wider_circle, robot_changes(4, 3.0, after=0.7)),
}


def disturbed(records: list[Record], name: str) -> Log:
    """Return a log of its own, for it keeps what was computed of it."""
    log = Log(records)
    for disturb in DISTURBANCES[name]:
        disturb(log)
    return log


SUSPECTED = {
    "none": [],
    "slip": [Cause.MOUNT_SLIPPED],
    "zero": [Cause.ZERO_LOST],
    "slow": [Cause.ZERO_LOST],  # which the re-visited poses show, not the slope
    "tracker": [Cause.UNKNOWN, Cause.DRIFT],
    "targets": [Cause.REPEATABILITY],
    "visits": [Cause.TEMPERATURE, Cause.REPEATABILITY],
    "mount": [Cause.MOUNT_OFFSET, Cause.REVERSAL],  # and no scatter of the targets
    "nest": [Cause.NEST_MOVED, Cause.UNKNOWN, Cause.DRIFT],  # and no base that has changed since
    "all": [Cause.TEMPERATURE, Cause.NEST_MOVED, Cause.MOUNT_OFFSET, Cause.ZERO_LOST],
}


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_small_change_is_named_where_no_large_one_is(records: list[Record], name: str) -> None:
    assert [each.cause for each in suspected_causes(disturbed(records, name))] == SUSPECTED[name]


def test_causes_follow_from_a_verdict_that_comes_later(records: list[Record]) -> None:
    """They are kept until then, and not until the next measurement."""
    log = Log(records)
    assert suspected_causes(log) == []
    cause = Suspicion(Cause.MOUNT_SLIPPED, 2.0, "mm", "re-visits")
    found = Revisited(holds=False, ratio=9.0, limit=2.0, suspicion=cause, suspected=[cause.text])
    body = msgspec.to_builtins(found)
    log.take(Record(log.version + 1, records[-1].t, "verdict", "revisits", body))
    assert suspected_causes(log) == [cause]


def test_every_cause_is_in_a_test_here_or_beside_it() -> None:
    beside = {
        Cause.SCALE, Cause.INSTRUMENT, Cause.REFLECTOR, Cause.BASE_MISPLACED, Cause.CHANGED_SINCE,
        Cause.STRIP, Cause.TRACKER_MOVED,
    }  # fmt: skip
    assert {*Cause} - {cause for causes in SUSPECTED.values() for cause in causes} == beside


CELL = load_cell("paper")
ARM = CELL.robot.arm()
SIGMA_MM = 0.018  # of one coordinate: robot, readings, model
VISITS = 3.0 * 27  # degrees of freedom of thirty visits of three places
COUNT = 135


def columns() -> Array:
    joints_rad = joints_for(CELL, targets(CELL, 1)["S1100"][:COUNT])
    found: Array = zero_columns(ARM, joints_rad)[:, :, :LARGE_AXES]
    return found


COLUMNS = columns()


def scatter(
    seed: int, *, axis: int = 0, slip_deg: float = 0.0, share: float = 1.0
) -> Suspicion | None:
    """Return what targets let suspect of which one axis slips; ``share`` of the stated sigma."""
    rng = np.random.default_rng(seed)
    known_mm2 = rng.chisquare(VISITS) / VISITS * SIGMA_MM**2  # as thirty visits estimate it
    off_mm = share * SIGMA_MM * rng.standard_normal((COUNT, 3))
    slips_rad = np.radians(slip_deg) * rng.standard_normal(COUNT)
    off_mm += COLUMNS[:, :, axis - 1] * slips_rad[:, None]
    covariance_mm2 = np.tile(known_mm2 * np.eye(3), (COUNT, 1, 1))
    off_mm -= off_mm.mean(axis=0)
    return TargetDeviations(off_mm, covariance_mm2, COLUMNS, VISITS).worst_scatter()


def test_chance_is_no_scatter() -> None:
    assert not any(scatter(seed) for seed in range(200))


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_the_axis_that_slips_is_named_with_its_size(axis: int) -> None:
    """.003 deg of axis 2 leave a mean of .055 mm beside a floor of .03, well within .12."""
    for seed in range(20):
        found = scatter(seed, axis=axis, slip_deg=0.003)
        assert found is not None
        assert found.unit == f"deg of axis {axis}"
        assert found.size == pytest.approx(0.003, rel=0.3)


def test_a_robot_that_scatters_in_all_directions_is_found() -> None:
    for seed in range(20):
        assert scatter(seed, share=2.0) is not None


def test_a_figure_that_is_none_holds_nothing() -> None:
    assert scatter(0, share=float("nan")) is not None


def stating(log: Log, rp_mm: float | None) -> Log:
    cell = {**log.inputs.cell, "robot": {**log.inputs.cell["robot"], "rp_mm": rp_mm}}
    log.plan = msgspec.structs.replace(log.inputs, cell=cell)
    return log


def test_visits_that_keep_the_stated_repeatability_are_no_suspicion(log: Log) -> None:
    assert worse_than_stated(stating(log, 0.06)) is None


def test_visits_are_compared_with_no_repeatability_that_nobody_states(log: Log) -> None:
    assert worse_than_stated(stating(log, None)) is None


def test_visits_that_scatter_by_more_than_the_stated_repeatability_are_one(log: Log) -> None:
    found = worse_than_stated(stating(log, 0.02))
    assert found is not None
    assert (found.cause, found.unit) == ("repeatability", "mm")
    assert found.size == pytest.approx(0.06, abs=0.02)
    assert "RP 0.02 mm stated" in found.noticed_by


def test_the_noise_of_readings_is_not_the_robots(log: Log) -> None:
    for point in log.select("repeatability"):
        log.points[point.key] = msgspec.structs.replace(point, std_mm=(0.1, 0.1, 0.1))
    assert worse_than_stated(stating(log, 0.02)) is None


class Based(Log):
    """A base measured ``off_mm`` (3,) beside its place in the cell file."""

    def __init__(self, cell: Cell, off_mm: list[float]) -> None:
        super().__init__()
        self._cell = cell
        matrix = cell.layout.nominal_base(cell.reference.rail_mm)
        matrix[:3, 3] += off_mm
        self.frames["base"] = replace(BASE, matrix=matrix.tolist())

    @property
    def cell(self) -> Cell:
        assert self._cell is not None
        return self._cell


BOLTED = [1.5, -2.0, 0.8]  # as far as bolts and nests let it


@pytest.mark.parametrize(
    ("higher_mm", "unit"),
    [
        (12.7, "mm along z of {W}, as of 0.5 in reflectors in floor nests for 1.5 in"),
        (-12.7, "mm along z of {W}, as of 1.5 in reflectors in floor nests for 0.5 in"),
    ],
)
def test_reflectors_of_another_size_in_all_nests_are_named(higher_mm: float, unit: str) -> None:
    found = misplaced_base(Based(CELL, [BOLTED[0], BOLTED[1], higher_mm]))
    assert found is not None
    assert (found.cause, found.unit) == ("reflector", unit)
    assert found.size == pytest.approx(higher_mm)


def test_a_base_elsewhere_is_misplaced_beyond_its_tolerance_only() -> None:
    assert misplaced_base(Based(CELL, BOLTED)) is None
    found = misplaced_base(Based(CELL, [30.0, 0.0, 0.0]))
    assert found is not None
    assert found.cause == "base misplaced"
    assert found.size == pytest.approx(30.0)
    wide = load_cell("paper", {"layout.base_tolerance_mm": "40.0"})
    assert misplaced_base(Based(wide, [30.0, 0.0, 0.0])) is None
    assert misplaced_base(Based(CELL, [np.nan, 0.0, 0.0])) is not None


def test_without_circles_nothing_is_known() -> None:
    log = Based(CELL, [30.0, 0.0, 0.0])
    log.frames.clear()
    assert misplaced_base(log) is None
