"""Signals to the process of a command: while it is imported, and when its exit code is known."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hilcell.__main__ import entry
from hilcell.commands import cli

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
HOME = (sys.executable, "-m", "hilcell", "run", "home", "--unattended", "--runs")


class Left(BaseException):
    """The process would have ended."""


def leave(code: int) -> None:
    raise Left(code)


def test_a_signal_while_modules_are_imported_leaves_at_once(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def main(*, imported: Callable[[], object]) -> int:
        with pytest.raises(Left, match="4"):
            signal.raise_signal(signal.SIGINT)
        imported()
        with pytest.raises(KeyboardInterrupt):  # the command's own from here on
            signal.raise_signal(signal.SIGINT)
        return 0

    signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(os, "_exit", leave)
    monkeypatch.setattr(cli, "main", main)
    assert entry() == 0
    assert capfd.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("number", NUMBERS)
def test_a_signal_after_the_command_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    def refused(*, imported: Callable[[], object]) -> int:
        raise SystemExit(2)

    def struck(*_: object) -> None:
        raise Left(number)

    signal.signal(number, struck)
    monkeypatch.setattr(os, "_exit", leave)
    monkeypatch.setattr(cli, "main", lambda imported: 7)
    assert entry() == 7
    signal.raise_signal(number)
    monkeypatch.setattr(cli, "main", refused)
    with pytest.raises(SystemExit):
        entry()
    signal.raise_signal(number)


def test_a_run_that_was_started_deaf_to_ctrl_c_stays_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def main(*, imported: Callable[[], object]) -> int:
        signal.raise_signal(signal.SIGINT)
        imported()
        signal.raise_signal(signal.SIGINT)
        return 0

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    monkeypatch.setattr(cli, "main", main)
    assert entry() == 0


@pytest.mark.nightly
@pytest.mark.wall
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_without_end_do_not_change_the_exit_code(
    tmp_path: Path, number: signal.Signals
) -> None:
    for turn in range(5):
        words = (*HOME, str(tmp_path / str(turn)), "--json")
        with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            while json.loads(process.stdout.readline())["kind"] != "end":
                pass
            while process.poll() is None:
                process.send_signal(number)
            assert process.returncode == 0
            assert process.stderr.read() == b""
