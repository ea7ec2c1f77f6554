"""`make mutants`: apply each break to a copy, run its tests, and report what survives."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from queue import SimpleQueue

from tests.mutants.judging import PASSED, Copy, Verdict
from tests.mutants.table import ROOT, Mutant, mutants

PROFILE = ("--hypothesis-profile", "mutants")


def main(only: list[str]) -> int:
    """Return 0 where every break is caught, 1 where one is not, 2 where the tests fail without."""
    chosen = [mutant for mutant in mutants() if not only or mutant.name in only]
    if unknown := set(only) - {mutant.name for mutant in chosen}:
        print("no break", *unknown)
        return 2
    for mutant in chosen:
        mutant.check(ROOT)
    began_s, workers = time.monotonic(), min(len(os.sched_getaffinity(0)), len(chosen))
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copies = [Copy(ROOT, Path(folder, str(number)), *PROFILE) for number in range(workers)]
        tests = sorted({test for mutant in chosen for test in mutant.tests})
        code, output = copies[0].run(tests, "-x", "-n", str(workers))
        if code != PASSED:
            print(output, "\nthe tests fail without any break", sep="")
            return 2
        print(f"{len(tests)} tests or files pass without a break", flush=True)
        missed = [each for each in judged(copies, chosen) if not each.caught]
    for each in missed:
        print(f"\n{each.name}: {each.verdict}\n{each.output}")
    took_s = time.monotonic() - began_s
    print(f"{len(chosen) - len(missed)} of {len(chosen)} breaks caught in {took_s:.0f} s")
    return 1 if missed else 0


def judged(copies: list[Copy], chosen: list[Mutant]) -> list[Verdict]:
    """Judge breaks, as many at a time as there are copies, and print each."""
    free: SimpleQueue[Copy] = SimpleQueue()
    for copy in copies:
        free.put(copy)

    def judge(mutant: Mutant) -> Verdict:
        copy = free.get()
        try:
            return copy.judge(mutant)
        finally:
            free.put(copy)

    verdicts = []
    with ThreadPoolExecutor(len(copies)) as pool:
        for future in as_completed([pool.submit(judge, mutant) for mutant in chosen]):
            verdict = future.result()
            print(f"{verdict.verdict:9}{verdict.took_s:6.1f} s  {verdict.name}", flush=True)
            verdicts.append(verdict)
    return verdicts


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
