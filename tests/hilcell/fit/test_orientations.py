"""Orientations read in another convention than their list's are named, whatever their weights."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hilcell.fit.measurements import Measurements, rotations
from hilcell.fit.methods import fit_robot
from hilcell.fit.placement import FitError
from hilcell.geometry.frames import from_rotvec, matrix, to_rotvec, zyx_from_pose
from hilcell.geometry.kinematics import Array, forward
from tests.hilcell.fit.test_fit import IRB120, T_L_B, crooked_arm, measured

KINDS = {
    "abc": "Z-Y-X angles",
    "rpy": "roll, pitch, yaw",
    "vector": "rotation vector",
    "quaternion": "quaternion",
}


def columns(kind: str, R: Array) -> Array:
    """The columns of rotations (N, 3, 3), in rad."""
    vector = to_rotvec(R)
    abc = np.radians(zyx_from_pose(matrix(R, np.zeros(3)))[:, 3:])
    half = np.linalg.norm(vector, axis=1)[:, None] / 2.0
    quaternion = np.hstack([np.cos(half), np.sinc(half / np.pi) * vector / 2.0])
    return {"abc": abc, "rpy": abc[:, ::-1], "vector": vector, "quaternion": quaternion}[kind]


def oriented(
    given: str, read: str, change: Callable[[Array], Array] = lambda v: v, *, inverse: bool = False
) -> Measurements:
    """Poses whose orientations are given as one kind, changed, and read as another."""
    rows = measured(1, 30, ["SMR1"])
    R = (T_L_B @ forward(crooked_arm(), rows.joints_rad))[:, :3, :3] @ from_rotvec([0.3, -1.0, 0.5])
    R = R @ from_rotvec(np.random.default_rng(2).normal(0.0, 1e-4, (30, 3)))
    values = change(columns(given, np.swapaxes(R, 1, 2) if inverse else R))
    return replace(rows, R=rotations(KINDS[read], values), turns=values)


@pytest.mark.parametrize("kind", KINDS)
def test_a_convention_is_read_back(kind: str) -> None:
    rows = oriented(kind, kind)
    assert rows.R is not None
    rows.R[::5] = np.nan  # not all poses have one
    assert fit_robot(IRB120, rows).result["train"] == 30


@pytest.mark.parametrize("u_rad", [None, 1e-4])
@pytest.mark.parametrize(
    ("rows", "named"),
    [
        (oriented("abc", "rpy"), r"columns a, b, c:"),
        (oriented("rpy", "abc"), r"columns roll, pitch, yaw:"),
        (oriented("abc", "vector"), r"columns a, b, c:"),
        (oriented("vector", "abc"), r"rotation vectors:"),
        (oriented("vector", "vector", np.degrees), r"rotation vectors in deg:"),
        (oriented("rpy", "rpy", np.radians), r"roll, pitch, yaw in rad:"),
        (oriented("quaternion", "quaternion", lambda v: np.roll(v, -1, axis=1)), "qx, qy, qz, qw:"),
        (oriented("abc", "abc", inverse=True), "a, b, c, of the tracker in the body's frame:"),
    ],
)
def test_the_convention_that_fits_is_named(
    rows: Measurements, named: str, u_rad: float | None
) -> None:
    told = rows if u_rad is None else replace(rows, u_rad=np.full(30, u_rad))
    with pytest.raises(FitError, match=f"they fit if they are .*{named}"):
        fit_robot(IRB120, told)


def test_orientations_of_other_poses_are_refused() -> None:
    rows = oriented("abc", "abc")
    assert rows.R is not None
    with pytest.raises(FitError, match=r"expected <= 2 deg; .*no unit"):
        fit_robot(IRB120, replace(rows, R=rows.R[::-1], turns=None))


def test_orientations_that_scatter_without_uncertainty_are_refused() -> None:
    rows = oriented("abc", "abc")
    assert rows.R is not None
    wrong = rows.R @ from_rotvec(np.random.default_rng(3).normal(0.0, np.radians(4.0), (30, 3)))
    with pytest.raises(FitError, match="expected <= 2 deg"):
        fit_robot(IRB120, replace(rows, R=wrong, turns=None))


@pytest.mark.parametrize(
    ("sequence", "named"),
    [("ZXZ", "Rz Rx Rz of the columns in order"), ("zxy", "Ry Rx Rz of the columns in reverse")],
)
def test_any_order_of_angles_is_named(sequence: Literal["ZXZ", "zxy"], named: str) -> None:
    rows = oriented("abc", "abc")
    assert rows.R is not None
    angles = Rotation.from_matrix(rows.R).as_euler(sequence)
    with pytest.raises(FitError, match=f"they fit if they are {named}"):
        fit_robot(IRB120, replace(rows, R=rotations("Z-Y-X angles", angles), turns=angles))
