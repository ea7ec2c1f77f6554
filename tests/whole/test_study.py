"""`hilcell study` as its users run it: worker processes, a scheduler, kills; all on loopback."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hilcell import __version__
from hilcell.commands.cli import main
from hilcell.study import cluster
from hilcell.study.design import cases
from hilcell.study.results import Results, row_of
from hilcell.study.study_file import read_study
from tests.hilcell.study.studies import written
from tests.whole.bench import HILCELL, hilcell
from tests.whole.dask_bench import LIMIT_S, READINGS, scheduler, worker


def table(folder: Path) -> pa.Table:
    return pq.read_table(folder / "cases")


def test_one_worker_or_two_find_the_same_digits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, READINGS)
    one = hilcell("study", path, "--workers", "1", "-o", tmp_path / "one", "--json")
    assert one.returncode == 0, one.stderr
    two = hilcell("study", path, "--workers", "2", "-o", tmp_path / "two")
    assert two.returncode == 0, two.stderr
    assert table(tmp_path / "one") == table(tmp_path / "two")
    assert table(tmp_path / "one").num_rows == 4
    answers = json.loads(one.stdout)
    assert answers["counts"] == {"done": 4}
    assert {each["point"] for each in answers["front"]} <= {1, 2}
    assert "Pareto front" in two.stdout  # with its table: a file of both is whole
    assert "Pareto front" not in two.stderr
    assert "4 done" in two.stderr

    assert main(["study", str(path), "--workers", "1", "-o", f"{tmp_path}/one", "--json"]) == 0
    again = capsys.readouterr()
    assert "4 of them kept" in again.err
    assert again.out == one.stdout

    assert main(["study", "report", f"{tmp_path}/one", "--json"]) == 0
    assert capsys.readouterr().out == one.stdout
    html = (tmp_path / "one/report.html").read_text("utf-8")
    assert html.count("<svg") == 3
    assert "Study trial" in html


@contextmanager
def studying(path: Path, folder: Path, address: str = "") -> Iterator[subprocess.Popen[str]]:
    """Run a study with the workers of a scheduler, or with two of its own."""
    workers = ["--scheduler", address] if address else ["--workers", "2"]
    running = subprocess.Popen(
        [*HILCELL, "study", str(path), "-o", str(folder), *workers],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # as in a terminal of its own
    )
    try:
        yield running
    finally:
        running.kill()
        running.communicate(timeout=LIMIT_S)


@pytest.mark.nightly
def test_a_killed_worker_loses_one_case(tmp_path: Path) -> None:
    """Its case is measured by the other worker, with the same digits."""
    path, folder = written(tmp_path, READINGS, head="machines = 4"), tmp_path / "r"
    with (
        scheduler() as (address, _),
        worker(address),
        worker(address) as doomed,
        studying(path, folder, address) as running,
    ):
        _first_part(folder, running)
        doomed.kill()
        running.communicate(timeout=LIMIT_S)
    assert running.returncode == 0
    whole = hilcell("study", path, "-o", tmp_path / "whole")
    assert whole.returncode == 0
    assert table(folder) == table(tmp_path / "whole")


@pytest.mark.parametrize(
    ("number", "send"),
    [
        (signal.SIGINT, os.killpg),  # a terminal sends it to the workers as well
        pytest.param(signal.SIGTERM, os.kill, marks=pytest.mark.nightly),
    ],
)
def test_an_interruption_keeps_what_is_finished(
    tmp_path: Path, number: signal.Signals, send: Callable[[int, int], None]
) -> None:
    path, folder = written(tmp_path, READINGS, head="machines = 99"), tmp_path / "r"
    with studying(path, folder) as running:
        _first_part(folder, running)
        send(running.pid, number)
        _, errors = running.communicate(timeout=LIMIT_S)
    assert running.returncode == 4
    assert errors.splitlines()[-1] == (
        "hilcell: interrupted; finished cases are kept, the same command goes on"
    )
    assert "distributed" not in errors  # no worker's own log
    assert "Traceback" not in errors
    assert "leaked" not in errors
    assert 1 <= table(folder).num_rows < 198


@pytest.mark.parametrize(
    ("kept", "words"),
    [(1, "interrupted; finished cases are kept, the same command goes on"), (0, "interrupted")],
)
def test_an_interruption_before_the_first_new_case(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    kept: int, words: str,
) -> None:  # fmt: skip
    """As a restart of the PC while workers start: cases of an earlier session are kept."""

    class Stopped:
        def measure(self, _: object) -> Iterator[object]:
            signal.raise_signal(signal.SIGTERM)
            yield from ()

    path = written(tmp_path, READINGS)
    asked, figures = read_study(path), {"mean_mm": 0.1, "covered": 1.0, "targets": 8.0}
    results = Results(tmp_path / "r", asked)
    row = {"state": "done", "reason": "", "minutes": 9.0} | figures
    with results.held():
        results.add([row_of(case, row, asked) for case in list(cases(asked))[:kept]])
    monkeypatch.setattr("hilcell.commands.study._workers", lambda _: nullcontext(Stopped()))
    assert main(["study", str(path), "-o", str(tmp_path / "r")]) == 4
    assert capsys.readouterr().err.splitlines()[-1] == f"hilcell: {words}"


def test_a_scheduler_that_vanishes_is_one_message(tmp_path: Path) -> None:
    path, folder = written(tmp_path, READINGS, head="machines = 5"), tmp_path / "r"
    with (
        scheduler() as (address, process),
        worker(address),
        studying(path, folder, address) as running,
    ):
        _first_part(folder, running)
        process.kill()
        _, errors = running.communicate(timeout=LIMIT_S)
    assert running.returncode == 3
    assert errors.splitlines()[-1] == (
        f"hilcell: scheduler {address} is gone; finished cases are kept, the same command goes on"
    )
    assert "Error" not in errors
    kept = table(folder).num_rows
    assert 1 <= kept < 10
    done = hilcell("study", path, "-o", folder, "--workers", "1")
    assert done.returncode == 0, done.stderr
    assert f"{kept} of them kept" in done.stderr
    assert table(folder)["case"].to_pylist() == list(range(1, 11))


OLDER = """
import hilcell
hilcell.__version__ = "0.0.9"
"""


def site(folder: Path, **modules: str) -> dict[str, str]:
    """Return the environment of a process that finds these modules."""
    folder.mkdir(exist_ok=True)
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text)
    return {"PYTHONPATH": str(folder)}


def test_workers_that_differ_are_one_message(tmp_path: Path) -> None:
    path, older = written(tmp_path, READINGS), site(tmp_path / "site", sitecustomize=OLDER)
    with (
        scheduler() as (address, _),
        worker(address, **older),
        worker(address, OMP_NUM_THREADS="2"),
        worker(address, "--nthreads", "2"),
    ):
        done = hilcell("study", path, "-o", tmp_path / "r", "--scheduler", address)
    assert done.returncode == 2
    (line,) = [each for each in done.stderr.splitlines() if "workers differ" in each]
    assert f"scheduler {address}: workers differ: " in line
    assert f"hilcell 0.0.9 (here {__version__})" in line
    assert "threads of BLAS 2 (here 1)" in line
    assert "2 threads, wanted --nthreads 1" in line
    assert not (tmp_path / "r").exists()


@pytest.mark.nightly
def test_a_worker_of_another_version_that_comes_later(tmp_path: Path) -> None:
    """Its first case ends the study, not with a row; those of the others are kept."""
    path, folder = written(tmp_path, READINGS, head="machines = 9"), tmp_path / "r"
    older = site(tmp_path / "site", sitecustomize=OLDER)
    with (
        scheduler() as (address, _),
        worker(address),
        studying(path, folder, address) as running,
    ):
        _first_part(folder, running)
        with worker(address, **older):
            _, errors = running.communicate(timeout=LIMIT_S)
    assert running.returncode == 3
    last = errors.splitlines()[-1]
    assert f"hilcell 0.0.9 (here {__version__})" in last
    assert last.endswith("finished cases are kept, the same command goes on")
    assert set(table(folder)["state"].to_pylist()) == {"done"}


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


def test_a_case_that_kills_its_worker_each_time_is_a_row(tmp_path: Path) -> None:
    """Two workers die of it among others' cases, two more of it alone; the study goes on.

    They come one after another: a worker takes a second to start, and one is left over of two.
    """
    found = site(tmp_path / "site", deadly=DEADLY)
    (tmp_path / "site/deadly-1.dist-info").mkdir()
    (tmp_path / "site/deadly-1.dist-info/METADATA").write_text("Name: deadly\nVersion: 1\n")
    (tmp_path / "site/deadly-1.dist-info/entry_points.txt").write_text(ENTRY)
    path = written(tmp_path, KILLS, head="machines = 1")
    done = subprocess.run(
        [*HILCELL, "study", str(path), "-o", str(tmp_path / "r"), "--workers", "1"],
        capture_output=True, text=True, timeout=LIMIT_S, check=False, env=os.environ | found,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    rows = table(tmp_path / "r").to_pylist()
    assert [(row["cell"], row["state"]) for row in rows] == [
        ("paper", "done"),
        ("deadly", "failed"),
    ]
    assert rows[1]["reason"].startswith("its worker was killed each time, alone at last; the last")
    assert "1 done, 1 failed" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_pc_that_starts_no_worker_is_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As in a container without /dev/shm."""

    def nothing_shared(_: str) -> None:
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(cluster, "get_context", nothing_shared)
    before = dict(os.environ)
    assert main(["study", str(written(tmp_path)), "-o", str(tmp_path / "r")]) == 2
    assert dict(os.environ) == before  # what workers inherit is not left to others
    errors = capsys.readouterr().err
    assert "hilcell: this PC starts no workers: No such file or directory; is there a" in errors
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("kind", "answer", "words"),
    [
        ("tcp", None, "Timed out trying to connect"),
        ("tcp", b"", "nothing came for 0.5 s"),  # as one that froze
        ("tcp", b"\xff" * 4096, ""),
        ("tls", b"", "TLS expects a `ssl_context`"),
    ],
)
def test_no_scheduler_is_one_message(
    kind: str, answer: bytes | None, words: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Nobody, something else, or a scheduler whose certificates are not named here."""
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
        code = main(["study", str(path), "-o", str(tmp_path / "r"), "--scheduler", address])
        if answer:
            speaking.join(LIMIT_S)
    said = capsys.readouterr()
    assert (code, said.out) == (2, "")
    _, line = said.err.splitlines()
    assert line.startswith(f"hilcell: scheduler {address} does not answer: {words}")
    assert not (tmp_path / "r").exists()


def _speak(listening: socket.socket, answer: bytes) -> None:
    """Answer the first connection at once, and read until it ends."""
    connection, _ = listening.accept()
    with connection, suppress(OSError):
        connection.sendall(answer)
        while connection.recv(4096):
            pass


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("report",), "name the folder of results"),
        (("a.toml", "b"), "one word too many"),
        (("report", "r", "--workers", "2"), "--workers is for performing"),
        (("a.toml", "--workers", "0"), "a whole number of 1 .. 1024 is wanted, found '0'"),
        (("a.toml", "--scheduler", "host"), "tcp://HOST:PORT is wanted"),
        (("a.toml", "--workers", "2", "--scheduler", "tcp://h:1"), "name one"),
        (("report", "r"), "is no folder of results"),
    ],
)
def test_words_that_contradict_one_another(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], wanted: str
) -> None:
    try:
        code = main(["study", *words])
    except SystemExit as ended:
        code = int(str(ended.code))
    assert code == 2
    assert wanted in capsys.readouterr().err


def test_a_dry_run_lists_the_cases(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path)
    assert main(["study", str(path), "--dry-run", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["cases"]
    assert [each["case"] for each in listed] == list(range(1, 9))
    assert listed[1]["settings"] == {"layout.nest_samples": 2, "grid.centre.x_mm": 3850.0}
    assert main(["study", str(path), "--dry-run"]) == 0
    assert "far" in capsys.readouterr().out
    assert not (tmp_path / "study-results").exists()


def test_a_dry_run_of_many_cases_lists_the_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, head="machines = 300")
    assert main(["study", str(path), "--dry-run"]) == 0
    printed = capsys.readouterr()
    assert "│ 1000 │" in printed.out
    assert "│ 1001 │" not in printed.out
    assert "200 more cases; --json lists all" in printed.err
    assert main(["study", str(path), "--dry-run", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["cases"]) == 1200


def test_a_dry_run_of_a_search_says_that_more_follow(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = "optimise = { trials = 20, most_minutes = 30 }"
    path = written(tmp_path, head=f'machines = 2\ndesign = "optimise"\n{wanted}')
    assert main(["study", str(path), "--dry-run"]) == 0
    assert "it measures 40 cases at most" in capsys.readouterr().err


def _first_part(folder: Path, running: subprocess.Popen[str]) -> None:
    """Wait until a row is kept."""
    while not any((folder / "cases").glob("*.parquet")):
        assert running.poll() is None, running.communicate()
        time.sleep(0.02)


def test_a_missing_package_is_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("hilcell.study.results")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["study", str(written(tmp_path))]) == 2
    assert "pip install 'hilcell[study]'" in capsys.readouterr().err
