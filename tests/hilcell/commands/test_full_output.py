"""Data that stdout does not take are reported, with exit code 7; a run goes on to its end."""

import errno
import io
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
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
    stdout = os.fdopen(writer, "w")
    try:
        yield stdout
    finally:
        with suppress(BrokenPipeError):
            stdout.close()


COMMANDS = [
    ("show", "r", "--json"), ("show", "r"), ("runs",), ("watch", "r", "--json"),
    ("compare", "r", "s", "--json"), ("run", "home", "--dry-run"),
]  # fmt: skip
OTHERS = [("explain", "HC-J14"), ("diagram",), ("check", "paper", "--json"), ("--help",)]


def lost(err: str) -> bool:
    """Whether the only line of a command's messages is that its output is lost."""
    return err.startswith("hilcell: stdout ") and err.count("\n") == 1


@pytest.mark.parametrize("words", [*((*words, "--runs", "") for words in COMMANDS), *OTHERS])
@pytest.mark.parametrize(
    ("stdout", "why"),
    [pytest.param(full, os.strerror(errno.ENOSPC), marks=needs_full),
     (closed_pipe, os.strerror(errno.EPIPE)), (nullcontext, "it is closed")],
    ids=["full disk", "closed pipe", "none"],
)  # fmt: skip
def test_a_command_whose_stdout_cannot_be_written_is_exit_7(
    run: Path,
    words: tuple[str, ...],
    stdout: Callable[[], Any],
    why: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = [word or str(run.parent) for word in words]
    with stdout() as file:
        monkeypatch.setattr(sys, "stdout", file)
        assert main(given) == 7
    err = capsys.readouterr().err
    assert f"hilcell: stdout cannot be written: {why}" in err
    assert err.splitlines()[-1].startswith("hilcell: stdout ")


@needs_full
@pytest.mark.parametrize("words", [("report",), ("export", "--csv"), ("export", "--json")])
def test_a_file_on_a_full_disk_is_exit_7(
    run: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    name, *form = words
    given = [name, run.name, "--runs", str(run.parent), *form, "-o"]
    assert main([*given, str(FULL)]) == 7
    err = capsys.readouterr().err
    assert "/dev/full" in err
    assert main([*given, str(run.parent)]) == 2  # the name's fault


def test_a_file_that_is_a_closed_pipe_is_exit_7(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`hilcell export RUN --json -o /dev/stdout | true` was exit 2, as if its name were wrong."""
    with closed_pipe() as stdout:
        out = f"/dev/fd/{stdout.fileno()}"
        words = ["export", "r", "--json", "-o", out, "--runs", str(run.parent)]
        assert main(words) == 7
    err = capsys.readouterr().err
    assert f"hilcell: {out}: cannot be written: {os.strerror(errno.EPIPE)}; " in err
    assert "use a reader that reads to the end" in err


def test_a_closed_stderr_puts_no_message_among_the_data(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    assert main(["explain", "HC-X99"]) == 2
    assert capsys.readouterr().out == ""


@needs_full
@pytest.mark.process
def test_the_interpreter_adds_no_words_of_its_own_at_its_end() -> None:
    with FULL.open("w") as stdout:
        done = subprocess.run(
            [sys.executable, "-m", "hilcell", "explain", "HC-J14"],
            stdout=stdout, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 7
    assert lost(done.stderr)


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
    assert f"hilcell watch {tmp_path / 'r'} --json" in capsys.readouterr().err


@needs_full
def test_a_run_into_a_full_disk_ends_with_exit_7_and_a_whole_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "home", "--name", "r", "--runs", str(tmp_path), "--json"]
    with full() as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        assert main(words) == 7
    end = read_journal(tmp_path / "r" / JOURNAL)[-1]
    assert (end.kind, end.body["state"], end.body["exit"]) == ("end", "finished", 0)
    err = capsys.readouterr().err
    assert "hilcell: stdout " in err
    assert "resume" not in err


@pytest.mark.process
def test_a_run_whose_messages_nobody_reads_any_more_comes_to_its_end(tmp_path: Path) -> None:
    """`hilcell run 2>&1 | head`: the bar's broken pipe ended the worker, and the run hung."""
    with closed_pipe() as stderr:
        done = subprocess.run(
            [sys.executable, "-m", "hilcell", "run", "world-frame", "--runs", str(tmp_path)],
            stdout=subprocess.PIPE, stderr=stderr.fileno(), text=True, check=False,
        )  # fmt: skip
    assert done.returncode == 0
    assert "points" in done.stdout
