"""An arm that is known from before is followed by few poses, or is no longer that arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import from_rotvec, matrix
from hilcell.identification.estimate import predict
from hilcell.identification.kinematics import Kinematics
from hilcell.identification.known_arm import GROWTH, REFLECTOR, ArmChanged, KnownArm, in_words
from hilcell.identification.measured_poses import Noise, Readings
from hilcell.ports import Array
from hilcell.sanitize import clean

CELL = load_cell("paper")
NOISE_MM = 0.02
POSES = 14


def known_arm(*, samples: float = 27.0) -> KnownArm:
    """An arm whose errors an earlier calibration knows to 0.02 mm and 20 urad."""
    kinematics = Kinematics(CELL.robot.arm())
    state = kinematics.start(np.eye(4), CELL.robot.seats_mm)
    drawn = np.random.default_rng(7).standard_normal(len(state.values))
    sigmas = np.sqrt(np.diag(kinematics.prior[1]))
    state = replace(state, values=0.2 * drawn * sigmas[kinematics.placed :])
    covariance = np.diag((0.02 * sigmas) ** 2)
    noise = Noise.independent(NOISE_MM)
    return KnownArm("RUN", kinematics, state, covariance, noise, samples)


def joints_rad(seed: int, count: int = POSES) -> Array:
    middle = np.radians([0.0, -75.0, 100.0, 0.0, -40.0, 0.0])
    drawn = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 6))
    return np.asarray(middle + drawn * np.radians([20.0, 15.0, 15.0, 20.0, 15.0, 20.0]))


def readings(
    known: KnownArm, seed: int, *, zero: tuple[int, float] | None = None,
    scatter: tuple[int, float] | None = None, base: Array | None = None,
) -> Readings:  # fmt: skip
    """Poses of the arm with an axis's zero (rad) or scatter from pose to pose (rad) changed."""
    rng, joints = np.random.default_rng(seed), joints_rad(seed)
    true_rad = joints.copy()
    if zero is not None:
        true_rad[:, zero[0]] += zero[1]
    if scatter is not None:
        true_rad[:, scatter[0]] += scatter[1] * rng.choice([-1.0, 1.0], POSES)
    state = known.state if base is None else replace(known.state, T=base @ known.state.T)
    xyz_mm = known.kinematics.positions_mm(state, true_rad)
    xyz_mm = xyz_mm + NOISE_MM * rng.standard_normal(xyz_mm.shape)
    return Readings(joints, xyz_mm, np.zeros((POSES, 1, 3, 3)))


@pytest.mark.parametrize("seed", range(8))
def test_an_unchanged_arm_stays_as_it_was(seed: int) -> None:
    known = known_arm()
    found = known.followed(readings(known, seed))
    assert found.changed == {}
    at_rad = joints_rad(100 + seed)
    moved_mm = found.estimate.predict(at_rad)[0] - known.kinematics.positions_mm(
        known.state, at_rad
    )
    assert np.linalg.norm(moved_mm, axis=-1).mean() < 0.03


@pytest.mark.parametrize(("axis", "urad"), [(0, 500.0), (1, 500.0), (2, -500.0), (4, 800.0)])
def test_a_lost_zero_is_followed_and_named(axis: int, urad: float) -> None:
    known = known_arm()
    found = known.followed(readings(known, 3, zero=(axis, 1e-6 * urad)))
    at_rad = joints_rad(50)
    true_rad = at_rad.copy()
    true_rad[:, axis] += 1e-6 * urad
    off_mm = found.estimate.predict(at_rad)[0] - known.kinematics.positions_mm(
        known.state, true_rad
    )
    assert np.linalg.norm(off_mm, axis=-1).mean() < 0.04
    if axis in (1, 2):  # that of axis 1 turns {B}, of the wrist's hardly more than the reflector
        assert [*found.changed] == [f"zero of axis {axis + 1}"]
        assert found.changed[f"zero of axis {axis + 1}"] == pytest.approx(abs(urad) * 1e-6, rel=0.3)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_another_gear_is_another_arm(axis: int) -> None:
    known = replace(known_arm(), run="20261129-193924-calibrate-46d7")  # as long as they are
    with pytest.raises(
        ArmChanged, match=rf"no longer that of 2026.*axis {axis + 1} .*--from"
    ) as error:
        known.followed(readings(known, 4, scatter=(axis, 45e-6)))
    assert clean(str(error.value)) == str(error.value)  # the next act is not cut off


def test_a_moved_base_is_no_change_of_the_arm() -> None:
    known = known_arm()
    base = matrix(from_rotvec(np.array([3e-4, -5e-4, 1e-3])), np.array([1.5, -1.0, 0.8]))
    found = known.followed(readings(known, 5, base=base))
    assert found.changed == {}
    expected_mm = (base @ np.append(known.state.T[:3, 3], 1.0))[:3]
    np.testing.assert_allclose(found.estimate.state.T[:3, 3], expected_mm, atol=0.5)


def test_one_slip_is_struck_out() -> None:
    known = known_arm()
    measured = readings(known, 6)
    measured.xyz_mm[4, 0] += [1.0, 0.0, 0.0]
    found = known.followed(measured)
    assert np.flatnonzero(found.estimate.outliers).tolist() == [4]


def test_a_chain_grows_no_more_certain() -> None:
    """The same poses again and again repeat what no parameter describes."""
    known, silent, variances_mm2 = known_arm(), Noise.independent(0.0), []
    for seed in range(10):
        found = known.followed(readings(known, 20 + seed)).estimate
        state = found.kinematics, found.state, found.covariance
        covariance_mm2 = predict(*state, silent, joints_rad(1))[1][:, 0]
        variances_mm2.append(np.trace(covariance_mm2, axis1=1, axis2=2).mean())
        known = replace(known, state=found.state, covariance=found.covariance)
    assert min(variances_mm2) > 0.65 * variances_mm2[0]


def test_larger_noise_is_taken_over_in_part() -> None:
    known = replace(known_arm(), noise=Noise.independent(0.85 * NOISE_MM))
    noise = known.followed(readings(known, 8)).estimate.noise
    assert 0.85 * NOISE_MM < noise.reading_mm < NOISE_MM
    sure = replace(known, samples=1e6).followed(readings(known, 8)).estimate.noise
    assert sure.reading_mm == pytest.approx(0.85 * NOISE_MM, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "size", "said"),
    [
        (REFLECTOR, 0.504, "0.50 mm"),
        (GROWTH, 21.4e-6, "21 µm/m"),
        ("zero of axis 3", 0.00084, "0.048°"),
    ],
)
def test_a_change_is_said_in_its_unit(name: str, size: float, said: str) -> None:
    assert in_words({name: size}) == f"{name} by {said}"
