"""A calibration that a command may correct by: found, judged, with what is to be said of it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from hilcell.calibration.file import read_calibration
from hilcell.calibration.form import Calibration, written_now
from hilcell.calibration.in_use import cell_calibrated, standing_by_name, written_by
from hilcell.calibration.validity import check_fitness
from hilcell.cell.file import Cell
from hilcell.compensation.stamp import Stamp
from hilcell.journal.find_run import find_run
from hilcell.journal.standing import Standing
from hilcell.run.order import Release

UNKNOWN = "standing unknown: not among this cell's finished runs"


@dataclass(frozen=True)
class Released:
    """``accepted`` says why it is out of tolerance, where that was accepted; ``standing`` is None
    where it is not known, ``cell`` the cell as it was calibrated, None likewise.
    """

    calibration: Calibration
    path: Path
    runs: Path
    standing: Standing | None
    accepted: list[str]
    cell: Cell | None

    def stamp(self, station: str) -> Stamp:
        """Return the stamp of targets that are corrected now."""
        made = self.calibration.provenance
        remarks = ["OUT OF TOLERANCE (accepted)"] if self.accepted else []
        if self.standing is None:
            remarks.append(UNKNOWN)
        elif not self.standing.usable:
            by = f" by {self.standing.by}" if self.standing.by else ""
            remarks.append(f"{self.standing.state.upper()}{by} (accepted)")
        return Stamp(made.latest, written_now(), station, made.simulated, tuple(remarks))

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
                f"warning: run {made.latest} is not in {self.runs}, or not finished: whether its "
                "calibration is current is not known"
            )
        elif not self.standing.usable:
            yield f"accepted although it is {self.standing.text}"
        if made.simulated:
            yield (
                f"hilcell: SIMULATED: run {made.run} measured no real robot; the output is for "
                "trying out, not for a machine"
            )


def released(name: str, release: Release, cell: Cell | None) -> Released:
    """Return the calibration of a run or a file; raises `Unfit`, `NoCalibration`, `SettingsError`.

    ``cell`` is that of today, None leaves it unchecked.
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
    return Released(calibration, path, release.runs, standing, accepted, calibrated)
