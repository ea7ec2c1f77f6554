"""The technician's screen in a real terminal, with real engines, by keys alone."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from hilcell.journal.journal import StorageError, read_journal
from hilcell.journal.runs import JOURNAL, live_engine, read_log, run_folders
from hilcell.run import control
from tests.whole.bench import LOOK_S, SMALL, command, judge, sets, simulation, wait_gone
from tests.whole.terminal import Terminal

pytestmark = pytest.mark.process

ESC, ENTER = "\x1b", "\r"
PACED = 100.0
UNHURRIED = "\x1b[Z\x1b[Z\x1b[C"  # shift-tab twice to the speed, to 100


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


def start(terminal: Terminal, keys: str = "") -> None:
    """Read the plan, or choose another one before the form has planned its own, and start."""
    terminal.shows("before you start")
    if not keys:
        terminal.shows("validated before and after", "start: robot and rail will move")
    terminal.press(keys + ENTER)
    terminal.shows("The robot and the rail will move")
    terminal.answer(ENTER)


def to_procedure(name: str) -> str:
    """Return the keys from the form's first choice to another procedure."""
    names = sorted(entry.name for entry in entry_points(group="hilcell.procedures"))
    return "\x1b[B" * (names.index(name) - names.index("calibrate"))


def cell_folder(runs: Path) -> Path:
    (folder,) = run_folders(runs)
    return folder


def state_of(folder: Path) -> str:
    """Return the state of a run, "" before its first record."""
    try:
        return read_log(folder).state
    except StorageError:
        return ""


def judged(folder: Path) -> list[str]:
    return judge(record.event(folder.name) for record in read_journal(folder / JOURNAL))


def wait_for(true: Callable[[], object]) -> None:
    """Wait until something that another process does is so."""
    while not true():
        select.select([], [], [], LOOK_S)


def test_pause_go_on_fault_recover_finish(tmp_path: Path) -> None:
    with simulation(PACED, SMALL) as cell:
        words = ("--set", f"simulation.address={cell.control}")
        with screen(tmp_path, *words) as terminal:
            start(terminal, to_procedure("robot-grid"))
            terminal.shows("► RUNNING")
            terminal.press(" ")
            terminal.shows("▌▌ PAUSED")
            assert cell.ask(do="fault", name="robot.e_stop", count=0)["ok"]
            terminal.press(" ")
            terminal.shows("Go on?")
            terminal.answer(ENTER)
            terminal.shows("× FAULT", "HC-B")
            assert cell.ask(do="clear")["ok"]
            wait_for(lambda: live_engine(cell_folder(tmp_path)) is None)
            terminal.shows("space  resume")
            terminal.press(" ")  # three keys: resume, yes, acknowledge
            terminal.shows("Resume this run?")
            terminal.answer(ENTER)
            terminal.shows("► RUNNING")
            terminal.press("k")
            terminal.until(lambda text: "HC-B" not in text)
            terminal.shows("● DONE")
        assert judged(cell_folder(tmp_path)) == []


def test_esc_right_after_the_start_is_heard(tmp_path: Path) -> None:
    with screen(tmp_path, long=True) as terminal:
        start(terminal, UNHURRIED)
        terminal.shows("CHECKING")
        terminal.press(ESC)
        terminal.until(lambda text: "LIVE" not in text)
        for folder in run_folders(tmp_path):
            if (folder / JOURNAL).is_file():
                assert state_of(folder) == "aborted" or not read_log(folder).moved


def test_a_killed_screen_pauses_an_attended_run_and_a_new_one_goes_on(tmp_path: Path) -> None:
    """The new one leaves it on purpose, and the run goes on without any screen."""
    with simulation(PACED, SMALL) as cell:
        words = ("--set", f"simulation.address={cell.control}")
        with screen(tmp_path, *words) as first:
            start(first)
            first.shows("► RUNNING")
            folder = cell_folder(tmp_path)
            first.process.kill()
            wait_for(lambda: state_of(folder) == "paused")
            with Terminal(["tui", "--runs", str(tmp_path), "last"]) as second:
                second.shows("▌▌ PAUSED")
                second.press(" ")
                second.shows("Go on?")
                second.answer(ENTER)
                second.shows("► RUNNING")
                second.answer("d")
                assert second.ends() == 0
            left = len(read_log(folder).points)
            wait_for(lambda: len(read_log(folder).points) >= left + 3)


def test_an_engine_that_is_suspended_is_silent_and_not_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "ORDER_S", 0.1)  # of a command that is never answered
    with screen(tmp_path, long=True) as terminal:
        start(terminal, UNHURRIED)
        terminal.shows("► RUNNING")
        folder = cell_folder(tmp_path)
        engine = live_engine(folder)
        assert engine is not None
        os.kill(engine.pid, signal.SIGSTOP)
        try:
            terminal.shows("NO ANSWER", "use the E-stop")
            asked = command("stop", "last", "--runs", tmp_path)
            assert asked.returncode == 2
            assert str(engine.pid) in asked.stderr
            assert "gone" not in command("runs", "--runs", tmp_path).stdout
            terminal.press(ESC)
            terminal.shows("STOP sent, but it does not answer")
        finally:
            os.kill(engine.pid, signal.SIGCONT)
        wait_for(lambda: read_log(folder).end is not None)
        terminal.shows("space  resume")
        assert "HC-J05" not in terminal.text
    assert judged(folder) == []


@pytest.mark.nightly  # by day: test_by_hand, and the boxes in test_prompt_box
def test_one_reflector_carried_by_hand_from_nest_to_nest(tmp_path: Path) -> None:
    values = {"layout.reflectors": "by_hand"}
    with simulation(PACED, SMALL | values) as cell:
        words = sets(values | {"simulation.address": cell.control})
        with screen(tmp_path, *words) as terminal:
            start(terminal, "\x1b[F")  # the last procedure: world-frame
            for nest in ("F1", "F2", "F3", "B1", "B2"):
                terminal.shows(f"Seat the reflector in {nest}", "not visible")
                terminal.press(ENTER)
                terminal.shows("Enter works once the tracker measures")
                assert cell.ask(do="seat", place=nest)["ok"]
                terminal.shows("● reflector visible")
                terminal.answer(ENTER)
            terminal.shows("● DONE")
        assert judged(cell_folder(tmp_path)) == []


def test_the_screen_speaks_the_language_of_the_locale(tmp_path: Path) -> None:
    """German by LANG alone; the form, the help and the end."""
    words = ["tui", "--runs", str(tmp_path), *sets(SMALL)]
    with Terminal(words, LC_ALL="", LANG="de_DE.UTF-8") as terminal:
        terminal.shows("vor dem Start", "NICHTS OFFEN", "Prüfungen", "Schritte")
        terminal.press("?")
        terminal.shows("Erste Kalibrierung", "zurück")
        terminal.press("q")
        terminal.shows("vor dem Start")
        terminal.press("\x11")
        assert terminal.ends() == 0
