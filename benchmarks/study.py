"""Cases of a study a second and core, and two workers beside one: ``python -m benchmarks.study``.

Processor seconds count, so that other work on the machine matters little; a processor that is
shared is slower all the same.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping

from hilcell.cell.file import Cell, load_cell
from hilcell.study.case import measured, packed, versions
from hilcell.study.cluster import local_workers
from hilcell.study.design import Case, Choice, Point

FULL: Mapping[str, str] = {}
FEW = {"validation.per_cell": "1", "validation.others": "3"}  # 27 and 3 targets
PLAIN = FEW | {"sweeps.enabled": "false"}
MACHINES = 5
CASES = 16


def rate(values: Mapping[str, str]) -> tuple[float, int]:
    """Return cases a second of processor after a first one, and the points of a case."""
    cell, here = packed(load_cell("paper", values)), versions()
    points = int(measured(cell, 1, 1, here)["points"])
    began_s = time.process_time()
    for machine in range(2, 2 + MACHINES):
        assert measured(cell, machine, 1, here)["state"] == "done"
    return MACHINES / (time.process_time() - began_s), points


def wall_s(workers: int, cell: Cell) -> tuple[float, float]:
    """Return how long workers take for the cases, the start and the first of each left out.

    And how much of this process, which has the scheduler in it, each case takes.
    """
    nothing: tuple[Choice, ...] = ()
    with local_workers(workers) as pool:
        for numbers in (range(1, 1 + 2 * workers), range(100, 100 + CASES)):
            began_s, own_s = time.perf_counter(), time.process_time()
            cases = [Case(n, Point(1, nothing), machine=n, seed=1) for n in numbers]
            assert len(list(pool.measure(cases, {1: cell}))) == len(cases)
        return time.perf_counter() - began_s, (time.process_time() - own_s) / CASES


def main() -> None:
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for name, values in (
        ("full paper calibration", FULL),
        ("64 vertices, 30 targets", FEW),
        ("the same without sweeps", PLAIN),
    ):
        found, points = rate(values)
        print(f"{name:26} {points:5} points  {found:5.2f} cases a second and core")
    cell = load_cell("paper", PLAIN)
    (one_s, _), (two_s, own_s) = wall_s(1, cell), wall_s(2, cell)
    print(f"workers, {CASES} cases: one {one_s:.1f} s, two {two_s:.1f} s = ", end="")
    print(f"{one_s / two_s / 2.0:.0%} efficiency; load of the machine {os.getloadavg()[0]:.1f}")
    print(f"scheduler and client: {own_s * 1e3:.1f} ms of processor a case")


if __name__ == "__main__":
    main()
