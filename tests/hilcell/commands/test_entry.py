"""Signals to the process of a command: at its start, while a run comes to its end, and after it."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hilcell.__main__ import entry
from hilcell.commands import cli
from hilcell.commands import run as command
from hilcell.commands.cli import main
from hilcell.commands.run_output import print_unclosed
from hilcell.journal.journal import StorageError, read_journal
from hilcell.journal.runs import CALIBRATION
from hilcell.ports import DeviceError
from hilcell.run import engine
from hilcell.run.runner import Runner
from hilcell.run.stopping import not_at_rest

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


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


def pressed(*_: object, **__: object) -> None:
    for number in (signal.SIGINT, signal.SIGINT, signal.SIGTERM):
        os.kill(os.getpid(), number)


def end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str], str]:
    """Return a short run's exit code, the last records of its journal and its words."""
    code = main(["run", "home", "--name", "R", "--unattended", "--runs", str(tmp_path)])
    records = read_journal(tmp_path / "R" / "journal.sqlite")
    return code, [record.kind for record in records[-2:]], capsys.readouterr().err


def test_signals_while_a_finished_run_closes_do_not_change_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The simulated cell, the calibration and the last words each get some."""
    written: list[Path] = []

    def write(calibration: object, path: Path) -> None:
        pressed()
        written.append(path)

    monkeypatch.setattr(engine, "calibration_after", pressed)
    monkeypatch.setattr(engine, "write_calibration", write)
    monkeypatch.setattr("hilcell.journal.log.Log.calibrates", True)
    monkeypatch.setattr(command, "print_unclosed", pressed)
    monkeypatch.setattr(engine, "lock_of_device", None)  # nobody else reaches a cell of our own
    code, kinds, words = end(tmp_path, capsys)
    assert code == 0
    assert kinds == ["state", "end"]
    assert written == [tmp_path / "R" / CALIBRATION]
    assert "Traceback" not in words
    pressed()  # until the process has ended, none of them changes the exit code


def test_a_signal_while_the_simulated_cell_starts_ends_the_run_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(engine, "start_simulation", pressed)
    code, kinds, words = end(tmp_path, capsys)
    assert code == 4
    assert kinds == ["plan", "end"]
    assert "SIGINT" in words


def test_a_slide_that_nobody_confirms_to_be_held_is_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    hung = DeviceError("HC-R37", "Rail", "close", "the drive keeps its power")
    unclosed: dict[str, Exception] = {"Rail": hung, "Tracker": StorageError("of no matter")}
    print_unclosed(unclosed, None)
    said = capsys.readouterr().err
    assert str(hung) in said
    assert "E-stop" in said
    print_unclosed(unclosed, not_at_rest(unclosed))  # the fault itself has said it
    assert not capsys.readouterr().err


def test_collections_leave_out_all_that_was_loaded_before_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A whole collection stops all threads: with all modules in it for over 20 ms."""
    done: list[str] = []
    run = Runner.run

    def noted(runner: Runner, signals: list[signal.Signals]) -> int:
        done.append("run")
        return run(runner, signals)

    monkeypatch.setattr(gc, "freeze", lambda: done.append("freeze"))
    monkeypatch.setattr(Runner, "run", noted)
    assert main(["run", "home", "--name", "R", "--unattended", "--runs", str(tmp_path)]) == 0
    assert done == ["freeze", "run"]


# -- plants and studies are optional: without their packages every other command works -------------


WITHOUT = """
import importlib, pkgutil, sys
missing = ("sqlalchemy", "alembic", "psycopg", "cryptography", "dask", "distributed", "pyarrow")
sys.modules |= dict.fromkeys(missing)  # an import of them fails
for module in pkgutil.walk_packages(["hilcell"], "hilcell."):
    if not module.name.startswith(("hilcell.plant", "hilcell.study", "hilcell.__main__")):
        importlib.import_module(module.name)
from hilcell.commands.cli import main
print([main(words.split()) for words in ("check paper", "plant show", "study report .")])
"""


@pytest.mark.process
def test_other_commands_need_no_optional_package() -> None:
    command = [sys.executable, "-c", WITHOUT]
    root = Path(__file__).parents[3]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=root)
    assert done.stdout.endswith("[0, 2, 2]\n"), done.stderr
    assert "plant: not installed: sqlalchemy, alembic, psycopg" in done.stderr
    assert "study: pyarrow is not installed" in done.stderr
