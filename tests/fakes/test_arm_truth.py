from __future__ import annotations

import msgspec
import numpy as np
import pytest

from fakes.truth.arm_truth import (
    ArmTruth,
    Design,
    Deviations,
    Ripple,
    reference_cube,
    unit_rp_mm,
    varying_rms_mm,
)
from fakes.truth.machine import Machine, load_machine
from fakes.truth.noise import KeyedNoise
from hilcell.calibration.frames import axis_6_height_mm
from hilcell.calibration.grid import grid_of
from hilcell.cell.file import Cell, load_cell
from hilcell.compensation.correction import corrected
from hilcell.compensation.interpolation import Idw, Trilinear
from hilcell.geometry.frames import apply, base_frame, fit_circle, inverse, rigid_fit
from hilcell.geometry.kinematics import Array, forward
from procedures.base_frame import sweep
from procedures.plan import joints_for, poses_at
from tests.hilcell.compensation.models import exact

SEEDS = range(2)
UP = np.ones(6)
URAD = 1e-6


def arm_of(cell: Cell, seed: int, machine: str = "paper") -> ArmTruth:
    return ArmTruth(load_machine(machine), cell.robot.smr_mm, np.random.default_rng(seed))


@pytest.mark.parametrize("seed", SEEDS)
def test_mean_error_over_the_cube_is_the_papers(cell: Cell, seed: int) -> None:
    arm = arm_of(cell, seed)
    nominal_mm = forward(cell.robot.arm(), arm.commands_rad)[:, :3, 3]
    np.testing.assert_allclose(nominal_mm, arm.targets_mm, atol=1e-6)
    errors = np.linalg.norm(arm.errors_mm(arm.commands_rad, arm.targets_mm), axis=1)
    assert len(errors) == 216
    assert errors.mean() == pytest.approx(1.2092, abs=1e-9)
    assert 1.3 < errors.max() <= 1.9


def test_ideal_base_is_what_noise_free_circles_find(cell: Cell) -> None:
    arm = arm_of(cell, 4)
    axis_1, axis_6 = (
        fit_circle(arm.pose(joints, np.ones_like(joints), np.zeros(6))[:, :3, 3], turn=-1.0)
        for joints in (sweep(cell, 1), sweep(cell, 6))
    )
    found = base_frame(axis_1, axis_6, axis_6_height_mm(cell))
    # The sweep's own ripple moves points along their circle only.
    np.testing.assert_allclose(found, arm.ideal_base, atol=1e-6)


def test_ripple_has_the_wanted_rms() -> None:
    turn = np.linspace(0.0, 2 * np.pi, 4_000, endpoint=False)
    sizes = load_machine("paper").transmission
    for seed in SEEDS:
        ripple = Ripple(sizes, np.random.default_rng(seed))
        rms_rad = np.sqrt((ripple(np.tile(turn[:, None], 6)) ** 2).mean(axis=0))
        np.testing.assert_allclose(rms_rad, 45 * URAD / np.sqrt(2), rtol=1e-6)
        used = ripple.cycles[ripple.amplitude_rad > 0]
        assert used.min() >= 30
        assert used.max() <= 500


def test_a_turning_gear_drives_the_arm_towards_its_resonance() -> None:
    sizes = load_machine("paper").transmission
    turn = np.tile(np.linspace(0.0, 2 * np.pi, 4_000, endpoint=False)[:, None], 6)
    ripple = Ripple(sizes, np.random.default_rng(1))
    np.testing.assert_array_equal(ripple(turn), ripple(turn, None))
    rates_rad_s = np.full_like(turn, np.radians(3.0))
    still, up, down = (
        np.abs(np.fft.rfft(ripple(turn, rates), axis=0)).max(axis=0)
        for rates in (None, rates_rad_s, -rates_rad_s)
    )
    largest = ripple.cycles[np.arange(6), ripple.amplitude_rad.argmax(axis=1)]
    share = largest * 3.0 / 360.0 / sizes.resonance_hz
    np.testing.assert_allclose(up / still, 1.0 / (1.0 - share**2), rtol=0.01)
    np.testing.assert_allclose(down, up, rtol=1e-6)
    np.testing.assert_allclose(ripple(turn, 1e-6 * rates_rad_s), ripple(turn), atol=1e-5 * URAD)


def test_side_of_approach_shows_as_lost_motion(cell: Cell) -> None:
    arm = arm_of(cell, 1)
    joints = np.radians(cell.base_frame.axis_1_deg)
    up, down = (arm.pose(joints, side * UP, np.zeros(6))[:3, 3] for side in (1, -1))
    reach_mm = float(np.hypot(*up[:2]))
    assert 0.3 < np.linalg.norm(up - down) / (2 * 15 * URAD * reach_mm) < 3.0


@pytest.mark.parametrize("seed", SEEDS)
def test_paper_methods_leave_what_the_study_says(cell: Cell, seed: int) -> None:
    """The paper's IDW leaves about a tenth of the error; trilinear less; ripple is the rest."""
    arm = arm_of(cell, seed)
    rng = np.random.default_rng([seed, 1])
    grid = grid_of(cell)
    index = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), axis=-1)
    vertices_mm = grid.origin_mm + index * grid.pitch_mm

    def measured_mm(targets_mm: Array, commands_mm: Array) -> Array:
        joints = joints_for(cell, commands_mm)
        landing = arm.joint_sigma_rad * rng.standard_normal(joints.shape)
        at_mm = arm.pose(joints, np.ones_like(joints), landing)[:, :3, 3]
        noise_mm = 0.01 * rng.standard_normal(at_mm.shape)
        return apply(inverse(arm.ideal_base), at_mm) - targets_mm + noise_mm

    flat_mm = vertices_mm.reshape(-1, 3)
    errors_mm = measured_mm(flat_mm, flat_mm).reshape(vertices_mm.shape)
    size_mm = np.array(cell.grid.size_mm)
    targets_mm = grid.origin_mm + rng.uniform(0.01, 0.99, (400, 3)) * size_mm
    left = {}
    for model in (Idw, Trilinear):
        commands = corrected(grid, poses_at(cell, targets_mm), exact(model, grid, errors_mm))
        left[model] = float(np.linalg.norm(measured_mm(targets_mm, commands), axis=1).mean())
    assert 0.09 < left[Idw] < 0.18
    assert 0.08 < left[Trilinear] < 0.14


def test_unit_rp_is_what_draws_give() -> None:
    J = np.random.default_rng(3).standard_normal((3, 3, 6)) * [5.0, 3.0, 3.0, 0.5, 1.0, 0.1]
    draws = np.random.default_rng(4).standard_normal((40_000, 6))
    for each, rp in zip(J, unit_rp_mm(J), strict=True):
        distances = np.linalg.norm(draws @ each.T, axis=1)
        assert rp == pytest.approx(distances.mean() + 3 * distances.std(), rel=0.02)


def test_rp_over_the_cube_is_the_data_sheets(cell: Cell) -> None:
    """ISO 9283: 30 visits of each place, RP = mean + 3 s of the distances from their mean."""
    rps_mm = []
    for seed in range(4):
        arm, noise = arm_of(cell, seed), KeyedNoise(seed, "robot").generator("RP")
        visits = np.repeat(arm.commands_rad[::5, None], 30, axis=1)
        landing = arm.joint_sigma_rad * noise.standard_normal(visits.shape)
        at_mm = arm.pose(visits, UP, landing)[..., :3, 3]
        distances = np.linalg.norm(at_mm - at_mm.mean(axis=1, keepdims=True), axis=-1)
        rps_mm.append((distances.mean(axis=1) + 3 * distances.std(axis=1, ddof=1)).mean())
    assert np.mean(rps_mm) == pytest.approx(0.06, abs=0.004)
    assert 8.5e-6 < arm.joint_sigma_rad < 10.5e-6


def test_varying_rms_is_what_a_rigid_fit_leaves(cell: Cell) -> None:
    arm = arm_of(cell, 2)
    errors_mm = arm.errors_mm(arm.commands_rad, arm.targets_mm)
    fit = rigid_fit(arm.targets_mm, arm.targets_mm + errors_mm)
    assert varying_rms_mm(arm.targets_mm, errors_mm) == pytest.approx(fit.rms_mm, rel=1e-3)


def test_most_of_the_papers_error_is_one_rigid_motion(cell: Cell) -> None:
    shares = []
    for seed in range(5):
        arm = arm_of(cell, seed)
        errors_mm = arm.errors_mm(arm.commands_rad, arm.targets_mm)
        left = varying_rms_mm(arm.targets_mm, errors_mm) ** 2
        shares.append(1.0 - left / (errors_mm**2).sum(axis=1).mean())
    assert 0.9 < np.mean(shares) < 0.99


def changed(machine: Machine, table: str, **values: object) -> Machine:
    inner = msgspec.structs.replace(getattr(machine, table), **values)
    return msgspec.structs.replace(machine, **{table: inner})


def test_the_reference_cube_is_the_machines_own(cell: Cell) -> None:
    machine = load_machine("paper")
    smaller = changed(machine, "reference", size_mm=(300.0, 300.0, 300.0))
    targets_mm, _ = reference_cube(smaller, smaller.chain(cell.robot.smr_mm))
    np.testing.assert_allclose(np.ptp(targets_mm, axis=0), 300.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_hard_leaves_much_after_the_best_rigid_fit(cell: Cell, seed: int) -> None:
    arm = arm_of(cell, seed, "hard")
    errors_mm = arm.errors_mm(arm.commands_rad, arm.targets_mm)
    assert rigid_fit(arm.targets_mm, arm.targets_mm + errors_mm).rms_mm >= 0.6
    assert np.linalg.norm(errors_mm, axis=1).max() <= 3.5


def test_a_warmer_arm_is_longer(cell: Cell) -> None:
    joints = np.radians(cell.robot.home_deg)
    for name, growth in (("hard", 20e-6), ("paper", 0.0)):
        arm = arm_of(cell, 1, name)
        cold_mm, warm_mm = (
            arm.pose(joints, UP, np.zeros(6), warm_k)[:3, 3] for warm_k in (0.0, 0.7)
        )
        assert np.linalg.norm(warm_mm - cold_mm) == pytest.approx(
            0.7 * growth * np.linalg.norm(cold_mm), abs=1e-9
        )


@pytest.mark.parametrize("seed", SEEDS)
def test_six_r_is_another_robot(seed: int) -> None:
    cell = load_cell("six-r")
    arm = arm_of(cell, seed, "six-r")
    errors_mm = np.linalg.norm(arm.errors_mm(arm.commands_rad, arm.targets_mm), axis=1)
    assert errors_mm.mean() == pytest.approx(0.9, abs=1e-9)
    stretched_mm = forward(cell.robot.arm(), np.radians([0.0, 90.0, -90.0, 0.0, 0.0, 0.0]))[:3, 3]
    assert 1300.0 < np.hypot(*stretched_mm[:2]) - 95.0 < 1500.0  # to the wrist's centre


def design_of(name: str) -> Design:
    return Design(load_machine(name), (98.0, 0.0, 127.0))


BAND = [{"cycles": [4, 32], "rms_urad": 45.0, "lines": 8}]


def test_only_hard_has_a_harmonic_outside_every_list() -> None:
    paper = Ripple(load_machine("paper").transmission, np.random.default_rng(1))
    assert not paper.amplitude_rad[:, -1].any()
    sizes = load_machine("hard").transmission
    for seed in range(10):
        ripple = Ripple(sizes, np.random.default_rng(seed))
        np.testing.assert_allclose(ripple.amplitude_rad[:, -1], 11 * URAD)
        beside = ripple.cycles[:, -1]
        assert ((beside > sizes.pins[1]) & (beside < sizes.ratios[0])).all()
        assert np.abs(beside - np.round(beside)).min() > 1e-6


def test_a_band_has_its_size_in_every_joint_between_its_frequencies() -> None:
    sizes = load_machine("paper", {"transmission": {"band": BAND, "ripple_urad": 0.0}}).transmission
    q = np.repeat(np.linspace(-np.pi, np.pi, 5000)[:, None], 6, axis=1)
    sizes_rad = np.array([
        Ripple(sizes, np.random.default_rng(seed))(q).std(axis=0) for seed in range(10)
    ])  # fmt: skip
    assert sizes_rad.mean() == pytest.approx(45 * URAD, rel=0.05)
    assert sizes_rad.min() > 25 * URAD
    inside = Ripple(sizes, np.random.default_rng(1)).cycles[:, -8:]
    assert inside.min() >= 4.0
    assert inside.max() <= 32.0


def test_loads_span_their_range_over_the_cube_and_no_more() -> None:
    design = design_of("hard")
    over_cube = design.loads(design.commands_rad)
    np.testing.assert_allclose(over_cube[:, :4].min(axis=0), -1.0)
    np.testing.assert_allclose(over_cube[:, :4].max(axis=0), 1.0)
    assert np.abs(over_cube[:, 4:]).max() < 1e-6  # one orientation: the hand's lever stays
    stretched = design.loads(np.zeros(6))
    assert stretched[1] == 1.0  # heavier than anywhere in the cube


def test_slopes_are_those_of_the_links() -> None:
    """The paper's robot counts a level upper arm as 0, the other make an upright one."""
    paper, six_r = (np.degrees(design_of(name).slopes(np.zeros(6))) for name in ("paper", "six-r"))
    assert [paper[0], six_r[0]] == pytest.approx([0.0, -90.0])
    assert paper[1] == pytest.approx(-np.degrees(np.arctan2(115, 1220)))
    assert six_r[1] == pytest.approx(-np.degrees(np.arctan2(120, 640)))


def test_gravity_bends_a_level_arm_most() -> None:
    machine = load_machine("paper")
    chain = machine.chain((0.0, 0.0, 0.0))
    level, upright = np.array(0.0), np.radians(-90.0)
    for seed in range(10):
        drawn = Deviations.drawn(machine.errors, chain, np.random.default_rng(seed))
        gravity = drawn._replace(harmonics_rad=drawn.harmonics_rad * 0.0)
        bent = [gravity.deflection(np.zeros(6), arm, arm)[1] for arm in (level, upright)]
        assert bent[0] > abs(bent[1])


def test_elasticity_follows_both_links() -> None:
    """Not a sum of functions of one angle each: its mixed difference does not vanish."""
    none, zero = np.zeros((5, 3)), np.zeros(6)
    bent = Deviations(none, none, zero, zero[:3], zero, np.zeros((6, 2)), np.array(1e-4))

    def axis_2(a2_deg: float, a3_deg: float) -> float:
        upper, fore = np.radians([a2_deg, a2_deg + a3_deg])
        return float(bent.deflection(zero, upper, fore)[1])

    mixed = axis_2(-60, 80) - axis_2(-60, 40) - axis_2(-20, 80) + axis_2(-20, 40)
    assert abs(mixed) > 1e-5
    assert axis_2(-90, 20) == pytest.approx(0.0, abs=1e-12)
