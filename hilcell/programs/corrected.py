"""Targets corrected by a usable calibration: commands, bounds and stamp.

Corrected targets are recognised by their points too: a spreadsheet drops the stamp's column, a
controller strips comments, and a second correction would subtract the error twice. Each correction
stores its points in the folder of the calibration's run (for a separate file, in the folder of
runs), and targets at such points are refused.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from hilcell.calibration.budget import target_bounds, with_drill
from hilcell.calibration.file import Calibration, compensate_targets, written_now
from hilcell.calibration.influence import Bounds, NoBound
from hilcell.calibration.lookup import CalibrationFile
from hilcell.calibration.orientation import orientation_bounds_deg
from hilcell.calibration.tool_point import AT_REFLECTOR, Tip
from hilcell.calibration.validity import check_usable
from hilcell.cell.file import Cell
from hilcell.compensation.targets import BOUND, CorrectedBefore, Stamp, csv_content
from hilcell.errors import bounded
from hilcell.geometry.frames import poses_from_zyx
from hilcell.geometry.kinematics import Bools
from hilcell.geometry.statistics import lengths_mm
from hilcell.journal.calibration_status import CalibrationStatus
from hilcell.journal.runs import is_run, run_folders
from hilcell.journal.runs_folder import usual_runs
from hilcell.ports import Array
from hilcell.run.order import Release
from hilcell.sanitize import counted

BOUNDS = ["name", BOUND, "u_x_mm", "u_y_mm", "u_z_mm"]
ORIENTATION_BOUND = "bound95_deg"  # where the calibration corrects orientation


@dataclass(frozen=True, eq=False)
class Corrected:
    """N targets of a tool's tip: ``nominal`` and its command, poses (N, 6). ``bounds_deg`` (N,): 95
    % bounds of the orientation, None where it is not corrected.
    """

    names: list[str]
    nominal: Array
    command: Array
    bounds: Bounds | NoBound
    stamp: Stamp
    bounds_deg: Array | None = None

    @cached_property
    def bounds95_mm(self) -> list[float] | None:
        """95 % bound of each target, None where none can be stated."""
        return None if isinstance(self.bounds, NoBound) else self.bounds.radii_mm.tolist()

    @property
    def summary(self) -> str:
        """Return median and largest bound in one line, or why there are none."""
        if isinstance(self.bounds, NoBound):
            return str(self.bounds)
        radii_mm = self.bounds.radii_mm
        worst = int(np.argmax(radii_mm))
        words = (
            f"95 % bounds of the corrected targets: median {np.median(radii_mm):.3f} mm, largest "
            f"{radii_mm[worst]:.3f} mm at {self.names[worst]}"
        )
        if self.bounds_deg is None:
            return words
        return (
            f"{words}; of their orientation, as the reflectors define it: "
            f"{np.median(self.bounds_deg):.4f} and {self.bounds_deg.max():.4f} deg (true; a "
            "measured angle also contains reading noise)"
        )

    def listed(self, header: Sequence[str], rows: Sequence[list[str]]) -> bytes:
        """List of the targets with a bound in each of its ``rows``, and their stamp."""
        named, listed = [*header], [[*row] for row in rows]
        columns = [(BOUND, self.bounds95_mm, 4), (ORIENTATION_BOUND, self.bounds_deg, 5)]
        for name, values, decimals in columns:
            if values is not None:
                named.append(name)
                for row, value in zip(listed, values, strict=True):
                    row.append(f"{value:.{decimals}f}")
        return csv_content(named, listed, self.stamp)

    def list_of_bounds(self) -> bytes:
        """Bounds of targets, u of coordinates in {W}, bounds of rotations; raises `NoBound`."""
        if isinstance(self.bounds, NoBound):
            raise self.bounds
        u_mm = np.sqrt(np.diagonal(self.bounds.covariance_mm2, axis1=1, axis2=2))
        numbers = np.column_stack([self.bounds.radii_mm, u_mm]).tolist()
        rows = [
            [name, *(f"{each:.4f}" for each in row)]
            for name, row in zip(self.names, numbers, strict=True)
        ]
        if self.bounds_deg is None:
            return csv_content(BOUNDS, rows)
        turned = zip(rows, self.bounds_deg.tolist(), strict=True)
        return csv_content(
            [*BOUNDS, ORIENTATION_BOUND], ([*row, f"{deg:.5f}"] for row, deg in turned)
        )


@dataclass(frozen=True)
class UsableCalibration:
    """A calibration that may be used under the conditions of ``release``.

    ``accepted`` says why it is out of tolerance, where that was accepted; ``status`` is None
    where it is not known, ``cell`` the cell as it was calibrated, None likewise.

    Examples:
        >>> used = open_calibration("small")
        >>> targets = np.array([[0.0, 0.0, 1250.0, 0.0, 75.0, 0.0]])
        >>> used.corrected("S1100", ["A1"], targets).command.shape
        (1, 6)
    """

    calibration: Calibration
    path: Path
    release: Release
    status: CalibrationStatus | None
    accepted: list[str]
    cell: Cell | None

    @classmethod
    def named(cls, name: str, release: Release, cell: Cell | None) -> Self:
        """Calibration of a run or a file; raises `HilcellError`."""
        used = CalibrationFile.named(name, release.runs)
        accepted = check_usable(
            used.calibration,
            datetime.now(UTC),
            max_age_days=release.max_age,
            temperature_c=release.temperature,
            cell=cell,
            calibrated=used.cell,
            accept_out_of_tolerance=release.accept_out_of_tolerance,
            status=used.status,
            accept_not_current=release.accept_not_current,
        )
        return cls(used.calibration, used.path, release, used.status, accepted, used.cell)

    @property
    def status_text(self) -> str:
        return "unknown" if self.status is None else self.status.state

    def notes(self) -> Iterator[str]:
        made = self.calibration.provenance
        yield from (f"accepted although {reason}" for reason in self.accepted)
        if self.status is None:
            yield (
                f"warning: run {made.latest} is not in {self.release.runs}, or not finished: "
                "whether its calibration is current is not known"
            )
        elif not self.status.usable:
            yield f"accepted although it is {self.status.text}"
        if made.simulated:
            yield (
                f"hilcell: SIMULATED: run {made.run} measured no real robot; the output is for "
                "trying out, not for a machine"
            )

    def stamp(self, station: str) -> Stamp:
        made = self.calibration.provenance
        remarks = ["OUT OF TOLERANCE (accepted)"] if self.accepted else []
        if self.status is None:
            remarks.append("standing unknown: not among this cell's finished runs")
        elif not self.status.usable:
            by = f" by {self.status.by}" if self.status.by else ""
            remarks.append(f"{self.status.state.upper()}{by} (accepted)")
        return Stamp(made.latest, written_now(), station, made.simulated, tuple(remarks))

    def corrected(
        self,
        station: str,
        names: list[str],
        nominal: Array,
        tip: Tip = AT_REFLECTOR,
        cell: Cell | None = None,
    ) -> Corrected:
        """Corrected targets (N, 6) of a tip in {W}: x, y, z in mm, Z-Y-X angles in deg.

        ``cell`` states where the drill is, for the bounds. Raises `HilcellError` naming targets
        outside the calibrated volume or orientation.
        """
        command = compensate_targets(self.calibration, station, nominal, names, tip)
        reflector_poses = poses_from_zyx(nominal) @ tip.T_D_T
        try:
            bounds_deg = orientation_bounds_deg(self.calibration, station, reflector_poses)
        except NoBound:
            bounds_deg = None
        bounds: Bounds | NoBound
        try:
            bounds = target_bounds(
                self._with_drill(tip, cell, bounds_deg),
                station,
                reflector_poses,
                self.release.temperature,
            )
        except NoBound as reason:
            bounds = reason
        return Corrected(names, nominal, command, bounds, self.stamp(station), bounds_deg)

    def _with_drill(self, tip: Tip, cell: Cell | None, bounds_deg: Array | None) -> Calibration:
        """Return the calibration with the budget of the tip, or of the cell's drill, if known."""
        stated = self.calibration.uncertainty
        offset_mm = drill_mm_of(cell)
        if tip.table is not None:
            x_mm, y_mm, z_mm = tip.lever_mm.tolist()
            offset_mm = (x_mm, y_mm, z_mm)
        if offset_mm is None or stated.missing:
            return self.calibration
        stated = with_drill(stated, offset_mm, tip.u_mm, bounds_deg)
        return replace(self.calibration, uncertainty=stated)

    def refuse_corrected(self, source: Path, names: list[str], *targets_mm: Array) -> None:
        """Raise `CorrectedBefore` where targets, in each frame (N, 3), are corrected ones."""
        folder = self.path.resolve().parent
        runs = [self.release.runs.resolve(), *([folder.parent] if is_run(folder) else [])]
        for place in dict.fromkeys(runs):
            for each in (place, *run_folders(place)):
                CorrectedPoints(each).refuse(source.name, names, *targets_mm)

    def remember(self, stamp: Stamp, *points: tuple[Array, Array]) -> list[str]:
        """Store nominal and corrected points, each (N, 3), or return a warning why not."""
        runs, folder = self.release.runs, self.path.resolve().parent
        if not is_run(folder):
            folder = runs
        why = f"{runs} is not there"
        if folder.is_dir():
            try:
                for nominal_mm, command_mm in points:
                    CorrectedPoints(folder).note(stamp.text, nominal_mm, command_mm)
            except OSError as error:
                why = f"{folder} cannot be written ({error.strerror})"
            else:
                return []
        return [f"warning: {why}: these targets are known as corrected by their stamp alone"]


def open_calibration(
    name: str | Path,
    runs: Path | str | None = None,
    *,
    temperature_c: float | None = None,
    max_age_days: float = 180.0,
    accept_out_of_tolerance: bool = False,
    accept_not_current: bool = False,
) -> UsableCalibration:
    """Open the calibration of a run, or a ``calibration.json``, if it may be used.

    ``runs``: the folder of runs, as in `open_run`; ``temperature_c``: ambient. Raises
    `HilcellError` where `hilcell compensate` would refuse the calibration: too old, revoked,
    superseded, out of tolerance, or of another temperature.
    """
    release = Release(
        temperature=temperature_c,
        max_age=max_age_days,
        accept_out_of_tolerance=accept_out_of_tolerance,
        accept_not_current=accept_not_current,
        runs=usual_runs(os.environ)[0] if runs is None else Path(runs),
    )
    return UsableCalibration.named(str(name), release, None)


def drill_mm_of(cell: Cell | None) -> tuple[float, float, float] | None:
    """Position of the drill in {T}, if the cell states it."""
    if cell is None or not any(cell.uncertainty.drill_offset_mm):
        return None
    return cell.uncertainty.drill_offset_mm


class CorrectedPoints:
    """Corrected points stored in a folder, to recognise a list whose stamp was lost."""

    FILE = "corrected.csv"
    SAME_MM = 0.009  # numbers may have been rounded, to two decimals
    LEAST_MOVE = 4.0  # roundings: a point that moved by less is its nominal target

    def __init__(self, folder: Path) -> None:
        self.file = folder / self.FILE

    def note(self, stamp: str, nominal_mm: Array, command_mm: Array) -> None:
        """Store corrected points (N, 3), and their corrections; raises `OSError`."""
        moved_mm = lengths_mm(command_mm - nominal_mm)
        rows = np.column_stack([command_mm, moved_mm])[moved_mm >= self.LEAST_MOVE * self.SAME_MM]
        with self.file.open("a", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows(
                [stamp, *(f"{value:.4f}" for value in row)] for row in rows.tolist()
            )

    def refuse(self, source: str, names: list[str], *targets_mm: Array) -> None:
        """Raise `CorrectedBefore` where targets, in each frame (N, 3), are corrected ones."""
        stamps, known = self._noted()
        for places_mm in targets_mm if stamps else ():
            same, nearest = self._same(known, places_mm)
            if not same.any():
                continue
            which = ", ".join(bounded([names[n] for n in np.flatnonzero(same)]))
            raise CorrectedBefore(
                f"{source}: {int(same.sum())} of {counted(len(places_mm), 'target')} corrected "
                f"before ({which}; {stamps[int(nearest[int(np.argmax(same))])]}), whose stamp was "
                "lost; a second correction would move them by the error once more: give "
                "the nominal targets"
            )

    def _same(self, known: Array, places_mm: Array) -> tuple[Bools, NDArray[np.intp]]:
        """Which of positions (N, 3) are known points (K, 4), and the number of the nearest."""
        from scipy.spatial import KDTree  # loads long, and few folders have corrected anything

        found = KDTree(known[:, :3]).query(places_mm)
        same, nearest = np.asarray(found[0]) <= self.SAME_MM, np.asarray(found[1])
        rounded_mm = 0.09  # or to one: then most of a list is at earlier points
        far = np.flatnonzero(known[:, 3] >= self.LEAST_MOVE * rounded_mm)
        if not same.any() and len(far):
            off_mm, nearest_far = KDTree(known[far, :3]).query(places_mm)
            rounded = np.asarray(off_mm) <= rounded_mm
            if rounded.mean() >= 0.5:
                return rounded, far[np.asarray(nearest_far)]
        return same, nearest

    def _noted(self) -> tuple[list[str], Array]:
        """Stamps, and points with their moves (N, 4), without lines cut by a crash."""
        stamps, points = list[str](), list[list[float]]()
        if self.file.is_file():
            with self.file.open(encoding="utf-8", errors="replace", newline="") as lines:
                for row in csv.reader(lines):
                    if len(row) != 5:
                        continue
                    try:
                        numbers = [float(value) for value in row[1:]]
                    except ValueError:
                        continue
                    if all(map(math.isfinite, numbers)):
                        stamps.append(row[0])
                        points.append(numbers)
        return stamps, np.array(points).reshape(-1, 4)
