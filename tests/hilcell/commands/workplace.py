"""A folder with a calibration of station S1100, and the command `compensate` over it."""

from __future__ import annotations

import csv
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

from hilcell.calibration.file import write_calibration
from hilcell.commands.cli import main
from tests.hilcell.calibration.calibrations import calibration
from tests.whole.bench import command


def read_corrected(path: Path) -> tuple[list[str], Any, set[str]]:
    """Return names, values (N, 6) and the stamps of a corrected list."""
    _, *rows = csv.reader(path.read_text().splitlines())
    values = np.array([[float(each) for each in row[1:7]] for row in rows])
    return [row[0] for row in rows], values, {row[-1] for row in rows}


class Workplace:
    """Corrects ``source`` into ``out`` unless a call names others."""

    def __init__(self, folder: Path, source: str, out: str) -> None:
        self.folder, self.source, self.out = folder, folder / source, folder / out
        self.calibrate()

    def calibrate(self, size_mm: float = 1.2, **provenance: Any) -> None:
        write_calibration(calibration(size_mm, **provenance), self.folder / "calibration.json")

    def compensate(self, *words: str, source: Path | None = None, out: Path | None = None) -> int:
        return main(self._words(*words, source=source, out=out))

    def run(
        self, *words: str | Path, source: Path | None = None, out: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Compensate, and return what it said as well."""
        return command(*self._words(*words, source=source, out=out))

    def refused(
        self, *words: str | Path, source: Path | None = None, out: Path | None = None
    ) -> str:
        """Return why it is refused; no file is written or changed."""
        before = self.contents
        done = self.run(*words, source=source, out=out)
        assert (done.returncode, done.stdout) == (2, ""), done.stderr
        assert self.contents == before
        return done.stderr

    @property
    def contents(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in self.folder.iterdir() if path.is_file()}

    @property
    def files(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir())

    def _words(self, *words: str | Path, source: Path | None, out: Path | None) -> list[str]:
        calibration = self.folder / "calibration.json"
        given = (calibration, source or self.source, "--station", "S1100", "-o", out or self.out)
        return ["compensate", *map(str, (*given, *words))]
