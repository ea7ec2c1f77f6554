"""Processes of Dask on loopback, for studies."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from distributed import LocalCluster

from tests.hilcell.study.studies import TWO_FACTORS

READINGS = TWO_FACTORS.partition('\n[[factor]]\nname = "place"')[0]


class Dask:
    """A command of Dask, once it has printed ``ready``; that line is kept."""

    def __init__(self, *words: str, ready: str, **environment: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--no-dashboard"],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"} | environment,
        )
        self.line, self.lines, self._said = "", list[str](), threading.Event()
        self._reader = threading.Thread(target=self._read, args=(ready,))
        self._reader.start()
        self._said.wait()
        if not self.line:
            self.kill()
            pytest.fail(f"dask {words[0]} never said {ready!r}")

    def _read(self, ready: str) -> None:
        """Look for the line, then read on: the pipe never fills."""
        assert self.process.stderr is not None
        for each in self.process.stderr:
            self.lines.append(each)
            if ready in each and not self.line:
                self.line = each
                self._said.set()
        self._said.set()

    @property
    def named(self) -> str:
        return next(each.split()[-1] for each in self.lines if "Start worker at" in each)

    def kill(self) -> None:
        """End it, at once; a second time does nothing."""
        self.process.kill()
        self.process.wait()
        self._reader.join()
        assert self.process.stderr is not None
        self.process.stderr.close()


@contextmanager
def scheduler(**environment: str) -> Iterator[tuple[str, Dask]]:
    words = ("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-show")
    started = Dask(*words, ready="Scheduler at:", **environment)
    try:
        yield started.line.split()[-1], started
    finally:
        started.kill()


@contextmanager
def scheduler_here() -> Iterator[str]:
    """Run a scheduler with a worker in threads of the test; yield its address."""
    with LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
    ) as serving:
        yield serving.scheduler_address


@contextmanager
def worker(address: str, *words: str, **environment: str) -> Iterator[Dask]:
    given = words or ("--nthreads", "1")
    started = Dask("worker", address, "--no-nanny", *given, ready="Registered to", **environment)
    try:
        yield started
    finally:
        started.kill()
