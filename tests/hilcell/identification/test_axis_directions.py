"""Small motions of single joints tell the axis and sense of each, on arms with errors."""

from dataclasses import replace

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply_each, from_rotvec, matrix
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.identification.axis_directions import AxesChecked, Hypothesis, check_axes

NOISE_MM = 0.03
SAME = (0, 1, 2, 3, 4, 5)
CROSSED = (0, 1, 2, 4, 3, 5)
STEPS_RAD = np.radians(np.vstack([np.zeros(6), np.eye(6)]))  # the reference pose, then each joint
AS_MODEL = Hypothesis(SAME, (1,) * 6, 0.0)


def arm_of(cell: str) -> Arm:
    return replace(load_cell(cell).robot.arm(), tool=np.eye(4))


def pose_rad(cell: str, hypothesis: Hypothesis, rng: np.random.Generator) -> Array:
    """Joints (6,) as the controller counts them, near the cell's home pose."""
    angles = np.radians(load_cell(cell).robot.home_deg) + np.radians(rng.uniform(-8, 8, 6))
    joints = angles[list(hypothesis.axes)]
    joints[2] -= hypothesis.coupling * joints[1]
    return joints * np.where(np.array(hypothesis.signs) == 0, 1, hypothesis.signs)


def seen(arm: Arm, angles: Array, smr_mm: Array, rng: np.random.Generator) -> Array:
    """Positions (N, 3) in a drawn tracker's frame, of an arm with errors of a real one."""
    real = replace(
        arm,
        a_mm=arm.a_mm + rng.normal(0, 0.5, 6),
        d_mm=arm.d_mm + rng.normal(0, 0.5, 6),
        offset_rad=arm.offset_rad + rng.normal(0, 2e-3, 6),
        beta_rad=rng.normal(0, 5e-4, 6),
    )
    R = from_rotvec(rng.normal(0, 1, 3))
    places = apply_each(matrix(R, rng.uniform(-4e3, 4e3, 3)) @ forward(real, angles), smr_mm)
    return np.asarray(places + NOISE_MM * rng.normal(size=places.shape))


def checked(cell: str, hypothesis: Hypothesis, seed: int) -> AxesChecked:
    rng, arm = np.random.default_rng(seed), arm_of(cell)
    joints = pose_rad(cell, hypothesis, rng) + STEPS_RAD
    smr_mm = np.array(load_cell(cell).robot.smr_mm) + rng.uniform(-60, 60, 3)
    return check_axes(arm, joints, seen(arm, hypothesis.angles(joints), smr_mm, rng), NOISE_MM)


@pytest.mark.parametrize(
    ("cell", "hypothesis", "wrong"),
    [
        ("paper", AS_MODEL, {}),
        ("lab", AS_MODEL, {}),
        (
            "paper",
            Hypothesis(SAME, (1, 1, -1, 1, 1, -1), 0.0),
            {3: "axis 3 turns against the model", 6: "axis 6 turns against the model"},
        ),
        (
            "paper",
            Hypothesis(SAME, (1,) * 6, 1.0),
            {3: "axis 3 turns with axis 2 (coupled, +1)"},
        ),
        (
            "six-r",
            Hypothesis(SAME, (1,) * 6, -1.0),
            {3: "axis 3 turns with axis 2 (coupled, -1)"},
        ),
        (
            "paper",
            Hypothesis(CROSSED, (1,) * 6, 0.0),
            {
                4: "axis 4 turns as axis 5: exchanged",
                5: "axis 5 turns as axis 4: exchanged",
            },
        ),
        ("paper", Hypothesis(SAME, (1, 1, 1, 0, 1, 1), 0.0), {4: "axis 4 does not turn"}),
    ],
)
def test_each_axis_is_judged(cell: str, hypothesis: Hypothesis, wrong: dict[int, str]) -> None:
    found = checked(cell, hypothesis, seed=3)
    assert found.best == hypothesis
    assert found.explained
    assert {each.axis: each.words for each in found.verdicts if not each.holds} == wrong
    assert found.holds == (not wrong)
    assert found.rms_mm < 3 * NOISE_MM


def test_a_coupled_model_is_judged_by_its_coupling() -> None:
    rng, arm = np.random.default_rng(4), replace(arm_of("paper"), coupling=1.0)
    coupled = Hypothesis(SAME, (1,) * 6, 1.0)
    joints = pose_rad("paper", coupled, rng) + STEPS_RAD
    smr_mm = np.array([98.0, 0.0, 127.0])
    found = check_axes(arm, joints, seen(arm.by_angles, coupled.angles(joints), smr_mm, rng), 0.03)
    assert found.best == coupled
    assert found.holds


def test_a_reflector_on_axis_6_does_not_show_its_sense() -> None:
    rng, arm = np.random.default_rng(5), arm_of("paper")
    joints = pose_rad("paper", AS_MODEL, rng) + STEPS_RAD
    on_axis_mm = np.array([0.0, 0.0, 127.0])
    found = check_axes(arm, joints, seen(arm, joints, on_axis_mm, rng), NOISE_MM)
    assert not found.holds
    assert [each.axis for each in found.verdicts if each.holds is None] == [6]
    assert found.verdicts[5].words.startswith("axis 6: not determined; ")


def test_positions_of_another_motion_are_not_explained() -> None:
    rng, arm = np.random.default_rng(6), arm_of("paper")
    joints = pose_rad("paper", AS_MODEL, rng) + STEPS_RAD
    places = seen(arm, joints, np.array([98.0, 0.0, 127.0]), rng)
    places[2] += [0.0, 0.0, 40.0]
    found = check_axes(arm, joints, places, NOISE_MM)
    assert not found.explained
    assert all(each.holds is None for each in found.verdicts)


def test_a_joint_that_never_moved_is_refused() -> None:
    joints = np.zeros((7, 6))
    with pytest.raises(ValueError, match="joint 1, 2, 3, 4, 5, 6: expected a motion"):
        check_axes(arm_of("paper"), joints, np.zeros((7, 3)), NOISE_MM)
