"""The identified robot as a model: what it predicts, when curves are used, its JSON form."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.compensation.kinematic import Kinematic, _excess, _identified, curves_used
from hilcell.compensation.model import Measured, MeasuredArm, ModelError, StaticPoses
from hilcell.compensation.model_choice import MODELS, Nominal, choose, chosen
from hilcell.geometry.kinematics import Array, forward
from hilcell.geometry.statistics import Figures, lengths_mm
from hilcell.identification.kinematics import Kinematics, State, TransmissionCurve
from hilcell.identification.measured_poses import IdentificationError, Readings
from tests.hilcell.compensation.models import GRID, drawn_mm, lattice, poses_at

CELL = load_cell("paper")
ROBOT = CELL.robot.nominal()
WAVES = TransmissionCurve(
    0, np.array([33.0, 160.0]), np.array([[40e-6, -30e-6], [25e-6, 35e-6]]), 9e-12 * np.eye(4),
    0.0, 1e-3, -np.pi, np.pi, 1e-6,
)  # fmt: skip


def truth(points_mm: Array, noise_mm: float = 0.0, *, errors: bool = True) -> tuple[Array, Array]:
    """Return commanded joints and actual positions of one crooked robot with waves in axis 1."""
    kinematics = Kinematics(ROBOT.arm, waves=False, curves=(WAVES,))
    rng = np.random.default_rng(4)
    mean, covariance = kinematics.prior
    values = mean + errors * rng.standard_normal(len(mean)) * np.sqrt(np.diag(covariance))
    joints = ROBOT.joints_for(poses_at(points_mm))
    if not errors:
        kinematics, values = replace(kinematics, curves=()), np.zeros(len(mean) - 5)
    state = State(
        np.eye(4),
        ROBOT.arm.tool[None, :3, 3],
        values[kinematics.placed :],
        np.zeros(kinematics.placed),
    )
    if errors:
        state.values[-5:] = [*WAVES.amplitude_rad.ravel(), 0.0]
    actual_mm = kinematics.positions_mm(state, joints)[:, 0]
    return joints, actual_mm + noise_mm * rng.standard_normal(actual_mm.shape)


def measured(
    count: int, *curves: TransmissionCurve, errors: bool = True, noise_mm: float = 0.01
) -> Measured:
    """Return the grid's 27 vertices, and all in all ``count`` poses."""
    vertices = GRID.vertices_mm()
    points_mm = np.vstack([vertices.reshape(-1, 3), drawn_mm(1, 200)])
    joints, actual_mm = truth(points_mm, noise_mm, errors=errors)
    grid = lattice(GRID, (actual_mm[:27] - points_mm[:27]).reshape(vertices.shape), noise_mm**2)
    own = np.tile(noise_mm**2 * np.eye(3), (count, 1, 1))
    joints, points_mm, actual_mm = joints[:count], points_mm[:count], actual_mm[:count]
    poses = StaticPoses.of(joints, poses_at(points_mm), actual_mm - points_mm, own)
    readings = Readings(joints, actual_mm[:, None], own[:, None])
    return Measured(poses, grid, MeasuredArm(ROBOT, readings, ROBOT.arm.tool[None, :3, 3], curves))


def arm_of(data: Measured) -> MeasuredArm:
    assert data.arm is not None
    return data.arm


def missed_mm(model: Kinematic) -> Array:
    points_mm = drawn_mm(9, 60)
    return lengths_mm(model.predict(poses_at(points_mm)).error_mm + points_mm - truth(points_mm)[1])


def test_unseen_poses_are_predicted_within_their_bounds() -> None:
    model = Kinematic.learn(measured(64))
    points_mm = drawn_mm(9, 60)
    found = model.predict(poses_at(points_mm))
    left = truth(points_mm)[1] - points_mm - found.error_mm
    squares = np.einsum(
        "ni,ni->n", left, np.linalg.solve(found.covariance_mm2, left[..., None])[..., 0]
    )
    assert lengths_mm(left).mean() < 0.08
    assert 0.2 < squares.mean() / 3 < 2.0


def test_errors_that_repeat_with_an_angle_widen_the_covariance() -> None:
    """A grid of 27 has few angles of axis 1, whose waves no parameter describes."""
    estimate, _ = _identified(arm_of(measured(27)))
    assert _excess(estimate) > 1.2
    model = Kinematic.learn(measured(27))
    ratio = model.noise.joint_rad / estimate.noise.joint_rad
    np.testing.assert_allclose(ratio**2, _excess(estimate))
    np.testing.assert_allclose(model.covariance, _excess(estimate) * estimate.system.covariance)


def test_curves_that_help_are_used() -> None:
    without, with_ = Kinematic.learn(measured(64)), Kinematic.learn(measured(64, WAVES))
    assert with_.decision.used
    assert missed_mm(with_).mean() < 0.7 * missed_mm(without).mean()


def test_curves_grow_with_the_load() -> None:
    arm, growth = arm_of(data := measured(64, WAVES, noise_mm=0.003)), 0.9
    bent = arm.readings.joints_rad.copy()
    reach_mm = np.linalg.norm(forward(ROBOT.arm, bent)[:, :2, 3], axis=1)
    bent[:, 0] += growth * (reach_mm / reach_mm.mean() - 1.0) * WAVES.evaluate(bent[:, 0])
    moved_mm = (forward(ROBOT.arm, bent) - forward(ROBOT.arm, arm.readings.joints_rad))[:, :3, 3]
    readings = replace(arm.readings, xyz_mm=arm.readings.xyz_mm + moved_mm[:, None])
    model = Kinematic.learn(replace(data, arm=replace(arm, readings=readings)))
    assert "; the curves grow with the load" in model.decision.reason
    at = model.kinematics.names.index("axis 1: growth by lever")
    assert abs(model.state.values[at - model.kinematics.placed] - growth) < 0.3
    entry = json.loads(json.dumps(model.parameters()))
    again = Kinematic.restore(GRID, np.zeros((*GRID.shape, 3)), entry)
    poses = poses_at(drawn_mm(9, 5))
    np.testing.assert_allclose(again.predict(poses).error_mm, model.predict(poses).error_mm)


def test_an_axis_that_was_not_swept_errs_smoothly_as_its_poses_show() -> None:
    arm, size_rad = arm_of(data := measured(64, WAVES)), 300e-6
    bent = arm.readings.joints_rad.copy()
    bent[:, 3] += size_rad * np.sin(8.0 * bent[:, 3])
    moved_mm = (forward(ROBOT.arm, bent) - forward(ROBOT.arm, arm.readings.joints_rad))[:, :3, 3]
    readings = replace(arm.readings, xyz_mm=arm.readings.xyz_mm + moved_mm[:, None])
    model = Kinematic.learn(replace(data, arm=replace(arm, readings=readings)))
    assert {curve.axis for curve in model.kinematics.curves} == {0, 3, 4, 5}
    assert model.decision.reason.endswith("; axes 4, 5, 6 err smoothly by these poses alone")
    low, high = np.quantile(arm.readings.joints_rad[:, 3], [0.05, 0.95])
    q = np.linspace(low, high, 50)
    at = np.tile(arm.readings.joints_rad[0], (50, 1))
    at[:, 3] = q
    error_rad = model.kinematics.joints_of(model.state, at)[:, 3] - q
    off = error_rad - size_rad * np.sin(8.0 * q)
    assert np.std(off - np.polyval(np.polyfit(q, off, 1), q)) < 0.3 * size_rad
    entry = json.loads(json.dumps(model.parameters()))
    again = Kinematic.restore(GRID, np.zeros((*GRID.shape, 3)), entry)
    poses = poses_at(drawn_mm(9, 5))
    np.testing.assert_allclose(again.predict(poses).error_mm, model.predict(poses).error_mm)


def moved(data: Measured, by_mm: Array) -> Measured:
    arm = arm_of(data)
    readings = replace(arm.readings, xyz_mm=arm.readings.xyz_mm + by_mm[:, None])
    return replace(data, arm=replace(arm, readings=readings))


def turned(data: Measured, axis: int, by_rad: Array) -> Measured:
    """Return poses at which an axis has turned further by angles (N,)."""
    joints_rad = arm_of(data).readings.joints_rad
    bent = joints_rad.copy()
    bent[:, axis] += by_rad
    return moved(data, (forward(ROBOT.arm, bent) - forward(ROBOT.arm, joints_rad))[:, :3, 3])


def test_a_third_wave_of_a_joint_is_identified() -> None:
    data = measured(64, WAVES, noise_mm=0.003)
    joints_rad = arm_of(data).readings.joints_rad
    waved = turned(data, 2, 150e-6 * np.sin(3.0 * joints_rad[:, 2]))
    names = Kinematic.learn(waved).kinematics.names
    assert sum(" 3q " in name for name in names) == 2 * len(ROBOT.arm)
    left_mm, before_mm = Kinematic.left_out_mm(waved), Kinematic.left_out_mm(data)
    assert lengths_mm(left_mm).mean() < 1.2 * lengths_mm(before_mm).mean()


def tail(sizes_mm: Array) -> float:
    return float(sizes_mm.max() / np.median(sizes_mm))


def test_normal_errors_along_one_line_have_no_heavy_tail() -> None:
    tails, raw = [], []
    for seed in range(4):
        normal = np.random.default_rng(seed).standard_normal(60)
        data = turned(measured(60, WAVES), 0, 15e-6 * normal)
        tails.append(tail(Kinematic.left_out_sizes_mm(data)))
        raw.append(tail(lengths_mm(Kinematic.left_out_mm(data))))
    assert max(tails) <= 3.0
    assert max(raw) > 3.0


@pytest.mark.parametrize(("far_mm", "struck"), [(0.3, False), (4.0, True)])
def test_one_pose_far_off_is_a_heavy_tail(far_mm: float, struck: bool) -> None:
    far = np.zeros((60, 3))
    far[33] = [0.0, 0.0, far_mm]
    data = moved(measured(60, WAVES), far)
    sizes_mm = Kinematic.left_out_sizes_mm(data)
    assert Kinematic.learn(data).outliers == [33] * struck
    assert np.argmax(sizes_mm) == 33
    assert tail(sizes_mm) > 5.0


def test_curves_that_harm_are_not_used() -> None:
    wrong = replace(WAVES, amplitude_rad=-2.0 * WAVES.amplitude_rad, shift_sigma_rad=1e-6)
    decision = curves_used(measured(64, wrong))
    assert not decision.used
    assert decision.with_mm is not None
    assert decision.without_mm is not None
    assert decision.with_mm > decision.without_mm
    assert not curves_used(measured(64)).used


def test_one_bad_curve_does_not_spoil_the_others() -> None:
    wrong = replace(WAVES, axis=1, amplitude_rad=-2.0 * WAVES.amplitude_rad)
    model = Kinematic.learn(measured(64, WAVES, wrong))
    assert model.decision.used
    assert [curve.axis for curve in model.kinematics.curves] == [0]
    assert missed_mm(model).mean() < 1.2 * missed_mm(Kinematic.learn(measured(64, WAVES))).mean()


def test_too_few_poses_are_refused_and_another_model_is_chosen() -> None:
    few = measured(19)
    with pytest.raises(IdentificationError, match="19 poses"):
        Kinematic.learn(few)
    assert "19 poses" in curves_used(few).reason
    choice = chosen(few)
    assert "19 poses" in choice.refused["kinematic"]
    assert choice.model in {"idw", "trilinear"}


def test_the_kinematic_model_is_chosen_where_it_is_best() -> None:
    choice = chosen(measured(64))
    assert choice.model == "kinematic"
    assert set(choice.figures) == set(MODELS)


def test_a_model_of_places_is_not_chosen_for_other_orientations() -> None:
    choice = chosen(measured(19), reoriented=True)
    assert choice.model == "nominal"  # too few poses for the kinematic one
    assert "trilinear" in choice.refused
    assert set(choice.figures) == {"nominal", "idw", "trilinear"}  # shown beside it
    assert chosen(measured(64), reoriented=True).model == "kinematic"


def test_nominal_is_kept_where_nothing_beats_it() -> None:
    choice = chosen(measured(64, errors=False, noise_mm=0.05))
    assert choice.model == "nominal"
    model = Nominal.learn(measured(64, errors=False, noise_mm=0.05))
    found = model.predict(poses_at(drawn_mm(1, 3)))
    assert not found.error_mm.any()
    np.testing.assert_allclose(np.trace(found.covariance_mm2[0]) / 3, 0.05**2, rtol=0.3)


@pytest.mark.parametrize("mean_mm", [6.1, 5.3, math.nan])
def test_a_model_worse_than_nominal_is_not_chosen(mean_mm: float) -> None:
    """The reproduction: 6.1 against 5.3 mm, and by far the smaller largest miss."""
    figures = {"nominal": Figures(5.3, 9.0, 60.0), "kinematic": Figures(mean_mm, 6.5, 7.0)}
    assert choose(figures) == "nominal"


def test_the_largest_miss_counts_beside_the_mean() -> None:
    figures = {
        "nominal": Figures(9.0, 9.0, 9.0),
        "idw": Figures(0.110, 0.2, 0.30),
        "trilinear": Figures(0.105, 0.2, 0.60),
    }
    assert choose(figures) == "idw"


def test_a_model_from_its_file_predicts_the_same() -> None:
    model = Kinematic.learn(measured(64, WAVES))
    kept = json.loads(json.dumps(model.parameters()))
    again = Kinematic.restore(GRID, np.zeros((3, 3, 3, 3)), kept)
    poses = poses_at(drawn_mm(2, 5))
    np.testing.assert_array_equal(again.predict(poses).error_mm, model.predict(poses).error_mm)
    np.testing.assert_allclose(
        again.predict(poses).covariance_mm2, model.predict(poses).covariance_mm2, rtol=1e-12
    )
    assert again.parameters() == model.parameters()


@pytest.fixture(scope="module")
def kept() -> dict[str, Any]:
    return Kinematic.learn(measured(64, WAVES)).parameters()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda p: p.pop("base"), "robot"),
        (lambda p: p["base"][0].__setitem__(0, 2.0), "base"),
        (lambda p: p["values"].pop(), "values"),
        (lambda p: p["values"].__setitem__(3, float("nan")), "values"),
        (lambda p: p["covariance"][0].__setitem__(1, 5.0), "symmetric"),
        (lambda p: p["covariance"][0].__setitem__(0, -1.0), "covariance"),
        (lambda p: p["curves"][0].__setitem__("axis", 6), "axis 6"),
        (lambda p: p["robot"]["sign"].__setitem__(0, 0.5), "sign"),
        (lambda p: p["robot"]["limits_rad"].pop(), "limits_rad"),
        (lambda p: p.update(reading_mm=-1.0), "reading_mm"),
        (lambda p: p.update(levers_mm=[900.0]), "levers_mm: 1, expected 0 or 3"),
        (lambda p: p.update(levers_mm=[900.0, 0.0, 700.0]), "levers_mm: expected >= 10 mm"),
        (lambda p: p["robot"].update(status=9), "status 9"),
    ],
)
def test_damaged_parameters_are_refused(kept: dict[str, Any], change: Any, named: str) -> None:
    damaged = json.loads(json.dumps(kept))
    change(damaged)
    with pytest.raises(ModelError, match=named):
        Kinematic.restore(GRID, np.zeros((3, 3, 3, 3)), damaged)
