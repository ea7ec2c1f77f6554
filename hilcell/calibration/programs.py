"""Whether a robot program agrees with a calibration: the base that it sets, and its strokes."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, isnan
from typing import NamedTuple

import numpy as np

from hilcell.calibration.form import Calibration
from hilcell.calibration.tip import AT_REFLECTOR, Tip
from hilcell.cell.file import Station
from hilcell.compensation.grid import ROUNDING_MM, OutsideGrid
from hilcell.compensation.programs import Program, StatedBase, Stroke, stands_in_root
from hilcell.errors import bounded
from hilcell.geometry.frames import apply, inverse, pose_from_zyx, poses_from_zyx, zyx_from_pose
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import Array, HilcellError

STEP_MM = 1.0  # between places of a stroke where the model is asked
POSTURE_BITS = 7  # of a status: behind axis 1, elbow, wrist; the others are no posture


class StrokeError(HilcellError):
    """Strokes over which the correction of the point before them does not hold."""

    code = "HC-C10"


class PostureError(HilcellError):
    """Targets in another posture of the arm than the calibrated one."""

    code = "HC-C10"


class SlideError(HilcellError):
    """A program that moves the slide elsewhere than to the station it is corrected for."""

    code = "HC-C10"


class BaseError(HilcellError):
    """A program whose base is not the frame of its targets."""

    code = "HC-C10"


def root_of(calibration: Calibration, station: str, program: Program | None) -> Array | None:
    """Return {B} in {W} (4, 4) at the station where a program's targets stand in {B}, else None."""
    if not stands_in_root(program) or station not in calibration.stations:
        return None
    return np.array(calibration.stations[station].T_W_B)


def taken_in(T: Array | None, values: Array) -> Array:
    """Return targets (N, 6) of the frame ``T``; None leaves them, to the last digit."""
    return values if T is None else zyx_from_pose(T @ poses_from_zyx(values))


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
    base_mm = 0.05  # at the targets: numbers of a program are rounded
    if not worst <= base_mm:
        numbers = zyx_from_pose(wanted[None])[0]
        words = ",".join(
            f"{axis} {value:.4f}" for axis, value in zip("XYZABC", numbers, strict=True)
        )
        raise BaseError(
            f"{stated.where}: the base set there is not the world frame {{W}} of the targets at "
            f"{station}: it puts them up to {worst:.3f} mm elsewhere, wanted <= {base_mm:g} mm; "
            f"set {{{words}}}, as calibrated, and take the targets in {{W}}"
        )


def check_posture(status: int, stated: Sequence[tuple[str, int]]) -> None:
    """Raise `PostureError` naming targets with another posture than the calibrated ``status``.

    A robot's errors are those of its joints: in another posture they are others, of millimetres.
    """
    other = [f"{where}: S {s}" for where, s in stated if s & POSTURE_BITS != status & POSTURE_BITS]
    if other:
        raise PostureError(
            f"{len(other)} of {len(stated)} targets are reached in another posture than the "
            f"calibrated one, S {status}: no correction is known there; state them in that posture,"
            f" or measure theirs (robot.status of a cell)\n{_listed(other)}"
        )


def check_slide(station: Station, stated: tuple[str, float] | None) -> None:
    """Raise `SlideError` where a program moves the slide elsewhere than to its station."""
    slide_mm = 5.0  # a program's place is the drive's, and the strip's decides: no other station
    if stated is not None and not abs(stated[1] - station.rail_mm) <= slide_mm:
        place = "a place not known" if isnan(stated[1]) else f"{stated[1]:g} mm"
        raise SlideError(
            f"{stated[0]} moves the slide to {place}, expected {station.rail_mm:g} mm, as at "
            f"{station.name}: correct the program for the station that it drives to"
        )


class StrokeLimits(NamedTuple):
    """How far strokes may lead, and by how far each of N targets' strokes may miss, (N,) or one.

    ``source`` says in words where ``miss_mm`` comes from.
    """

    longest_mm: float
    miss_mm: Array | float
    source: str


class StrokeMiss(NamedTuple):
    """By how far strokes miss at worst: across (a hole's position) and along (its depth)."""

    across_mm: float = 0.0
    along_mm: float = 0.0


def check_strokes(
    calibration: Calibration,
    station: str,
    targets: Array,
    command: Array,
    strokes: Sequence[Stroke],
    limits: StrokeLimits,
    tip: Tip = AT_REFLECTOR,
) -> StrokeMiss:
    """Return by how far strokes miss the line that their target's nominal pose states.

    A stroke keeps the correction of the target before it, so it misses by as much as the error on
    its way differs from that at the target, and where angles are corrected by as much as the stroke
    is turned with them. The calibration's model is asked every `STEP_MM` of the way: the ripple of
    gears passes within some millimetres, an end can be good by chance. ``targets`` (N, 6) are
    nominal, ``command`` (N, 6) corrected, poses of the ``tip`` in {W}. Raises `StrokeError` naming
    the strokes that lead too far, end outside of the calibrated volume, or miss by more than
    ``limits``.
    """
    if not strokes:
        return StrokeMiss()
    names, at = [each.where for each in strokes], np.array([each.target for each in strokes])
    shifts_mm = np.array([each.shift_mm for each in strokes])
    _refuse_long(lengths_mm(shifts_mm), limits.longest_mm, names)
    T_B_W = inverse(np.array(calibration.stations[station].T_W_B))
    ends = poses_from_zyx(targets[at])
    ends[:, :3, 3] += shifts_mm
    ends_mm = (T_B_W @ ends @ tip.T_D_T)[:, :3, 3]
    try:
        calibration.grid().check_inside(ends_mm, names)
    except OutsideGrid as error:
        raise StrokeError(f"strokes that end outside: {error}") from error
    ways = [_way(each) for each in strokes]
    missed_mm = _missed(calibration, T_B_W, targets[at], command[at], ways, tip)
    most_mm = np.broadcast_to(limits.miss_mm, len(targets))[at]
    return _refuse_missed(ways, missed_mm, most_mm, names, limits.source)


def _way(stroke: Stroke) -> Array:
    """Return places (K, 3) of a stroke, relative to its target, in {W}, `STEP_MM` apart."""
    length_mm = float(np.linalg.norm(np.subtract(stroke.shift_mm, stroke.from_mm)))
    return np.linspace(stroke.from_mm, stroke.shift_mm, max(2, ceil(length_mm / STEP_MM) + 1))


def _missed(
    calibration: Calibration,
    T_B_W: Array,
    starts: Array,
    command: Array,
    ways: Sequence[Array],
    tip: Tip,
) -> list[Array]:
    """Return by how far each place of ``ways`` is missed, each (K, 3) in {W}.

    ``starts`` and ``command`` (N, 6) are the nominal and the corrected target of each way.
    """
    counts = [len(each) for each in ways]
    places = np.repeat(starts, counts, axis=0)
    places[:, :3] += np.concatenate(ways)
    model = calibration.error_model()
    errors_mm = model.predict(T_B_W @ poses_from_zyx(places) @ tip.T_D_T).error_mm
    at_start_mm = model.predict(T_B_W @ poses_from_zyx(starts) @ tip.T_D_T).error_mm
    change_mm = (errors_mm - np.repeat(at_start_mm, counts, axis=0)) @ T_B_W[:3, :3]  # in {W}
    turn = poses_from_zyx(command)[:, :3, :3] @ poses_from_zyx(starts)[:, :3, :3].swapaxes(1, 2)
    sent_mm = [way @ each.T for way, each in zip(ways, turn, strict=True)]
    total_mm = change_mm + np.concatenate(sent_mm) - np.concatenate(ways)
    return np.split(total_mm, np.cumsum(counts)[:-1])


def _refuse_long(found_mm: Array, longest_mm: float, names: Sequence[str]) -> None:
    bad = np.flatnonzero(~(found_mm <= longest_mm + ROUNDING_MM))
    if len(bad):
        raise StrokeError(
            f"{len(bad)} of {len(names)} strokes lead away from their point by more than "
            f"{longest_mm:.6g} mm; shorten them, or declare their length with --allow-stroke MM\n"
            + _listed([f"{names[n]}: {found_mm[n]:.3f} mm" for n in bad.tolist()])
        )


def _refuse_missed(
    ways: Sequence[Array], missed_mm: Sequence[Array], most_mm: Array, names: Sequence[str],
    source: str,
) -> StrokeMiss:  # fmt: skip
    bad, worst = list[str](), StrokeMiss()
    for way, missed, most, name in zip(ways, missed_mm, most_mm.tolist(), names, strict=True):
        direction = (way[-1] - way[0]) / max(float(np.linalg.norm(way[-1] - way[0])), ROUNDING_MM)
        along_mm = missed @ direction
        across_mm = lengths_mm(missed - along_mm[:, None] * direction)
        found = StrokeMiss(float(across_mm.max()), float(np.abs(along_mm).max()))
        worst = StrokeMiss(*map(max, worst, found))
        if not (found.across_mm <= most and found.along_mm <= most):
            depth_mm = float(lengths_mm(way)[across_mm.argmax()])
            bad.append(
                f"{name}: {found.across_mm:.3f} mm across at {depth_mm:.0f} mm from the point, "
                f"{found.along_mm:.3f} mm along; wanted <= {most:.3f} mm, {source}"
            )
    if bad:
        raise StrokeError(
            f"{len(bad)} of {len(names)} strokes miss their line, on which they keep the correction"
            f" of the point before them: by up to {worst.across_mm:.3f} mm across (the hole's "
            f"position) and {worst.along_mm:.3f} mm along (its depth); shorten them, state their "
            "end as a point, which is corrected by itself, or state what the drilling allows with "
            f"--stroke-tolerance MM\n{_listed(bad)}"
        )
    return worst


def _listed(lines: Sequence[str]) -> str:
    return "\n".join(f"  {each}" for each in bounded(lines))
