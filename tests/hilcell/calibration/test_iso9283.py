"""Characteristics of ISO 9283 against sums written out by hand, their uncertainties and limits.

A figure and its uncertainty keep a limit, or it is not kept.
"""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hilcell.calibration.iso9283 import (
    CYCLE,
    Angles,
    Cube,
    Distance,
    Pose,
    PoseTest,
    commanded_mm,
    interruptions,
)
from hilcell.calibration.measurement_budget import (
    CENTRED,
    NOISE,
    WORLD,
    combined_mm,
    measurement_budget,
)
from hilcell.calibration.position_errors import Errors
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import to_rotvec
from hilcell.journal.log import Log
from hilcell.journal.runs import read_records
from hilcell.model.outcome import Outcome
from hilcell.model.point import PointId
from hilcell.model.verdicts import AP, ISO, RP
from hilcell.ports import Array
from tests.hilcell.calibration.pose_tests import made_up
from tests.hilcell.report.journals import Writer
from tests.hilcell.verdicts import plain

RNG = np.random.default_rng(9283)
NOTHING_MM2 = np.zeros((3, 3))


# -- poses and characteristics ---------------------------------------------------------------------


def test_the_poses_lie_on_the_diagonals_of_one_plane_of_the_largest_cube() -> None:
    """10 % of the diagonal from its ends (6.8.5), so 40 % of it from the centre."""
    cell = load_cell("paper", {"grid.size_mm": "[900.0, 600.0, 1200.0]"})
    cube, poses_mm = Cube.largest(cell), commanded_mm(cell)
    assert cube.side_mm == 600.0
    assert sorted(poses_mm) == sorted(CYCLE)
    assert poses_mm["P1"].tolist() == cube.centre_mm
    diagonal_mm = 600.0 * math.sqrt(3.0)
    levers_mm = np.array([poses_mm[f"P{n}"] - poses_mm["P1"] for n in range(2, 6)])
    assert np.linalg.norm(levers_mm, axis=1) == pytest.approx([0.4 * diagonal_mm] * 4)
    assert np.allclose(levers_mm[0], -levers_mm[2])  # P2 and P4, P3 and P5 on one diagonal each
    assert np.allclose(levers_mm[1], -levers_mm[3])
    assert np.linalg.matrix_rank(levers_mm) == 2


def errors(attained_mm: Array, wanted_mm: Array) -> Errors:
    return Errors(np.tile(wanted_mm, (len(attained_mm), 1)), attained_mm - wanted_mm)


def pose(attained_mm: Array, wanted_mm: Array = NOTHING_MM2[0], *, noise_mm2: float = 0.0) -> Pose:
    return Pose.of(errors(attained_mm, wanted_mm), wanted_mm, NOTHING_MM2, noise_mm2)


def test_accuracy_and_repeatability_of_a_pose() -> None:
    wanted = [100.0, 200.0, 300.0]
    attained = RNG.normal(wanted, 0.05, size=(30, 3)) + [0.3, -0.4, 1.2]
    found = pose(attained, np.array(wanted))
    mean = [sum(row[axis] for row in attained) / 30 for axis in range(3)]
    off = [mean[axis] - wanted[axis] for axis in range(3)]
    assert [found.ap_x_mm, found.ap_y_mm, found.ap_z_mm] == pytest.approx(off)
    assert found.ap_mm == pytest.approx(math.sqrt(sum(each**2 for each in off)))
    l_mm = [math.sqrt(sum((row[axis] - mean[axis]) ** 2 for axis in range(3))) for row in attained]
    l_mean = sum(l_mm) / 30
    s_l = math.sqrt(sum((each - l_mean) ** 2 for each in l_mm) / 29)
    assert (found.l_mean_mm, found.s_l_mm) == pytest.approx((l_mean, s_l))
    assert found.rp_mm == pytest.approx(l_mean + 3 * s_l)


def test_the_measurement_s_noise_is_taken_off() -> None:
    robot = RNG.normal(scale=0.02, size=(3000, 3))
    seen = robot + RNG.normal(scale=0.01, size=(3000, 3))
    wanted_mm = pose(robot).rp_mm
    found = pose(seen, noise_mm2=3 * 0.01**2)
    assert found.rp_mm > 1.08 * wanted_mm
    assert found.rp_robot_mm == pytest.approx(wanted_mm, rel=0.03)
    assert pose(seen, noise_mm2=1.0).rp_robot_mm == 0.0
    always_there = np.ones((4, 3))
    assert (
        pose(always_there, noise_mm2=0.01**2).rp_robot_mm == pose(always_there).rp_robot_mm == 0.0
    )


def distance(ends: tuple[Array, Array], wanted: Array) -> Distance:
    return Distance.of((errors(ends[0], wanted[0]), errors(ends[1], wanted[1])), 0.0)


def test_accuracy_and_repeatability_of_a_distance() -> None:
    wanted = np.array([[0.0, 0.0, 0.0], [300.0, -400.0, 1200.0]])
    one, other = (RNG.normal(end, 0.03, size=(30, 3)) for end in wanted * 1.001)
    found = distance((one, other), wanted)
    lengths = [math.dist(*each) for each in zip(one, other, strict=True)]
    mean = sum(lengths) / 30
    assert found.commanded_mm == pytest.approx(1300.0)
    assert found.ad_mm == pytest.approx(mean - 1300.0)
    assert found.rd_mm == pytest.approx(
        3 * math.sqrt(sum((each - mean) ** 2 for each in lengths) / 29)
    )
    along = [
        sum(abs(a[axis] - b[axis]) for a, b in zip(one, other, strict=True)) / 30
        for axis in range(3)
    ]
    assert [found.ad_x_mm, found.ad_y_mm, found.ad_z_mm] == pytest.approx(
        [along[0] - 300.0, along[1] - 400.0, along[2] - 1200.0]
    )


def test_stated_uncertainties_are_the_scatter_of_many_tests() -> None:
    """Of RP: l and S are not independent, and not normal; the figure is right to a quarter."""
    clouds = RNG.normal(size=(1600, 30, 3))
    found = [pose(cloud) for cloud in clouds]
    rp = np.array([each.rp_mm for each in found])
    assert np.mean([each.rp_u95_mm for each in found]) == pytest.approx(2.0 * rp.std(), rel=0.25)
    far = np.array([[5.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    ways = [
        distance((cloud + far[0], other), far)
        for cloud, other in zip(clouds[:800], clouds[800:], strict=True)
    ]
    for name, U in (("ad_mm", "ad_u95_mm"), ("rd_mm", "rd_u95_mm")):
        spread = np.std([getattr(each, name) for each in ways])
        assert np.mean([getattr(each, U) for each in ways]) == pytest.approx(2.0 * spread, rel=0.1)


def test_accuracy_and_repeatability_of_angles_by_scipy() -> None:
    """Attained orientations of a robot, made and read by scipy, in axes of the base."""
    rng = np.random.default_rng(41711)
    commanded = Rotation.from_euler("ZYX", [10.0, 70.0, 5.0], degrees=True)
    wanted_deg, scatter_deg = np.array([0.05, -0.03, 0.08]), np.array([0.01, 0.02, 0.005])
    angles_deg = wanted_deg + rng.normal(size=(30, 3)) * scatter_deg
    attained = Rotation.from_euler("xyz", angles_deg, degrees=True) * commanded
    turns_rad = to_rotvec(attained.as_matrix() @ commanded.as_matrix().T)
    found = Angles.of(turns_rad, NOTHING_MM2)
    peer_deg = (attained * commanded.inv()).as_euler("xyz", degrees=True)
    assert [*found.ap_deg.values()] == pytest.approx(peer_deg.mean(axis=0), abs=2e-4)
    rp_deg = np.array([*found.rp_deg.values()])
    assert rp_deg == pytest.approx(3.0 * peer_deg.std(axis=0, ddof=1), abs=2e-4)
    U = np.array([*found.rp_u95_deg.values()]) / rp_deg
    assert pytest.approx([2.0 / math.sqrt(2.0 * 29.0)] * 3) == U
    U_deg = np.array([*found.ap_u95_deg.values()])
    assert pytest.approx(2.0 * rp_deg / 3.0 / math.sqrt(30.0)) == U_deg
    assert Angles.of(turns_rad, None).ap_deg == {}


# -- limits ----------------------------------------------------------------------------------------


def result(ad_mm: float = -0.2, **limits: float) -> PoseTest:
    made = made_up()
    distance = msgspec.structs.replace(
        made.distance, ad_mm=ad_mm, ad_u95_mm=0.05, rd_mm=0.06, rd_u95_mm=0.01
    )
    worst = msgspec.structs.replace(
        made.worst, ap_mm=1.0, ap_u95_mm=0.1, rp_mm=0.05, rp_u95_mm=0.01
    )
    return msgspec.structs.replace(made, worst=worst, distance=distance, limits=limits)


@pytest.mark.parametrize(
    ("limits", "holds"),
    [
        ({"ap_limit_mm": 1.11}, True),
        ({"ap_limit_mm": 1.05}, False),  # AP keeps it, AP + U does not
        ({"rp_limit_mm": 0.061}, True),
        ({"rp_limit_mm": 0.059}, False),
        ({"ad_limit_mm": 0.26}, True),  # of either sign
        ({"ad_limit_mm": 0.24}, False),
        ({"rd_limit_mm": 0.071}, True),
        ({"rd_limit_mm": 0.069}, False),
        ({"ap_limit_mm": 1.05, "rp_limit_mm": 0.061}, False),
    ],
)
def test_a_limit_is_kept_with_the_uncertainty(limits: dict[str, float], holds: bool) -> None:
    judged = result(**limits).judgement()
    assert judged is not None
    assert judged.holds is holds
    assert limits.items() <= plain(judged).items()


def test_a_report_s_row_is_judged_by_the_same_rule() -> None:
    outcomes = {each.of: each.outcome for each in result(ap_limit_mm=1.05).figures()}
    assert outcomes[AP] is Outcome.UNDECIDED  # AP keeps it, AP + U does not
    assert outcomes[RP] is None


ANGLES = {
    "P1": Angles(
        count=30,
        rp_deg={"a": 0.03, "b": 0.01, "c": 0.01},
        rp_u95_deg={"a": 0.004, "b": 0.002, "c": 0.002},
        ap_deg={"a": 0.01, "b": -0.05, "c": 0.0},
        ap_u95_deg={"a": 0.01, "b": 0.01, "c": 0.01},
    )
}


@pytest.mark.parametrize(
    ("limits", "holds"),
    [
        ({"ap_limit_deg": 0.061}, True),  # of either sign
        ({"ap_limit_deg": 0.055}, False),  # AP_b keeps it, AP_b + U does not
        ({"rp_limit_deg": 0.035}, True),
        ({"rp_limit_deg": 0.033}, False),
    ],
)
def test_the_worst_angle_keeps_its_limit_or_not(limits: dict[str, float], holds: bool) -> None:
    judged = msgspec.structs.replace(result(**limits), orientation=ANGLES).judgement()
    assert judged is not None
    assert judged.holds is holds
    assert limits.items() <= plain(judged).items()
    not_measured = result(**limits).judgement()
    assert not_measured is not None
    assert not_measured.holds is False


def test_without_limits_there_is_no_verdict() -> None:
    assert result().judgement() is None


def test_a_figure_that_is_no_number_keeps_no_limit() -> None:
    judged = result(np.nan, ad_limit_mm=1.0).judgement()
    assert judged is not None
    assert judged.holds is False


def test_stops_and_pauses_between_visits_are_departures(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    for session in (1, 2):
        writer.state("run", "paused")  # the first is before any visit
        writer.state("run", "running")
        writer.point(PointId(ISO, pose="P1", number=session), (0.0, 0.0, 0.0), session=session)
    log = Log(read_records(writer.left()))
    assert len([*interruptions(log)]) == 2


# -- a run -----------------------------------------------------------------------------------------

SHIFT_MM = 0.05  # of the base, a standard deviation of each coordinate


def four_cycles(folder: Path, spread_mm: float = 0.0) -> Log:
    """Return a test of four cycles in a base that is known to `SHIFT_MM`.

    Every pose is missed by 1 mm along x; ``spread_mm`` is added and taken off in turn.
    """
    writer = Writer(folder).began()
    shift = np.diag([SHIFT_MM**2] * 3 + [0.0] * 3)
    writer.frame("base", covariance=shift.tolist())
    for nest, at_mm in zip(load_cell("paper").layout.floor, 2000.0 * np.eye(3), strict=True):
        writer.point(PointId("world", nest=nest.name), at_mm, nest=nest.name)
    for cycle in range(4):
        for name, at_mm in commanded_mm(load_cell("paper")).items():
            off_mm = 1.0 + spread_mm * (-1) ** cycle
            writer.point(
                PointId(ISO, pose=name, number=cycle), at_mm + [off_mm, 0.0, 0.0], "S1100",
                nominal_mm=tuple(at_mm), smr_mm=(0.0, 0.0, 0.0),
            )  # fmt: skip
    return Log(read_records(writer.left()))


def system_mm(log: Log, *without: str) -> float:
    budget = measurement_budget(log)
    assert budget is not None
    assert {NOISE, WORLD} <= {each.name for each in budget.lines}
    return combined_mm([each for each in budget.lines if each.name not in without])


def test_accuracy_is_as_uncertain_as_the_base_and_the_instruments(tmp_path: Path) -> None:
    log = four_cycles(tmp_path / "r")
    found, u_mm = PoseTest.of(log).poses["P3"], system_mm(log, NOISE, WORLD, CENTRED)
    assert (found.ap_mm, found.rp_mm) == pytest.approx((1.0, 0.0), abs=1e-9)
    assert found.ap_u95_mm == pytest.approx(2.0 * np.hypot(SHIFT_MM, u_mm))


def test_accuracy_by_a_calibration_is_as_uncertain_as_the_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The base is the calibration's then; the tracker finds {W} again."""
    log, used = four_cycles(tmp_path / "r"), SimpleNamespace(provenance=SimpleNamespace(latest="c"))
    monkeypatch.setattr("hilcell.calibration.iso9283.calibration_in", lambda _: used)
    found = PoseTest.of(log).poses["P3"]
    assert system_mm(log, NOISE) > 1.01 * system_mm(log, NOISE, WORLD, CENTRED)
    assert found.ap_u95_mm == pytest.approx(2.0 * system_mm(log, NOISE))


def test_a_distance_has_the_instruments_uncertainty_at_both_ends(tmp_path: Path) -> None:
    log = four_cycles(tmp_path / "r")
    found = PoseTest.of(log).distance
    assert found.ad_u95_mm == pytest.approx(2.0 * 2.0**0.5 * system_mm(log, NOISE, WORLD, CENTRED))


def test_the_scatter_of_a_mean_shrinks_with_its_cycles(tmp_path: Path) -> None:
    log = four_cycles(tmp_path / "r", spread_mm=0.3)
    s_mm = 0.3 * (4.0 / 3.0) ** 0.5
    u_mm = np.sqrt(s_mm**2 / 4 + SHIFT_MM**2 + system_mm(log, NOISE, WORLD, CENTRED) ** 2)
    assert PoseTest.of(log).poses["P3"].ap_u95_mm == pytest.approx(2.0 * u_mm)
