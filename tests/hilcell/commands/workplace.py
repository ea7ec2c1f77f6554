"""A folder with a calibration of station S1100, and the command `compensate` over it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hilcell.calibration.file import write_calibration
from hilcell.commands.cli import main
from tests.hilcell.calibration.calibrations import calibration


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
