"""A pose as the cell file states it."""

from __future__ import annotations

import tomllib

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.tables import Pose
from hilcell.geometry.frames import pose_from_zyx

lengths_mm, angles_deg = st.floats(-1e5, 1e5), st.floats(-180.0, 180.0)


@given(st.tuples(*[lengths_mm] * 3), st.tuples(*[angles_deg] * 3))
def test_a_measured_pose_is_read_back_from_a_cell_file(
    xyz_mm: tuple[float, ...], zyx_deg: tuple[float, ...]
) -> None:
    T = pose_from_zyx(*xyz_mm, *zyx_deg)
    read = msgspec.convert(tomllib.loads(f"pose = {Pose.of(T).toml}")["pose"], Pose)
    off_mm, off_deg = read.off(T)
    assert off_mm < 0.001
    assert off_deg < 0.0001


@pytest.mark.parametrize("turn_deg", [0.0, 1e-3, 90.0, 179.9, 180.0])
def test_how_far_a_frame_is_from_a_pose(turn_deg: float) -> None:
    pose = Pose(x_mm=100.0, y_mm=-50.0, z_mm=7.0, a_deg=30.0)
    T = pose.matrix() @ pose_from_zyx(3.0, 4.0, 0.0, 0.0, 0.0, turn_deg)
    assert pose.off(T) == pytest.approx((5.0, turn_deg), abs=1e-5)
    T[0, 0] = np.nan
    assert not pose.off(T)[1] <= 180.0
