"""``python -m campaigns faults``: every fault in every phase, and the table of reactions."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from functools import cache

from campaigns.faults.bed import hasten
from campaigns.faults.injections import Injection
from campaigns.faults.judging import Judged, judged
from campaigns.faults.page import PAGE, page
from campaigns.faults.phases import Phase
from campaigns.faults.script import Case, Ran, limited, play
from campaigns.faults.table import FAULTS, Fault
from campaigns.faults.table_abb import FAULTS_OF_ABB
from campaigns.spread import spread

TABLES = {"paper": FAULTS, "abb": FAULTS_OF_ABB}
LIMIT_S = 90
AT_ONCE = 2  # a driver often waits for an answer that does not come


def cases(
    numbers: Sequence[int] = (),
    phases: Sequence[Phase] = tuple(Phase),
    cell: str = "paper",
    seed: int = 1,
) -> Iterator[Case]:
    for fault in TABLES[cell]:
        if numbers and fault.number not in numbers:
            continue
        for phase in phases:
            if phase not in fault.skipped:
                for injection in fault.injections:
                    yield Case(fault.number, injection, phase, fault.procedure, cell, seed)


def fault_of(case: Case) -> Fault:
    return next(fault for fault in TABLES[case.cell] if fault.number == case.number)


def judge_case(case: Case) -> Judged:
    """Play and judge one case; one that hangs is judged so."""
    hasten()
    try:
        with limited(LIMIT_S):
            calm = undisturbed(case.procedure, case.cell, case.seed)
            return judged(fault_of(case), case, play(case), calm)
    except TimeoutError as error:
        return Judged("hangs", (str(error),))


@cache
def undisturbed(procedure: str, cell: str = "paper", seed: int = 1) -> Ran:
    """Return a run that nothing strikes."""
    return play(Case(0, Injection(), Phase.MEASURING, procedure, cell, seed))


COUNT = sum(1 for _ in cases())


def campaign(seeds: Sequence[int]) -> int:
    """Run the cases of these numbers, 1 the first; all of them write the page."""
    everything = list(cases())
    chosen = [everything[seed - 1] for seed in seeds if seed <= len(everything)]
    return report(chosen, whole=len(chosen) == len(everything))


def main(words: Sequence[str]) -> int:
    """Run the faults of some numbers, one phase or another cell; return 0 where every case holds.

    ``--machine-seed``: of the simulated cell.
    """
    parser = argparse.ArgumentParser(prog="python -m campaigns faults")
    parser.add_argument("number", nargs="*", type=int)
    parser.add_argument("--phase", choices=[phase.value for phase in Phase])
    parser.add_argument("--cell", choices=[*TABLES], default="paper")
    parser.add_argument("--machine-seed", type=int, default=1)
    args = parser.parse_args(words)
    if unknown := set(args.number) - {fault.number for fault in TABLES[args.cell]}:
        parser.error(f"no fault {', '.join(map(str, sorted(unknown)))}")
    phases = [Phase(args.phase)] if args.phase else list(Phase)
    chosen = list(cases(args.number, phases, args.cell, args.machine_seed))
    return report(chosen, whole=chosen == list(cases()))


def report(chosen: Sequence[Case], *, whole: bool) -> int:
    """Play cases and print what they show; the ``whole`` table becomes the page."""
    began_s, found = time.monotonic(), dict[Case, Judged]()
    for case, verdict in zip(chosen, spread(judge_case, chosen, at_once=AT_ONCE), strict=True):
        found[case] = verdict
        where = f"{case.number:2}  {case.phase.value:12}  {case.injection.text}"
        print(f"{where:70} {verdict.reaction}", flush=True)
        for problem in verdict.problems:
            print(f"      BROKEN: {problem}", flush=True)
    if whole:
        PAGE.write_text(page(found), "utf-8")
    places = {(case.number, case.phase) for case in chosen}
    bad = {(case.number, case.phase) for case, verdict in found.items() if verdict.problems}
    print(
        f"faults: {len(places) - len(bad)} of {len(places)} pairs of fault and phase that apply "
        f"hold ({len(chosen)} injections), "
        f"{time.monotonic() - began_s:.0f} s"
    )
    return 1 if bad else 0
