"""What holds for every test: the seeds of property tests, the number of workers, the browser.

Property tests judge results, not seconds: wall time says nothing on a busy machine. `make test`
draws the same examples every time, `make nightly` fresh ones and more of them.
"""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from signal import SIGHUP, SIGINT
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings

from fakes import simulator
from hilcell.journal import journal
from hilcell.journal.runs_folder import OVERRIDE as RUNS
from hilcell.programs.corrected import CorrectedPoints
from hilcell.run.cell_lock import OVERRIDE as LOCKS
from hilcell.run.signals import COMMANDS
from tests.cell_here import start_here
from tests.hilcell.report.browser import NAMES, found
from tests.leaks import no_leaks
from tests.whole.golden import GoldenRuns

os.environ["TZ"] = "UTC"  # the zone of the wall, whatever this machine has
time.tzset()
START = simulator._start
POPEN = subprocess.Popen.__init__

settings.register_profile(
    "suite",
    max_examples=25,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "nightly", settings.get_profile("suite"), derandomize=False, max_examples=1000
)
settings.register_profile(  # of a break: whether an example fails, not which is the least
    "breaks", settings.get_profile("suite"), phases=(Phase.explicit, Phase.generate)
)
settings.load_profile("suite")


@pytest.fixture(autouse=True)
def _apart(
    _of_this_session: None, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """Keep tests apart; one fixture does it all, since each costs every test.

    The test that leaves a thread, a file, a socket or a process behind fails, and is named.
    Handlers of signals are put back: a run in this process notes them until it ends. Only tests
    marked ``process`` or ``wall`` start processes; ``wall`` has the simulated cell in one, too.
    """
    before = {number: signal.getsignal(number) for number in COMMANDS}
    if request.node.get_closest_marker("wall"):
        monkeypatch.setattr(simulator, "_start", START)
    elif not request.node.get_closest_marker("process"):
        monkeypatch.setattr(subprocess.Popen, "__init__", _no_process)
    corrected = Path(os.environ[RUNS], CorrectedPoints.FILE)
    with no_leaks():
        yield
    corrected.unlink(missing_ok=True)
    for number, handler in before.items():
        if signal.getsignal(number) is not handler:
            signal.signal(number, handler)


@pytest.fixture(scope="session")
def _of_this_session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Serve simulated cells in this process; keep locks and runs away from the user's own.

    Journals that this process writes need not outlast a loss of power.
    """
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(journal, "SYNCHRONOUS", "OFF")
        patched.setattr(simulator, "_start", start_here)
        patched.setenv(LOCKS, str(tmp_path_factory.mktemp("locks")))
        patched.setenv(RUNS, str(tmp_path_factory.mktemp("runs")))
        yield


def _no_process(popen: Any, words: Any, *args: Any, **options: Any) -> None:
    if words[0] != "fc-list":  # matplotlib asks for the fonts of a machine, once
        raise AssertionError(f"{words}: a test that starts a process is marked `process` or `wall`")
    POPEN(popen, words, *args, **options)


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield the folder of temporary files, a new one whose name leaves room for a socket's."""
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("TMPDIR", folder)  # of processes that are started
        monkeypatch.setattr(tempfile, "tempdir", folder)
        yield Path(folder)


def pytest_xdist_auto_num_workers() -> int:
    """Return one for each processor that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def pytest_configure() -> None:
    """Heed signals, and look for no garbage while tests are collected: what is made there stays.

    A shell lets what it starts in the background ignore SIGINT, nohup SIGHUP, and so would every
    process of a test.
    """
    gc.disable()
    for number, handler in (SIGINT, signal.default_int_handler), (SIGHUP, signal.SIG_DFL):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Have each worker import its share of all tests first: a fresh clone is compiled once."""
    config = session.config
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker and config.args == config.getini("testpaths"):
        number, count = int(worker[2:]), int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
        files = sorted(config.rootpath.glob("tests/**/test_*.py"))
        for file in files[len(files) * number // count : len(files) * (number + 1) // count]:
            import_module(".".join(file.relative_to(config.rootpath).with_suffix("").parts))


def pytest_collection_finish() -> None:
    """Keep what is imported out of garbage collections: it stays, and to look at it takes 0.2 s.

    What a test leaves is looked for thirty times less often than usual: a tenth of its time.
    """
    gc.freeze()
    gc.set_threshold(20_000, 10, 10)
    gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest golden run; all else stays in its random order.

    One worker makes it from the start: anywhere else, others come upon it, too, and wait for it.
    """
    items.sort(key=lambda item: not _of_the_longest_run(item))


def _of_the_longest_run(item: pytest.Item) -> bool:
    """Whether a test needs the golden run of the paper."""
    fixtures = getattr(item, "fixturenames", ())
    params = getattr(getattr(item, "callspec", None), "params", {})
    return not {"paper", "whole"}.isdisjoint(fixtures) or (
        "golden" in fixtures and str(params.get("name")).startswith("paper")
    )


def pytest_report_header() -> str:
    """Name the browser in which the report is looked at."""
    none = f"none of {', '.join(NAMES)} is installed: its tests are skipped"
    return f"browser for the report: {found() or none}"


@pytest.fixture(scope="session")
def golden(tmp_path_factory: pytest.TempPathFactory) -> GoldenRuns:
    """Return runs by name, each made once for all workers, and for all lanes of `make test`."""
    return GoldenRuns(Path(os.environ.get("GOLDEN_RUNS") or shared_folder(tmp_path_factory)))


def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder that all workers share."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
