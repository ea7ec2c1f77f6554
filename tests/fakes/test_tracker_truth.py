from __future__ import annotations

import numpy as np
import pytest

from fakes.faults import Faults
from fakes.truth.tracker_truth import TrackerTruth
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Array

PLACES = {"far": [-500.0, 0.0, 1000.0], "near": [-500.0, 30.0, 1000.0], "gone": [-9000.0, 0, 0]}


def tracker_of(cell: Cell, faults: Faults) -> TrackerTruth:
    return TrackerTruth(cell, 1, faults, lambda: {k: np.array(v) for k, v in PLACES.items()})


def readings(tracker: TrackerTruth, name: str, count: int) -> Array:
    found = tracker.measurements(name, count)
    assert found is not None
    return found.xyz_mm


STRUCK = ("noisy", "drift_step", "scale_ppm", "nest_lifted", "spike", "warmer", "wrong_offset")


@pytest.mark.parametrize("fault", STRUCK)
def test_measurements_in_a_row_are_those_of_one_after_another(cell: Cell, fault: str) -> None:
    """In one process a tracker takes them together, over wires one by one."""
    together, singly = Faults(), Faults()
    tracker, other = tracker_of(cell, together), tracker_of(cell, singly)
    for faults in (together, singly):
        faults.set(f"tracker.{fault}", 0.5, after=1, count=2)
    row = tracker.measurements("far", 5)
    single = [other.measure("far") for _ in range(5)]
    assert row is not None
    for xyz_mm, std_mm, each in zip(row.xyz_mm, row.std_mm, single, strict=True):
        assert each is not None
        assert np.array_equal(xyz_mm, each.xyz_mm)
        assert np.array_equal(std_mm, each.std_mm)
    assert tracker.air() == other.air()


def test_noise_along_and_across_the_beam(cell: Cell) -> None:
    tracker = tracker_of(cell, Faults())
    cloud = readings(tracker, "far", 500)
    true_mm = apply(inverse(tracker.pose_in_world), np.array([PLACES["far"]]))[0]
    range_mm = float(np.linalg.norm(true_mm))
    along = true_mm / range_mm
    off = cloud - true_mm
    radial = off @ along
    across = off - radial[:, None] * along
    across -= across.mean(axis=0)  # the tracker's axes are a little off
    assert np.std(radial) == pytest.approx(0.0075, rel=0.1)
    assert np.sqrt((across**2).sum(axis=1).mean() / 2) == pytest.approx(2.5e-6 * range_mm, rel=0.1)
    assert np.linalg.norm(off.mean(axis=0)) < 0.02  # drift, axes


def test_finds_the_nearest_in_radius_and_range(cell: Cell) -> None:
    tracker = tracker_of(cell, Faults())
    at = tracker.reflectors()
    assert tracker.find(at["near"] + 5.0, 50.0) == "near"
    assert tracker.find(at["far"], 50.0) == "far"
    assert tracker.find(at["far"] + 100.0, 50.0) is None
    assert tracker.find(at["gone"], 50.0) is None  # more than 10 m away
    assert tracker.measure("gone") is None


def test_another_reflector_can_be_caught(cell: Cell) -> None:
    faults = Faults()
    tracker = tracker_of(cell, faults)
    faults.set("tracker.wrong_target")
    assert tracker.find(tracker.reflectors()["far"], 50.0) == "near"


def test_drift_is_slow_and_small(cell: Cell) -> None:
    tracker = tracker_of(cell, Faults())
    cloud = readings(tracker, "far", 3000)  # about one period
    means = cloud.reshape(6, 500, 3).mean(axis=1)
    spread = np.linalg.norm(means - means[0], axis=1).max()
    assert 0.0015 < spread < 0.02  # 0.0007 would be the noise of the means alone


def test_air_keeps_to_the_papers_laboratory(cell: Cell) -> None:
    tracker = tracker_of(cell, Faults())
    temperatures = []
    for _ in range(200):
        readings(tracker, "far", 10)
        temperatures.append(tracker.air().temperature_c)
    assert min(temperatures) >= 22.0
    assert max(temperatures) <= 24.0
    assert max(temperatures) - min(temperatures) > 0.5


def test_a_spike_strikes_once(cell: Cell) -> None:
    faults = Faults()
    tracker = tracker_of(cell, faults)
    before = readings(tracker, "far", 1)[0]
    faults.set("tracker.spike", 2.0)
    assert np.linalg.norm(readings(tracker, "far", 1)[0] - before) == pytest.approx(2.0, abs=0.1)
    assert np.linalg.norm(readings(tracker, "far", 1)[0] - before) < 0.1


def test_axes_that_are_off_have_the_other_sign_in_the_second_face(cell: Cell) -> None:
    faults = Faults()
    tracker = tracker_of(cell, faults)
    true_mm = tracker.reflectors()["far"]
    faults.set("tracker.transit", 5000.0)
    front_mm = readings(tracker, "far", 20).mean(axis=0) - true_mm
    back = tracker.measurements("far", 20, back=True)
    assert back is not None
    back_mm = back.xyz_mm.mean(axis=0) - true_mm
    np.testing.assert_allclose(front_mm, -back_mm, atol=0.03)  # drift, noise
    assert np.linalg.norm(front_mm) == pytest.approx(5e-3 * abs(true_mm[2]), rel=0.05)


def test_readings_in_the_second_face_change_no_other(cell: Cell) -> None:
    tracker, other = tracker_of(cell, Faults()), tracker_of(cell, Faults())
    tracker.measurements("far", 5, back=True)
    assert np.array_equal(readings(tracker, "far", 3), readings(other, "far", 3))


def test_a_tracker_that_turns_does_so_with_its_measurements(cell: Cell) -> None:
    faults = Faults()
    tracker = tracker_of(cell, faults)
    true_mm = tracker.reflectors()["far"]
    faults.set("tracker.turning", 1000.0)
    off_mm = readings(tracker, "far", 1001)[-1] - true_mm
    assert np.linalg.norm(off_mm) == pytest.approx(1e-3 * np.hypot(*true_mm[:2]), rel=0.05)
