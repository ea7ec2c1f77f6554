"""The technician's screen in a real terminal, with real engines, by keys alone."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from hilcell.journal.engine_file import live_engine
from hilcell.journal.journal import StorageError, read_journal
from hilcell.journal.log import Log
from hilcell.journal.point_words import short_words
from hilcell.journal.runs import JOURNAL, read_log, run_folders
from hilcell.run import client
from hilcell.run.client import order
from tests.whole.bench import LIMIT_S, SMALL, command, sets, simulation, sweep, wait_gone
from tests.whole.golden import GoldenRuns
from tests.whole.terminal import Terminal
from tests.whole.trace import judge

ESC = "\x1b"
ENTER = "\r"
PACED, SLOW = 100.0, 20.0
UNHURRIED = "\x1b[Z\x1b[Z\x1b[C"  # shift-tab twice to the speed, to 100
SOON_S = 5.0


@contextmanager
def screen(runs: Path, *words: str, long: bool = False) -> Iterator[Terminal]:
    """Show the screen; an engine that outlives it is stopped.

    ``long``: a whole calibration, which at the speed of 100 ends half a minute after any test.
    """
    size = [] if long else sets(SMALL)
    with Terminal(["tui", "--runs", str(runs), *size, *words]) as terminal:
        try:
            yield terminal
        finally:
            for folder in run_folders(runs):
                engine = live_engine(folder)
                if engine is not None:
                    os.kill(engine.pid, signal.SIGTERM)
                    wait_gone(engine.pid)


def start(terminal: Terminal, keys: str = ENTER) -> None:
    """Choose what the form offers, read the plan, start."""
    terminal.shows("before you start")
    terminal.shows("validated before and after")
    terminal.press(keys)
    terminal.shows("The robot and the rail will move")
    terminal.answer(ENTER)


def to_procedure(name: str) -> str:
    """Return the keys from the form's first choice to another procedure."""
    names = sorted(entry.name for entry in entry_points(group="hilcell.procedures"))
    return "\x1b[B" * (names.index(name) - names.index("calibrate"))


def folder_of(runs: Path) -> Path:
    """Return the only run."""
    (folder,) = run_folders(runs)
    return folder


def logs(runs: Path) -> list[Log]:
    """Return the logs of the runs that have come as far as their first record."""
    journals = [folder / JOURNAL for folder in run_folders(runs)]
    return [Log(read_journal(journal)) for journal in journals if journal.is_file()]


def judged(folder: Path) -> list[str]:
    """Return the invariants that a run's journal breaks."""
    return judge(record.event(folder.name) for record in read_journal(folder / JOURNAL))


def wait_for(true: Callable[[], object], what: str) -> None:
    """Wait until something outside the terminal is so."""
    deadline_s = time.monotonic() + LIMIT_S
    while not true():
        assert time.monotonic() < deadline_s, what
        time.sleep(0.05)


@pytest.mark.nightly  # by day: test_retake, and the keys in test_actions
def test_the_worst_point_of_a_calibration_is_found_remeasured_and_reported(
    tmp_path: Path, golden: GoldenRuns
) -> None:
    """Of a run that is done; `test_story` makes one from the form."""
    log = read_log(golden["small"].copied_to(tmp_path))
    with screen(tmp_path, "last") as terminal:
        terminal.shows("● DONE", LIMIT_S)
        terminal.press("w")
        terminal.shows("w order")
        worst = next(line for line in terminal.text.splitlines() if line.startswith("▌►"))
        words = (worst[2:16].strip(), worst[17:24].strip())
        (key,) = [
            key
            for key, each in log.points.items()
            if (short_words(each.id), each.station) == words and each.id.how == "chosen"
        ]
        terminal.press("r")
        terminal.shows("Open this run again")
        terminal.answer(ENTER)
        terminal.shows("LIVE")
        # The screen may still show that the first session is done.
        wait_for(lambda: read_log(folder_of(tmp_path)).session == 2, "the engine begins again")
        terminal.shows("● DONE", LIMIT_S)
        wait_for(lambda: live_engine(folder_of(tmp_path)) is None, "the engine ends")
        again = read_log(folder_of(tmp_path))
        assert again.points[key].retaken
        assert again.points[key].session == 2
        assert not log.points[key].retaken
        terminal.press("o")
        terminal.shows("report written", LIMIT_S)
        assert (folder_of(tmp_path) / "report.html").stat().st_size > 100_000
        terminal.press("\x1b[F")  # to the end of the figures
        terminal.shows("corrected")
        terminal.press("q\x11")
        assert terminal.ends() == 0
    assert judged(folder_of(tmp_path)) == []


@pytest.mark.long
def test_pause_go_on_fault_recover_finish(tmp_path: Path) -> None:
    with simulation(SLOW, SMALL) as cell:
        words = ("--set", f"simulation.address={cell.control}")
        with screen(tmp_path, *words) as terminal:
            start(terminal, to_procedure("robot-grid") + ENTER)
            terminal.shows("newest point: grid point", LIMIT_S)
            terminal.press(" ")
            terminal.shows("▌▌ PAUSED", LIMIT_S)
            terminal.press(" ")
            terminal.shows("Go on?")
            terminal.answer(ENTER)
            terminal.shows("► RUNNING", LIMIT_S)
            assert cell.ask(do="fault", name="robot.e_stop", count=0)["ok"]
            terminal.shows("× FAULT", LIMIT_S)
            terminal.shows("HC-B")
            terminal.shows("What to do")
            terminal.press("e")
            terminal.shows("What  ")
            terminal.shows("not acknowledged")
            terminal.press("q")
            assert cell.ask(do="clear")["ok"]
            wait_for(lambda: live_engine(folder_of(tmp_path)) is None, "the engine ends")
            terminal.shows("space  resume")
            terminal.press(" ")  # three keys: resume, yes, acknowledge
            terminal.shows("Resume this run?")
            terminal.answer(ENTER)
            terminal.shows("► RUNNING", LIMIT_S)
            terminal.press("k")
            terminal.until(lambda text: "HC-B" not in text)
            terminal.shows("● DONE", LIMIT_S)
        assert judged(folder_of(tmp_path)) == []


@pytest.mark.nightly  # each page: test_terminal
@pytest.mark.parametrize("keys", ["h/", "\x10", "", "l", "a"])
def test_esc_stops_from_wherever_one_is(tmp_path: Path, keys: str) -> None:
    with screen(tmp_path, long=True) as terminal:
        start(terminal, UNHURRIED + ENTER)
        terminal.shows("► RUNNING", LIMIT_S)
        for key in keys:
            terminal.press(key)
            terminal.pump(0.3)
        terminal.press(ESC)
        folder = folder_of(tmp_path)
        wait_for(lambda: read_log(folder).end is not None, "the run ends")
        assert read_log(folder).states["run"] == "aborted"
        terminal.shows("ABORTED")


@pytest.mark.parametrize("wait_s", [0.0, *sweep(0.2, 0.5, 0.8, 1.1)])
def test_esc_right_after_the_start_is_heard(tmp_path: Path, wait_s: float) -> None:
    with screen(tmp_path, long=True) as terminal:
        start(terminal, UNHURRIED + ENTER)
        terminal.shows("CHECKING")
        terminal.pump_for(wait_s)
        terminal.press(ESC)
        terminal.until(lambda text: "LIVE" not in text)
        for log in logs(tmp_path):
            assert log.states["run"] == "aborted" or not log.moved


@pytest.mark.nightly  # by day right after a start, above
def test_esc_right_after_a_resume_is_heard(tmp_path: Path) -> None:
    with screen(tmp_path, long=True) as terminal:
        start(terminal, UNHURRIED + ENTER)
        terminal.shows("► RUNNING", LIMIT_S)
        terminal.press(ESC)
        terminal.shows("space  resume", LIMIT_S)
        (before,) = logs(tmp_path)
        terminal.press(" ")
        terminal.shows("Resume this run?")
        terminal.answer(ENTER)
        terminal.shows("CHECKING")
        terminal.press(ESC)
        terminal.until(lambda text: "LIVE" not in text)
        (after,) = logs(tmp_path)
        assert list(after.points) == list(before.points)


@pytest.mark.long
def test_a_killed_screen_pauses_an_attended_run_and_a_new_one_goes_on(tmp_path: Path) -> None:
    with simulation(PACED, SMALL) as cell:
        words = ("--set", f"simulation.address={cell.control}")
        with screen(tmp_path, *words) as second:
            with Terminal(["tui", "--runs", str(tmp_path), *sets(SMALL), *words]) as first:
                start(first)
                first.shows("of 14  Robot grid", LIMIT_S)
            folder = folder_of(tmp_path)
            wait_for(lambda: read_log(folder).states["run"] == "paused", "the run pauses")
            second.press("\x11")  # it looked before there was a run: leave it, look again
            assert second.ends() == 0
            with Terminal(["tui", "--runs", str(tmp_path), "last"]) as third:
                third.shows("▌▌ PAUSED")
                third.press(" ")
                third.shows("Go on?")
                third.answer(ENTER)
                third.shows("► RUNNING")
                third.answer("d")
                assert third.ends() == 0
            left = len(read_log(folder).points)
            wait_for(lambda: len(read_log(folder).points) >= left + 3, "detached, it goes on")


@pytest.mark.nightly  # killed over its own run: by day, above
def test_a_screen_killed_while_it_shows_another_run_pauses_the_live_one(tmp_path: Path) -> None:
    words = ("run", "home", "--unattended", "--runs", str(tmp_path), "--name", "20200101-home")
    assert command(*words).returncode == 0
    with screen(tmp_path, long=True) as terminal:
        start(terminal, UNHURRIED + ENTER)
        terminal.shows("► RUNNING", LIMIT_S)
        terminal.press("h")
        terminal.shows("2 of 2 runs")
        terminal.press("\x1b[F" + ENTER)
        terminal.shows("Esc still stops it")
        terminal.answer(ENTER)
        terminal.shows("behind: RUNNING")
        terminal.process.kill()
        folder = run_folders(tmp_path)[-1]
        wait_for(lambda: read_log(folder).states["run"] == "paused", "the run pauses")


def state_of(folder: Path) -> str:
    """The state of a run, "" before its first record."""
    try:
        return read_log(folder).state
    except StorageError:
        return ""


@pytest.mark.long
def test_a_screen_that_dies_before_its_engine_speaks_leaves_nothing_moving(tmp_path: Path) -> None:
    with screen(tmp_path, long=True) as terminal:
        start(terminal, UNHURRIED + ENTER)
        terminal.shows("CHECKING")
        terminal.process.kill()
        wait_for(lambda: run_folders(tmp_path), "the run begins")
        folder = folder_of(tmp_path)
        wait_for(lambda: state_of(folder) == "paused", "the run pauses")
        assert not read_log(folder).points


@pytest.mark.long
def test_an_engine_that_stands_still_is_silent_and_not_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "ORDER_S", 1.0)  # of the command below
    with screen(tmp_path, long=True) as terminal:
        start(terminal, UNHURRIED + ENTER)
        terminal.shows("► RUNNING", LIMIT_S)
        folder = folder_of(tmp_path)
        engine = live_engine(folder)
        assert engine is not None
        os.kill(engine.pid, signal.SIGSTOP)
        try:
            terminal.shows("NO ANSWER")
            terminal.shows("use the E-stop")
            terminal.press("a")
            terminal.shows("abort: the engine does not answer")
            asked = command("stop", "last", "--runs", tmp_path)
            assert asked.returncode == 2
            assert f"process {engine.pid}, has not answered" in asked.stderr
            assert "gone" not in command("runs", "--runs", tmp_path).stdout
            terminal.press(ESC)
            terminal.shows("STOP sent, but it does not answer: use the E-stop")
        finally:
            os.kill(engine.pid, signal.SIGCONT)
        wait_for(lambda: read_log(folder).end is not None, "the stop is heard")
        terminal.shows("space  resume")
        assert "HC-J05" not in terminal.text
    assert judged(folder) == []


@pytest.mark.long
def test_the_screen_that_started_a_run_is_left_at_once_and_the_run_goes_on(tmp_path: Path) -> None:
    with screen(tmp_path, long=True) as terminal:
        start(terminal, UNHURRIED + ENTER)
        terminal.shows("► RUNNING", LIMIT_S)
        terminal.press("d")
        assert terminal.ends(SOON_S) == 0
        folder = folder_of(tmp_path)
        assert live_engine(folder) is not None
        assert order(folder, "status").state == "running"


@pytest.mark.nightly  # by day: test_by_hand, and the boxes in test_prompt_box
def test_one_reflector_carried_by_hand_from_nest_to_nest(tmp_path: Path) -> None:
    values = {"layout.reflectors": "by_hand"}
    with simulation(PACED, SMALL | values) as cell:
        words = sets(values | {"simulation.address": cell.control})
        with screen(tmp_path, *words) as terminal:
            start(terminal, "\x1b[F" + ENTER)  # the last procedure: world-frame
            for nest in ("F1", "F2", "F3", "B1", "B2"):
                terminal.shows(f"Seat the reflector in {nest}", LIMIT_S)
                terminal.shows("from above, to scale")
                terminal.shows("sees nothing")
                terminal.press(ENTER)
                terminal.shows("Enter works when the tracker sees")
                assert cell.ask(do="seat", place=nest)["ok"]
                terminal.shows("● tracker sees it")
                terminal.answer(ENTER)
            terminal.shows("● DONE", LIMIT_S)
        assert judged(folder_of(tmp_path)) == []


def test_a_refused_start_says_why_and_leaves_nothing(tmp_path: Path) -> None:
    with screen(tmp_path, "--set", "robot.speed_percent=-5") as terminal:
        terminal.shows("validated before and after")
        terminal.press(ENTER)
        terminal.shows("speed_percent")
        assert not run_folders(tmp_path)


def test_keys_that_conflict_are_refused_before_anything_is_shown(tmp_path: Path) -> None:
    keys = tmp_path / "keys.toml"
    keys.write_text('[keys]\nhistory = "p"\n')
    with Terminal(["tui", "--runs", str(tmp_path), "--keys", str(keys)]) as terminal:
        terminal.shows("key 'p' means")
        assert terminal.ends() == 2
