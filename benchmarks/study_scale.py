"""A study of 10 000 cases: ``python -m benchmarks.study_scale``: memory, and overhead of a case.

The whole path of `hilcell study --scheduler`: the file read, cells built, packed and sent, rows
kept as Parquet, merged, and answered. Only the calibration is left out: a case takes no time and
returns figures of its number. Scheduler, workers and client are processes of their own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from multiprocessing import active_children
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks.words import parser
from hilcell.study.analysis import answers
from hilcell.study.case import RESULTS, encode_cell
from hilcell.study.cluster import local_workers, scheduler_workers
from hilcell.study.design import Case, Choice, Point
from hilcell.study.results import Results
from hilcell.study.runner import run_study
from hilcell.study.study_file import read_study, study_cell
from tests.whole.dask_bench import scheduler, worker

REAL = 60
STUDY = """
name = "scale"
design = "sobol"
samples = 1024
machines = 10

[[factor]]
name = "readings"
setting = "layout.nest_samples"
low = 1
high = 20

[[factor]]
name = "touch poses"
setting = "touch.poses"
low = 0
high = 12

[[factor]]
name = "backlash"
setting = "simulation.sizes.rail.backlash_mm"
low = 0.05
high = 0.6
"""


def empty(cell: bytes, machine: int, seed: int, wanted: Mapping[str, str]) -> dict[str, Any]:
    figures = dict.fromkeys(RESULTS, 0.05 + 0.001 * machine + 1e-6 * (len(cell) % 100))
    return {"state": "done", "reason": "", "minutes": 20.0} | figures | {"targets": 50.0}


def peak_mib(pid: int) -> float:
    """Return the largest memory that a process ever had."""
    status = Path(f"/proc/{pid}/status").read_text("ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024.0


def processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def many_cases() -> None:
    """Print what 10 240 empty cases take."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "study.toml"
        path.write_text(STUDY)
        study = read_study(path)
        results = Results(Path(name) / "results", study)
        with (
            scheduler() as (address, serving),
            worker(address) as one,
            worker(address) as two,
            scheduler_workers(address, print) as workers,
            results.held(),
        ):
            processes = {"client": os.getpid()}
            processes |= {"scheduler": serving.process.pid, "worker": one.process.pid}
            before_s = {each: processor_s(pid) for each, pid in processes.items()}
            began_s = time.perf_counter()
            counts = run_study(results, workers, lambda _: None)
            took_s = time.perf_counter() - began_s
            spent_s = {each: processor_s(pid) for each, pid in processes.items()}
            assert counts == {"done": study.most_cases}
            print(f"{study.most_cases} empty cases, two workers: {took_s:.0f} s of wall time")
            for each, pid in processes.items():
                ms = 1e3 * (spent_s[each] - before_s[each]) / study.most_cases
                print(f"{each:10} {peak_mib(pid):5.0f} MiB at most, {ms:5.2f} ms a case")
            assert peak_mib(two.process.pid) < 2048.0
        began_s = time.process_time()
        answers(study, results.rows())
        print(f"answers    {peak_mib(os.getpid()):5.0f} MiB at most,", end=" ")
        print(f"{time.process_time() - began_s:.1f} s of processor")


def real_cases(count: int) -> None:
    """Print whether workers of this PC grow: real cases of 64 vertices, 30 targets and sweeps."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "study.toml"
        path.write_text(STUDY)
        few = {"validation.per_cell": 1, "validation.others": 3}
        cell = encode_cell(study_cell(read_study(path), few))
    nothing: tuple[Choice, ...] = ()
    cases = [Case(n, Point(1, nothing), machine=n, seed=1) for n in range(1, count + 1)]
    for workers in (1, 2):
        with local_workers(workers, print) as pool:
            pids = [each.pid or 0 for each in active_children() if "Dask Worker" in each.name]
            grown, done = list[list[float]](), 0
            for n, (_, row) in enumerate(pool.measure((each, cell) for each in cases), start=1):
                done += row.state == "done"  # of some machines the program refuses the set-up
                if n in (count // 6, count):
                    grown.append([peak_mib(pid) for pid in pids])
            spent_s = sum(processor_s(pid) for pid in pids)
        shown = [" and ".join(f"{each:.0f}" for each in times) for times in grown]
        print(f"{workers} workers, {done} of {count} cases done: {shown[0]} MiB ", end="")
        print(f"after {count // 6}, ", end="")
        print(f"{shown[1]} MiB after all; {spent_s / count:.2f} s of processor a case", flush=True)


def main() -> None:
    words = parser(__doc__)
    words.add_argument("real", nargs="?", type=int, help="so many cases that calibrate, alone")
    if count := words.parse_args().real:
        real_cases(count)
        return
    with patch("hilcell.study.cluster.calibrate_case", empty):
        many_cases()
    subprocess.run([sys.executable, "-m", "benchmarks.study_scale", str(REAL)], check=True)


if __name__ == "__main__":
    main()
