"""What the processor does in a case of a study: ``python -m benchmarks.study_parts``.

Samples of the stack, each counted for its innermost part; shares depend little on other work.
"""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Iterator
from types import FrameType

from benchmarks.study import FEW, FULL, PAPER, PLAIN
from benchmarks.words import parser
from hilcell.cell.file import load_cell
from hilcell.study.case import calibrate_case, encode_cell, versions

CASES = {"whole": FULL, "paper's": PAPER, "64 + 30": FEW, "no sweeps": PLAIN}  # as in `study`
MACHINES = range(2, 8)
SAMPLE_S = 0.001
PARTS = {  # by the beginning of a function's name
    "KeyedNoise.generator": "simulated noise: seeding its generators",
    "Direct": "simulated devices",
    "MemoryJournal.": "journal and log",
    "Mover.sweep": "sweeps and their curves",
    "swept_axis": "sweeps and their curves",
    "CellSession._flange_points": "session: a point's motions, checks, record",
    "Mover.expect": "session: a point's motions, checks, record",
    "Watch.verify_tracker": "nests, frames, verifications",
    "WorldFrame.": "nests, frames, verifications",
    "TwoFaces.": "nests, frames, verifications",
    "frame_station": "nests, frames, verifications",
    "fitted": "identification",
    "SignCheck.": "identification",
    "suspected_causes": "suspicions",
    "Validate._command": "corrections, budgets, result",
    "guard_band": "corrections, budgets, result",
    "Procedure.result": "corrections, budgets, result",
    "calibrate_case": "all else",
}


def names(frame: FrameType | None) -> Iterator[str]:
    """Yield the functions of a stack, the innermost first."""
    while frame is not None:
        yield frame.f_code.co_qualname
        frame = frame.f_back


def parts(case: str) -> Counter[str]:
    """Return the samples of cases by part, after a first case."""
    cell, here, found = encode_cell(load_cell("paper", CASES[case])), versions(), Counter[str]()

    def sample(_: int, stack: FrameType | None) -> None:
        parts = (PARTS[key] for name in names(stack) for key in PARTS if name.startswith(key))
        found[next(parts, "all else")] += 1

    calibrate_case(cell, 1, 1, here)
    before = signal.signal(signal.SIGPROF, sample)
    signal.setitimer(signal.ITIMER_PROF, SAMPLE_S, SAMPLE_S)
    try:
        for machine in MACHINES:
            assert calibrate_case(cell, machine, 1, here).state == "done"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    return found


def main() -> None:
    parser(__doc__).parse_args()
    found = {case: parts(case) for case in CASES}
    print(f"{'share of the processor':45}", *(f"{case:>10}" for case in CASES))
    for part in dict.fromkeys(PARTS.values()):
        shares = (found[case][part] / found[case].total() for case in CASES)
        print(f"{part:45}", *(f"{share:10.0%}" for share in shares))


if __name__ == "__main__":
    main()
