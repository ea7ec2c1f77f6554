"""One reflector carried by hand: a test plays the operator, with status and orders alone."""

import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from hilcell.ports import HilcellError
from hilcell.run.client import order
from hilcell.run.protocol import PromptStatus, Status
from tests.whole.bench import (
    SMALL,
    Engine,
    Simulation,
    command,
    end_of,
    events,
    sets,
    simulation,
    sweep,
)
from tests.whole.trace import judge

BY_HAND = SMALL | {"layout.reflectors": "by_hand"}


class Operator:
    """Somebody at the cell who sees the run's status and carries the reflector."""

    def __init__(self, folder: Path, cell: Simulation) -> None:
        self.folder, self.cell = folder, cell
        self.seats: list[str] = []

    def status(self) -> Status:
        return order(self.folder, "status")

    def prompt(self, place: str = "") -> PromptStatus:
        """Wait until something is asked, and return it."""
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            status = self.status()
            prompt = status.prompt
            if status.state == "suspended" and prompt is not None:
                assert place in ("", prompt.place), prompt
                return prompt
            time.sleep(0.01)
        raise AssertionError("nothing was asked")

    def wanted(self) -> bool:
        """Wait for a prompt or for the end; return whether it is a prompt."""
        while True:
            try:
                status = self.status()
            except HilcellError:
                return False
            if status.prompt is not None and status.state == "suspended":
                return True
            time.sleep(0.01)

    def seat(self, place: str) -> None:
        assert self.cell.ask(do="seat", place=place)["ok"]

    def answer(self) -> str:
        """Return why the answer was refused."""
        try:
            order(self.folder, "answer")
        except HilcellError as error:
            return str(error)
        return ""

    def obey(self, place: str = "") -> str:
        """Do what is asked, say so, and return the place."""
        asked = str(self.prompt(place).place)
        self.seat(asked)
        assert self.answer() == ""
        self.seats.append(asked)
        return asked


@pytest.fixture(scope="module")
def cell() -> Iterator[Simulation]:
    with simulation(values=BY_HAND) as cell:
        yield cell


@pytest.fixture(autouse=True)
def taken_away(cell: Simulation) -> None:
    """Before each test the reflector lies in its box."""
    assert cell.ask(do="seat", place="")["ok"]


def words(cell: Simulation, runs: Path, name: str = "hand") -> list[str | Path]:
    values = sets(BY_HAND | {"simulation.address": cell.control})
    return ["--name", name, "--runs", runs, *values]


@pytest.mark.timeout(300)
@pytest.mark.long
@pytest.mark.parametrize("procedure", ["base-frame", *sweep("calibrate")])
def test_a_whole_run_with_one_reflector(tmp_path: Path, cell: Simulation, procedure: str) -> None:
    engine = Engine("run", procedure, *words(cell, tmp_path))
    engine.until(lambda event: event["kind"] == "state" and event["to"] == "suspended")
    operator = Operator(tmp_path / "hand", cell)

    first = operator.prompt("F1")
    assert first.title == "Seat the reflector in F1"
    assert "nest F1 on the floor, x 0, y 0, z 0 mm in {W}" in first.text
    assert (first.seen_mm, first.ready, first.check) == (None, False, True)
    assert "sees no reflector at F1" in operator.answer()  # said without doing it
    assert operator.status().state == "suspended"
    operator.seat("F2")  # the wrong nest
    assert "sees no reflector at F1" in operator.answer()
    operator.seat("F1")
    while not operator.prompt("F1").ready:
        time.sleep(0.01)
    assert operator.status().state == "suspended"  # seen, but nobody has said so
    assert operator.answer() == ""
    operator.seats.append("F1")

    # Its events are read all the while, for a full pipe would hold the run.
    listener = threading.Thread(target=engine.until, args=(lambda event: event["kind"] == "end",))
    listener.start()
    while operator.wanted():
        operator.obey()
    listener.join(60)
    printed = engine.rest()
    assert printed[-1]["exit"] == 0, engine.errors
    assert judge(printed) == []
    seated = [e["place"] for e in printed if e.get("what") == "seated"]
    assert seated == operator.seats
    assert seated[:6] == ["F1", "F2", "F3", "B1", "B2", "flange"]
    assert not [one for one, other in pairwise(seated) if one == other]
    assert len(seated) <= 57
    refused = [e for e in printed if e.get("what") == "answer refused"]
    assert len(refused) == 2
    suspended = [e for e in printed if e["kind"] == "state" and e["to"] == "suspended"]
    assert len(suspended) == len(seated)
    after = [e["prompt"]["limit_mm"] for e in suspended if e["prompt"]["place"] == "F1"]
    assert after == [50.0] + [5.0] * (len(after) - 1)


def test_kill_9_during_a_prompt_begins_the_frame_again(tmp_path: Path, cell: Simulation) -> None:
    """All nests of a frame are measured by one engine: nobody knows whether the tracker stood."""
    engine = Engine("run", *words(cell, tmp_path))
    engine.until(lambda event: event["kind"] == "state" and event["to"] == "suspended")
    operator = Operator(tmp_path / "hand", cell)
    operator.obey("F1")
    operator.prompt("F2")
    operator.seat("F2")  # carried, not yet answered
    engine.kill()

    again = Engine("resume", "hand", "--runs", tmp_path)
    again.until(lambda event: event["kind"] == "state" and event["to"] == "suspended")
    assert operator.prompt("F1").title == "No good reading of F1"  # where it was seen last
    operator.obey("F1")
    operator.prompt("F2")
    again.kill()

    last = Engine("resume", "hand", "--runs", tmp_path)
    last.until(lambda event: event["kind"] == "state" and event["to"] == "suspended")
    assert "Take the reflector from nest F1" in operator.prompt("F2").text  # it sits there still
    for place in ("F2", "F3", "B1", "B2"):
        operator.obey(place)
    operator.prompt("flange")
    order(tmp_path / "hand", "abort")
    assert last.rest()[-1]["exit"] == 4
    journal = events(command("watch", "hand", "--runs", tmp_path, "--json").stdout)
    assert judge(journal) == []
    points = [e["key"] for e in journal if e["kind"] == "point"]
    asked = ["world/F1", "world/F2", "world/F3", "length/B1", "length/B2"]
    assert points == ["world/F1", "world/F1", *asked]


def test_a_reflector_taken_away_asks_and_resume_alone_does_not_go_on(
    tmp_path: Path, cell: Simulation
) -> None:
    engine = Engine("run", "base-frame", *words(cell, tmp_path))
    engine.until(lambda event: event["kind"] == "state" and event["to"] == "suspended")
    operator = Operator(tmp_path / "hand", cell)
    for place in ("F1", "F2", "F3", "B1", "B2", "flange"):
        operator.obey(place)
    engine.until(lambda event: event["kind"] == "point" and event["group"] == "base")
    operator.seat("")
    prompt = operator.prompt("flange")
    assert prompt.title == "No good reading of flange"
    assert command("resume", "hand", "--runs", tmp_path).returncode == 0
    engine.until(lambda event: event.get("what") == "answer refused")
    assert operator.status().state == "suspended"
    operator.seat("flange")
    assert command("resume", "hand", "--runs", tmp_path).returncode == 0
    assert engine.rest()[-1]["exit"] == 0, engine.errors
    assert judge(engine.events) == []


@pytest.mark.parametrize("word", ["run", "resume"])
def test_nobody_is_left_alone_with_it(tmp_path: Path, cell: Simulation, word: str) -> None:
    if word == "run":
        done = command("run", *words(cell, tmp_path), "--unattended", "--json")
    else:
        engine = Engine("run", *words(cell, tmp_path))
        engine.until(lambda event: event["kind"] == "state" and event["to"] == "suspended")
        engine.kill()
        done = command("resume", "hand", "--runs", tmp_path, "--unattended")
    assert done.returncode == 2
    assert "layout.reflectors is by_hand: somebody must be there" in done.stderr
    if word == "run":
        assert end_of(done)["state"] == "idle"
        assert not list(tmp_path.iterdir())


def test_a_campaign_needs_mounted_reflectors() -> None:
    done = command("run", "campaign", "--dry-run", *sets(BY_HAND))
    assert done.returncode == 2
    assert "must be mounted" in done.stderr


def test_stop_from_a_prompt(tmp_path: Path, cell: Simulation) -> None:
    engine = Engine("run", *words(cell, tmp_path))
    engine.until(lambda event: event["kind"] == "state" and event["to"] == "suspended")
    order(tmp_path / "hand", "stop")
    printed = engine.rest()
    assert printed[-1]["exit"] == 4
    assert judge(printed) == []
