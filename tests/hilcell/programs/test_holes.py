"""Holes CSV: both forms, orientations that fit the normals, every problem with its line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import HEADER
from hilcell.geometry.frames import pose_from_zyx
from hilcell.programs import holes as module
from hilcell.programs.holes import NORMALS, TOOL_ROTATIONS, Holes, read_holes, tools_against


def file_of(folder: Path, *lines: str) -> Path:
    path = folder / "holes.csv"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def file_problems(path: Path) -> list[str]:
    with pytest.raises(SettingsError) as raised:
        read_holes(path)
    return raised.value.problems


def test_holes_with_normals(tmp_path: Path) -> None:
    holes = read_holes(
        file_of(tmp_path, ",".join(NORMALS), "H1,1,2,3,-2,0,0", "", "H2,4,5,6,0,0,1")
    )
    assert holes.names == ["H1", "H2"]
    np.testing.assert_array_equal(holes.points_mm, [[1, 2, 3], [4, 5, 6]])
    poses = holes.poses()
    assert poses.shape == (2, TOOL_ROTATIONS, 4, 4)
    np.testing.assert_array_equal(poses[1, 5, :3, 3], [4, 5, 6])
    np.testing.assert_allclose(
        poses[0, :, :3, 2], np.tile([1.0, 0, 0], (TOOL_ROTATIONS, 1)), atol=1e-15
    )
    np.testing.assert_allclose(
        poses[1, :, :3, 2], np.tile([0, 0, -1.0], (TOOL_ROTATIONS, 1)), atol=1e-15
    )


def test_targets_keep_their_whole_orientation(tmp_path: Path) -> None:
    holes = read_holes(file_of(tmp_path, ",".join(HEADER), "H1,1,2,3,10,75,-5"))
    assert holes.tools.shape == (1, 1, 3, 3)
    np.testing.assert_allclose(holes.poses()[0, 0], pose_from_zyx(1, 2, 3, 10, 75, -5), atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_tools_are_right_handed_and_turn_evenly(seed: int) -> None:
    normals = np.random.default_rng(seed).normal(0, 1, (4, 3))
    normals[0] = np.eye(3)[seed % 3] * 7.0
    tools = tools_against(normals)
    np.testing.assert_allclose(np.linalg.det(tools), 1.0)
    np.testing.assert_allclose(
        tools @ np.swapaxes(tools, -1, -2), np.broadcast_to(np.eye(3), tools.shape), atol=1e-12
    )
    along = np.einsum("nki,ni->nk", tools[..., 2], normals)
    np.testing.assert_allclose(
        along, -np.linalg.norm(normals, axis=1)[:, None] * np.ones(TOOL_ROTATIONS)
    )
    step = np.einsum("nki,nki->nk", tools[..., 0], np.roll(tools[..., 0], 1, axis=1))
    np.testing.assert_allclose(step, np.cos(2 * np.pi / TOOL_ROTATIONS))


def test_all_problems_are_reported_with_their_lines(tmp_path: Path) -> None:
    path = file_of(
        tmp_path, ",".join(NORMALS), "H1,1,2,3,-1,0,0", "H1,1,2,3,-1,0,0", "H2,1,2,3,0,0,0",
        "H3,nan,2,3,1,0,0", "H4,1,2,3,0,0,inf", "H5,1,2,3,1e-9,0,0", "H6,1,2,3,1,0",
        "H7,1,b,3,1,0,0", ",1,2,3,1,0,0", "H8,1_0,2,3,1,0,0",
    )  # fmt: skip
    found = file_problems(path)
    assert [line.split(":")[0] for line in found] == [f"line {n}" for n in range(3, 12)]
    assert file_problems(file_of(tmp_path, ",".join(NORMALS))) == ["no holes"]


def test_other_headers_are_refused(tmp_path: Path) -> None:
    for header in ("name,x_mm,y_mm,z_mm", "x,y,z,nx,ny,nz", ""):
        (problem,) = file_problems(file_of(tmp_path, header))
        assert ",".join(NORMALS) in problem
        assert ",".join(HEADER) in problem


def test_too_many_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_HOLES", 2)
    lines = [f"H{n},1,2,3,1,0,0" for n in range(3)]
    (problem,) = file_problems(file_of(tmp_path, ",".join(NORMALS), *lines))
    assert problem.startswith("3 holes")


@pytest.mark.parametrize(("off_mm", "told"), [(0.0, 1), (0.001, 1), (0.2, 0)])
def test_holes_nearer_than_a_bound_tells_apart(tmp_path: Path, off_mm: float, told: int) -> None:
    path = file_of(
        tmp_path, ",".join(NORMALS), "H1,1,2,3,-1,0,0", "H9,1,2,3,1,0,0",
        f"h1,{1 + off_mm},2,3,-1,0,0",
    )  # fmt: skip
    warnings = read_holes(path).twins
    assert len(warnings) == told
    assert all("h1" in warning and "H1" in warning for warning in warnings)


def test_the_turn_nearest_to_an_orientation() -> None:
    """It is turned by no more than the angle between the axes, and opposite axes add nothing."""
    R = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z along x
    normals = np.array([[-1.0, 0.0, 0.0], [-1.0, 0.02, 0.0], [1.0, 0.0, 0.0]])
    holes = Holes(["A", "B", "C"], np.zeros((3, 3)), tools_against(normals))
    found = holes.with_rotation_near(R).tools
    assert found.shape[1] == holes.tools.shape[1] + 1
    z = -normals / np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(found[:, -1, :, 2], z, atol=1e-12)
    cosine = (np.einsum("nij,ij->n", found[:, -1], R) - 1) / 2
    np.testing.assert_allclose(np.arccos(np.clip(cosine[:2], -1, 1)), [0.0, 0.02], atol=1e-5)
    fixed = Holes(["A"], np.zeros((1, 3)), R[None, None])
    assert fixed.with_rotation_near(np.eye(3)) is fixed
