"""A folder with a calibration of station S1100, and the command `compensate` over it."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from hilcell.calibration.file import write_calibration
from hilcell.commands.cli import main
from tests.hilcell.calibration.calibrations import calibration


def read_corrected(path: Path) -> tuple[list[str], Any, set[str]]:
    """Return names, values (N, 6) and the stamps of a corrected list."""
    _, *rows = csv.reader(path.read_text().splitlines())
    values = np.array([[float(each) for each in row[1:7]] for row in rows])
    return [row[0] for row in rows], values, {row[-1] for row in rows}


class Workplace:
    """``source`` is what is corrected into ``out`` unless a call names others."""

    def __init__(self, folder: Path, source: str, out: str) -> None:
        self.folder, self.source, self.out = folder, folder / source, folder / out
        self.calibrate()

    def calibrate(self, size_mm: float = 1.2, **provenance: Any) -> None:
        write_calibration(calibration(size_mm, **provenance), self.folder / "calibration.json")

    def compensate(self, *words: str, source: Path | None = None, out: Path | None = None) -> int:
        return main(
            ["compensate", str(self.folder / "calibration.json"), str(source or self.source),
             "--station", "S1100", "-o", str(out or self.out), *words]
        )  # fmt: skip

    @property
    def files(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir())
