"""A live run is paused, watched, resumed and stopped from other processes; signals too."""

import json
import signal
import socket
import sys
from pathlib import Path
from typing import Any

import pytest

from hilcell.run import client
from tests.whole.bench import (
    SMALL,
    Engine,
    children,
    command,
    events,
    sets,
    simulation,
    wait_gone,
)
from tests.whole.trace import judge

# hilcell, whose engine waits less long for the screen that ordered a run.
IMPATIENT = [
    sys.executable,
    "-c",
    """if True:
    from hilcell.commands.cli import main
    from hilcell.run import worker
    worker.SCREEN_S = 1.0
    raise SystemExit(main())""",
]


def state(event: dict[str, object], name: str) -> bool:
    return event["kind"] == "state" and event["machine"] == "run" and event["to"] == name


def test_pause_resume_watch_from_other_processes(tmp_path: Path) -> None:
    engine = Engine("run", "--runs", tmp_path, "--speed", "50", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "point")
    assert command("pause", engine.run, "--runs", tmp_path).returncode == 0
    engine.until(lambda event: state(event, "paused"))
    watcher = Engine("watch", engine.run, "--runs", tmp_path)
    watcher.until(lambda event: state(event, "paused"))
    assert command("resume", engine.run, "--runs", tmp_path).returncode == 0
    engine.until(lambda event: state(event, "running"))
    stopped = command("stop", engine.run, "--runs", tmp_path, "--json")
    assert events(stopped.stdout)[0]["ok"] is True
    assert engine.rest()[-1]["exit"] == 4
    assert watcher.rest() == engine.events
    assert judge(engine.events) == []
    assert "hilcell resume" in engine.errors


@pytest.mark.parametrize(("number", "twice"), [(signal.SIGTERM, False), (signal.SIGINT, True)])
def test_signals_stop_safely_and_nothing_is_left(
    tmp_path: Path, number: signal.Signals, twice: bool
) -> None:
    engine = Engine("run", "--runs", tmp_path, "--speed", "20", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "intent")
    simulated = children(engine.process.pid)
    engine.process.send_signal(number)
    if twice:
        engine.until(lambda event: state(event, "paused"))
        engine.process.send_signal(number)
    last = engine.rest()[-1]
    assert last["exit"] == 4
    assert last["state"] == "aborted"
    assert judge(engine.events) == []
    for pid in simulated:
        wait_gone(pid)


def test_a_lost_listener_does_not_stop_a_run(tmp_path: Path) -> None:
    engine = Engine("run", "robot-grid", "--runs", tmp_path, *sets(SMALL), "--unattended")
    engine.until(lambda event: event["kind"] == "point")
    assert engine.process.stdout is not None
    engine.process.stdout.close()
    engine.process.stdout = None
    _, err = engine.process.communicate(timeout=90)
    assert engine.process.returncode == 7, err
    assert "stdout: cannot be written: Broken pipe" in err
    assert "is whole" in err
    assert "Traceback" not in err
    (run,) = events(command("runs", "--json", "--runs", tmp_path).stdout)[0]["runs"]
    assert run["state"] == "finished"
    assert run["exit"] in (0, 1)  # how the run ended, not its command


class Screen:
    """A screen that attends over one connection, and can vanish."""

    def __init__(self, folder: Path) -> None:
        where = json.loads((folder / "engine.json").read_text())["socket"]
        self.link = socket.socket(socket.AF_UNIX)
        self.link.settimeout(20)
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
    words = [] if attended else ["--unattended"]
    engine = Engine("run", "--runs", tmp_path, "--speed", "50", *words, *sets(SMALL))
    engine.until(lambda event: event["kind"] == "point")
    one, other = Screen(tmp_path / engine.run), Screen(tmp_path / engine.run)
    assert one.ask("attend")["screens"] == 1
    assert other.ask("attend")["screens"] == 2
    one.vanish()
    engine.until(lambda event: event["kind"] == "point")
    assert other.ask("status")["screens"] == 1
    assert other.ask("status")["state"] == "running"
    other.vanish()
    engine.until(lambda event: event.get("what") == "screen lost")
    if attended:
        paused = engine.until(lambda event: state(event, "paused"))
        assert paused["reason"] == "the screen was lost"
    else:
        engine.until(lambda event: event["kind"] == "point")
    assert command("stop", engine.run, "--runs", tmp_path).returncode == 0
    assert engine.rest()[-1]["exit"] == 4
    assert judge(engine.events) == []


def test_a_screen_that_leaves_lets_the_run_go_on(tmp_path: Path) -> None:
    engine = Engine("run", "--runs", tmp_path, "--speed", "50", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "point")
    screen = Screen(tmp_path / engine.run)
    screen.ask("attend")
    assert screen.ask("leave")["screens"] == 0
    screen.vanish()
    engine.until(lambda event: event["kind"] == "point" and event["group"] == "grid")
    assert not [event for event in engine.events if event.get("what") == "screen lost"]
    assert command("stop", engine.run, "--runs", tmp_path).returncode == 0
    assert engine.rest()[-1]["exit"] == 4


def test_a_lost_terminal_pauses_an_attended_run(tmp_path: Path) -> None:
    engine = Engine("run", "--runs", tmp_path, "--speed", "50", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "point")
    engine.process.send_signal(signal.SIGHUP)
    engine.until(lambda event: state(event, "paused"))
    engine.process.send_signal(signal.SIGTERM)
    assert engine.rest()[-1]["exit"] == 4


def test_an_axis_that_loses_its_zero_in_the_grid_ends_the_run(tmp_path: Path) -> None:
    with simulation(100.0, SMALL) as cell:
        words = sets({"simulation.address": cell.control})
        engine = Engine("run", "--unattended", "--runs", tmp_path, *words, *sets(SMALL))
        engine.until(lambda event: event["kind"] == "point" and event["group"] == "grid")
        assert cell.ask(do="fault", name="robot.lost_zero", value=0.5, count=1)["ok"]
        last = engine.rest()[-1]
    assert last["exit"] == 3
    assert "an axis lost its zero" in last["reason"]
    assert judge(engine.events) == []


def test_a_run_that_a_screen_ordered_moves_only_before_its_eyes(tmp_path: Path) -> None:
    words = ("--runs", tmp_path, "--screen")
    size = ("--speed", "50", *sets(SMALL))
    engine = Engine("run", *words, "--name", "x", *size, program=IMPATIENT)
    engine.until(lambda event: event.get("what") == "screen lost")
    engine.until(lambda event: state(event, "paused"))
    assert not [event for event in engine.events if event["kind"] in ("intent", "point")]
    assert command("stop", "x", "--runs", tmp_path).returncode == 0
    assert engine.rest()[-1]["exit"] == 4
    resumed = Engine("resume", "x", *words)
    resumed.until(lambda event: event.get("what") == "connected")
    screen = Screen(tmp_path / "x")
    screen.ask("attend")
    resumed.until(lambda event: event["kind"] == "point")
    assert not [event for event in resumed.events if state(event, "paused")]
    assert screen.ask("stop")["ok"] is True
    assert resumed.rest()[-1]["exit"] == 4
    screen.vanish()


def test_an_order_that_failed_moves_nothing_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "ORDER_S", 1.0)
    engine = Engine("run", "--runs", tmp_path, "--speed", "50", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "point")
    assert command("pause", engine.run, "--runs", tmp_path).returncode == 0
    engine.until(lambda event: state(event, "paused"))
    engine.process.send_signal(signal.SIGSTOP)
    refused = command("resume", engine.run, "--runs", tmp_path)
    assert refused.returncode == 2
    assert "has not answered within 1 s" in refused.stderr
    engine.process.send_signal(signal.SIGCONT)
    screen = Screen(tmp_path / engine.run)  # comes after the order, and is heard after it
    assert screen.ask("status")["state"] == "paused"
    assert command("stop", engine.run, "--runs", tmp_path).returncode == 0
    assert engine.rest()[-1]["exit"] == 4
    after = engine.events[[state(event, "paused") for event in engine.events].index(True) + 1 :]
    assert not [event for event in after if state(event, "running")]
    screen.vanish()
