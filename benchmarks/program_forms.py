"""``python -m benchmarks.program_forms [POINTS]``: programs of each form, corrected.

Processor seconds of `hilcell compensate --cell paper` without its start: the program, of holes with
two points before each, is read, checked against the arm, corrected and written with its bounds.
"""

from __future__ import annotations

import tempfile
import time
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path

from benchmarks.words import parser
from hilcell.calibration.file import write_calibration
from hilcell.commands.cli import main as hilcell
from tests.drivers.program_forms import CELL, FORMS, Form, correctable, station
from tests.hilcell.calibration.calibrations import calibration

POINTS = 4000
REPEATS = 3


def corrected_s(form: Form, points: int, folder: Path) -> tuple[float, int]:
    """Return the least of several times, s, after one that loads the code, and the size, bytes."""
    texts = correctable(form, station(points // form.points_a_hole, 0.0))
    for suffix, text in texts.items():
        (folder / f"S1100{suffix}").write_text(text, "latin-1", newline="")
    source = folder / f"S1100{next(iter(texts))}"
    words = ("compensate", folder / "calibration.json", source, "--station", "S1100", "--cell",
             "paper", "-o", folder / f"out{source.suffix}")  # fmt: skip
    taken = []
    for n in range(1 + REPEATS):
        runs = folder / f"runs-{n}"  # each remembers the points that were corrected into it
        runs.mkdir()
        said = StringIO()
        began_s = time.process_time()
        with redirect_stderr(said):
            code = hilcell([*map(str, words), "--runs", str(runs)])
        taken.append(time.process_time() - began_s)
        if code:
            raise SystemExit(said.getvalue())
    return min(taken[1:]), sum(map(len, texts.values()))


def main() -> None:
    words = parser(__doc__)
    words.add_argument("points", nargs="?", type=int, default=POINTS)
    points = words.parse_args().points
    for form in FORMS:
        with tempfile.TemporaryDirectory() as folder:
            write_calibration(
                calibration(1.2, digest=CELL.digest), Path(folder) / "calibration.json"
            )
            taken_s, size = corrected_s(form, points, Path(folder))
        print(f"{form.writer:10} {points} points, {size / 1e3:5.0f} kB: {taken_s:.2f} s")


if __name__ == "__main__":
    main()
