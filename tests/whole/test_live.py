"""A live run is paused, watched, resumed and stopped from other processes; signals too."""

from __future__ import annotations

import json
import math
import signal
import socket
from pathlib import Path
from typing import Any

import pytest

from hilcell.journal.runs import read_log
from hilcell.run import control, worker
from hilcell.run.control import order
from tests.whole.bench import (
    SMALL,
    Engine,
    children,
    command,
    events,
    judge,
    sets,
    simulation,
    wait_gone,
)
from tests.whole.threaded import Event, ThreadedRun, is_state


def is_point(event: Event) -> bool:
    return bool(event["kind"] == "point")


# -- processes and signals -------------------------------------------------------------------------


@pytest.mark.process
def test_pause_resume_watch_from_other_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An order that failed, for the engine stood still, moves nothing later."""
    engine = Engine("run", "--runs", tmp_path, "--speed", "100", *sets(SMALL))
    engine.until(is_point)
    assert command("pause", engine.run, "--runs", tmp_path).returncode == 0
    paused = engine.until(lambda event: is_state(event, "paused"))
    shown = command("show", engine.run, "--runs", tmp_path)
    assert "as the operator asked" in shown.stdout
    engine.process.send_signal(signal.SIGSTOP)
    with monkeypatch.context() as patched:
        patched.setattr(control, "ORDER_S", 0.02)  # nothing will come
        assert command("resume", engine.run, "--runs", tmp_path).returncode == 2
    engine.process.send_signal(signal.SIGCONT)
    screen = Screen(tmp_path / engine.run)  # comes after the order, and is heard after it
    assert screen.ask("status")["state"] == "paused"
    screen.vanish()
    watcher = Engine("watch", engine.run, "--runs", tmp_path)
    watcher.until(lambda event: is_state(event, "paused"))
    assert read_log(tmp_path / engine.run).life[-1].seq == paused["seq"]
    assert command("resume", engine.run, "--runs", tmp_path).returncode == 0
    engine.until(lambda event: is_state(event, "running"))
    stopped = command("stop", engine.run, "--runs", tmp_path, "--json")
    assert events(stopped.stdout)[0]["ok"] is True
    assert engine.rest()[-1]["exit"] == 4
    assert watcher.rest() == engine.events
    assert judge(engine.events) == []
    assert "hilcell resume" in engine.errors


@pytest.mark.process
@pytest.mark.parametrize(
    ("pauses", "stops"), [(signal.SIGINT, signal.SIGINT), (signal.SIGHUP, signal.SIGTERM)]
)
def test_signals_stop_safely_and_nothing_is_left(
    tmp_path: Path, pauses: signal.Signals, stops: signal.Signals
) -> None:
    engine = Engine("run", "--runs", tmp_path, "--speed", "100", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "intent")
    simulated = children(engine.process.pid)
    engine.process.send_signal(pauses)
    engine.until(lambda event: is_state(event, "paused"))
    engine.process.send_signal(stops)
    last = engine.rest()[-1]
    assert (last["exit"], last["state"]) == (4, "aborted")
    assert judge(engine.events) == []
    for pid in simulated:
        wait_gone(pid)


@pytest.mark.process
def test_a_lost_listener_does_not_stop_a_run(tmp_path: Path) -> None:
    engine = Engine("run", "world-frame", "--runs", tmp_path, *sets(SMALL), "--unattended")
    engine.until(is_point)
    assert engine.process.stdout is not None
    engine.process.stdout.close()
    engine.process.stdout = None
    _, err = engine.process.communicate()
    assert engine.process.returncode == 7, err
    assert "Broken pipe" in err
    assert "Traceback" not in err
    (run,) = events(command("runs", "--json", "--runs", tmp_path).stdout)[0]["runs"]
    assert (run["state"], run["exit"]) == ("finished", 0)  # how the run ended, not its command


# -- screens that attend ---------------------------------------------------------------------------


class Screen:
    """A screen that attends over one connection, and can vanish."""

    def __init__(self, folder: Path) -> None:
        where = json.loads((folder / "engine.json").read_text())["socket"]
        self.link = socket.socket(socket.AF_UNIX)
        self.link.connect(where)
        self.lines = self.link.makefile("rb")

    def ask(self, command: str) -> dict[str, Any]:
        self.link.sendall(json.dumps({"command": command}).encode() + b"\n")
        answer: dict[str, Any] = json.loads(self.lines.readline())
        return answer

    def vanish(self) -> None:
        self.lines.close()
        self.link.close()


@pytest.mark.parametrize("attended", [True, False])
def test_losing_the_last_screen_pauses_an_attended_run_only(tmp_path: Path, attended: bool) -> None:
    """One that leaves on purpose, and one of two that is lost, let it go on."""
    words = sets(SMALL) if attended else [*sets(SMALL), "--unattended"]
    with ThreadedRun(tmp_path, "run", *words) as run:
        run.until(is_point)
        left, one, other = (Screen(run.folder) for _ in range(3))
        assert [each.ask("attend")["screens"] for each in (left, one, other)] == [1, 2, 3]
        assert left.ask("leave")["screens"] == 2
        left.vanish()
        one.vanish()
        run.until(is_point)
        while other.ask("status")["screens"] != 1:
            continue  # its end is still being read
        assert other.ask("status")["state"] == "running"
        assert not [event for event in run.events if event.get("what") == "screen lost"]
        other.vanish()
        run.until(lambda event: event.get("what") == "screen lost")
        run.until(lambda event: is_state(event, "paused") if attended else is_point(event))
        order(run.folder, "stop")
        assert run.rest()["exit"] == 4


def test_a_run_that_a_screen_ordered_moves_only_before_its_eyes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(worker.Worker, "SCREEN_S", 0.0)  # none will come
        with ThreadedRun(tmp_path, "run", "--screen", "--name", "x", *sets(SMALL)) as run:
            run.until(lambda event: event.get("what") == "screen lost")
            run.until(lambda event: is_state(event, "paused"))
            order(run.folder, "stop")
            assert run.rest()["exit"] == 4
        assert not [event for event in run.events if event["kind"] in ("intent", "point")]
    with ThreadedRun(tmp_path, "resume", "x", "--screen") as resumed:
        resumed.until(lambda event: event.get("what") == "connected")
        screen = Screen(resumed.folder)
        screen.ask("attend")
        resumed.until(is_point)
        assert not [event for event in resumed.events if is_state(event, "paused")]
        assert screen.ask("stop")["ok"] is True
        assert resumed.rest()["exit"] == 4
        screen.vanish()


def test_an_axis_that_loses_its_zero_in_the_grid_ends_the_run(tmp_path: Path) -> None:
    with simulation(math.inf, SMALL) as cell:
        words = sets(SMALL | {"simulation.address": cell.control})
        with ThreadedRun(tmp_path, "run", "--unattended", *words) as run:
            run.until(lambda event: is_point(event) and event["group"] == "grid")
            assert cell.ask(do="fault", name="robot.lost_zero", value=0.5, count=1)["ok"]
            last = run.rest()
    assert (last["exit"], last["error"]["code"]) == (3, "HC-T17")
