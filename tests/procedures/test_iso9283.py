"""The pose test's commands: corrected by the tested calibration, at its speed, in its order."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hilcell.calibration.file import write_calibration
from hilcell.calibration.iso9283 import CYCLE, commanded_mm
from hilcell.cell.file import load_cell
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array
from procedures import iso9283
from procedures.iso9283 import PoseCycle
from tests.hilcell.calibration.calibrations import LOW_MM, PITCH_MM, calibration

CELL = load_cell("paper", {"iso9283.velocity_percent": "55"})
SIZE_MM = 1.2


def errors_mm(at_mm: Array) -> Array:
    """Return the errors (N, 3) that `calibrations.field_mm` states on its grid, which is linear."""
    x, y, z = ((at_mm - LOW_MM) / PITCH_MM - 1.0).T
    return SIZE_MM * np.stack([0.5 + 0.2 * y, -0.4 + 0.1 * z, 0.6 - 0.2 * x], axis=1)


def test_a_calibration_is_tested_by_poses_that_it_has_corrected(tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    write_calibration(calibration(SIZE_MM), file)
    cell = load_cell("paper", {"iso9283.calibration": str(file)})
    wanted_mm = np.array([commanded_mm(cell)[name] for name in CYCLE])
    as_it_is, corrected = (
        forward(cell.robot.arm(), PoseCycle.commands_rad(cell, calibrated))[:, :3, 3]
        for calibrated in (False, True)
    )
    np.testing.assert_allclose(as_it_is, wanted_mm, atol=1e-6)
    np.testing.assert_allclose(corrected + errors_mm(corrected), wanted_mm, atol=1e-4)


def test_the_ways_that_are_checked_are_those_that_are_driven(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    checked: list[tuple[Array, Array]] = []
    monkeypatch.setattr(
        iso9283, "check_planned_path", lambda *found: checked.append((found[2], found[3]))
    )
    PoseCycle().plan(CELL, 1)
    ((before_rad, joints_rad),) = checked
    driven = driven_by(monkeypatch, visits=2 * len(CYCLE))
    for n, (_, straight, to_rad) in enumerate(driven):
        place = n % len(CYCLE)
        np.testing.assert_array_equal(straight.from_rad, before_rad[place])
        np.testing.assert_array_equal(to_rad, joints_rad[place])
    for (_, _, to_rad), (_, straight, _) in pairwise(driven):
        np.testing.assert_array_equal(to_rad, straight.from_rad)


def test_it_drives_at_the_speed_of_the_test(monkeypatch: pytest.MonkeyPatch) -> None:
    assert CELL.robot.speed_percent != 55.0
    assert {each.speed_percent for _, each, _ in driven_by(monkeypatch, visits=5)} == {55.0}


def driven_by(monkeypatch: pytest.MonkeyPatch, visits: int) -> list[Any]:
    """Return the first visits of a test: names of poses, ways, joints."""

    class Enough(Exception):
        pass

    found: list[Any] = []

    def flange_point(id: Any, _station: Any, joints_rad: Array, **more: Any) -> None:
        found.append((id.pose, more["straight"], joints_rad))
        if len(found) == visits:
            raise Enough

    session: Any = SimpleNamespace(
        cell=CELL,
        log=None,
        flange_point=flange_point,
        frames=SimpleNamespace(base_in_world=lambda _: np.eye(4)),
    )
    monkeypatch.setattr(iso9283, "calibration_in", lambda _: None)
    with pytest.raises(Enough):
        PoseCycle().perform(session)
    return found
