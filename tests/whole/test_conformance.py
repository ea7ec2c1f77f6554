"""`hilcell run conformance` on machines: slowly, and attended by a whole "yes" before a motion.

The machines are simulated devices of their own whose name plates do not say so, reached by a cell
file that names no simulator: the engine takes them for real ones, with real deadlines. It runs in a
thread, and `hilcell resume` is told that it has a terminal; one test has a process and a terminal.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fakes import strip
from fakes.canopen import rail_server
from fakes.kuka.controller import KrlController
from fakes.leica.emscon_server import wide
from hilcell.commands import run as run_command
from hilcell.commands.cli import main
from hilcell.conformance import promises
from hilcell.errors import HilcellError
from hilcell.run.control import order
from tests.whole.bench import Engine, command, ran, sets, shop_cell, simulation
from tests.whole.terminal import Terminal
from tests.whole.threaded import Event, ThreadedRun, is_state

pytestmark = pytest.mark.wall

QUESTION = 'type "yes" to continue'
FIRST_MM, SECOND_MM = 320.0, 300.0  # where the first two motions take the slide
OTHER_WORDS = ("yess", "y", "no", "", "go")


@contextmanager
def machines(folder: Path, speed: float) -> Iterator[list[str]]:
    """Yield the words that name a cell of machines, and a slow one."""
    cell = shop_cell(folder)
    with pytest.MonkeyPatch.context() as plates:
        for module in (rail_server, strip):
            plates.setattr(module, "IDENTITY", replace(module.IDENTITY, name="of the plant"))
        plates.setattr(KrlController, "_identity", lambda self: f'"{self._arm.model}"')
        plates.setattr(
            "fakes.leica.emscon_server.wide", lambda text: wide(text.replace(" (simulated)", ""))
        )
        with simulation(speed) as simulated:
            slow = {"robot.speed_percent": "10", "rail.speed_mm_s": "25"}
            yield ["--cell", str(cell), *sets(simulated.shop | slow)]


@pytest.fixture
def shop(tmp_path: Path, faster_than_a_drive: None) -> Iterator[list[str]]:
    """Return the words for machines that run fast, for an engine of this process."""
    with machines(tmp_path, math.inf) as words:
        yield words


@pytest.fixture
def streaming_shop(tmp_path: Path, faster_than_a_drive: None) -> Iterator[list[str]]:
    """Return the words for machines whose time passes by itself: a stream has none else."""
    with machines(tmp_path, 200.0) as words:
        yield words


@pytest.fixture
def paced_shop(tmp_path: Path) -> Iterator[list[str]]:
    """Return the words for machines that run in real time, for an engine of its own process."""
    with machines(tmp_path, 1.0) as words:
        yield words


class Attended:
    """A run that waits for the word before its first motion of the slide."""

    def __init__(self, run: ThreadedRun | Engine, runs: Path) -> None:
        self._run = run
        asked = self.pauses()
        assert self._sent() == []
        self.folder = runs / str(asked["run"])
        order(self.folder, "proceed", until=asked["seq"])  # home
        self.asked = self.pauses()
        self._home = len(self._sent())

    def pauses(self) -> Event:
        return self._run.until(lambda event: is_state(event, "paused"))

    @property
    def state(self) -> str:
        return order(self.folder, "status").state

    @property
    def announced(self) -> str:
        events = [event for event in self._run.events if event.get("what") == "announced"]
        return str(events[-1]["motion"])

    @property
    def moved_mm(self) -> list[float]:
        """Where the slide was sent since the first word."""
        return [event["position_mm"] for event in self._sent()[self._home :]]

    def _sent(self) -> list[Event]:
        return [event for event in self._run.events if event["kind"] == "intent"]


class Typed(io.StringIO):
    """A terminal at which a word is typed."""

    def isatty(self) -> bool:
        return True


def at_terminal(patched: pytest.MonkeyPatch, word: str | None) -> None:
    """Let `hilcell resume` have a terminal at which a word is typed, or none."""
    stdin = None if word is None else Typed(word)
    patched.setattr(run_command, "sys", SimpleNamespace(stdin=stdin, stderr=Typed()))


def answered(folder: Path, word: str | None, monkeypatch: pytest.MonkeyPatch) -> int:
    with monkeypatch.context() as patched:
        at_terminal(patched, word)
        return main(["resume", folder.name, "--runs", str(folder.parent)])


def test_only_a_whole_yes_lets_the_one_motion_go_that_was_announced(
    shop: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ThreadedRun(tmp_path, "run", "conformance", *shop) as run:
        attended = Attended(run, tmp_path)
        folder, asked = attended.folder, attended.asked
        assert f"to {FIRST_MM:.2f} mm" in attended.announced
        for word in OTHER_WORDS:
            assert answered(folder, word, monkeypatch) == 4
        assert answered(folder, None, monkeypatch) == 2
        assert (attended.state, attended.moved_mm) == ("paused", [])

        assert answered(folder, "yes\n", monkeypatch) == 0
        run.until(lambda event: is_state(event, "running"))
        with pytest.raises(HilcellError):  # another yes to the same question
            order(folder, "proceed", until=asked["seq"])
        attended.pauses()
        assert f"to {SECOND_MM:.2f} mm" in attended.announced
        with pytest.raises(HilcellError):
            order(folder, "proceed", until=asked["seq"])
        assert (attended.state, attended.moved_mm) == ("paused", [FIRST_MM])

        order(folder, "stop")
        end = run.rest()
        assert (end["state"], end["exit"]) == ("aborted", 4)
        assert attended.moved_mm == [FIRST_MM]
    with pytest.MonkeyPatch.context() as patched:  # a run that is opened again asks again
        at_terminal(patched, "yes\n")
        with ThreadedRun(tmp_path, "resume", folder.name) as resumed:
            again = Attended(resumed, tmp_path)
            assert f"to {FIRST_MM:.2f} mm" in again.announced
            order(folder, "stop")
            resumed.rest()
        assert again.moved_mm == []


@pytest.mark.nightly  # by day in the test's process, above
def test_the_word_is_typed_at_a_terminal(paced_shop: list[str], tmp_path: Path) -> None:
    """One that is closed at the question, or left by ctrl-C, moves nothing."""
    engine = Engine("run", "conformance", "--runs", tmp_path, *paced_shop)
    attended = Attended(engine, tmp_path)
    words = ["resume", engine.run, "--runs", str(tmp_path)]
    with Terminal(words, columns=200) as closed:
        closed.shows(QUESTION)
    with Terminal(words, columns=200) as interrupted:
        interrupted.shows(QUESTION)
        interrupted.answer("\x03")
        assert interrupted.ends() != 0
    assert attended.state == "paused"
    with Terminal(words, columns=200) as terminal:
        terminal.shows(QUESTION, f"to {FIRST_MM:.2f} mm")
        assert "SIMULATED" not in terminal.text
        terminal.answer("yes\n")
        assert terminal.ends() == 0
    attended.pauses()
    with Terminal(words, columns=200) as terminal:
        terminal.shows(QUESTION)
        command("stop", engine.run, "--runs", tmp_path)
        end = engine.rest()[-1]
        terminal.answer("yes\n")
        assert terminal.ends() == 2
        assert "Traceback" not in terminal.text
    assert (end["state"], end["exit"]) == ("aborted", 4)
    assert attended.moved_mm == [FIRST_MM]


@pytest.mark.nightly
def test_all_promises_that_apply_to_a_machine_are_kept(
    streaming_shop: list[str], tmp_path: Path
) -> None:
    with ThreadedRun(tmp_path, "run", "conformance", *streaming_shop) as run:
        attended = Attended(run, tmp_path)
        last: dict[str, Any] = attended.asked
        while last["kind"] != "end":
            order(attended.folder, "proceed", until=last["seq"])
            last = run.until(lambda event: is_state(event, "paused") or event["kind"] == "end")
        run.rest()
    verdicts = {
        each["verdict"] for found in last["result"]["conformance"].values() for each in found
    }
    assert last["exit"] == 0
    assert verdicts == {"held", "not applicable"}
    announced = [event for event in run.events if event.get("what") == "announced"]
    orders = [event for event in run.events if event["kind"] == "intent"]
    moves = [event for event in orders if event["seq"] > attended.asked["seq"]]
    moves = [event for event in moves if str(event["action"]).endswith("move")]
    assert len(announced) == 1 + len(moves)  # to reference once
    assert not last["result"]["simulated"]


SLOW = {"robot.speed_percent": "10", "rail.speed_mm_s": "25"}


@pytest.mark.usefixtures("faster_than_a_drive")
def test_a_real_device_is_moved_slowly_and_by_a_persons_word_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # of this PC: 200 times as long at the tracker
    monkeypatch.setattr(promises.TrackerPromises, "STREAM_S", 0.2)
    words = ("--cell", shop_cell(tmp_path))
    with simulation(200.0) as simulated:
        fast = ran(tmp_path, "conformance", simulated.shop, *words, name="fast")
        run = ran(tmp_path, "conformance", simulated.shop | SLOW, *words)
    assert fast.done.returncode == 2
    assert "--set robot.speed_percent=10 --set rail.speed_mm_s=25" in fast.done.stderr
    assert run.end["exit"] == 0, run.result
    verdicts = {
        (port, each["promise"]): each["verdict"]
        for port, outcomes in run.result["conformance"].items()
        for each in outcomes
    }
    assert verdicts["rail", "units"] == verdicts["robot", "handedness"] == "needs a person"
    assert verdicts["tracker", "units"] == verdicts["tracker", "stream-ends"] == "held"
    assert {verdicts[port, "silent"] for port in ("rail", "robot", "tracker")} == {"not applicable"}
    assert "broken" not in verdicts.values()
    assert "announced" not in [each["what"] for each in run.events if each["kind"] == "event"]
    moves = [each["action"] for each in run.events if each["kind"] == "intent"]
    assert moves == ["robot.park", "rail.home"]
