"""What a command does so that the interpreter's own work holds up no stop."""

import gc
import signal
from pathlib import Path

import pytest

from hilcell.commands.cli import main
from hilcell.run.runner import Runner


def test_collections_leave_out_what_was_loaded_before_a_run(
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
