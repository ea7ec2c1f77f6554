"""Plans on the paper's cell: everything drilled once, from where it can be, by fewest stations."""

from collections.abc import Sequence
from itertools import combinations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.cell.file import Station, load_cell
from hilcell.geometry.frames import inverse, pose_from_zyx
from hilcell.geometry.inverse import NominalRobot
from hilcell.ports import HilcellError
from hilcell.programs.holes import Holes, tools_against
from hilcell.programs.plan import along_rail, plan, ratio, reach

CELL = load_cell("paper")
ARM = CELL.robot.arm()
LIMITS = CELL.robot.margin_limits_rad
HOME = np.radians(CELL.robot.home_deg)
seeds = st.integers(0, 2**32 - 1)


def holes_at(
    points: np.ndarray | Sequence[Sequence[float]], normals: np.ndarray | None = None
) -> Holes:
    if normals is None:
        normals = np.tile([-1.0, 0.0, 0.0], (len(points), 1))
    names = [f"H{n + 1}" for n in range(len(points))]
    return Holes(names, np.asarray(points, dtype=float), tools_against(np.asarray(normals)))


def wall(seed: int, count: int, half_width_mm: float = 2000.0) -> Holes:
    """Return holes of a wall along the rail, facing the robot within 15 degrees."""
    rng = np.random.default_rng(seed)
    points = np.column_stack(
        [
            rng.uniform(-100, 100, count),
            rng.uniform(-half_width_mm, half_width_mm, count),
            rng.uniform(700, 1500, count),
        ]
    )
    normals = np.column_stack([-np.ones(count), rng.uniform(-0.25, 0.25, (count, 2))])
    return holes_at(points, normals)


def reaches(station: Station, holes: Holes, number: int) -> bool:
    """Whether any turn of the tool brings it to the hole, judged pose by pose."""
    back = inverse(CELL.layout.nominal_base(station.rail_mm))
    ok = NominalRobot(ARM, CELL.robot.status, LIMITS, HOME).reachable(back @ holes.poses()[number])
    return bool(ok.any())


@settings(max_examples=5)
@given(seeds, st.integers(1, 40), st.booleans())
def test_every_hole_once_at_the_closest_chosen_station_that_reaches_it(
    seed: int, count: int, free: bool
) -> None:
    holes = wall(seed, count)
    found = plan(CELL, holes, free=free)
    visited = [name for each in found.stations for name in each.holes]
    assert sorted(visited) == sorted(holes.names)
    stations = [each.station for each in found.stations]
    for each in found.stations:
        for name in each.holes:
            number = holes.names.index(name)
            along_mm = holes.points_mm[number, 1] + 1100.0
            able = [other for other in stations if reaches(other, holes, number)]
            assert each.station in able
            off_mm = min(abs(other.rail_mm - along_mm) for other in able)
            assert abs(each.station.rail_mm - along_mm) == pytest.approx(off_mm, abs=1e-9)


@settings(max_examples=5)
@given(seeds, st.integers(1, 30))
def test_no_fewer_stations_do(seed: int, count: int) -> None:
    holes = wall(seed, count)
    used = len(plan(CELL, holes).stations)
    able = np.array([[reaches(s, holes, n) for s in CELL.station] for n in range(count)])
    for subset in combinations(range(len(CELL.station)), used - 1):
        assert not able[:, subset].any(axis=1).all()


@settings(max_examples=5)
@given(seeds, st.integers(1, 30))
def test_poses_are_within_limits_and_drill_against_the_normal(seed: int, count: int) -> None:
    holes = wall(seed, count)
    for each in plan(CELL, holes).stations:
        poses = np.array([pose_from_zyx(*row) for row in each.poses])
        back = inverse(CELL.layout.nominal_base(each.station.rail_mm))
        NominalRobot(ARM, CELL.robot.status, LIMITS, HOME).joints_for(back @ poses)
        for pose, name in zip(poses, each.holes, strict=True):
            number = holes.names.index(name)
            np.testing.assert_allclose(pose[:3, 3], holes.points_mm[number], atol=1e-9)
            np.testing.assert_allclose(pose[:3, 2], holes.tools[number, 0, :, 2], atol=1e-9)


def test_the_turn_with_most_room_is_taken() -> None:
    holes = wall(3, 10, 800.0)
    reached = reach(CELL, holes, CELL.station)
    back = inverse(CELL.layout.nominal_base(CELL.station[1].rail_mm))
    for number in range(10):
        rooms = []
        for pose in holes.poses()[number]:
            if NominalRobot(ARM, CELL.robot.status, LIMITS, HOME).reachable(back @ pose):
                joints = NominalRobot(ARM, CELL.robot.status, LIMITS, HOME).joints_for(back @ pose)
                to_limits = np.minimum(joints - LIMITS[0], LIMITS[1] - joints).min()
                rooms.append(min(to_limits, abs(joints[4])))
            else:
                rooms.append(-1.0)
        assert reached.turn[number, 1] == int(np.argmax(rooms))


def test_stations_are_visited_along_the_rail_from_where_homing_leaves_the_slide() -> None:
    rails = [each.station.rail_mm for each in plan(CELL, wall(1, 60, 2400.0)).stations]
    assert len(rails) >= 2
    assert rails == sorted(rails)
    assert along_rail({4: 300.0, 2: 1900.0, 7: 1100.0}) == [4, 7, 2]
    assert along_rail({4: -2700.0, 2: -1100.0, 7: -1900.0}) == [2, 7, 4]
    assert along_rail({1: 5.0}) == [1]


def test_recorded_stations_come_first_and_free_ones_serve_where_they_do_not() -> None:
    near = wall(4, 20, 300.0)
    assert [each.station for each in plan(CELL, near, free=True).stations] == [CELL.station[1]]
    far = holes_at([[-100.0, 3300.0, 1100.0]])
    with pytest.raises(HilcellError, match="cannot be drilled"):
        plan(CELL, far)
    (only,) = plan(CELL, far, free=True).stations
    assert only.station not in CELL.station
    low = CELL.rail.travel_min_mm + CELL.rail.back_off_mm
    assert low <= only.station.rail_mm <= CELL.rail.travel_max_mm
    assert reaches(only.station, far, 0)


@pytest.mark.parametrize(
    ("point", "normal", "reason"),
    [
        ((3000.0, 0.0, 1000.0), (-1.0, 0, 0), r"H2: .*\d mm at S1100"),
        ((0.0, 0.0, 1000.0), (1.0, 0, 0), "H2: "),
        ((-9000.0, 0.0, 1000.0), (-1.0, 0, 0), r"H2: .*134\d\d mm"),
    ],
)
def test_what_nobody_reaches_is_refused_with_the_reason(
    point: tuple[float, float, float], normal: tuple[float, float, float], reason: str
) -> None:
    holes = holes_at([(0, 0, 1000.0), point], np.array([(-1.0, 0, 0), normal]))
    with pytest.raises(HilcellError, match=reason) as raised:
        plan(CELL, holes)
    assert "1 of 2" in str(raised.value)
    assert "H1" not in str(raised.value)


def test_a_hole_out_of_the_trackers_range_is_refused_though_reached() -> None:
    tracker = msgspec.structs.replace(CELL.tracker, max_range_mm=4400.0)
    with pytest.raises(HilcellError, match="range 4"):
        plan(msgspec.structs.replace(CELL, tracker=tracker), holes_at([(0, 0, 1000.0)]))


def test_sums_and_ratio() -> None:
    found = plan(CELL, wall(1, 60, 2400.0))
    assert found.travel_mm == sum(each.travel_mm for each in found.stations)
    assert found.bound_mm <= found.travel_mm <= 1.05 * found.bound_mm
    assert ratio(0.0, 0.0) == 1.0
    assert ratio(3.0, 2.0) == 1.5
