"""A format of robot programs that is no format is refused in words."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.settings import SettingsError
from hilcell.compensation import programs
from hilcell.compensation.programs import Stroke
from hilcell.geometry.frames import from_rotvec, matrix, pose_from_zyx, zyx_from_pose
from hilcell.programs.target_jobs import StrokeError, StrokeLimits, check_strokes
from tests.hilcell.calibration.calibrations import T_W_B, calibration


def test_a_format_that_reads_no_program_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "load_entry", lambda _group, _name: lambda _path: ["P1"])
    with pytest.raises(SettingsError, match=r"format 'src': expected a .*\.Program, got list"):
        programs.load_program(Path("part.src"))


MADE = calibration()
POSE = T_W_B @ pose_from_zyx(1850.0, 0.0, 950.0, 0.0, 75.0, 0.0)
LENGTH_MM = 20.0
ALONG = POSE[:3, 2]
ANY = StrokeLimits(LENGTH_MM, math.inf, "")


def stroke(shift_mm: np.ndarray, from_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Stroke:
    return Stroke("XP1", 0, tuple(shift_mm.tolist()), from_mm)


def test_a_stroke_turns_with_the_corrected_tool() -> None:
    """Turned by as much as the errors change on its way, it keeps its line."""
    shift_mm = LENGTH_MM * ALONG
    dx, dy, dz = T_W_B[:3, :3].T @ shift_mm
    change_mm = T_W_B[:3, :3] @ (1.2 / 450.0 * np.array([0.2 * dy, 0.1 * dz, -0.2 * dx]))
    across_mm = change_mm - (change_mm @ ALONG) * ALONG
    turn = from_rotvec(np.cross(ALONG, -across_mm) / LENGTH_MM)
    nominal = zyx_from_pose(POSE[None])
    command = zyx_from_pose(matrix(turn @ POSE[:3, :3], POSE[:3, 3])[None])
    as_it_is = check_strokes(MADE, "S1100", nominal, nominal, [stroke(shift_mm)], ANY)
    turned = check_strokes(MADE, "S1100", nominal, command, [stroke(shift_mm)], ANY)
    assert as_it_is.across_mm == pytest.approx(np.linalg.norm(across_mm), rel=1e-3)
    assert turned.across_mm < 0.01 * as_it_is.across_mm


def test_a_stroke_is_measured_from_its_point() -> None:
    """Two strokes of half the length, one after the other, lead as far as one."""
    nominal = zyx_from_pose(POSE[None])
    half = tuple((0.5 * LENGTH_MM * ALONG).tolist())
    second = stroke(LENGTH_MM * ALONG, half)
    limits = StrokeLimits(LENGTH_MM - 0.1, math.inf, "")
    with pytest.raises(StrokeError, match="XP1"):
        check_strokes(MADE, "S1100", nominal, nominal, [second], limits)
    check_strokes(MADE, "S1100", nominal, nominal, [second], ANY)
