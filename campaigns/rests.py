"""Random rests where threads and processes hand over: a test that holds by luck alone fails.

A case is one run of the tests in event time with rests of up to `LONGEST_S` at a small share of the
starts of threads, signals between them, sends and receives of sockets, and appends to a journal. As
a plug-in of pytest it serves single files too, where a larger share shows more::

    python -m pytest -p campaigns.rests --rests 7 --share 0.03 tests/drivers
"""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from random import Random
from typing import Any

import pytest

from hilcell.journal.journal import Journal

COUNT = 1
LONGEST_S = 0.2
SHARE = 0.005
WORKERS = 8  # most of them rest

PLACES: list[tuple[type, str]] = [
    (threading.Thread, "start"),
    (threading.Thread, "run"),
    (threading.Event, "set"),
    (threading.Event, "wait"),
    (threading.Condition, "notify_all"),
    *((socket.socket, name) for name in ("accept", "close", "connect", "recv")),
    *((socket.socket, name) for name in ("send", "sendall", "sendto")),
    (Journal, "append"),
]


def campaign(seeds: range) -> int:
    """Run the tests in event time once for each seed; random order, so a failure names its own."""
    marks = "not (nightly or process or wall)"
    workers = ["-n", str(WORKERS), "--dist", "worksteal", "-m", marks]
    worst = 0
    for seed in seeds:
        rests = ["-p", "campaigns.rests", "--rests", str(seed)]
        done = subprocess.run([sys.executable, "-m", "pytest", *rests, *workers], check=False)
        print(f"seed {seed}: {'all pass' if done.returncode == 0 else 'a test holds by luck'}")
        worst = max(worst, done.returncode)
    return min(worst, 1)


def rest_at(places: list[tuple[type, str]], rest: Callable[[str], None]) -> pytest.MonkeyPatch:
    """Have every call of these methods tell ``rest`` before and after it; return what undoes it."""
    patches = pytest.MonkeyPatch()
    for owner, name in places:
        patches.setattr(
            owner, name, _rested(getattr(owner, name), f"{owner.__name__}.{name}", rest)
        )
    return patches


def _rested(
    call: Callable[..., Any], place: str, rest: Callable[[str], None]
) -> Callable[..., Any]:
    def rested(*args: Any, **options: Any) -> Any:
        rest(f"before {place}")
        answer = call(*args, **options)
        rest(f"after {place}")
        return answer

    rested.__name__ = call.__name__
    return rested


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--rests", type=int, default=1, help="seed of the rests")
    parser.addoption("--share", type=float, default=SHARE, help="of the hand-overs rest")


def pytest_configure(config: pytest.Config) -> None:
    worker = getattr(config, "workerinput", {"workerid": "alone"})["workerid"]
    random = Random(f"{config.getoption('rests')} {worker}")
    share = config.getoption("share")
    sleep = time.sleep  # a test may replace it

    def rest(place: str) -> None:
        if random.random() < share:
            sleep(LONGEST_S * random.random())

    config.add_cleanup(rest_at(PLACES, rest).undo)
