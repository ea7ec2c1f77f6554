from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.spatialanalyzer import t2sa_points
from drivers.spatialanalyzer.t2sa_points import NamedPoints, main, points_of, read_points, written
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import forward

SEARCH_MM = 300.0


@pytest.fixture(scope="module")
def paper() -> NamedPoints:
    return points_of(load_cell("paper"), SEARCH_MM)


def test_the_nearest_direction_counts_at_any_range() -> None:
    points = NamedPoints(["near", "far"], np.array([[1000.0, 100.0, 0.0], [5000.0, 0.0, 0.0]]))
    name, xyz_mm, beside_mm = points.aim(np.array([1000.0, 10.0, 0.0]), 50.0)
    assert name == "far"
    assert beside_mm == pytest.approx(10.0, rel=1e-3)
    np.testing.assert_array_equal(xyz_mm, [5000, 0, 0])


def test_the_far_side_of_another_reflector_is_aimed_at() -> None:
    """Places in mm across, at 1 m."""
    across = {"left": -30.0, "middle": -4.0, "right": 30.0, "outer": 70.0}
    xyz_mm = np.array([[1000.0, y, 0.0] for y in across.values()])
    points = NamedPoints(list(across), xyz_mm)
    near_mm, beside_mm, behind_mm = np.array([[1000.0, 0, 0], [1000.0, -5, 0], [2000.0, 20, 0]])
    assert points.aim(near_mm, 60.0)[0] == "middle"
    assert points.aim(near_mm, 60.0, [beside_mm])[0] == "right"
    assert points.aim(near_mm, 60.0, [behind_mm])[0] in ("middle", "left")
    assert points.aim(near_mm, 60.0, [beside_mm, behind_mm])[0] == "middle"
    assert points.aim(near_mm, 20.0, [beside_mm])[0] == "middle"  # the others are too far


def test_every_place_of_a_cell_is_within_the_search(paper: NamedPoints) -> None:
    cell = load_cell("paper")
    T = inverse(cell.tracker.pose.matrix())
    rng = np.random.default_rng(7)
    low_rad, high_rad = cell.robot.margin_limits_rad
    reached = forward(cell.robot.arm(), rng.uniform(low_rad, high_rad, (400, 6)))[:, :3, 3]
    bases = [cell.layout.nominal_base(at) for at in rng.uniform(0, 3000, len(reached))]
    places = [apply(base, at_mm[None])[0] for base, at_mm in zip(bases, reached, strict=True)]
    slide = [nest.xyz_mm for nest in cell.layout.slide]
    places = [each for each in places if each[2] > 0]
    places += [nest.xyz_mm for nest in cell.layout.fixed_nests]
    places += list(apply(bases[0], np.array(slide)))
    for at_mm in apply(T, np.array(places)):
        if cell.tracker.min_range_mm <= np.linalg.norm(at_mm) <= cell.tracker.max_range_mm:
            assert paper.aim(at_mm, SEARCH_MM)[2] <= SEARCH_MM


def test_a_list_is_read_as_it_was_written(paper: NamedPoints, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(written(paper), "ascii")
    found = read_points(path)
    assert found.names == paper.names
    np.testing.assert_allclose(found.xyz_mm, paper.xyz_mm, atol=0.001)
    path.write_text("name,x,y,z\n" + written(paper), "utf-8-sig")
    assert read_points(path).names == paper.names
    assert [name for name, _ in found.spread(5)][::4] == [paper.names[0], paper.names[-1]]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", "expected 1"),
        ("P1,1,2\n", "line 1"),
        ("P1,1,2,3\nP2,1,2,nan\n", "line 2"),
        ("P1,1,2,inf\n", "line 1"),
        ("P1,0,0,0\n", "line 1"),  # no direction
        ("P;1,1,2,3\n", "line 1"),
        ("P1,1,2,3\nP1,4,5,6\n", "line 2"),
    ],
)
def test_bad_lists_are_refused_by_their_line(text: str, place: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text, "utf-8")
    with pytest.raises(SettingsError) as error:
        read_points(path)
    (problem,) = error.value.problems
    assert problem.startswith(place)


def test_the_command_writes_the_list(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(t2sa_points, "STEP_MM", 1000.0)
    path = tmp_path / "points.csv"
    assert main(["lab", str(path), "--search", "300"]) == 0
    assert str(len(read_points(path).names)) in capsys.readouterr().out
    for words in (["lab", str(path), "--search", "nan"], ["none", str(path)]):
        assert main(words) == 2
        assert capsys.readouterr().err
