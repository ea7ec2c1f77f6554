"""Every parser against hostile bytes: it refuses them in its own words, and never hangs.

With atheris (the extra ``torture``) inputs are guided by coverage; without it they are random
mutations of samples, which the table says. An input is a case, the first seed the generator's.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from campaigns.spread import print_table, progress, spread

COUNT = 1_000_000
NAMES = (
    "tracker", "robot", "sdo", "can", "journal-record", "journal-file", "calibration", "cell",
    "krl-program", "holes", "control", "screen", "eki", "rtde", "geocom", "t2sa", "strip",
    "urscript", "tp-listing", "rapid-module",
)  # fmt: skip
SECONDS = 3600  # a parser at most
_DONE = re.compile(r"Done (\d+) runs in (\d+) second")
_COVERED = re.compile(r"cov: (\d+) ft: (\d+)")
_FOUND = re.compile(r"^(?:FOUND .*|.*(?:Uncaught Python exception|ERROR: libFuzzer).*)$", re.M)
TAIL = 1500  # characters of what a fuzzer says in the end


class Budget(NamedTuple):
    """So many inputs, or so long, from a seed."""

    inputs: int
    seconds: int
    seed: int


@dataclass(frozen=True)
class Fuzzed:
    """``found`` are inputs neither accepted nor refused as declared, or that hung."""

    name: str
    by: str
    inputs: int
    seconds: int
    edges: int  # of the code that were reached; 0 where nobody counts
    found: str = ""


def fuzzed(budget: Budget, name: str) -> Fuzzed:
    """Fuzz one parser in a process of its own: a fuzzer ends the process that it lives in."""
    by = "atheris" if find_spec("atheris") else "mutation"
    words = [str(each) for each in budget]
    memory = Path("/dev/shm")  # files that live for one input need no disk
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as files:
        done = subprocess.run(
            [sys.executable, "-m", "campaigns.fuzz.fuzzer", by, name, *words],
            capture_output=True,
            text=True,
            errors="replace",
            env=os.environ | {"TMPDIR": files},  # a fuzzer that found something tidies nothing
            check=False,
        )
    return read_output(name, by, done.returncode, done.stdout + done.stderr)


def read_output(name: str, by: str, code: int, said: str) -> Fuzzed:
    ended = _DONE.findall(said)
    inputs, seconds = map(int, ended[-1]) if ended else (0, 0)
    covered = _COVERED.findall(said)
    whole = code == 0 and ended and not _FOUND.search(said)
    edges = int(covered[-1][0]) if covered else 0
    return Fuzzed(
        name, by, inputs, seconds, edges, "" if whole else said[-TAIL:] or "it said nothing"
    )


def campaign(seeds: range, names: Iterable[str] = NAMES, seconds: int = SECONDS) -> int:
    """Hand ``len(seeds)`` inputs to each parser, as far as the time reaches."""
    found = []
    for each in spread(partial(fuzzed, Budget(len(seeds), seconds, seeds.start)), names):
        progress(f"{each.name}: {each.inputs} inputs in {each.seconds} s, {each.found or 'sound'}")
        found.append(each)
    return 0 if report(found) else 1


def report(found: Iterable[Fuzzed]) -> bool:
    """Print the figures; return whether every parser is sound."""
    found = list(found)
    rows = [
        (each.name, each.by, each.inputs, f"{each.inputs / max(each.seconds, 1):.0f}",
         each.edges or "-", "FOUND" if each.found else "sound")
        for each in found
    ]  # fmt: skip
    print_table(("parser", "inputs by", "inputs", "a second", "edges", "verdict"), rows)
    for each in found:
        if each.found:
            print(f"FOUND {each.name}: {each.found}")
    print(f"{sum(each.inputs for each in found)} inputs, {len(found)} parsers")
    return not any(each.found for each in found)
