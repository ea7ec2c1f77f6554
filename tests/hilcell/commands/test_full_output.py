"""Data that stdout does not take are reported, with exit code 7; a run goes on to its end."""

import errno
import io
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from hilcell.commands.cli import main
from hilcell.commands.run_output import JsonOutput, print_lost
from hilcell.journal.journal import Record, read_journal
from hilcell.journal.runs import JOURNAL
from tests.hilcell.report.journals import validated_run

FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")
WORDS = "hilcell: stdout: cannot be written: "


@pytest.fixture
def run(tmp_path: Path) -> Path:
    validated_run(tmp_path / "s").ended()
    return validated_run(tmp_path / "r").ended()


@contextmanager
def full() -> Iterator[io.TextIOBase]:
    """A stdout as a command has it, into a full disk."""
    with FULL.open("w") as stdout:
        yield stdout


@contextmanager
def closed_pipe() -> Iterator[io.TextIOBase]:
    """A stdout that nobody reads any more."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stdout:
        yield stdout


COMMANDS = [
    ("show", "r", "--json"), ("show", "r"), ("runs",), ("runs", "--json"), ("watch", "r", "--json"),
    ("compare", "r", "s", "--json"), ("run", "home", "--dry-run", "--json"),
    ("run", "home", "--dry-run"),
]  # fmt: skip
OTHERS = [("explain", "HC-J14"), ("diagram",), ("check", "paper", "--json"), ("--help",)]


@needs_full
@pytest.mark.parametrize("words", [*((*words, "--runs", "") for words in COMMANDS), *OTHERS])
def test_a_command_into_a_full_disk_is_exit_7(
    run: Path,
    words: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = [word or str(run.parent) for word in words]
    with full() as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        assert main(given) == 7
    err = capsys.readouterr().err
    assert f"{WORDS}{os.strerror(errno.ENOSPC)}; " in err
    assert "Traceback" not in err


@needs_full
@pytest.mark.parametrize("words", [("report",), ("export", "--csv"), ("export", "--json")])
def test_a_file_on_a_full_disk_is_exit_7(
    run: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    name, *form = words
    given = [name, run.name, "--runs", str(run.parent), *form, "-o"]
    assert main([*given, str(FULL)]) == 7
    err = capsys.readouterr().err
    assert f"/dev/full: cannot be written: {os.strerror(errno.ENOSPC)}" in err
    assert main([*given, str(run.parent)]) == 2  # the name's fault


def test_a_command_into_a_closed_pipe_is_exit_7(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with closed_pipe() as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        assert main(["show", "r", "--json", "--runs", str(run.parent)]) == 7
    assert f"{WORDS}Broken pipe; " in capsys.readouterr().err


def test_a_closed_stdout_is_exit_7(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    assert main(["explain", "HC-J14"]) == 7
    assert f"{WORDS}it is closed; " in capsys.readouterr().err


def test_a_closed_stderr_puts_no_message_among_the_data(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    assert main(["explain", "HC-X99"]) == 2
    assert capsys.readouterr().out == ""


@needs_full
def test_the_interpreter_adds_no_words_of_its_own_at_its_end() -> None:
    with FULL.open("w") as stdout:
        done = subprocess.run(
            [sys.executable, "-m", "hilcell", "explain", "HC-J14"],
            stdout=stdout, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 7
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith(WORDS)


# -- a run ----------------------------------------------------------------------------------------

RECORD = Record(1, "2026-01-01T00:00:00+00:00", "event", "", {"what": "tick"})


@pytest.mark.parametrize("stdout", [pytest.param(full, marks=needs_full), closed_pipe])
def test_a_run_whose_output_is_lost_goes_on_and_says_so(
    tmp_path: Path,
    stdout: Callable[[], Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    output = JsonOutput("r")
    with stdout() as file:
        monkeypatch.setattr(sys, "stdout", file)
        output.take(RECORD)
        output.take(RECORD)
    print_lost(tmp_path / "r", output)
    err = capsys.readouterr().err
    assert err.startswith(WORDS)
    assert f"`hilcell watch {tmp_path / 'r'} --json` prints it" in err


@needs_full
@pytest.mark.parametrize("words", [("--json",), pytest.param((), marks=pytest.mark.nightly)])
def test_a_run_into_a_full_disk_ends_with_exit_7_and_a_whole_journal(
    tmp_path: Path,
    words: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with full() as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        assert main(["run", "world-frame", "--name", "r", "--runs", str(tmp_path), *words]) == 7
    end = read_journal(tmp_path / "r" / JOURNAL)[-1]
    assert (end.kind, end.body["state"], end.body["exit"]) == ("end", "finished", 0)
    err = capsys.readouterr().err
    assert WORDS in err
    assert "is whole" in err
    assert "resume with" not in err


def test_a_run_whose_messages_nobody_reads_any_more_comes_to_its_end(tmp_path: Path) -> None:
    """`hilcell run 2>&1 | head`: the bar's broken pipe ended the worker, and the run hung."""
    with closed_pipe() as stderr:
        done = subprocess.run(
            [sys.executable, "-m", "hilcell", "run", "world-frame", "--runs", str(tmp_path)],
            stdout=subprocess.PIPE, stderr=stderr.fileno(), text=True, timeout=60, check=False,
        )  # fmt: skip
    assert done.returncode == 0
    assert "points" in done.stdout
