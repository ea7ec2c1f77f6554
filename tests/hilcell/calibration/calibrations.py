"""Calibrations made without a run: a known error field on a small grid."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import msgspec
import numpy as np

from hilcell.calibration.decision_rule import Guard, decide, tolerance_limits
from hilcell.calibration.file import SCHEMA, Calibration, LostMotion, ModelEntry, Validity
from hilcell.calibration.influence import ASSUMED, MEASURED, Influence, UncertaintyBudget, motion
from hilcell.cell.file import load_cell
from hilcell.compensation.grid import Grid
from hilcell.compensation.model import Measured, StaticPoses
from hilcell.compensation.model_choice import MODELS
from hilcell.geometry.frames import pose_from_zyx
from hilcell.model.calibration import Device, Provenance, StationEntry
from tests.hilcell.compensation import models
from tests.hilcell.verdicts import FITTED

LOW_MM = np.array([1400.0, -450.0, 500.0])
PITCH_MM = 450.0
SHAPE = (3, 3, 3)
T_W_B = pose_from_zyx(-1850.0, -3.0, 300.0, 0.02, 0.1, -0.06)
LIMITS = tolerance_limits(load_cell("paper"))
STAMP = "%Y-%m-%dT%H:%M:%SZ"


def field_mm(size_mm: float) -> Any:
    """Return errors (3, 3, 3, 3) in {B}: about ``size_mm``, linear in the place."""
    x, y, z = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in SHAPE), indexing="ij")
    return size_mm * np.stack([0.5 + 0.2 * y, -0.4 + 0.1 * z, 0.6 - 0.2 * x], axis=-1)


READINGS_MM2 = 0.005**2 * np.eye(3)
REPEATABILITY_MM = 0.02


def measured(size_mm: float = 1.2) -> Measured:
    """Return that field on its grid, as read with 5 um of noise."""
    grid, errors_mm = Grid(LOW_MM, PITCH_MM, SHAPE), field_mm(size_mm)
    lattice = models.lattice(grid, errors_mm, READINGS_MM2)
    at, error_mm = models.level(grid.vertices_mm().reshape(-1, 3)), errors_mm.reshape(-1, 3)
    joints_rad = np.arange(len(at))[:, None] * np.ones(6)
    own_mm2 = lattice.covariance_mm2.reshape(-1, 3, 3)
    return Measured(StaticPoses.of(joints_rad, at, error_mm, own_mm2), lattice)


def calibration(
    size_mm: float = 1.2, *, method: str = "trilinear", **provenance: Any
) -> Calibration:
    """Return a calibration written now, its sign checked, of a real cell."""
    made = Provenance(
        "20261101-120000-calibrate-abcd",
        "paper",
        "d" * 64,
        False,
        "",
        "",
        "hilcell 0",
        f"{datetime.now(UTC):{STAMP}}",
        True,
        {"hilcell": "0"},
        [Device("tracker", "a tracker", "T-1", "tracker", "", "")],
        ["grid/0-0-0"],
        FITTED.loocv,
    )
    uncertainty = UncertaintyBudget(
        [
            Influence("Robot repeatability", MEASURED, "visits", "4.2.4", "base",
                      motion(REPEATABILITY_MM**2), freedom=60.0),
            Influence("SMR centring", ASSUMED, "limit", "4.3.7", "world", motion(0.007**2),
                      applies="in use"),
        ],
        {"S1100": []}, 10e-6, 4.0,
    )  # fmt: skip
    high_mm = LOW_MM + PITCH_MM * (np.array(SHAPE) - 1)
    entry = StationEntry(T_W_B.tolist(), np.eye(4).tolist(), np.eye(6).tolist(), 0.01, 1100.0)
    values = {
        "schema": SCHEMA,
        "provenance": msgspec.structs.replace(made, **provenance),
        "validity": Validity(
            tuple(LOW_MM.tolist()),
            tuple(high_mm.tolist()),
            pose_from_zyx(0, 0, 0, 0, 75, 0)[:3, :3].tolist(),
            2.0,
            (22.0, 23.0),
        ),
        "stations": {"S1100": entry},
        "pitch_mm": PITCH_MM,
        "grid_errors_mm": field_mm(size_mm).tolist(),
        "model": ModelEntry(method, MODELS[method].learn(measured(size_mm)).parameters()),
        "uncertainty": uncertainty,
        "lost_motion": LostMotion([0.0] * 6, [0.0] * 6, measured=True),
        "failed": {},
        "verdicts": {"S1100": decide(0.03, 0.09, LIMITS, Guard(0.04, 0.05))},
    }
    return msgspec.convert(msgspec.to_builtins(values), Calibration)
