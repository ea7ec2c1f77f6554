"""Cases of a study a second and core, and two workers beside one: ``python -m benchmarks.study``.

Processor seconds count, so that other work on the machine matters little; a processor that is
shared is slower all the same.
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Mapping

from distributed import Client, LocalCluster, as_completed

from benchmarks.words import parser
from hilcell.cell.file import Cell, load_cell
from hilcell.study.case import calibrate_case, encode_cell, versions
from hilcell.study.cluster import local_workers
from hilcell.study.design import Case, Choice, Point

FULL: Mapping[str, str] = {}
PAPER = {"sweeps.enabled": "false"}  # its calibration has none
FEW = {"validation.per_cell": "1", "validation.others": "3"}  # 27 and 3 targets
PLAIN = FEW | PAPER
MACHINES = 5
CASES = 16
EMPTY = 3000


def rate(values: Mapping[str, str]) -> tuple[float, int]:
    """Return cases a second of processor after a first one, and the points of a case."""
    cell, here = encode_cell(load_cell("paper", values)), versions()
    points = int(calibrate_case(cell, 1, 1, here).figures["points"])
    began_s = time.process_time()
    for machine in range(2, 2 + MACHINES):
        assert calibrate_case(cell, machine, 1, here).state == "done"
    return MACHINES / (time.process_time() - began_s), points


def handed_over_a_second(cell: Cell) -> float:
    """Return how many cases a scheduler hands over and takes back where none takes any time.

    Workers of a cluster together cannot measure more; scheduler and client share this process.
    """
    content = encode_cell(cell)
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
        ) as cluster,
        Client(cluster) as client,
    ):
        client.submit(len, content, key="first").result()
        began_s, running = time.perf_counter(), as_completed()
        numbers = iter(range(EMPTY))
        for n in itertools.islice(numbers, 256):
            running.add(client.submit(len, content, key=f"case-{n}"))
        for future in running:
            assert future.result() == len(content)
            for n in itertools.islice(numbers, 1):
                running.add(client.submit(len, content, key=f"case-{n}"))
        return EMPTY / (time.perf_counter() - began_s)


def wall_s(workers: int, cell: Cell) -> float:
    """Return how long workers take for the cases, the start and the first of each left out."""
    nothing: tuple[Choice, ...] = ()
    with local_workers(workers, print) as pool:
        for numbers in (range(1, 1 + 2 * workers), range(100, 100 + CASES)):
            began_s = time.perf_counter()
            cases = [Case(n, Point(1, nothing), machine=n, seed=1) for n in numbers]
            assert len(list(pool.measure((case, encode_cell(cell)) for case in cases))) == len(
                cases
            )
        return time.perf_counter() - began_s


def main() -> None:
    parser(__doc__).parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for name, values in (
        ("whole calibration", FULL),
        ("without sweeps: the paper's", PAPER),
        ("64 vertices, 30 targets", FEW),
        ("the same without sweeps", PLAIN),
    ):
        found, points = rate(values)
        print(f"{name:27} {points:5} points  {found:5.2f} cases a second and core")
    cell = load_cell("paper", PLAIN)
    one_s, two_s = wall_s(1, cell), wall_s(2, cell)
    print(f"workers, {CASES} cases: one {one_s:.1f} s, two {two_s:.1f} s = ", end="")
    print(f"{one_s / two_s / 2.0:.0%} efficiency; load of the machine {os.getloadavg()[0]:.1f}")
    print(f"cases handed over: {handed_over_a_second(cell):.0f} a second")


if __name__ == "__main__":
    main()
