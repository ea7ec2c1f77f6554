"""`hilcell study` with worker processes, a scheduler, kills; all on loopback."""

from __future__ import annotations

import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from multiprocessing import active_children, resource_tracker
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import hilcell.__main__
from hilcell.cell.file import Cell
from hilcell.commands.cli import main
from hilcell.study import cluster
from hilcell.study.case import CaseResult, calibrate_case, encode_cell, versions
from hilcell.study.cluster import ClusterError
from hilcell.study.design import Case, cases
from hilcell.study.results import Results, case_row
from hilcell.study.study_file import read_study, study_cell
from tests.hilcell.cell.packages import install
from tests.hilcell.study.studies import Bench, performed, study, written
from tests.whole.bench import HILCELL, command
from tests.whole.dask_bench import READINGS, scheduler, scheduler_here, worker


def table(folder: Path) -> pa.Table:
    return pq.read_table(folder / "cases")


def measured_here(path: Path, folder: Path) -> pa.Table:
    """Return the rows of a study that this process measures by itself."""

    def calibrated(case: Case, cell: Cell) -> CaseResult:
        return calibrate_case(encode_cell(cell), case.machine, case.seed, versions())

    performed(Results(folder, read_study(path)), Bench(calibrated))
    return table(folder)


@pytest.fixture(scope="module")
def _tracker() -> Iterator[None]:
    """Start the process that Python keeps beside workers of its own; it stays.

    Workers import the main module again: that of `hilcell`, not pytest.
    """
    resource_tracker.ensure_running()
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(sys.modules, "__main__", hilcell.__main__)
        yield


@pytest.mark.process
@pytest.mark.usefixtures("_tracker")
def test_workers_find_the_digits_of_this_process(tmp_path: Path) -> None:
    path, folder = written(tmp_path, READINGS, head="machines = 1"), tmp_path / "r"
    done = command("study", path, "--workers", "2", "-o", folder, "--json")
    assert done.returncode == 0, done.stderr
    assert table(folder) == measured_here(path, tmp_path / "here")
    answers = json.loads(done.stdout)
    assert answers["counts"] == {"done": 2}
    assert {each["point"] for each in answers["front"]} <= {1, 2}
    again = command("study", path, "--workers", "1", "-o", folder, "--json")
    assert (again.returncode, again.stdout) == (0, done.stdout)
    assert command("study", "report", folder, "--json").stdout == done.stdout
    assert (folder / "report.html").read_text("utf-8").count("<svg") == 3


FOREIGN = """
import asyncio, json, os, ssl, sys
from distributed.comm.core import connect
from distributed.security import Security

if os.getuid() == 0:
    os.setuid(65534)  # nobody

async def asked(address, given):
    comm = await connect(address, timeout=5.0, **given)
    try:
        await comm.write({"op": "identity", "reply": True})
        return str(await comm.read())
    finally:
        comm.abort()

certified = Security.temporary().get_connection_args("client")  # by itself, and trusting anybody
certified["ssl_context"].verify_mode = ssl.CERT_NONE
ways = [("tcp", {}), ("tls", certified | {"require_encryption": False})]
answers = []
for place in sys.argv[1:]:
    for protocol, given in ways:
        try:
            answers.append(asyncio.run(asked(f"{protocol}://{place}", given)))
        except (OSError, ValueError):
            pass
print(json.dumps(answers))
"""


@pytest.mark.process
@pytest.mark.usefixtures("_tracker")
def test_another_user_of_the_pc_gets_no_answer() -> None:
    """Neither from the scheduler nor from a worker, whose ports any user can connect to."""
    with cluster.local_workers(1, print) as workers:
        known = workers._client.scheduler_info()
        addresses = [known["address"], *known["workers"]]
        addresses += [each["nanny"] for each in known["workers"].values()]
        places = [address.partition("://")[2] for address in addresses]
        foreign = [sys.executable, "-c", FOREIGN, *places]
        done = subprocess.run(foreign, capture_output=True, text=True, check=True)
    assert len(places) == 3
    assert json.loads(done.stdout) == []


@contextmanager
def studying(path: Path, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a study with a worker, in a session of its own as in a terminal."""
    running = subprocess.Popen(
        [*HILCELL, "study", str(path), "-o", str(folder), "--workers", "1"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        yield running
    finally:
        running.kill()
        running.communicate()


@pytest.mark.process
@pytest.mark.parametrize(
    ("number", "send"),
    [
        (signal.SIGINT, os.killpg),  # a terminal sends it to the workers as well
        pytest.param(signal.SIGTERM, os.kill, marks=pytest.mark.nightly),
    ],
)
def test_an_interruption_keeps_finished_cases(
    tmp_path: Path, number: signal.Signals, send: Callable[[int, int], None]
) -> None:
    path, folder = written(tmp_path, READINGS, head="machines = 99"), tmp_path / "r"
    with studying(path, folder) as running:
        while not any((folder / "cases").glob("*.parquet")):
            with suppress(subprocess.TimeoutExpired):
                pytest.fail(f"it ended with {running.wait(0.05)}: {running.communicate()}")
        send(running.pid, number)
        _, errors = running.communicate()
    assert running.returncode == 4
    assert not any(word in errors for word in ("distributed", "Traceback", "leaked"))
    assert 1 <= table(folder).num_rows < 198


@pytest.mark.parametrize("kept", [1, 0])
@pytest.mark.parametrize(("lost", "code"), [(False, 4), (True, 3)])
def test_a_study_that_ends_early_says_whether_cases_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept: int, lost: bool, code: int
) -> None:
    """As a restart of the PC while workers start: cases of an earlier session are kept."""

    class Ends(Bench):
        def measure(
            self, waiting: Iterable[tuple[Case, bytes]]
        ) -> Iterator[tuple[Case, CaseResult]]:
            if not lost:
                signal.raise_signal(signal.SIGTERM)
            yield from super().measure(waiting)

    path = written(tmp_path, READINGS)
    asked = read_study(path)
    found = CaseResult("done", "", 9.0, {"mean_mm": 0.1, "covered": 1.0, "targets": 8.0})
    results = Results(tmp_path / "r", asked)
    with results.held():
        results.add([case_row(case, found, asked) for case in list(cases(asked))[:kept]])
    ends = Ends(lambda case, cell: found, most=kept)
    monkeypatch.setattr("hilcell.commands.study._workers", lambda _: nullcontext(ends))
    done = command("study", path, "-o", tmp_path / "r")
    assert done.returncode == (code if kept or not lost else 2)
    assert ("continues" in done.stderr.splitlines()[-1]) is bool(kept)


class Frozen(BaseException):
    """The message on the worker that froze: it ends a test's study, and is no worker's error."""


@pytest.mark.nightly
@pytest.mark.wall
def test_workers_and_schedulers_that_froze_or_are_gone_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each limit is shortened where nothing can answer any more.

    A worker freezes in the middle of a study, where it may hold rows that nobody has read, and
    before one. The other may be late as well on a busy PC: what is said of it does not matter.
    """
    monkeypatch.setattr(cluster, "POLL_S", 0.1)
    monkeypatch.setattr(cluster, "SILENT_S", 2.0)
    with (
        scheduler() as (address, asked),
        worker(address) as last,
        worker(address) as frozen,
        monkeypatch.context() as patch,
    ):
        at = frozen.named

        def said(words: str) -> None:
            if at in words:
                raise Frozen

        with cluster.scheduler_workers(address, said) as workers:
            rows = _begun(workers, tmp_path)
            frozen.process.send_signal(signal.SIGSTOP)
            with pytest.raises(Frozen):
                list(rows)
        patch.setattr(cluster, "VERSIONS_S", 1.0)
        with pytest.raises(ClusterError, match=at), cluster.scheduler_workers(address, print):
            raise AssertionError("it can be used")
        patch.undo()
        frozen.kill()
        with cluster.scheduler_workers(address, print) as workers:
            rows = _begun(workers, tmp_path)
            last.kill()
            patch.setattr(cluster, "WORKERS_S", 0.5)
            with pytest.raises(ClusterError, match=r"no worker for 0\.5 s"):
                list(rows)
            asked.process.send_signal(signal.SIGSTOP)
            patch.setattr(cluster, "SCHEDULER_S", 0.5)
            with pytest.raises(ClusterError, match=address):
                list(workers.measure(iter(())))
            asked.process.send_signal(signal.SIGCONT)


def _begun(workers: cluster.Workers, folder: Path) -> Iterator[tuple[Case, CaseResult]]:
    """Begin a long study; return its rows after the first."""
    rows = workers.measure(_many(folder))
    assert next(rows)[1].state == "done"
    return rows


def _many(folder: Path) -> Iterator[tuple[Case, bytes]]:
    asked = study(folder, READINGS, "machines = 99")
    return ((case, encode_cell(study_cell(asked, case.point.values))) for case in cases(asked))


@pytest.mark.nightly
@pytest.mark.wall
@pytest.mark.usefixtures("_tracker")
def test_a_worker_of_this_pc_that_froze_is_restarted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask takes no shorter time than ten heartbeats, 5 s; no case is lost."""
    monkeypatch.setattr(cluster, "POLL_S", 0.1)
    monkeypatch.setattr(cluster, "SILENT_S", 2.0)
    monkeypatch.setitem(cluster.SETTINGS, "distributed.scheduler.worker-ttl", "2s")
    asked = study(tmp_path, READINGS, "machines = 2")
    waiting = ((case, encode_cell(study_cell(asked, case.point.values))) for case in cases(asked))
    said = list[str]()
    with cluster.local_workers(1, said.append) as workers:
        rows = workers.measure(waiting)
        found = [next(rows)]
        (process,) = [each for each in active_children() if each.name.startswith("Dask Worker")]
        assert process.pid is not None
        os.kill(process.pid, signal.SIGSTOP)
        found += rows
    assert sorted(case.number for case, _ in found) == [1, 2, 3, 4]
    assert {row.state for _, row in found} == {"done"}
    assert said


@pytest.mark.nightly
@pytest.mark.wall
def test_a_killed_worker_loses_no_case(tmp_path: Path) -> None:
    """Its case is measured by the other worker, with the same digits."""
    asked = study(tmp_path, READINGS, "machines = 3")
    found: dict[int, CaseResult] = {}
    with (
        scheduler() as (address, _),
        worker(address),
        worker(address) as doomed,
        cluster.scheduler_workers(address, print) as workers,
    ):
        waiting = (
            (case, encode_cell(study_cell(asked, case.point.values))) for case in cases(asked)
        )
        for case, row in workers.measure(waiting):
            found[case.number] = row
            doomed.kill()
    wanted = measured_here(tmp_path / "study.toml", tmp_path / "r").to_pylist()
    assert [row["mean_mm"] for row in wanted] == [found[n].figures["mean_mm"] for n in range(1, 7)]


OLDER = 'import hilcell\nhilcell.__version__ = "0.0.9"\n'


@pytest.mark.process
def test_a_worker_that_differs_measures_nothing(tmp_path: Path) -> None:
    """One that comes later ends the study, not with a row."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site/sitecustomize.py").write_text(OLDER)
    waiting = _many(tmp_path)
    with ExitStack() as stack:
        address = stack.enter_context(scheduler_here())
        with cluster.scheduler_workers(address, print) as workers:
            ((_, first),) = workers.measure(itertools.islice(waiting, 1))
            assert first.state == "done"
            site = str(tmp_path / "site")
            stack.enter_context(worker(address, "--nthreads", "2", PYTHONPATH=site))
            with pytest.raises(ClusterError, match=r"0\.0\.9"):
                assert {row.state for _, row in workers.measure(waiting)} == {"done"}
        done = command(
            "study", tmp_path / "study.toml", "-o", tmp_path / "r", "--scheduler", address
        )
    assert done.returncode == 2
    assert "hilcell 0.0.9" in done.stderr
    assert "--nthreads 1" in done.stderr
    assert not (tmp_path / "r").exists()


DEADLY = """
import os, signal

class Deadly:
    def __init__(self, cell, seed):
        os.kill(os.getpid(), signal.SIGKILL)
"""
ENTRY = "[hilcell.in_process_cells]\ndeadly = deadly:Deadly\n"
KILLS = """
[[factor]]
name = "cell"
setting = "simulation.simulator"
levels = ["paper", "deadly"]
"""


@pytest.mark.process
@pytest.mark.usefixtures("_tracker")
def test_a_case_that_kills_its_worker_each_time_is_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One worker dies of it among others' cases, one more of it alone; the study goes on."""
    monkeypatch.setitem(cluster.SETTINGS, "distributed.scheduler.allowed-failures", 0)
    install(tmp_path / "site", ENTRY, deadly=DEADLY)
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    path = written(tmp_path, KILLS, head="machines = 1")
    done = command("study", path, "-o", tmp_path / "r", "--workers", "1")
    assert done.returncode == 1, done.stderr
    rows = table(tmp_path / "r").to_pylist()
    assert [(row["cell"], row["state"]) for row in rows] == [
        ("paper", "done"),
        ("deadly", "failed"),
    ]
    assert "Traceback" not in done.stderr


def test_a_pc_that_starts_no_worker_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container without /dev/shm."""

    def nothing_shared(_: str) -> None:
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(cluster, "get_context", nothing_shared)
    before = dict(os.environ)
    assert main(["study", str(written(tmp_path)), "-o", str(tmp_path / "r")]) == 2
    assert dict(os.environ) == before  # what workers inherit is not left to others
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("kind", "answer"),
    [("tcp", None), ("tcp", b""), ("tcp", b"\xff" * 4096), ("tls", b"")],
    ids=["nobody", "silent", "something else", "no certificates"],
)
def test_no_scheduler_is_refused(
    kind: str, answer: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None of them would answer later."""
    monkeypatch.setattr(cluster, "CONNECT_S", 0.2)
    monkeypatch.setattr(cluster, "ANSWER_S", 0.5)
    path = written(tmp_path, READINGS)
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        address = f"{kind}://127.0.0.1:{listening.getsockname()[1]}"
        if answer is not None:
            listening.listen()
        speaking = threading.Thread(target=_speak, args=(listening, answer))
        if answer:
            speaking.start()
        done = command("study", path, "-o", tmp_path / "r", "--scheduler", address)
        if answer:
            speaking.join()
    assert (done.returncode, done.stdout) == (2, "")
    assert address in done.stderr
    assert not (tmp_path / "r").exists()


def _speak(listening: socket.socket, answer: bytes) -> None:
    """Answer the first connection at once, and read until it ends."""
    connection, _ = listening.accept()
    with connection, suppress(OSError):
        connection.sendall(answer)
        while connection.recv(4096):
            pass


def test_a_dry_run_lists_the_cases(tmp_path: Path) -> None:
    path = written(tmp_path)
    found = json.loads(command("study", path, "--dry-run", "--json").stdout)
    listed, plans = found["cases"], found["points"]
    assert [each["case"] for each in listed] == list(range(1, 9))
    assert listed[1]["settings"] == {"layout.nest_samples": 2, "grid.centre.x_mm": 3850.0}
    assert [each["point"] for each in plans] == [1, 2, 3, 4]
    assert [each["minutes"] is None for each in plans] == [False, True, False, True]  # far
    assert ["grid" in each["cannot_be"] for each in plans] == [False, True, False, True]
    cell = encode_cell(study_cell(read_study(path), listed[0]["settings"]))
    assert calibrate_case(cell, 1, 1, versions()).minutes == plans[0]["minutes"]
    shown = command("study", path, "--dry-run").stdout
    assert "far" in shown
    assert f"{plans[0]['minutes']:.1f}" in shown
    assert "points that cannot be: 2, 4" in shown  # with the reason, once
    many = written(tmp_path, head="machines = 300")
    printed = command("study", many, "--dry-run")
    assert "│ 1000 │" in printed.stdout
    assert "│ 1001 │" not in printed.stdout
    assert "200 more" in printed.stderr
    search = written(
        tmp_path,
        head='machines = 2\ndesign = "optimise"\noptimise = { trials = 20, most_minutes = 30 }',
    )
    assert "40 cases" in command("study", search, "--dry-run").stderr
    assert not (tmp_path / "study-results").exists()


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("hilcell.study.results")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    done = command("study", written(tmp_path))
    assert done.returncode == 2
    assert "'.[study]'" in done.stderr
