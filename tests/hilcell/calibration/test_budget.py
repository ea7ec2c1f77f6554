"""Which lines of a corrected target's budget a journal proves, with figures worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.calibration.budget import NO_VISITS, in_validation, target_uncertainty, touch_influence
from hilcell.calibration.influence import ASSUMED, MEASURED, Influence
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import pose_from_zyx
from hilcell.journal.log import Log
from hilcell.model.point import PointId
from hilcell.model.verdicts import CurvesUsed
from tests.hilcell.report.journals import Writer, plan_record
from tests.hilcell.verdicts import FITTED

HERE = load_cell("paper").station_named("S1100")
COVARIANCE = np.diag([1e-4, 4e-4, 9e-4, 1e-10, 4e-10, 9e-10])
# Nine visits of each of two places, 30 um along x and y of {L} in turn.
OFFSETS_MM = 0.03 * np.array([[0, 0, 0], *4 * [[1, 0, 0]], *4 * [[0, 1, 0]]], dtype=float)


def calibrated(folder: Path, **uncertainty: object) -> Writer:
    """Return a run with frames at three stations, visits and measured nests."""
    plan = plan_record()
    plan["cell"]["uncertainty"] |= uncertainty
    writer = Writer(folder, cell=plan["cell"]).began()
    for nest in load_cell("paper").layout.floor:
        writer.point(PointId("world", nest=nest.name), nest.xyz_mm, samples=4)
    base = pose_from_zyx(-1850, 0, 500, 90, 0, 0)  # 200 mm above the slide's origin
    writer.frame("base", matrix=base, covariance=COVARIANCE)
    for name, y_mm in (("S300", -800.0), ("S1100", 0.0), ("S1900", 800.0)):
        placed = pose_from_zyx(-1850, y_mm, 300, 0, 0, 0)
        writer.frame(f"station.{name}", matrix=placed, covariance=COVARIANCE)
    far_mm = 1500.0 / math.sqrt(3.0)  # as far as F2 and F3, so that the noise is alike there
    return writer.visited([far_mm + OFFSETS_MM, OFFSETS_MM])


def lines(log: Log, station: str = "S1100") -> dict[str, Influence]:
    found = target_uncertainty(log)
    assert not found.missing
    return {each.name: each for each in (*found.lines, *found.stations[station])}


def shift_mm2(line: Influence) -> np.ndarray:
    return np.array(line.covariance)[:3, :3]


@pytest.fixture
def log(tmp_path: Path) -> Log:
    return calibrated(tmp_path / "run").facts().log


def test_without_repeated_visits_there_is_a_reason_only(tmp_path: Path) -> None:
    found = target_uncertainty(Writer(tmp_path / "few").began().facts().log)
    assert (found.missing, found.lines, found.stations) == (NO_VISITS, [], {})


def test_the_lines(log: Log) -> None:
    found = lines(log)
    assert {name: line.applies for name, line in found.items()} == {
        "Robot repeatability": "always",
        "Approach direction": "in use",
        "Drift": "always",
        "World frame": "in use",
        "Tracker, systematic": "in use",
        "SMR centring": "in use",
        "Drill's offset": "in use",
        "Station frame": "always",
        "Strip": "always",
    }


def test_repeatability_is_pooled_and_turned_and_less_the_readings(log: Log) -> None:
    """{B} is turned by 90 degrees; 16 degrees of freedom for each direction."""
    left = OFFSETS_MM - OFFSETS_MM.mean(axis=0)
    xx, xy = 2 * (left[:, 0] ** 2).sum() / 16, 2 * (left[:, 0] * left[:, 1]).sum() / 16
    values, axes = np.linalg.eigh(np.array([[xx, -xy], [-xy, xx]]) - 0.01**2 * np.eye(2))
    wanted = (axes * np.maximum(values, 0.0)) @ axes.T
    line = lines(log)["Robot repeatability"]
    np.testing.assert_allclose(shift_mm2(line)[:2, :2], wanted)
    np.testing.assert_allclose(shift_mm2(line)[2], 0.0, atol=1e-12)  # all of z is the readings'
    assert line.frame == "base"
    assert line.in_model
    assert line.freedom is not None
    assert 16 < line.freedom < 32


def test_drift_is_less_the_readings(tmp_path: Path) -> None:
    writer = calibrated(tmp_path / "drift")
    nest = load_cell("paper").layout.floor[0]
    for turn, along in enumerate(((0.03, 0, 0), (0, 0.03, 0)), start=1):
        id = PointId("control", session=1, pass_number=turn, nest=nest.name)
        writer.point(id, nest.xyz_mm + along, samples=4)
    line = lines(writer.facts().log)["Drift"]
    assert line.source == MEASURED
    noise_mm2 = 2 * 0.01**2 / 4
    np.testing.assert_allclose(shift_mm2(line), (0.03**2 / 3 - noise_mm2) * np.eye(3))


def test_drift_is_assumed_where_nests_were_measured_once(log: Log) -> None:
    line = lines(log)["Drift"]
    assert line.source == ASSUMED
    np.testing.assert_allclose(shift_mm2(line), 0.02**2 / 3 * np.eye(3))


def test_the_world_s_rotation_counts_by_its_lever(log: Log) -> None:
    """F2 alone turns {W} about z, by its noise across over its distance: lever 1.5 m."""
    line = lines(log)["World frame"]
    nest_mm2 = 0.01**2 / 4 + 0.0127**2 / 3
    covariance = np.array(line.covariance)
    assert covariance[5, 5] == pytest.approx(2 * nest_mm2 / 1500.0**2, rel=1e-3)  # F1 and F2
    assert covariance[0, 0] == pytest.approx(nest_mm2, rel=1e-3)  # its origin is F1
    assert covariance[6, 6] == 0.0


def test_the_station_frame_is_carried_to_the_base_and_none_at_the_grid_s(log: Log) -> None:
    assert not np.array(lines(log)["Station frame"].covariance).any()
    line = lines(log, "S300")["Station frame"]
    # At the origin of {S} itself, whatever the lever to {B}, its own covariance is left.
    found = line.at(np.eye(4), np.array([[-1850.0, -800.0, 300.0]]))
    np.testing.assert_allclose(found[0], COVARIANCE[:3, :3], atol=1e-12)
    at_2_m = line.at(np.eye(4), np.array([[-1850.0, -800.0, 2300.0]]))[0]
    assert at_2_m[0, 0] == pytest.approx(1e-4 + 4e-10 * 2000.0**2)


def test_the_strip_is_held_twice_along_the_rail(log: Log) -> None:
    line = lines(log)["Strip"]
    np.testing.assert_allclose(shift_mm2(line), np.diag([0, 2 * 0.02**2 / 3, 0]))
    assert line.freedom is None


def test_the_strip_by_its_repeats(tmp_path: Path) -> None:
    writer = calibrated(tmp_path / "strip")
    for number, along_mm in enumerate((0.0, 0.02, 0.04)):
        id = PointId("repeat", how="strip", direction="random", number=number)
        writer.point(id, (0, along_mm, 0))
    line = lines(writer.facts().log)["Strip"]
    np.testing.assert_allclose(shift_mm2(line), np.diag([0, 2 * 0.02**2, 0]))
    assert line.freedom == 2


def test_what_the_cell_states(tmp_path: Path) -> None:
    writer = calibrated(
        tmp_path / "stated",
        tracker_limit_mm=0.03, tracker_limit_um_m=6.0, smr_centring_limit_mm=0.006,
        reversal_limit_mm=0.06, drill_offset_mm=(0.0, 0.0, 200.0), orientation_urad=500.0,
        arm_growth_um_m_k=12.0, air_range_k=6.0,
    )  # fmt: skip
    log = writer.facts().log
    found, whole = lines(log), target_uncertainty(log)
    np.testing.assert_allclose(shift_mm2(found["SMR centring"]), 0.006**2 / 3 * np.eye(3))
    np.testing.assert_allclose(shift_mm2(found["Approach direction"]), 0.06**2 / 3 * np.eye(3))
    tracker = np.array(found["Tracker, systematic"].covariance)
    np.testing.assert_allclose(np.diag(tracker)[:6], [3e-4] * 3 + [12e-12] * 3)
    assert whole.growth_per_k == pytest.approx(12e-6)
    assert whole.air_range_k == 6.0
    drill = found["Drill's offset"]
    turn = 500e-6**2 + (1 + 4 + 9) * 1e-10 / 3  # the base frame's own besides
    poses = pose_from_zyx(0, 0, 0, 0, 0, 0)[None]
    across = drill.at(poses, poses[:, :3, 3])[0]
    np.testing.assert_allclose(np.diag(across), [turn * 200.0**2] * 2 + [0], atol=1e-12)


def test_readings_and_air_of_the_validation(tmp_path: Path) -> None:
    writer = calibrated(tmp_path / "air")
    writer.point(PointId("grid", vertex=(0, 0, 0)), (0, 0, 0), temperature_c=21.0)
    for number, celsius in enumerate((22.0, 20.0)):
        id = PointId("validate", station="S1100", how="chosen", number=number)
        writer.point(id, (0, 0, 0), "S1100", temperature_c=celsius)
    log = writer.facts().log
    readings, air = in_validation(log, HERE, log.select("validate"))
    np.testing.assert_allclose(shift_mm2(readings), 0.01**2 * np.eye(3))
    assert math.sqrt(3 * air.covariance[6][6]) == pytest.approx(23e-6 * 1.0)  # 1 K, rms
    assert air.origin_mm == (0.0, 0.0, 0.0)


def test_touch_poses_take_in_the_growth_until_then(tmp_path: Path) -> None:
    """The grid at 21 C, the touch poses of the last visit at 22.5, the targets at 22."""
    writer = calibrated(tmp_path / "air")
    writer.frame("touch.S1100", covariance=COVARIANCE, poses=1, visit=2)
    writer.point(PointId("grid", vertex=(0, 0, 0)), (0, 0, 0), temperature_c=21.0)
    for visit, celsius in ((1, 30.0), (2, 22.5)):
        id = PointId("touch", station="S1100", visit=visit, number=0)
        writer.point(id, (0, 0, 0), "S1100", temperature_c=celsius)
    id = PointId("validate", station="S1100", how="chosen", number=0)
    writer.point(id, (0, 0, 0), "S1100", temperature_c=22.0)
    log = writer.facts().log
    _, over_cube, later = in_validation(log, HERE, log.select("validate"))
    assert over_cube.origin_mm == (1850.0, 0.0, 950.0)  # the cube's centre
    assert math.sqrt(3 * over_cube.covariance[6][6]) == pytest.approx(23e-6 * 1.0)
    assert later.origin_mm == (0.0, 0.0, 0.0)
    assert math.sqrt(3 * later.covariance[6][6]) == pytest.approx(23e-6 * 0.5)


def test_a_touched_base_has_its_own_covariance(tmp_path: Path) -> None:
    writer = calibrated(tmp_path / "touched")
    at = pose_from_zyx(-1850, -800, 500, 0, 0, 0)
    writer.frame("touch.S300", matrix=at, covariance=COVARIANCE, poses=8, visit=3)
    log = writer.facts().log
    assert touch_influence(log, log.cell.station_named("S1900")) is None
    line = touch_influence(log, log.cell.station_named("S300"))
    assert line is not None
    at_2_m = line.at(np.eye(4), np.array([[-1850.0, -800.0, 2500.0]]))[0]
    assert at_2_m[0, 0] == pytest.approx(1e-4 + 4e-10 * 2000.0**2)


def test_the_model_rests_on_poses_whose_angles_differ(tmp_path: Path) -> None:
    writer = calibrated(tmp_path / "few")
    assert target_uncertainty(writer.facts().log).model_samples is None
    writer = calibrated(tmp_path / "grid")
    for number in range(8):
        id = PointId("grid", vertex=(number, 0, 0))
        axes_deg = (number % 4 + 0.001 * number, 10.0 * number, -5.0 * number, 0.0, 0.0, 0.0)
        writer.point(id, (0, 0, 0), commanded_deg=axes_deg)
    log = writer.facts().log
    assert target_uncertainty(log).model_samples == 4  # of axis 1
    curves = CurvesUsed(used=True, reason="")
    log.verdicts["fit"] = replace(FITTED, curves=curves)  # what is left is no gear's
    assert target_uncertainty(log).model_samples == 8
