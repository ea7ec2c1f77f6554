"""Whether a robot program agrees with a calibration: the base that it sets, and its strokes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hilcell.calibration.form import Calibration
from hilcell.compensation.grid import ROUNDING_MM, OutsideGrid
from hilcell.compensation.programs import StatedBase, Stroke
from hilcell.geometry.frames import apply, inverse, pose_from_zyx, poses_from_zyx, zyx_from_pose
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import Array, HilcellError

STROKE_CHANGE_MM = 0.05  # by which the end of a stroke may be missed
BASE_MM = 0.05  # at the targets: numbers of a program are rounded
NAMED = 5


class StrokeError(HilcellError):
    """Strokes over which the correction of the point before them does not hold."""

    code = "HC-C10"


class BaseError(HilcellError):
    """A program whose base is not the frame of its targets."""

    code = "HC-C10"


def check_base(
    calibration: Calibration, station: str, stated: StatedBase | None, targets: Array
) -> None:
    """Raise `BaseError` where a program sets a base by numbers that is not {W} at the station.

    ``stated`` is None where it sets none by numbers. A controller's base is relative to its own
    root, {B}, so {W} is the inverse of the calibrated T_W_B. Judged where ``targets`` (N, 6) would
    stand.
    """
    if stated is None:
        return
    wanted = inverse(np.array(calibration.stations[station].T_W_B))
    places = targets[:, :3]
    off_mm = lengths_mm(apply(pose_from_zyx(*stated.values), places) - apply(wanted, places))
    worst = float(off_mm.max())
    if not worst <= BASE_MM:
        numbers = zyx_from_pose(wanted[None])[0]
        words = ",".join(
            f"{axis} {value:.4f}" for axis, value in zip("XYZABC", numbers, strict=True)
        )
        raise BaseError(
            f"{stated.where}: the base set there is not the world frame {{W}} of the targets at "
            f"{station}: it puts them up to {worst:.3f} mm elsewhere, wanted <= {BASE_MM:g} mm; "
            f"set {{{words}}}, as calibrated, and take the targets in {{W}}"
        )


def check_strokes(
    calibration: Calibration,
    station: str,
    targets: Array,
    command: Array,
    strokes: Sequence[Stroke],
    longest_mm: float,
) -> float:
    """Return by how far the end of a stroke is missed at most, mm; 0 without strokes.

    A stroke keeps the correction of the target before it, so its end is missed by as much as the
    error there differs from that at the target, and where angles are corrected by as much as the
    stroke is turned with them. By the calibration's model, asked at both nominal ends, that may be
    `STROKE_CHANGE_MM` (0.05 mm). ``targets`` (N, 6) are nominal, ``command`` (N, 6) corrected, in
    {W}. Raises `StrokeError` naming the strokes that are longer than ``longest_mm``, end outside of
    the calibrated volume, or miss their end by more.
    """
    if not strokes:
        return 0.0
    shifts_mm = np.array([each.shift_mm for each in strokes])
    names, at = [each.where for each in strokes], [each.target for each in strokes]
    _refuse(
        lengths_mm(shifts_mm), longest_mm + ROUNDING_MM, names, "lead away from their point",
        "shorten them, or declare their length with --allow-stroke MM",
    )  # fmt: skip
    starts = targets[at]
    ends = starts.copy()
    ends[:, :3] += shifts_mm
    T_B_W = inverse(np.array(calibration.stations[station].T_W_B))
    from_poses, to_poses = (T_B_W @ poses_from_zyx(each) for each in (starts, ends))
    try:
        calibration.grid().check_inside(to_poses[:, :3, 3], names)
    except OutsideGrid as error:
        raise StrokeError(f"strokes that end outside: {error}") from error
    model = calibration.error_model()
    change_mm = model.predict(to_poses).error_mm - model.predict(from_poses).error_mm
    wanted_mm = to_poses[:, :3, 3] - from_poses[:, :3, 3]
    turned = (T_B_W @ poses_from_zyx(command[at]))[:, :3, :3]
    along_mm = np.einsum("nji,nj->ni", from_poses[:, :3, :3], wanted_mm)  # in the tool's frame
    sent_mm = np.einsum("nij,nj->ni", turned, along_mm)
    missed_mm = lengths_mm(sent_mm + change_mm - wanted_mm)
    _refuse(
        missed_mm, STROKE_CHANGE_MM, names, "miss their end",
        "shorten them, or state their end as a point, which is corrected by itself",
    )  # fmt: skip
    return float(missed_mm.max())


def _refuse(found_mm: Array, most_mm: float, names: Sequence[str], what: str, act: str) -> None:
    bad = np.flatnonzero(~(found_mm <= most_mm))
    if len(bad):
        named = "\n".join(f"  {names[n]}: {found_mm[n]:.3f} mm" for n in bad[:NAMED])
        more = "\n  ..." if len(bad) > NAMED else ""
        raise StrokeError(
            f"{len(bad)} of {len(names)} strokes {what} by more than {most_mm:.6g} mm; {act}\n"
            f"{named}{more}"
        )
