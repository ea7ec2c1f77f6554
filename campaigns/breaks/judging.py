"""Runs tests in processes forked from one that has imported what the product and pytest need.

The product itself is not imported there: each fork imports it, with its break.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing import connection, get_context
from pathlib import Path

import pytest

from campaigns.breaks.patch import Patch, install

LIMIT_S = 600.0
TEST_S = 60
PYTEST = (
    "-q", "--timeout", f"{TEST_S}", "-p", "no:randomly", "-p", "no:cacheprovider",
    "--assert", "plain", "--tb", "short", "--hypothesis-profile", "breaks",
)  # fmt: skip
SITE = Path(__file__).with_name("site")
HEAVY = (
    "alembic.command", "can", "canopen", "cryptography.hazmat.primitives.asymmetric.ed25519",
    "distributed", "hypothesis.strategies", "jinja2", "matplotlib.figure", "msgspec",
    "numpy.testing", "pyarrow.parquet", "pyte", "rich.table", "scipy.interpolate",
    "scipy.optimize", "scipy.spatial.transform", "scipy.special", "scipy.stats", "serial",
    "sqlalchemy", "textual.app", "transitions", "xlsxwriter",
)  # fmt: skip
FORK = get_context("fork")


@dataclass(frozen=True, slots=True)
class Run:
    """Tests that run in one process, with a break or without."""

    name: str
    tests: Sequence[str]
    patch: Patch | None = None
    options: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Ended:
    """How a run ended: pytest's exit code, the tests that failed, and what it printed."""

    run: Run
    code: int
    took_s: float
    failed: Sequence[str]
    output: str


def prepare() -> None:
    """Import what is slow to import, once for all forks."""
    for name in HEAVY:
        import_module(name)


def run_all(runs: Sequence[Run], workers: int, folder: Path) -> Iterator[Ended]:
    """Yield how each run ended, ``workers`` at a time."""
    waiting, live = deque(enumerate(runs)), list[_Live]()
    try:
        while waiting or live:
            while waiting and len(live) < workers:
                number, run = waiting.popleft()
                live.append(_Live(run, folder / str(number)))
            connection.wait([each.process.sentinel for each in live], timeout=1.0)
            for each in [each for each in live if each.over]:
                live.remove(each)
                yield each.ended()
    finally:
        for each in live:
            each.kill()


class _Live:
    """A run that is under way."""

    def __init__(self, run: Run, folder: Path) -> None:
        self._run, self._folder = run, folder
        folder.mkdir()
        self.process = FORK.Process(target=_perform, args=(run, folder))
        self._began_s = time.monotonic()
        self.process.start()

    @property
    def over(self) -> bool:
        """Whether the process has ended, or is to be ended."""
        took_s = time.monotonic() - self._began_s
        return self.process.exitcode is not None or took_s > LIMIT_S

    def ended(self) -> Ended:
        """End all that is left of the run, and return how it ended."""
        took_s = time.monotonic() - self._began_s
        self.kill()
        failed, output = self._folder / "failed", self._folder / "output"
        return Ended(
            self._run,
            self.process.exitcode or 0,
            took_s,
            failed.read_text("utf-8").split("\n") if failed.exists() else [],
            output.read_text("utf-8", "replace") if output.exists() else "",
        )

    def kill(self) -> None:
        """End the process and all that it has started."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.ident or 0, signal.SIGKILL)
        self.process.join()


@dataclass(eq=False)  # pytest hashes its plugins
class _Failures:
    """A plugin of pytest that notes which tests failed."""

    tests: list[str] = field(default_factory=list)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.tests.append(report.nodeid)


def _perform(run: Run, folder: Path) -> None:
    """Run the tests in this process, a fork that has nothing of the product yet."""
    os.setsid()
    _redirect(folder / "output")
    if run.patch is not None:
        os.environ |= run.patch.environment() | {"PYTHONPATH": str(SITE)}
        install()
    failures = _Failures()
    words = [*PYTEST, "--basetemp", str(folder / "t"), *run.options, *run.tests]
    try:
        code = pytest.main(words, plugins=[failures])
    finally:  # also where a test that failed left what only the end of pytest finds
        if failures.tests:
            (folder / "failed").write_text("\n".join(failures.tests), "utf-8")
    sys.exit(int(code))


def _redirect(output: Path) -> None:
    """Read nothing, and write to a file."""
    for path, flags, numbers in (
        (os.devnull, os.O_RDONLY, (0,)),
        (output, os.O_WRONLY | os.O_CREAT, (1, 2)),
    ):
        opened = os.open(path, flags, 0o600)
        for number in numbers:
            os.dup2(opened, number)
        os.close(opened)
