"""One reflector carried by hand: a test plays the operator, with status and orders alone."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from hilcell.ports import HilcellError
from hilcell.run.control import PromptStatus, Status, order
from tests.whole.bench import (
    SMALL,
    Simulation,
    command,
    cut,
    end_of,
    journal,
    sets,
    simulation,
    sweep,
)
from tests.whole.threaded import Event, Stands, ThreadedRun, is_state, never

pytestmark = pytest.mark.waits
BY_HAND = SMALL | {"layout.reflectors": "by_hand"}


class Operator:
    """Somebody at the cell who sees the run's status and carries the reflector."""

    def __init__(self, run: ThreadedRun, cell: Simulation) -> None:
        self.run, self.cell = run, cell
        self.seats: list[str] = []

    def status(self) -> Status:
        return order(self.run.folder, "status")

    def asked(self) -> bool:
        """Wait for a question or for the end; return whether it is a question."""
        event = self.run.until(lambda event: suspended(event) or event["kind"] == "end")
        return suspended(event)

    def prompt(self, place: str = "", *, seen: bool = False) -> PromptStatus:
        """Wait until a place is asked for, and with ``seen`` until the reflector is seen there."""
        while True:
            status = self.status()
            prompt = status.prompt
            if status.state == "suspended" and prompt is not None and (prompt.ready or not seen):
                assert place in ("", prompt.place), prompt
                return prompt

    def seat(self, place: str) -> None:
        assert self.cell.ask(do="seat", place=place)["ok"]

    def answer(self) -> bool:
        """Say that it is done; return whether that is taken."""
        try:
            order(self.run.folder, "answer")
        except HilcellError:
            return False
        return True

    def obey(self, *places: str) -> None:
        """Do what is asked, place by place, and say so."""
        for place in places or ("",):
            asked = str(self.prompt(place).place)
            self.seat(asked)
            assert self.answer()
            self.seats.append(asked)
            assert self.asked()


def suspended(event: Event) -> bool:
    return is_state(event, "suspended")


def carried(cell: Simulation, runs: Path, *words: str, stands: Stands = never) -> ThreadedRun:
    """Return a run, or a resumed one, in which the reflector is carried by hand."""
    if words[0] == "run":
        words += ("--name", "hand", *sets(BY_HAND | {"simulation.address": cell.control}))
    return ThreadedRun(runs, *words, stands=stands)


@pytest.fixture(scope="module")
def cell() -> Iterator[Simulation]:
    with simulation(values=BY_HAND) as cell:
        yield cell


@pytest.fixture(autouse=True)
def taken_away(cell: Simulation) -> None:
    """Before each test the reflector lies in its box."""
    assert cell.ask(do="seat", place="")["ok"]


@pytest.mark.parametrize("procedure", ["base-frame", *sweep("calibrate")])
def test_a_whole_run_with_one_reflector(tmp_path: Path, cell: Simulation, procedure: str) -> None:
    with carried(cell, tmp_path, "run", procedure) as run:
        operator = Operator(run, cell)
        assert operator.asked()
        first = operator.prompt("F1")
        assert (first.seen_mm, first.ready, first.check) == (None, False, True)
        assert not operator.answer()  # said without doing it
        operator.seat("F2")  # the wrong nest
        assert not operator.answer()
        operator.seat("F1")
        operator.prompt("F1", seen=True)
        assert operator.status().state == "suspended"  # seen, but nobody has said so
        assert operator.answer()
        operator.seats.append("F1")
        while operator.asked():
            place = str(operator.prompt().place)
            operator.seat(place)
            assert operator.answer()
            operator.seats.append(place)
        assert run.rest()["exit"] == 0
    printed = run.events
    seated = [e["place"] for e in printed if e.get("what") == "seated"]
    assert seated == operator.seats
    assert seated[:6] == ["F1", "F2", "F3", "B1", "B2", "flange"]
    assert not [one for one, other in pairwise(seated) if one == other]
    assert len(seated) <= 57
    assert len([e for e in printed if e.get("what") == "answer refused"]) == 2
    asked = [e["prompt"] for e in printed if suspended(e)]
    assert len(asked) == len(seated)
    after = [prompt["limit_mm"] for prompt in asked if prompt["place"] == "F1"]
    assert after == [50.0] + [5.0] * (len(after) - 1)


def test_a_tracker_check_with_one_reflector(tmp_path: Path, cell: Simulation) -> None:
    with carried(cell, tmp_path, "run", "tracker-check") as run:
        operator = Operator(run, cell)
        while operator.asked():
            operator.seats.append(str(operator.prompt().place))
            operator.seat(operator.seats[-1])
            assert operator.answer()
        end = run.rest()
    assert (end["state"], end["exit"]) == ("finished", 0), end
    assert operator.seats == ["F1", "F2", "F3", "B1", "B2", "F2", "F3"]  # near is B2
    result = end["result"]
    assert [each["nest"] for each in result["tracker_axes"]["nests"]] == ["B2", "F2", "F3"]
    assert result["tracker_drift"]["points"] == 21
    assert any("one reflector" in each for each in result["not_checked"])


def test_kill_9_during_a_prompt_begins_the_frame_again(tmp_path: Path, cell: Simulation) -> None:
    """All nests of a frame are measured by one engine: nobody knows whether the tracker stood."""

    def killed(operator: Operator, name: str) -> None:
        """Leave the journal that an engine leaves that is killed at this prompt."""
        seq = operator.run.events[-1]["seq"]
        order(operator.run.folder, "stop")
        operator.run.rest()
        cut(operator.run.folder, tmp_path / name, seq)

    with carried(cell, tmp_path, "run") as run:
        operator = Operator(run, cell)
        assert operator.asked()
        operator.obey("F1")
        operator.prompt("F2")
        operator.seat("F2")  # carried, not yet answered
        killed(operator, "once")
    with carried(cell, tmp_path, "resume", "once") as again:
        operator = Operator(again, cell)
        assert operator.asked()
        operator.obey("F1")  # where it was seen last
        operator.prompt("F2")
        killed(operator, "twice")
    with carried(cell, tmp_path, "resume", "twice") as last:
        operator = Operator(last, cell)
        assert operator.asked()
        assert "from nest F1" in operator.prompt("F2").text  # it sits there still
        operator.obey("F2", "F3", "B1", "B2")
        operator.prompt("flange")
        order(last.folder, "abort")
        assert last.rest()["exit"] == 4
    points = [e["key"] for e in journal(tmp_path, "twice") if e["kind"] == "point"]
    asked = ["world/F1", "world/F2", "world/F3", "length/B1", "length/B2"]
    assert points == ["world/F1", "world/F1", *asked]


def test_a_reflector_taken_away_asks_and_resume_alone_does_not_go_on(
    tmp_path: Path, cell: Simulation
) -> None:
    resume = ("resume", "hand", "--runs", tmp_path)

    def on_flange(event: Event) -> bool:
        return bool(event["kind"] == "point" and event["group"] == "base")

    with carried(cell, tmp_path, "run", "base-frame", stands=on_flange) as run:
        operator = Operator(run, cell)
        assert operator.asked()
        operator.obey("F1", "F2", "F3", "B1", "B2")
        operator.seat("flange")
        assert operator.answer()
        run.until(on_flange)
        operator.seat("")
        assert operator.asked()
        operator.prompt("flange")
        assert command(*resume).returncode == 0
        run.until(lambda event: event.get("what") == "answer refused")
        assert operator.status().state == "suspended"
        operator.seat("flange")
        assert command(*resume).returncode == 0
        assert run.rest()["exit"] == 0


def test_an_unattended_run_with_one_reflector_is_refused(tmp_path: Path, cell: Simulation) -> None:
    words = sets(BY_HAND | {"simulation.address": cell.control})
    refused = command("run", "--unattended", "--json", "--runs", tmp_path, *words)
    assert (refused.returncode, end_of(refused)["state"]) == (2, "idle")
    assert "layout.reflectors" in refused.stderr
    assert list(tmp_path.iterdir()) == []
    with carried(cell, tmp_path, "run") as run:
        run.until(suspended)
        order(run.folder, "stop")
        assert run.rest()["exit"] == 4
    refused = command("resume", "hand", "--runs", tmp_path, "--unattended")
    assert refused.returncode == 2
    assert "layout.reflectors" in refused.stderr
