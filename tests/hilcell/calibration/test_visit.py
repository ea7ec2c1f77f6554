"""A motion is the same whichever frame it is stated in; folded targets are kept by the file."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.file import (
    Calibration,
    TargetPass,
    Targets,
    compensate_targets,
    read_calibration,
    write_calibration,
)
from hilcell.calibration.influence import Influence
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import apply, inverse, motion_levers, pose_from_zyx, zyx_from_pose
from tests.hilcell.calibration.calibrations import T_W_B, calibration

TARGET = np.array([[0.0, 0.0, 1200.0, 0.0, 75.0, 0.0]])


def test_a_motion_is_carried_to_another_frame() -> None:
    rng = np.random.default_rng(1)
    half = rng.standard_normal((7, 7)) * np.array([0.1] * 3 + [1e-4] * 3 + [1e-5])
    own = pose_from_zyx(100, -200, 300, 10, 20, 30)
    line = Influence(
        "", "", "", "", "world", (half.T @ half).tolist(), origin_mm=(50.0, -700.0, 20.0)
    )
    at_mm = rng.uniform(-2000, 2000, (5, 3))
    J = motion_levers(apply(inverse(T_W_B), at_mm))
    R = T_W_B[:3, :3]
    carried = R @ J @ line.about(own, T_W_B) @ np.swapaxes(J, -1, -2) @ R.T
    np.testing.assert_allclose(carried, line.at(own, at_mm), rtol=1e-9)


def with_targets(**change: Any) -> Calibration:
    """Return a calibration with one target folded in, 0.03 mm along x of {B} all its error."""
    made = calibration()
    command = compensate_targets(made, "S1100", TARGET, ["H1"])
    pose = inverse(T_W_B) @ pose_from_zyx(*command[0])
    values: dict[str, Any] = {
        "run": "R",
        "names": ["H1"],
        "poses": [tuple(zyx_from_pose(pose).tolist())],
        "residuals_mm": [(0.03, 0.0, 0.0)],
        "own_mm2": [(1e-10 * np.eye(3)).tolist()],
        "common": np.zeros((7, 7)).tolist(),
    }
    folded = Targets(0.05**2, [TargetPass(**(values | change))])
    return msgspec.structs.replace(made, targets=folded)


def test_a_folded_target_moves_its_command_alone(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(with_targets(), path)
    both = np.vstack([TARGET, TARGET + [0.0, 100.0, 0.0, 0.0, 0.0, 0.0]])
    before = compensate_targets(calibration(), "S1100", both, ["H1", "H2"])
    after = compensate_targets(read_calibration(path), "S1100", both, ["H1", "H2"])
    moved = (after - before)[:, :3] @ T_W_B[:3, :3]
    np.testing.assert_allclose(moved, [[-0.03, 0.0, 0.0], [0.0, 0.0, 0.0]], atol=5e-5)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"poses": []}, "poses"),
        ({"residuals_mm": [(float("1e9"), 0.0, 0.0)]}, "remainders_mm"),
        ({"own_mm2": [np.zeros((3, 3)).tolist()]}, "variance"),
        ({"common": np.eye(6).tolist()}, "common"),
    ],
)
def test_a_damaged_pass_is_refused(tmp_path: Path, change: dict[str, Any], named: str) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(with_targets(**change), path)
    with pytest.raises(SettingsError, match=named):
        read_calibration(path)
