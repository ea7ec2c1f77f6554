from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import msgspec
import numpy as np
import pytest

from fakes.faults import Faults
from fakes.time import CellTime
from fakes.truth.cell_truth import FLANGE, CellTruth
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Array, forward

DEG = np.pi / 180
HARD = load_cell("hard")


def truth_of(cell: Cell, seed: int = 1) -> CellTruth:
    return CellTruth(cell, seed, CellTime(), Faults())


def rail_of(truth: CellTruth) -> RailTruth:
    assert isinstance(truth.rail, RailTruth)
    return truth.rail


def go(truth: CellTruth, joints_deg: Array, polls: int = 0) -> None:
    truth.robot.move(np.array(joints_deg) * DEG, 0.3)
    for _ in range(polls):
        truth.robot.poll()
    truth.time.advance(60.0)


def visit(truth: CellTruth, joints_deg: Array, polls: int = 0) -> Array:
    go(truth, np.array(joints_deg) - 0.5, polls)
    go(truth, joints_deg, polls)
    measured = truth.tracker.measure(FLANGE)
    assert measured is not None
    return measured.xyz_mm


POSES = np.array([[0, -75, 100, 0, -40, 0], [20, -60, 90, 10, -50, 30], [-30, -90, 95, 5, -35, 0]])


def test_same_seed_same_figures_however_often_polled(cell: Cell) -> None:
    figures = []
    for polls in (0, 3, 20):
        truth = truth_of(cell)
        figures.append([visit(truth, pose, polls) for pose in (*POSES, POSES[0])])
    # Time differs, so the slow drift and nothing else may.
    assert np.array_equal(figures[0], figures[1])
    assert np.array_equal(figures[0], figures[2])


def test_another_run_on_the_same_machine_has_noise_of_its_own(cell: Cell) -> None:
    """Else a re-check would compare an earlier run with itself."""
    first, same, other = (CellTruth(cell, 3, CellTime(), Faults(), run) for run in (None, 3, 4))
    for one in (first, same, other):
        assert np.array_equal(one.tracker.pose_in_world, first.tracker.pose_in_world)
        assert one.streams.offset_s == first.streams.offset_s
    at_mm = [[visit(one, pose) for pose in POSES] for one in (first, same, other)]
    assert np.array_equal(at_mm[0], at_mm[1])
    apart_mm = np.linalg.norm(np.subtract(at_mm[0], at_mm[2]), axis=1)
    assert (apart_mm > 1e-4).all()
    assert (apart_mm < 0.3).all()


def test_two_visits_of_one_pose_differ_by_repeatability(cell: Cell) -> None:
    truth = truth_of(cell)
    visits = []
    for _ in range(20):
        visit(truth, POSES[1])
        visits.append(visit(truth, POSES[0]))
    off = np.linalg.norm(np.array(visits) - np.mean(visits, axis=0), axis=1)
    rp_mm = off.mean() + 3 * off.std(ddof=1)
    assert 0.04 < rp_mm < 0.09  # 0.06 of the robot, and the tracker


def test_joints_that_did_not_move_keep_their_place(cell: Cell) -> None:
    truth = truth_of(cell)
    visit(truth, POSES[0])
    before = truth.robot.state().landing_rad
    go(truth, POSES[0] + [0, 0, 0, 0, 0, 10])
    after = truth.robot.state().landing_rad
    assert np.array_equal(before[:5], after[:5])
    assert before[5] != after[5]


def test_reflectors_stand_near_their_nominal_places(cell: Cell) -> None:
    truth = truth_of(cell)
    at_mm = truth.reflectors_in_world()
    base = cell.layout.nominal_base(truth.rail.slide_mm())
    assert set(at_mm) == {
        *(nest.name for nest in cell.layout.fixed_nests + cell.layout.slide),
        FLANGE,
    }
    for nest in cell.layout.floor:
        assert 0 < np.linalg.norm(at_mm[nest.name] - nest.xyz_mm) < cell.layout.nest_tolerance_mm
    for nest in cell.layout.slide:
        off = np.linalg.norm(at_mm[nest.name] - apply(base, nest.xyz_mm[None])[0])
        assert 0 < off < 10.0
    nominal = base @ forward(cell.robot.arm(), np.radians(cell.robot.home_deg))
    assert 0.1 < np.linalg.norm(at_mm[FLANGE] - nominal[:3, 3]) < 15.0


def test_other_reflectors_on_the_flange_ride_rigidly_near_their_nominal_places() -> None:
    seats = "[[-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]]"
    cell = load_cell("paper", {"robot.more_smr_mm": seats})
    truth, names = truth_of(cell), [FLANGE, "flange 2", "flange 3"]
    shapes = []
    for turn_deg in (0.0, 20.0):
        go(truth, np.array(cell.robot.home_deg) + turn_deg)
        at_mm = truth.reflectors_in_world()
        shapes.append([np.linalg.norm(at_mm[a] - at_mm[b]) for a, b in combinations(names, 2)])
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-9)
    wanted = [np.linalg.norm(a - b) for a, b in combinations(cell.robot.seats_mm, 2)]
    off_mm = np.abs(np.array(shapes[0]) - wanted)
    assert 0.01 < off_mm.max() < 3.0  # mounted by hand
    alone = truth_of(load_cell("paper"))
    go(alone, np.array(cell.robot.home_deg) + 20.0)
    go(truth, np.array(cell.robot.home_deg) + 20.0)
    assert np.array_equal(truth_of(cell).base_in_world(), alone.base_in_world())


def test_slide_nests_and_robot_ride_rigidly(cell: Cell) -> None:
    truth = truth_of(cell)
    before, base_before = truth.reflectors_in_world(), truth.base_in_world()
    rail_of(truth).brake(closed=False)
    rail_of(truth).move(1000.0, 250.0, 200.0)
    truth.time.advance(60.0)
    after, base_after = truth.reflectors_in_world(), truth.base_in_world()
    names = [nest.name for nest in cell.layout.slide] + [FLANGE]
    shapes = [
        apply(inverse(base), np.array([at[name] for name in names]))
        for at, base in ((before, base_before), (after, base_after))
    ]
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-9)
    assert np.linalg.norm(after["P1"] - before["P1"]) > 900
    assert np.array_equal(before["F1"], after["F1"])


def test_braked_robot_stands_on_its_way(cell: Cell) -> None:
    truth = truth_of(cell)
    start = truth.robot.state().joints_rad
    truth.robot.move(POSES[1] * DEG, 0.3)
    truth.robot.poll()
    truth.robot.brake()
    truth.time.advance(10.0)
    state = truth.robot.state()
    moved = np.abs(POSES[1] * DEG - start) > 0
    share = ((state.joints_rad - start)[moved]) / (POSES[1] * DEG - start)[moved]
    assert not state.moving
    assert 0.05 < share[0] < 0.95
    np.testing.assert_allclose(share, share[0], rtol=1e-9)


def test_override_zero_holds_and_then_lets_go_on(cell: Cell) -> None:
    truth = truth_of(cell)
    truth.robot.move(POSES[1] * DEG, 0.3)
    truth.robot.poll()
    truth.robot.override(0.0)
    truth.time.advance(60.0)
    held = truth.robot.state()
    assert held.moving
    assert not truth.robot.axes_moving
    truth.robot.override(1.0)
    truth.time.advance(60.0)
    assert not truth.robot.moving
    np.testing.assert_allclose(truth.robot.state().joints_rad, POSES[1] * DEG)


def slide_on(truth: CellTruth) -> None:
    rail_of(truth).brake(closed=False)
    rail_of(truth).move(100.0, 250.0, 200.0)
    truth.time.advance(60.0)


def measure_often(truth: CellTruth) -> None:
    for _ in range(100):
        truth.tracker.measure(FLANGE)


CHANGES: dict[str, Callable[[CellTruth], None]] = {
    "the robot moves": lambda truth: go(truth, POSES[1]),
    "the slide moves": slide_on,
    "it gets warmer": measure_often,
    "the mount slips": lambda truth: truth.slip_mount(0.1),
    "a zero is lost": lambda truth: truth.lose_zero(1e-3),
    "motion is lost": lambda truth: truth.lose_motion(1e-3),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_stood_is_not_taken_for_what_is_now(change: str) -> None:
    """Places are kept while nothing changes; two truths agree, one was asked in between."""
    asked, other = truth_of(HARD), truth_of(HARD)
    for truth in (asked, other):
        go(truth, POSES[0])
    before_mm = asked.places_in_world()[FLANGE]
    assert asked.places_in_world()[FLANGE] is before_mm
    for truth in (asked, other):
        CHANGES[change](truth)
    after_mm = asked.places_in_world()[FLANGE]
    assert not np.allclose(after_mm, before_mm, rtol=0, atol=1e-4)
    assert np.array_equal(after_mm, other.places_in_world()[FLANGE])


def test_a_lost_zero_is_that_axis_further_on(cell: Cell) -> None:
    for axis in range(1, 7):
        truth, turn_rad = truth_of(cell), np.zeros(6)
        turn_rad[axis - 1] = 1e-3
        at = truth.robot.state().joints_rad
        further = truth.arm.pose(at + turn_rad, np.ones(6), np.zeros(6))
        truth.lose_zero(1e-3, axis)
        lost = truth.arm.pose(at, np.ones(6), np.zeros(6))
        np.testing.assert_allclose(lost, further, atol=0.1)  # but for the ripple of another angle


def test_lost_motion_is_the_way_between_both_sides_of_an_axis(cell: Cell) -> None:
    truth, turn_rad = truth_of(cell), np.zeros(6)
    at, sides = truth.robot.state().joints_rad, np.ones(6)
    sides[2] = -1.0
    before = [truth.arm.pose(at, side, np.zeros(6))[:3, 3] for side in (np.ones(6), sides)]
    truth.lose_motion(150e-6)
    after = [truth.arm.pose(at, side, np.zeros(6))[:3, 3] for side in (np.ones(6), sides)]
    turn_rad[2] = 150e-6
    wanted_mm = (truth.arm.design.pose(at + turn_rad) - truth.arm.design.pose(at))[:3, 3]
    widened_mm = (after[0] - after[1]) - (before[0] - before[1])
    np.testing.assert_allclose(widened_mm, wanted_mm, atol=0.01)


def test_the_machine_is_the_same_under_another_plan(cell: Cell) -> None:
    """The plan of measurements changes nothing of the truth, to the last digit."""
    replace = msgspec.structs.replace
    grid = replace(
        cell.grid,
        centre=replace(cell.grid.centre, x_mm=1700.0, b_deg=60.0),
        size_mm=(600.0, 400.0, 200.0),
        pitch_mm=200.0,
        station="S300",
    )
    frame = replace(
        cell.base_frame, axis_6_deg=(0.0, -90.0, 90.0, 0.0, -30.0, 0.0), axis_1_sweep_deg=(-40, 50)
    )
    other = replace(
        cell,
        grid=grid,
        base_frame=frame,
        robot=replace(cell.robot, safe_deg=(10.0, -90.0, 100.0, 0.0, -40.0, 0.0)),
        validation=replace(cell.validation, per_cell=1, others=9),
        survey=replace(cell.survey, to_mm=1000.0),
    )
    facts = [_facts(truth_of(each)) for each in (cell, other)]
    assert len(facts[0]) == len(facts[1])
    assert all(np.array_equal(one, same) for one, same in zip(*facts, strict=True))
    unlike = _facts(truth_of(cell, 2))
    assert not any(np.array_equal(one, same) for one, same in zip(facts[0], unlike, strict=True))


def _facts(truth: CellTruth) -> list[Array]:
    """Return what the seed fixes of robot, rail, strip, nests and tracker."""
    rail = rail_of(truth)
    rail.brake(closed=False)
    strip, slide = [], []
    for target_mm in (200.0, 900.0, 300.0, 2200.0):
        rail.move(target_mm, 250.0, 200.0)
        truth.time.advance(60.0)
        strip.append(rail.poll().strip_mm)
        slide.append(rail.slide_pose())
    joints = np.radians(POSES).astype(float)
    places = truth.places_in_world()
    return [
        truth.arm.pose(joints, np.ones((3, 6)), np.zeros((3, 6)), warm_k=0.5),
        truth.arm.ideal_base,
        truth.base_in_world(),
        np.array(strip),
        np.array(slide),
        np.array([places[name] for name in ("F1", "P3", FLANGE)]),
        np.array(truth.tracker.pose_in_world),
        visit(truth, POSES[0]),
    ]


def test_a_robot_on_the_floor_stands_and_is_bolted_askew() -> None:
    cell = load_cell("fixed")
    truth = truth_of(cell)
    assert truth.rail.slide_mm() == 0.0
    assert {FLANGE, "F1", "B1"} <= truth.reflectors_in_world().keys()
    askew_mm = np.linalg.norm((truth.base_in_world() - cell.layout.nominal_base(0.0))[:3, 3])
    assert 0.1 < askew_mm < 10.0


def test_an_arm_grows_with_the_measurements(cell: Cell) -> None:
    truth = truth_of(cell)
    go(truth, POSES[0])
    before = truth.places_in_world()[FLANGE]
    truth.grow(1000.0)
    assert truth.tracker.measurements("F1", 1000) is not None
    grown_mm = np.linalg.norm(truth.places_in_world()[FLANGE] - before)
    assert 1.5 < grown_mm < 3.5  # a thousandth of its reach


def test_a_brake_slips_at_each_stop(cell: Cell) -> None:
    truth = truth_of(cell)
    truth.loosen(2, 0.01 * DEG)
    landed = []
    for _ in range(20):
        go(truth, POSES[1])
        go(truth, POSES[0])
        landed.append(truth.robot.state().landing_rad)
    scatter = np.std(landed, axis=0)
    assert scatter[1] == pytest.approx(0.01 * DEG, rel=0.5)
    assert scatter[2] < 0.2 * scatter[1]
