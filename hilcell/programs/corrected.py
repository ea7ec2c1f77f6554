"""Targets corrected by a calibration that may be used: their commands, bounds and stamp."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from msgspec.structs import replace

from hilcell.calibration.bounds import target_bounds
from hilcell.calibration.budget import with_drill
from hilcell.calibration.corrected import memories, memory_of, note_corrected, refuse_known
from hilcell.calibration.file import compensate_targets, read_calibration
from hilcell.calibration.form import Calibration, written_now
from hilcell.calibration.in_use import cell_calibrated, standing_by_name, written_by
from hilcell.calibration.influence import Bounds, NoBound
from hilcell.calibration.orientation import turn_bounds_deg
from hilcell.calibration.tip import Tip
from hilcell.calibration.validity import check_fitness
from hilcell.cell.file import Cell
from hilcell.compensation.stamp import Stamp
from hilcell.compensation.targets import BOUND, csv_of
from hilcell.geometry.frames import poses_from_zyx
from hilcell.journal.find_run import find_run
from hilcell.journal.standing import Standing
from hilcell.ports import Array
from hilcell.run.order import Release

BOUNDS = ["name", BOUND, "u_x_mm", "u_y_mm", "u_z_mm"]
TURN = "bound95_deg"  # where the calibration corrects orientation


@dataclass(frozen=True, eq=False)
class Corrected:
    """N targets of a tool's tip: ``nominal`` and what is commanded for it, poses (N, 6).

    ``turns_deg`` (N,) are 95 % bounds of the orientation, None where it is not corrected.
    """

    names: list[str]
    nominal: Array
    command: Array
    bounds: Bounds | NoBound
    stamp: Stamp
    turns_deg: Array | None = None

    @cached_property
    def bounds95_mm(self) -> list[float] | None:
        """Return the 95 % bound of each target, None where none can be stated."""
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
        if self.turns_deg is None:
            return words
        return (
            f"{words}; of their orientation, as the reflectors define it: "
            f"{np.median(self.turns_deg):.4f} and {self.turns_deg.max():.4f} deg (true; a measured "
            "angle has the readings' noise, too)"
        )

    def listed(self, header: Sequence[str], rows: Sequence[list[str]]) -> bytes:
        """Return a list of the targets with a bound in each of its ``rows``, and their stamp."""
        named, listed = [*header], [[*row] for row in rows]
        columns = [(BOUND, self.bounds95_mm, 4), (TURN, self.turns_deg, 5)]
        for name, values, decimals in columns:
            if values is not None:
                named.append(name)
                for row, value in zip(listed, values, strict=True):
                    row.append(f"{value:.{decimals}f}")
        return csv_of(named, listed, self.stamp)

    def list_of_bounds(self) -> bytes:
        """Return a row a target: its bound, u of its coordinates in {W}, the bound of its turn.

        Raises `NoBound`.
        """
        if isinstance(self.bounds, NoBound):
            raise self.bounds
        u_mm = np.sqrt(np.diagonal(self.bounds.covariance_mm2, axis1=1, axis2=2))
        numbers = np.column_stack([self.bounds.radii_mm, u_mm]).tolist()
        rows = [
            [name, *(f"{each:.4f}" for each in row)]
            for name, row in zip(self.names, numbers, strict=True)
        ]
        if self.turns_deg is None:
            return csv_of(BOUNDS, rows)
        turned = zip(rows, self.turns_deg.tolist(), strict=True)
        return csv_of([*BOUNDS, TURN], ([*row, f"{deg:.5f}"] for row, deg in turned))


@dataclass(frozen=True)
class Released:
    """A calibration that may be used under the conditions of ``release``.

    ``accepted`` says why it is out of tolerance, where that was accepted; ``standing`` is None
    where it is not known, ``cell`` the cell as it was calibrated, None likewise.
    """

    calibration: Calibration
    path: Path
    release: Release
    standing: Standing | None
    accepted: list[str]
    cell: Cell | None

    @classmethod
    def named(cls, name: str, release: Release, cell: Cell | None) -> Self:
        """Return the calibration of a run or a file, judged for the cell of today, if it is known.

        Raises `Unfit`, `NoCalibration`, `SettingsError`.
        """
        where = Path(name)
        is_file = os.path.isfile(where)  # noqa: PTH113 - Path.is_file raises for a name too long
        path = where if is_file else written_by(find_run(release.runs, name))
        calibration = read_calibration(path)
        standing = standing_by_name(calibration, path, release.runs)
        calibrated = cell_calibrated(calibration, path, release.runs)
        accepted = check_fitness(
            calibration,
            datetime.now(UTC),
            max_age_days=release.max_age,
            temperature_c=release.temperature,
            cell=cell,
            calibrated=calibrated,
            accept_out_of_tolerance=release.accept_out_of_tolerance,
            standing=standing,
            accept_not_current=release.accept_not_current,
        )
        return cls(calibration, path, release, standing, accepted, calibrated)

    @property
    def stands(self) -> str:
        """Return in a word or two how the calibration stands."""
        return "unknown" if self.standing is None else self.standing.state

    def notes(self) -> Iterator[str]:
        """Yield the warnings for the user of the output."""
        made = self.calibration.provenance
        yield from (f"accepted although {reason}" for reason in self.accepted)
        if self.standing is None:
            yield (
                f"warning: run {made.latest} is not in {self.release.runs}, or not finished: "
                "whether its calibration is current is not known"
            )
        elif not self.standing.usable:
            yield f"accepted although it is {self.standing.text}"
        if made.simulated:
            yield (
                f"hilcell: SIMULATED: run {made.run} measured no real robot; the output is for "
                "trying out, not for a machine"
            )

    def stamp(self, station: str) -> Stamp:
        """Return the stamp of targets that are corrected now."""
        made = self.calibration.provenance
        remarks = ["OUT OF TOLERANCE (accepted)"] if self.accepted else []
        if self.standing is None:
            remarks.append("standing unknown: not among this cell's finished runs")
        elif not self.standing.usable:
            by = f" by {self.standing.by}" if self.standing.by else ""
            remarks.append(f"{self.standing.state.upper()}{by} (accepted)")
        return Stamp(made.latest, written_now(), station, made.simulated, tuple(remarks))

    def corrected(
        self, station: str, names: list[str], nominal: Array, tip: Tip, cell: Cell | None
    ) -> Corrected:
        """Return targets (N, 6) of a tip in {W}, corrected for a station of ``cell``.

        Raises `HilcellError` naming each target that the calibration does not correct.
        """
        command = compensate_targets(self.calibration, station, nominal, names, tip)
        seen = poses_from_zyx(nominal) @ tip.T_D_T
        try:
            turns_deg = turn_bounds_deg(self.calibration, station, seen)
        except NoBound:
            turns_deg = None
        bounds: Bounds | NoBound
        try:
            bounds = target_bounds(
                self._with_drill(tip, cell, turns_deg), station, seen, self.release.temperature
            )
        except NoBound as reason:
            bounds = reason
        return Corrected(names, nominal, command, bounds, self.stamp(station), turns_deg)

    def _with_drill(self, tip: Tip, cell: Cell | None, turns_deg: Array | None) -> Calibration:
        """Return the calibration with the budget of the tip, or of the cell's drill, if known."""
        stated = self.calibration.uncertainty
        offset_mm = drill_mm_of(cell)
        if tip.table is not None:
            x_mm, y_mm, z_mm = tip.lever_mm.tolist()
            offset_mm = (x_mm, y_mm, z_mm)
        if offset_mm is None or stated.missing:
            return self.calibration
        stated = with_drill(stated, offset_mm, tip.u_mm, turns_deg)
        return replace(self.calibration, uncertainty=stated)

    def refuse_corrected(self, source: Path, names: list[str], *targets_mm: Array) -> None:
        """Raise `CorrectedBefore` where targets (N, 3) are the output of a correction.

        ``targets_mm`` are the same targets in each frame that they may have been corrected in.
        """
        refuse_known(memories(self.release.runs, self.path), source.name, names, *targets_mm)

    def remember(self, stamp: Stamp, *points: tuple[Array, Array]) -> list[str]:
        """Keep pairs of nominal and corrected points, each (N, 3), to be known without the stamp.

        Returns a warning where they cannot be kept.
        """
        folder = memory_of(self.release.runs, self.path)
        why = f"{self.release.runs} is not there"
        if folder is not None:
            try:
                for nominal_mm, command_mm in points:
                    note_corrected(folder, stamp.text, nominal_mm, command_mm)
            except OSError as error:
                why = f"{folder} cannot be written ({error.strerror})"
            else:
                return []
        return [f"warning: {why}: these targets are known as corrected by their stamp alone"]


def drill_mm_of(cell: Cell | None) -> tuple[float, float, float] | None:
    """Return where the cell states that its drill is, in {T}, if it does."""
    if cell is None or not any(cell.uncertainty.drill_offset_mm):
        return None
    return cell.uncertainty.drill_offset_mm
