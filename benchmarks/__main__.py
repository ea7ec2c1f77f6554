"""``make bench``: start-up, journal and a whole calibration, each beside a bare measure."""

from __future__ import annotations

import os
import resource
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.words import parser
from hilcell.journal.journal import Journal
from tests.whole.bench import HILCELL


def seconds(act: Callable[[], object], runs: int) -> float:
    """Return the median time of an act over several runs, after one warm-up."""
    act()
    taken = []
    for _ in range(runs):
        began = time.perf_counter()
        act()
        taken.append(time.perf_counter() - began)
    return statistics.median(taken)


def command(*words: str) -> Callable[[], object]:
    return lambda: subprocess.run(words, check=True, capture_output=True)


def start_up() -> None:
    bare = seconds(command(sys.executable, "-c", "pass"), 9)
    ours = seconds(command(*HILCELL, "--help"), 9)
    print(f"hilcell --help   {ours * 1e3:6.0f} ms  = {ours / bare:.1f} x a bare interpreter")


def journal(folder: Path) -> None:
    base = sqlite3.connect(folder / "bare.sqlite", isolation_level=None)
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("PRAGMA synchronous=FULL")
    base.execute("CREATE TABLE t (seq INTEGER PRIMARY KEY, body TEXT)")
    text = "x" * 600
    bare = seconds(lambda: base.execute("INSERT INTO t (body) VALUES (?)", (text,)), 500)
    kept = Journal(folder / "journal.sqlite", "r", create=True)
    ours = seconds(lambda: kept.append("point", "p", {"what": text}), 500)
    print(f"journal append   {ours * 1e3:6.2f} ms  = {ours / bare:.1f} x a bare committed insert")
    base.close()
    kept.close()


def calibration(folder: Path) -> None:
    began = time.perf_counter()
    subprocess.run(
        [*HILCELL, "run", "--full", "--json", "--runs", str(folder)], check=True, stdout=-3
    )
    taken = time.perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"calibrate        {taken:6.1f} s   peak memory of its largest process {peak:.0f} MB")


def main() -> None:
    parser(__doc__).parse_args()
    print(f"{os.cpu_count()} cores, python {sys.version.split()[0]}")
    with tempfile.TemporaryDirectory() as folder:
        start_up()
        journal(Path(folder))
        calibration(Path(folder))


if __name__ == "__main__":
    main()
