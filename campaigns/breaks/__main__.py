"""`make mutants`: make each break, run its tests, and report what survives."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from campaigns.breaks.judging import Ended, Run, prepare, run_all
from campaigns.breaks.patch import RottenError
from campaigns.breaks.table import Break, breaks

CAUGHT, TOGETHER = "caught", 20
# Exit codes of pytest; all others mean that the tests did not run.
VERDICTS = {0: "SURVIVED", 1: CAUGHT, -9: "TIMEOUT"}


def main(words: list[str]) -> int:
    """Return 0 where every break is caught, 1 where one is not or cannot be made, 2 for words."""
    parser = argparse.ArgumentParser("python -m campaigns.breaks")
    parser.add_argument("only", nargs="*", metavar="NAME", help="a break, or a room: hilcell.run")
    parser.add_argument("--check", action="store_true", help="see whether they can be made")
    args = parser.parse_args(words)
    chosen = [each for each in breaks() if not args.only or _is_one(each, args.only)]
    if not chosen:
        parser.error(f"no break {', '.join(args.only)}")
    began_s, runs = time.monotonic(), sound(chosen)
    missed = [] if args.check else judged(runs)
    for verdict, each in missed:
        print(f"\n{each.run.name}: {verdict}\n{each.output}")
    what = "can be made" if args.check else "caught"
    good, took_s = len(runs) - len(missed), time.monotonic() - began_s
    print(f"{good} of {len(chosen)} breaks {what}, in {took_s:.0f} s")
    return 0 if good == len(chosen) else 1


def _is_one(each: Break, only: Sequence[str]) -> bool:
    return any(word == each.name or each.target.startswith(f"{word}.") for word in only)


def sound(chosen: Sequence[Break]) -> list[Run]:
    """Return the runs of the breaks that can be made, and print which cannot."""
    runs = []
    for each in chosen:
        try:
            runs.append(Run(each.name, each.tests, each.patch(), ("-x",)))
        except RottenError as error:
            print(f"ROTTEN    {each.name}: {error}", flush=True)
    return runs


def judged(runs: Sequence[Run]) -> list[tuple[str, Ended]]:
    """Judge breaks, print each, and return those that are not caught, with the verdict."""
    prepare()
    workers, missed = len(os.sched_getaffinity(0)), list[tuple[str, Ended]]()
    caught: dict[str, list[Ended]] = {}  # by the test that failed
    with tempfile.TemporaryDirectory(prefix="breaks-") as folder:
        for each in run_all(runs, workers, Path(folder)):
            verdict = VERDICTS.get(each.code, "NOT RUN")
            test = each.failed[0] if each.failed else ""
            print(f"{verdict:9}{each.took_s:6.1f} s  {each.run.name}  {test}", flush=True)
            if verdict == CAUGHT:
                caught.setdefault(test, []).append(each)
            else:
                missed.append((verdict, each))
    failing = failing_without(sorted(caught), workers)
    if failing:
        print("these tests fail without a break:", *failing, sep="\n")
    return missed + [("NOT PROVEN", each) for test in failing for each in caught[test]]


def failing_without(tests: Sequence[str], workers: int) -> list[str]:
    """Return which tests fail without any break: they prove nothing."""
    parts = [tests[start : start + TOGETHER] for start in range(0, len(tests), TOGETHER)]
    runs = [Run("no break", part) for part in parts]
    with tempfile.TemporaryDirectory(prefix="breaks-") as folder:
        return sorted(
            test
            for each in run_all(runs, workers, Path(folder))
            for test in (each.failed if each.code in (0, 1) else each.run.tests)
        )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
