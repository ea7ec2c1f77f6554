"""``python -m benchmarks.history [RUNS]``: a history of 10 000 runs is built, reopened, filtered.

The journals are small but real: written by `Journal`, hash-chained, closed; those of one kind are
written once and copied. Files are in the cache, as they are for a screen that is opened twice.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.words import parser
from hilcell.journal.index import NAME, SETTLED_S, matches, read_index
from hilcell.journal.journal import Journal
from hilcell.journal.runs import JOURNAL

RUNS = 10_000
TARGET_MS = 300.0
POINTS = 20
POINT = {
    "id": {"kind": "grid"},
    "group": "grid",
    "station": "S1100",
    "reflector": "SMR",
    "xyz_mm": [1.0, 2.0, 3.0],
    "std_mm": [0.01, 0.01, 0.01],
    "samples": 4,
    "session": 1,
    "frame": "tracker",
}
OPERATORS = ("Ann", "Bob", "Chi", "Dee", "Eve")
WORDS = f"paper state:faulted {datetime.now(UTC):%Y}- -operator:eve"


def write_journal(path: Path, operator: str, *, faulted: bool) -> None:
    cell = {"name": "paper", "serial": "P-1", "grid": {"station": "S1100"}}
    plan = {
        "procedure": "calibrate",
        "cell": cell,
        "operator": operator,
        "job": "J-17",
        "seed": 1,
        "machine_seed": 1,
        "simulated": True,
        "replayed": False,
        "digest": "",
        "speed": None,
        "unattended": True,
        "versions": {},
        "settings": {},
        "steps": [],
        "points": POINTS,
        "duration_s": 60.0,
        "cell_file": "",
    }
    errors = {"mean": 1.2, "p95": 1.9, "max": 2.2}
    sent = {"points": POINTS, "points_sent": {"before": POINTS, "chosen": POINTS}}
    result = {"validation": {"S1100": sent | {"before": errors, "chosen": errors}}}
    journal = Journal(path, path.parent.name, create=True)
    journal.append("plan", "", plan)
    for state in ("checking", "running"):
        journal.append("state", "", {"machine": "run", "to": state})
    for number in range(POINTS):
        journal.append("point", f"grid/{number}", POINT)
    state = "faulted" if faulted else "finished"
    reason = "Tracker: measure: beam broken" if faulted else ""
    journal.append("state", "", {"machine": "run", "to": state, "reason": reason})
    end = {"exit": 3, "result": {}} if faulted else {"exit": 0, "result": result}
    journal.append("end", "", {"state": state, "reason": reason} | end)
    journal.close()


def write_runs(runs: Path, count: int) -> None:
    """Write the folders of runs; every tenth run faulted."""
    models = []
    for operator in OPERATORS:
        for faulted in (False, True):
            models.append(runs / f".model-{operator}-{faulted}")
            write_journal(models[-1], operator, faulted=faulted)
    old_s = time.time() - 10 * SETTLED_S
    for number in range(count):
        day, minute = divmod(number, 1440)
        name = f"2026{1 + day:04d}-{minute // 60:02d}{minute % 60:02d}00-calibrate"
        folder = runs / name
        folder.mkdir()
        model = models[2 * (number % len(OPERATORS)) + (number % 10 == 3)]
        shutil.copyfile(model, folder / JOURNAL)
        os.utime(folder / JOURNAL, (old_s, old_s))


def timed(what: str, runs: Path, words: str = "") -> float:
    """Read and filter in this process; return the milliseconds."""
    began, cpu_began = time.perf_counter(), time.process_time()
    rows = read_index(runs)
    found = sum(matches(row, words) for row in rows)
    if unreadable := sum(row.state == "unreadable" for row in rows):
        sys.exit(f"{unreadable} of {len(rows)} runs are unreadable: this measures nothing")
    taken_ms = (time.perf_counter() - began) * 1e3
    cpu_ms = (time.process_time() - cpu_began) * 1e3
    print(f"{what:34} {taken_ms:7.0f} ms ({cpu_ms:.0f} of a core)   {found} of {len(rows)} runs")
    return taken_ms


def main() -> None:
    words = parser(__doc__)
    words.add_argument("count", type=int, nargs="?", default=RUNS, metavar="RUNS")
    count = words.parse_args().count
    print(f"{os.cpu_count()} cores, python {sys.version.split()[0]}, {count} runs")
    with tempfile.TemporaryDirectory() as folder:
        runs = Path(folder)
        write_runs(runs, count)
        timed("first build", runs)
        again = [timed("reopened and filtered", runs, WORDS) for _ in range(5)]
        rows = read_index(runs)
        began = time.perf_counter()
        found = sum(matches(row, WORDS) for row in rows)
        print(f"{'filtered again':34} {(time.perf_counter() - began) * 1e3:7.0f} ms   {found} runs")
        command = [sys.executable, "-m", "hilcell", "runs", "--json", "--runs", folder]
        began = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        print(
            f"{'hilcell runs --json, a process':34} {(time.perf_counter() - began) * 1e3:7.0f} ms"
        )
        print(f"{NAME}: {(runs / NAME).stat().st_size / 1e6:.1f} MB")
        verdict = "reached" if max(again) <= TARGET_MS else "MISSED"
        print(f"target {TARGET_MS:.0f} ms, worst of {len(again)}: {max(again):.0f} ms: {verdict}")


if __name__ == "__main__":
    main()
