"""A live run is paused, watched, resumed and stopped from other processes; signals too."""

import signal
from pathlib import Path

import pytest

from tests.whole.bench import SMALL, Engine, children, events, hilcell, sets, wait_gone
from tests.whole.trace import judge


def state(event: dict[str, object], name: str) -> bool:
    return event["kind"] == "state" and event["machine"] == "run" and event["to"] == name


def test_pause_resume_watch_from_other_processes(tmp_path: Path) -> None:
    engine = Engine("run", "--runs", tmp_path, "--speed", "50", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "point")
    assert hilcell("pause", engine.run, "--runs", tmp_path).returncode == 0
    engine.until(lambda event: state(event, "paused"))
    watcher = Engine("watch", engine.run, "--runs", tmp_path)
    watcher.until(lambda event: state(event, "paused"))
    assert hilcell("resume", engine.run, "--runs", tmp_path).returncode == 0
    engine.until(lambda event: state(event, "running"))
    stopped = hilcell("stop", engine.run, "--runs", tmp_path, "--json")
    assert events(stopped.stdout)[0]["ok"] is True
    assert engine.rest()[-1]["exit"] == 4
    assert watcher.rest() == engine.events
    assert judge(engine.events) == []
    assert "hilcell resume" in engine.told


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
    engine = Engine("run", "--runs", tmp_path, *sets(SMALL), "--unattended")
    engine.until(lambda event: event["kind"] == "point")
    assert engine.process.stdout is not None
    engine.process.stdout.close()
    engine.process.stdout = None
    _, told = engine.process.communicate(timeout=90)
    assert engine.process.returncode in (0, 1), told
    (run,) = events(hilcell("runs", "--json", "--runs", tmp_path).stdout)[0]["runs"]
    assert run["state"] == "finished"
