"""Plans on the paper's cell: everything drilled once, from where it can be, by fewest stations."""

import csv
import json
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.cell.file import Station, load_cell
from hilcell.commands.cli import main
from hilcell.geometry.frames import inverse, pose_from_zyx
from hilcell.geometry.inverse import NominalRobot
from hilcell.ports import HilcellError
from hilcell.programs.holes import NORMALS, Holes, tools_against
from hilcell.programs.plan import HolePlan, Reach, along_rail, fewest, plan, ratio

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


def drilled_against_normals(holes: Holes, found: HolePlan) -> None:
    """Fail unless all poses are within limits, at their holes and against their normals."""
    for each in found.stations:
        poses = np.array([pose_from_zyx(*row) for row in each.poses])
        back = inverse(CELL.layout.nominal_base(each.station.rail_mm))
        NominalRobot(ARM, CELL.robot.status, LIMITS, HOME).joints_for(back @ poses)
        numbers = [holes.names.index(name) for name in each.holes]
        np.testing.assert_allclose(poses[:, :3, 3], holes.points_mm[numbers], atol=1e-9)
        np.testing.assert_allclose(poses[:, :3, 2], holes.tools[numbers, 0, :, 2], atol=1e-9)


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
    drilled_against_normals(holes, found)


@settings(max_examples=5)
@given(seeds, st.integers(1, 30))
def test_no_fewer_stations_do(seed: int, count: int) -> None:
    holes = wall(seed, count)
    found = plan(CELL, holes)
    drilled_against_normals(holes, found)
    used = len(found.stations)
    able = np.array([[reaches(s, holes, n) for s in CELL.station] for n in range(count)])
    for subset in combinations(range(len(CELL.station)), used - 1):
        assert not able[:, subset].any(axis=1).all()


def test_the_turn_with_most_room_is_taken() -> None:
    holes = wall(3, 10, 800.0)
    reached = Reach(CELL, holes, CELL.station)
    back = inverse(CELL.layout.nominal_base(CELL.station[1].rail_mm))
    robot = NominalRobot(ARM, CELL.robot.status, LIMITS, HOME)
    for number in range(10):
        rooms = []
        for pose in holes.poses()[number]:
            if robot.reachable(back @ pose):
                joints = robot.joints_for(back @ pose)
                to_limits = np.minimum(joints - LIMITS[0], LIMITS[1] - joints).min()
                rooms.append(min(to_limits, abs(joints[4])))
            else:
                rooms.append(-1.0)
        assert reached.turn[number, 1] == int(np.argmax(rooms))


def test_stations_are_visited_along_the_rail_from_where_homing_leaves_the_slide() -> None:
    found = plan(CELL, wall(1, 60, 2400.0))
    rails = [each.station.rail_mm for each in found.stations]
    assert len(rails) >= 2
    assert rails == sorted(rails)
    assert found.travel_mm == sum(each.travel_mm for each in found.stations)
    assert found.travel_bound_mm <= found.travel_mm <= 1.05 * found.travel_bound_mm
    assert (ratio(0.0, 0.0), ratio(3.0, 2.0)) == (1.0, 1.5)
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


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 8), st.floats(0.1, 0.9))
def test_against_all_subsets(seed: int, holes: int, stations: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    ok = rng.random((holes, stations)) < share
    ok[np.arange(holes), rng.integers(0, stations, holes)] = True
    penalty = rng.random(stations)
    chosen = fewest(ok, penalty)
    covers = [
        subset
        for size in range(1, stations + 1)
        for subset in combinations(range(stations), size)
        if ok[:, subset].any(axis=1).all()
    ]
    size = min(len(subset) for subset in covers)
    assert len(chosen) == size
    assert ok[:, chosen].any(axis=1).all()
    lightest = min(penalty[list(subset)].sum() for subset in covers if len(subset) == size)
    assert penalty[chosen].sum() == pytest.approx(lightest, abs=1e-4)


def test_burden_never_buys_a_station() -> None:
    ok = np.array([[True, False, True], [False, True, True]])
    np.testing.assert_array_equal(fewest(ok, np.array([0.0, 0.0, 1.0])), [2])


def test_a_hole_reached_from_nowhere_is_refused() -> None:
    with pytest.raises(HilcellError, match="station"):
        fewest(np.array([[True, True], [False, False]]), np.zeros(2))


def holes_file(folder: Path, *, half_width_mm: float = 2400.0, x_mm: float = 0.0) -> Path:
    rng = np.random.default_rng(3)
    path = folder / "holes.csv"
    with path.open("w", encoding="utf-8") as file:
        print(",".join(NORMALS), file=file)
        for n in range(40):
            y, z = rng.uniform(-half_width_mm, half_width_mm), rng.uniform(700, 1500)
            print(f"H{n + 1},{x_mm},{y:.3f},{z:.3f},-1,0,0", file=file)
    return path


def test_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "--cell", "paper", str(holes_file(tmp_path)), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"stations", "travel_mm", "bound_mm", "ratio", "unreached"}
    assert found["unreached"] == []
    assert len(found["stations"]) >= 2
    for station in found["stations"]:
        assert {"name", "rail_mm", "holes", "travel_mm"} <= set(station)
        assert len(station["targets"]) == len(station["holes"])
    visited = [name for station in found["stations"] for name in station["holes"]]
    assert sorted(visited) == sorted(f"H{n + 1}" for n in range(40))
    assert 1.0 <= found["ratio"] <= 1.05
    assert found["ratio"] == pytest.approx(found["travel_mm"] / found["bound_mm"])


def test_table_and_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan.csv"
    assert main(["plan", str(holes_file(tmp_path)), "-o", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "S300" in shown
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["station", "order", "name"]
    assert {row["name"] for row in rows} == {f"H{n + 1}" for n in range(40)}
    for station in {row["station"] for row in rows}:
        orders = [int(row["order"]) for row in rows if row["station"] == station]
        assert orders == list(range(1, len(orders) + 1))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["holes.csv", "plan.csv"]


def test_unreachable_holes_exit_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan.csv"
    words = ["plan", str(holes_file(tmp_path, x_mm=4000.0)), "--json", "-o", str(out)]
    assert main(words) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "40 of 40" in shown.err
    assert "posture (robot.status = 6)" in shown.err
    assert shown.err.count("\n  H") == 10
    assert "metres" not in shown.err
    assert not out.exists()


METRES = [f"H{n},-0.1,{n / 1000},1.1,0,0,-1" for n in range(200)]


@pytest.mark.parametrize(
    ("rows", "words", "named"),
    [
        (["H1,1,2,3,0,0,0"], [], "line 2"),
        (METRES, [], "metres"),
        (["H1,0,0,1000,-1,0,0"], ["--cell", "papper"], "papper"),
        (["H1,0,0,1000,-1,0,0"], ["-o", "no/plan.csv"], "no"),
        (["H1,0,0,1000,-1,0,0"], ["-o", "holes.csv"], "holes.csv"),
        (["H1,0,0,1000,-1,0,0"], ["-o", "link.csv"], "link.csv"),  # of the holes
        (None, [], "holes.csv"),
    ],
    ids=["no normal", "metres", "cell", "no folder", "the holes", "a link to them", "no holes"],
)
def test_what_cannot_be_planned_or_written_exits_with_2(
    rows: list[str] | None, words: list[str], named: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    file, text = Path("holes.csv"), "\n".join([",".join(NORMALS), *(rows or [])])
    if rows is not None:
        file.write_text(text, "utf-8")
        Path("link.csv").symlink_to(file)
    assert main(["plan", str(file), *words]) == 2
    shown = capsys.readouterr().err
    assert named in shown
    assert len(shown.splitlines()) < 30
    assert rows is None or file.read_text("utf-8") == text
