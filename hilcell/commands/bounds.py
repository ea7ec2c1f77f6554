"""The 95 % bounds of corrected targets, for ``compensate``: a line of summary, and a file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from hilcell.calibration.bounds import target_bounds
from hilcell.calibration.budget import with_drill
from hilcell.calibration.form import Calibration
from hilcell.calibration.influence import Bounds, NoBound
from hilcell.calibration.orientation import turn_bounds_deg
from hilcell.calibration.tip import Tip
from hilcell.commands.output_place import CSV, check_output
from hilcell.compensation.targets import write_rows
from hilcell.geometry.frames import poses_from_zyx
from hilcell.ports import Array
from hilcell.writing import NotWritten

HEADER = ["name", "bound95_mm", "u_x_mm", "u_y_mm", "u_z_mm"]

TURN = "bound95_deg"  # where the calibration corrects orientation

Found = Bounds | NoBound  # the reason where no bound can be stated


def bounds_of_targets(
    calibration: Calibration,
    station: str,
    targets: Array,
    temperature_c: float | None,
    tip: Tip,
    drill_offset_mm: tuple[float, float, float] | None = None,
) -> Found:
    """Return the bounds of corrected targets (N, 6) in {W} of a tip, or why there are none.

    ``drill_offset_mm`` takes the place of that of the calibration where the tip is the reflector.
    """
    try:
        stated = calibration.uncertainty
        if tip.table is not None:
            x_mm, y_mm, z_mm = tip.lever_mm.tolist()
            drill_offset_mm = (x_mm, y_mm, z_mm)
        if drill_offset_mm is not None and not stated.missing:
            turns_deg = turns_of_targets(calibration, station, targets, tip)
            stated = with_drill(stated, drill_offset_mm, tip.u_mm, turns_deg)
            calibration = msgspec.structs.replace(calibration, uncertainty=stated)
        seen = poses_from_zyx(targets) @ tip.T_D_T
        return target_bounds(calibration, station, seen, temperature_c)
    except NoBound as reason:
        return reason


def turns_of_targets(
    calibration: Calibration, station: str, targets: Array, tip: Tip
) -> Array | None:
    """Return the bounds (N,) of orientation, in deg, of corrected targets (N, 6) in {W} of a tip.

    None where the calibration corrects positions only, or where no bounds can be stated.
    """
    try:
        return turn_bounds_deg(calibration, station, poses_from_zyx(targets) @ tip.T_D_T)
    except NoBound:
        return None


def summary(found: Found, names: Sequence[str], turns_deg: Array | None = None) -> str:
    """Return median and largest bound in one line, or why there are none.

    ``turns_deg`` (N,) are the bounds of orientation, where it is corrected.
    """
    if isinstance(found, NoBound):
        return str(found)
    radii_mm = found.radii_mm
    worst = int(np.argmax(radii_mm))
    words = (
        f"95 % bounds of the corrected targets: median {np.median(radii_mm):.3f} mm, largest "
        f"{radii_mm[worst]:.3f} mm at {names[worst]}"
    )
    if turns_deg is None:
        return words
    middle_deg = float(np.median(turns_deg))
    sizes = f"{middle_deg:.4f} and {turns_deg.max():.4f} deg (true; a measured angle has the "
    sizes += "readings' noise, too)"
    return f"{words}; of their orientation, as the reflectors define it: {sizes}"


def write_bounds(
    path: Path,
    found: Found,
    names: Sequence[str],
    out: Path,
    *,
    inputs: Iterable[Path],
    turns_deg: Array | None = None,
) -> None:
    """Write a row a target: its bound, u of its coordinates in {W}, and the bound (N,) of its
    orientation where that is corrected.

    ``out`` is where the targets are written. Raises `NoBound`, and `NotWritten` as `write_whole`
    does.
    """
    if isinstance(found, NoBound):
        raise found
    if os.path.realpath(path) == os.path.realpath(out):
        raise NotWritten(f"{path} is where the corrected targets go; name another file of bounds")
    read = list(inputs)
    check_output(path, CSV, "a list", inputs=read)
    u_mm = np.sqrt(np.diagonal(found.covariance_mm2, axis1=1, axis2=2))
    rows = [
        [name, f"{bound:.4f}", *(f"{each:.4f}" for each in u)]
        for name, bound, u in zip(names, found.radii_mm, u_mm, strict=True)
    ]
    if turns_deg is None:
        write_rows(path, HEADER, rows, inputs=read)
        return
    turned = [[*row, f"{deg:.5f}"] for row, deg in zip(rows, turns_deg, strict=True)]
    write_rows(path, [*HEADER, TURN], turned, inputs=read)
