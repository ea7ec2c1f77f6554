"""`hilcell run conformance` on machines, attended: no motion without somebody's "yes".

The machines are simulated devices of their own whose name plates do not say so, reached by a cell
file that names no simulator: the engine takes them for real ones. It and `hilcell resume` are
processes, the latter at a terminal.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.on_failure import on_failure
from fakes.canopen import rail_drive, rail_strip
from fakes.kuka.controller import KrlController
from fakes.leica.emscon_packets import wide
from hilcell.run.client import order
from tests.whole.bench import HILCELL, LIMIT_S, Engine, command, sets, simulation, sweep
from tests.whole.terminal import Terminal

PAPER = Path(__file__).parents[2] / "hilcell/cells/paper.toml"
FIRST, SECOND = (
    f"rail (canopen): the slide moves from {start} to {end} mm at 25 mm/s; the robot goes to its "
    "safe pose first"
    for start, end in (("0.00", "320.00"), ("320.00", "300.00"))
)
HOME = ("robot (kuka-c3): to its safe pose, ", "rail (canopen): the slide moves from ")
QUESTION = 'type "yes" to go on; any other answer moves nothing:'


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[str]]:
    """Return the words that name a cell of machines, and a slow one."""
    folder = tmp_path_factory.mktemp("shop")
    cell = folder / "shop.toml"
    cell.write_text(PAPER.read_text("utf-8").split("[simulation]")[0])
    with pytest.MonkeyPatch.context() as plates:
        for module in (rail_drive, rail_strip):
            plates.setattr(module, "IDENTITY", replace(module.IDENTITY, name="of the plant"))
        plates.setattr(KrlController, "_identity", lambda self: f'"{self._arm.model}"')
        plates.setattr(
            "fakes.leica.emscon_device.wide", lambda text: wide(text.replace(" (simulated)", ""))
        )
        with simulation(20.0) as machines:
            where = machines.addresses
            values = {
                "name": "shop",
                "serial": "HC-7",
                "rail.options.channel": where["rail"]["channel"],
                "robot.options.port": str(where["robot"]["port"]),
                "tracker.options.port": str(where["tracker"]["port"]),
                "settle.rail_s": "0.0",
                "robot.speed_percent": "10",
                "rail.speed_mm_s": "25",
            }
            yield ["--cell", str(cell), *sets(values)]


class Attended:
    """A run that waits for the word before its first motion."""

    def __init__(self, shop: list[str], runs: Path) -> None:
        self.runs = runs
        self.engine = Engine("run", "conformance", "--runs", runs, *shop)
        with on_failure(self.engine.process.kill):
            paused = self.paused()
            assert [each for each in HOME if each not in paused["reason"]] == []
            assert self.intents == []
            order(runs / self.engine.run, "proceed", until=paused["seq"])
            self.waits_before(FIRST)
        self.homed = len(self.intents)

    def __enter__(self) -> Attended:
        return self

    def __exit__(self, *_: object) -> None:
        if self.engine.process.poll() is None:
            command("stop", self.engine.run, "--runs", self.runs)
            self.engine.rest()

    def paused(self) -> dict[str, Any]:
        """Read events until the run is paused; return the last."""
        return self.engine.until(lambda event: event.get("to") == "paused")

    def waits_before(self, motion: str) -> None:
        """Read events until the run is paused; the motion must have been announced."""
        paused = self.paused()
        typed = f'then type "yes" at `hilcell resume {self.engine.run}`'
        reason = f"conformance: {motion}; clear the cell, stay at the E-stop, {typed}"
        assert paused["reason"].startswith(reason)
        announced = [e for e in self.engine.events if e.get("what") == "announced"]
        assert announced[-1]["motion"] == motion

    @property
    def intents(self) -> list[dict[str, Any]]:
        return [event for event in self.engine.events if event["kind"] == "intent"]

    @property
    def moved(self) -> list[float]:
        """Return where the slide was sent since the first pause."""
        return [intent["position_mm"] for intent in self.intents[self.homed :]]

    def terminal(self) -> Terminal:
        """Return a terminal that asks whether the run may go on."""
        found = Terminal(["resume", self.engine.run, "--runs", str(self.runs)], columns=200)
        found.shows(QUESTION)
        return found

    def status(self) -> str:
        return order(self.runs / self.engine.run, "status").state

    def stop(self) -> dict[str, Any]:
        """Stop it; return its last event."""
        command("stop", self.engine.run, "--runs", self.runs)
        return self.engine.rest()[-1]


@pytest.fixture
def attended(shop: list[str], tmp_path: Path) -> Iterator[Attended]:
    with Attended(shop, tmp_path) as attended:
        yield attended


def test_yes_lets_the_one_motion_go_that_was_announced(attended: Attended) -> None:
    with attended.terminal() as terminal:
        assert f"it waits: conformance: {FIRST}; clear the cell" in terminal.text
        assert "your answer is for this motion alone" in terminal.text
        assert "SIMULATED" not in terminal.text
        assert attended.moved == []
        terminal.answer("yes\n")
        assert terminal.ends() == 0
    attended.waits_before(SECOND)
    assert attended.moved == [320.0]
    assert attended.status() == "paused"
    held = [e for e in attended.engine.events if e.get("promise") == "taken"]
    assert [each["verdict"] for each in held] == ["held"]


@pytest.mark.parametrize("word", ["yess", "\x03", *sweep("y", "no", "", "go", "\x04")],
                         ids=["typo", "ctrl-C", "y", "no", "enter", "other", "ctrl-D"])  # fmt: skip
def test_any_other_word_moves_nothing(attended: Attended, word: str) -> None:
    with attended.terminal() as terminal:
        terminal.answer(word if word in ("\x03", "\x04") else f"{word}\n")
        assert terminal.ends() != 0
    assert attended.status() == "paused"
    end = attended.stop()
    assert attended.moved == []
    assert (end["state"], end["exit"]) == ("aborted", 4)


def test_nobody_at_a_terminal_moves_nothing(attended: Attended) -> None:
    words = ["resume", attended.engine.run, "--runs", str(attended.runs)]
    for close, said in ((None, b"yes\n"), (subprocess.DEVNULL, None)):
        done = subprocess.run(
            [*HILCELL, *words],
            stdin=close,
            input=said,
            capture_output=True,
            timeout=LIMIT_S,
            check=False,
        )
        assert done.returncode == 2
        assert b"nobody can be asked whether the robot may go on" in done.stderr
    closed = subprocess.run(
        ["sh", "-c", 'exec "$@" <&-', "sh", *HILCELL, *words],
        capture_output=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert closed.returncode == 2
    assert b"Traceback" not in closed.stderr
    assert attended.status() == "paused"
    attended.stop()
    assert attended.moved == []


def test_a_terminal_that_is_closed_at_the_question_moves_nothing(attended: Attended) -> None:
    with attended.terminal():
        pass
    assert attended.status() == "paused"
    attended.stop()
    assert attended.moved == []


def test_a_stop_at_the_question_ends_the_run_and_a_yes_after_it_moves_nothing(
    attended: Attended,
) -> None:
    with attended.terminal() as terminal:
        end = attended.stop()
        assert (end["state"], end["exit"]) == ("aborted", 4)
        terminal.answer("yes\n")
        assert terminal.ends() == 2
        assert "Traceback" not in terminal.text
    assert attended.moved == []


def test_a_yes_to_a_motion_that_another_terminal_has_agreed_to_moves_nothing_else(
    attended: Attended,
) -> None:
    with attended.terminal() as one, attended.terminal() as other:
        one.answer("yes\n")
        assert one.ends() == 0
        attended.waits_before(SECOND)
        other.answer("yes\n")
        assert other.ends() == 2
        assert "it has gone on since you were asked" in other.text
    assert attended.status() == "paused"
    attended.stop()
    assert attended.moved == [320.0]


def test_motions_wait_again_after_a_resume(shop: list[str], tmp_path: Path) -> None:
    with Attended(shop, tmp_path) as attended:
        attended.stop()
    with attended.terminal() as terminal:
        assert "it waits" not in terminal.text
        terminal.answer("yes\n")
        terminal.shows(f"conformance: {FIRST}; clear the cell")
        terminal.press("\x03")
        assert terminal.ends() == 4


@pytest.mark.nightly
def test_all_promises_that_a_machine_may_be_asked_for_are_held(
    shop: list[str], tmp_path: Path
) -> None:
    with Attended(shop, tmp_path) as attended:
        engine, folder = attended.engine, tmp_path / attended.engine.run
        while True:
            order(folder, "proceed", until=engine.events[-1]["seq"])
            last = engine.until(lambda e: e.get("to") == "paused" or e["kind"] == "end")
            if last["kind"] == "end":
                break
        engine.rest()
    verdicts = [
        each["verdict"] for found in last["result"]["conformance"].values() for each in found
    ]
    assert last["exit"] == 0
    assert set(verdicts) == {"held", "not applicable"}
    announced = [e for e in engine.events if e.get("what") == "announced"]
    moved = [e for e in attended.intents[attended.homed :] if e["action"].endswith("move")]
    assert len(announced) == 1 + len(moved)  # to reference once
    assert not last["result"]["simulated"]
