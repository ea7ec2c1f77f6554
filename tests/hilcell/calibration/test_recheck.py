"""A calibration that holds is found to, one that drifted is not; errors of known covariance."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hilcell.calibration import recheck as module
from hilcell.calibration.recheck import RecheckErrors, Visits
from hilcell.cell.file import load_cell
from hilcell.compensation.model import Prediction
from hilcell.geometry.frames import apply, from_rotvec, matrix
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array, HilcellError
from procedures.plan import joints_for

RNG = np.random.default_rng(230)
TARGETS_MM = np.array([1850.0, 0.0, 950.0]) + RNG.uniform(-400.0, 400.0, (7, 3))
OWN_MM = 0.02
FRAME_MM = 0.03  # of the shift that moves all poses together
LEVEL = np.tile(np.eye(3), (7, 1, 1))  # {T} in {B}
OWN_MM2 = np.tile(np.diag([1.0, 1.0, 1.5]) * OWN_MM**2, (7, 1, 1))
COMMON_MM2 = np.array(np.kron(np.ones((7, 7)), FRAME_MM**2 * np.eye(3)), dtype=np.float64)


def found(errors_mm: Array) -> RecheckErrors:
    return RecheckErrors(TARGETS_MM, errors_mm, OWN_MM2, COMMON_MM2, LEVEL)


def noise_mm(rng: np.random.Generator) -> Array:
    """Return errors (7, 3) of just that covariance."""
    covariance = found(np.zeros((7, 3))).covariance_mm2
    drawn: Array = rng.multivariate_normal(np.zeros(21), covariance).reshape(7, 3)
    return drawn


def moved_mm(shift_mm: list[float], turn_rad: list[float]) -> Array:
    """Return how far a motion of the base carries the targets."""
    T = matrix(from_rotvec(np.array(turn_rad)), np.array(shift_mm))
    by_mm: Array = apply(T, TARGETS_MM) - TARGETS_MM
    return by_mm


def test_a_calibration_that_holds_is_refused_as_rarely_as_stated() -> None:
    rng = np.random.default_rng(1)
    verdicts = [found(noise_mm(rng)).judgement() for _ in range(600)]
    wrong = sum(each.verdict != "valid" for each in verdicts)
    assert 1 <= wrong <= 14  # of 6 expected, 3 sigma
    assert np.mean([each.moved.chi2 for each in verdicts]) == pytest.approx(6.0, abs=0.45)
    assert np.mean([each.rest.chi2 for each in verdicts]) == pytest.approx(15.0, abs=0.7)


def test_a_base_that_moved_is_an_update_with_its_motion() -> None:
    rng = np.random.default_rng(2)
    shift, turn = [0.3, -0.1, 0.05], [1e-4, 0.0, -2e-4]
    off, sizes = [], []
    for _ in range(100):
        judgement = found(moved_mm(shift, turn) + noise_mm(rng)).judgement()
        assert judgement.verdict in ("update", "redo")
        off.append(judgement.motion - np.array([*shift, *turn]))
        sizes.append(judgement.shift_mm)
        covariance = judgement.covariance
    # In standard deviations the misses are as the posterior says.
    squares = np.einsum("ni,ij,nj->n", np.array(off), np.linalg.inv(covariance), np.array(off))
    assert squares.mean() == pytest.approx(6.0, rel=0.2)
    at_middle = np.linalg.norm(moved_mm(shift, turn).mean(axis=0))
    assert np.mean(sizes) == pytest.approx(at_middle, abs=0.02)


def test_the_base_where_it_stands_now_takes_the_motion_away() -> None:
    judgement = found(moved_mm([0.4, 0.0, -0.2], [0.0, 3e-4, 1e-4])).judgement()
    assert judgement.verdict == "update"
    np.testing.assert_allclose(
        apply(judgement.base, TARGETS_MM) - TARGETS_MM,
        moved_mm([0.4, 0.0, -0.2], [0.0, 3e-4, 1e-4]),
        atol=0.02,
    )
    assert np.abs(judgement.left_mm).max() < 0.02
    assert judgement.drift_mm > 5 * judgement.drift_u_mm


def test_one_pose_that_no_motion_explains_is_a_redo_and_named() -> None:
    errors_mm = noise_mm(np.random.default_rng(3))
    errors_mm[4] += [0.0, 0.25, 0.0]
    judgement = found(errors_mm).judgement()
    assert judgement.verdict == "redo"
    assert judgement.worst == 4


def test_a_frame_that_is_known_badly_moves_no_base() -> None:
    """The same shift of all poses: frames explain it where they are uncertain by as much."""
    shifted_mm = np.tile([0.08, 0.0, 0.0], (7, 1))
    exact = RecheckErrors(TARGETS_MM, shifted_mm, OWN_MM2, np.zeros((21, 21)), LEVEL)
    vague = RecheckErrors(TARGETS_MM, shifted_mm, OWN_MM2, 9 * COMMON_MM2, LEVEL)
    assert exact.judgement().verdict == "update"
    assert vague.judgement().verdict == "valid"
    assert vague.judgement().u_mm > exact.judgement().u_mm


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"errors_mm": np.full((7, 3), np.nan)}, "finite"),
        ({"errors_mm": np.zeros((3, 3))}, "3 poses"),
    ],
)
def test_what_cannot_be_judged_is_refused(change: dict[str, Any], said: str) -> None:
    values = {
        "targets_mm": TARGETS_MM, "errors_mm": np.zeros((7, 3)), "own_mm2": OWN_MM2,
        "common_mm2": COMMON_MM2, "orientations": LEVEL,
    }  # fmt: skip
    with pytest.raises(HilcellError, match=said):
        RecheckErrors(**(values | change)).judgement()


CELL = load_cell("paper")
JOINTS_RAD = joints_for(CELL, TARGETS_MM)


@pytest.mark.parametrize(("axis", "lost_deg"), [(3, -0.02), (4, 0.2), (5, 0.1)])
def test_an_axis_that_lost_its_zero_is_suspected(axis: int, lost_deg: float) -> None:
    arm = CELL.robot.arm()
    lost_rad = np.radians(lost_deg) * np.eye(6)[axis - 1]
    moved = forward(arm, JOINTS_RAD + lost_rad)[:, :3, 3] - TARGETS_MM
    this = found(moved + noise_mm(np.random.default_rng(axis)))
    likeliest = this.suspicions(this.judgement(), arm, JOINTS_RAD)[0]
    assert (likeliest.cause, likeliest.unit) == ("zero lost", f"deg of axis {axis}")
    assert likeliest.size == pytest.approx(lost_deg, rel=0.25)


TURNS_RAD = np.radians(27.0) * np.array(
    [[0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 1], [0, 0, 0]]
)
TURNED = from_rotvec(TURNS_RAD)
SLIP_MM = np.array([0.5, 0.0, 0.0])


def seen(errors_mm: Array, orientations: Array) -> tuple[str, list[str]]:
    """Return the verdict, and what is suspected."""
    this = RecheckErrors(TARGETS_MM, errors_mm, OWN_MM2, COMMON_MM2, orientations)
    judgement = this.judgement()
    causes = this.suspicions(judgement, CELL.robot.arm(), JOINTS_RAD)
    return judgement.verdict, [each.cause for each in causes if each.cause == "mount slipped"]


def test_one_orientation_does_not_tell_a_slipped_mount_from_a_moved_base() -> None:
    noise = noise_mm(np.random.default_rng(6))
    assert seen(LEVEL @ SLIP_MM + noise, LEVEL) == ("update", ["mount slipped"])
    assert seen(moved_mm([0.0, 0.0, 0.0], [0.0, 0.0, 4e-4]) + noise, LEVEL) == ("update", [])


def test_turned_poses_do() -> None:
    noise = noise_mm(np.random.default_rng(6))
    assert seen(moved_mm([0.5, 0.0, 0.0], [0.0, 0.0, 0.0]) + noise, TURNED) == ("update", [])
    this = RecheckErrors(TARGETS_MM, TURNED @ SLIP_MM + noise, OWN_MM2, COMMON_MM2, TURNED)
    assert this.judgement().verdict == "redo"
    assert this.judgement().slipped.holds
    assert this.judgement().slip_mm == pytest.approx(0.5, abs=0.05)


def test_what_needs_no_cause_has_none() -> None:
    this = found(noise_mm(np.random.default_rng(9)))
    assert this.suspicions(this.judgement(), CELL.robot.arm(), JOINTS_RAD) == []
    errors_mm = noise_mm(np.random.default_rng(3))
    errors_mm[4] += [0.0, 0.25, 0.0]  # one reading, which nothing of the robot explains
    this = found(errors_mm)
    assert this.suspicions(this.judgement(), CELL.robot.arm(), JOINTS_RAD) == []


def test_turned_poses_are_judged_by_what_the_model_states_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    poses = forward(CELL.robot.arm(), JOINTS_RAD)
    poses[:, :3, :3] = TURNED @ poses[:, :3, :3]
    joints_deg = np.degrees(CELL.robot.nominal().joints_for(poses))
    points = [SimpleNamespace(commanded_deg=tuple(each)) for each in joints_deg]
    zeros = np.zeros((7, 3, 3))
    visit = Visits(TARGETS_MM, TARGETS_MM, zeros, np.zeros((7, 7)), zeros[0])
    asked: list[Array] = []

    def predict(poses: Array) -> Prediction:
        asked.append(poses)
        return Prediction(np.zeros((7, 3)), OWN_MM2)

    made = SimpleNamespace(error_model=lambda: SimpleNamespace(predict=predict))
    monkeypatch.setattr(module, "used_calibration", lambda log: made)
    monkeypatch.setattr(Visits, "of", lambda *given: visit)
    log: Any = SimpleNamespace(select=lambda kind: points, cell=CELL)
    found = RecheckErrors.of_run(log)
    np.testing.assert_allclose(asked[0], poses, atol=1e-6)
    np.testing.assert_allclose(found.orientations, poses[:, :3, :3], atol=1e-9)
