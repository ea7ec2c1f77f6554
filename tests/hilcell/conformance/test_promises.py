"""The kit judges rightly: shipped drivers keep every promise, each broken one breaks its own.

By day the promises that are judged at once, on simulated cells in the test's process; those that
wait for deadlines are judged of the robot, and every night of all.
"""

from __future__ import annotations

import math
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.supervision import HEARTBEAT_TIMEOUT_S
from hilcell.cell.file import load_cell
from hilcell.conformance import trial
from hilcell.conformance.common_promises import PortPromises, WirePromises
from hilcell.conformance.exercise import PORTS, Port
from hilcell.conformance.promises import PROMISES, driver_cell, promises_of, renewed
from hilcell.conformance.trial import Bench, Broken, Outcome, Promise, Trial
from hilcell.errors import Stopped
from hilcell.ports import RobotReading
from tests.hilcell.conformance.broken_drivers import BROKEN, LateByTag

pytestmark = pytest.mark.waits

PAGE = Path(__file__).parents[3] / "docs" / "conformance.md"

# Every shipped driver, in a cell to which it belongs, and the promises that are none of its own.
OF_NONE = ["connect-twice", "close-twice", "stop-twice", "taken", "no-number", "reads-back",
           "at-rest", "travel"]  # fmt: skip
NO_RAIL = [each.name for each in promises_of("rail") if each.name not in OF_NONE]
NO_STREAM = [each.name for each in promises_of("tracker") if each.name.startswith("stream")]
SHIPPED: list[tuple[Port, str, str, list[str]]] = [
    ("rail", "canopen", "paper", []),
    ("rail", "kuka-e1", "paper", []),
    ("rail", "none", "fixed", NO_RAIL),
    ("robot", "abb-egm", "abb", []),
    ("robot", "kuka-c3", "paper", []),
    ("robot", "kuka-eki", "paper", []),
    ("robot", "ur-rtde", "lab", []),
    ("tracker", "leica-emscon", "paper", []),
    ("tracker", "leica-geocom", "paper", NO_STREAM),
    ("tracker", "t2sa", "paper", [*NO_STREAM, "identity-wrong"]),
]
SHORT = {"rail.standstill_dwell_s": "0.05"}  # its close waits for it in real time
FIRST = ("canopen", "none", "kuka-c3", "leica-emscon")  # the others of a port are for the night


def at_once(promise: Promise) -> bool:
    """Whether a promise is judged without waiting for a deadline, and by no time of the PC."""
    return not (promise.waits or promise.paced or promise.name == "slow")


def named(port: Port, name: str) -> Promise:
    return next(each for each in promises_of(port) if each.name == name)


def test_every_driver_is_put_through_the_kit() -> None:
    installed = {
        (port, each.name) for port in PORTS for each in entry_points(group=f"hilcell.{port}s")
    }
    assert {(port, name) for port, name, _, _ in SHIPPED} == installed


def test_every_promise_has_a_driver_that_breaks_it() -> None:
    common = {each.name for each in promises_of("robot")}
    for port in PORTS:
        names = {each.name for each in promises_of(port)}
        own = {"units", "handedness"} if port != "robot" else common
        assert names - common | own == BROKEN[port].keys()


def test_the_page_lists_the_promises() -> None:
    text = PAGE.read_text("utf-8")
    assert renewed(text) == text
    assert all(f"`{promise.name}`" in text for promise in PROMISES)


@pytest.mark.parametrize("turned_deg", [0.003, -0.003, math.nan])
def test_readings_of_two_places_are_no_rest(turned_deg: float) -> None:
    bench = Bench(load_cell("paper"), "robot")
    one = RobotReading(np.zeros(6), np.eye(4), still=True, taken_s=0.0)
    other = replace(one, joints_rad=np.radians([0.0, 0.0, turned_deg, 0.0, 0.0, 0.0]))
    judging = PortPromises(bench)
    judging.require_same_place(one, one, "it moves")
    with pytest.raises(Broken, match="it moves: "):
        judging.require_same_place(one, other, "it moves")


def test_one_of_some_stops_has_to_be_prompt() -> None:
    WirePromises._prompt("stop took", [0.5, 0.01], 0.02)
    with pytest.raises(Broken, match="stop took 30 ms, expected <= 20 ms"):
        WirePromises._prompt("stop took", [0.5, 0.03], 0.02)


@pytest.mark.parametrize(
    ("port", "name", "cell", "others"), [each for each in SHIPPED if each[1] in FIRST]
)
def test_a_shipped_driver_keeps_what_is_judged_at_once(
    port: Port, name: str, cell: str, others: list[str]
) -> None:
    promises = [each for each in promises_of(port) if at_once(each)]
    with Trial(driver_cell(cell, port, name, SHORT if cell == "paper" else {}), port) as trial:
        outcomes = [trial.judge(each) for each in promises]
    assert [each for each in outcomes if each.verdict == "broken"] == []
    found = {each.promise for each in outcomes if each.verdict != "held"}
    assert found == {*others} & {each.name for each in promises}


@pytest.mark.nightly
@pytest.mark.wall
@pytest.mark.parametrize(("port", "name", "cell", "others"), SHIPPED)
def test_a_shipped_driver_keeps_every_promise(
    port: Port, name: str, cell: str, others: list[str]
) -> None:
    with Trial(driver_cell(cell, port, name, {}), port) as trial:
        outcomes = judge_all(port, trial)
    assert [each for each in outcomes if each.verdict == "broken"] == []
    assert {each.promise for each in outcomes if each.verdict != "held"} == {*others}


@pytest.mark.wall
def test_a_robot_that_goes_on_without_its_client_breaks_its_promise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A shorter motion and a shorter wait than usual: one that brakes by itself does so in both."""
    monkeypatch.setattr(trial.Bench, "PACE", 1.5 * trial.Bench.PACE)
    monkeypatch.setattr(WirePromises, "GONE_S", HEARTBEAT_TIMEOUT_S + 0.5)
    assert kept("robot", ["client-killed"]) == []


@pytest.mark.nightly
@pytest.mark.wall
def test_a_robot_s_driver_keeps_what_needs_deadlines_and_broken_ones_do_not() -> None:
    """Those broken by waiting until the driver gives up are for the night."""
    names = ["client-killed", "stop-at-once", "stop-rests", "slow"]
    promises = [each for each in promises_of("robot") if not at_once(each)]
    with (
        ThreadPoolExecutor(len(names)) as beside,  # they wait, too; a broken promise stays broken
        Trial(load_cell("paper"), "robot") as trial,
    ):
        broken = [beside.submit(kept, "robot", names[:1])]
        trial.begin(promises)
        outcomes = [trial.judge(each) for each in promises if not each.waits]
        broken += [beside.submit(kept, "robot", [name]) for name in names[1:]]
        outcomes += [trial.judge(each) for each in promises if each.waits]
        assert [each for each in outcomes if each.verdict != "held"] == []
        assert [each.result() for each in broken] == [[]] * len(names)


@pytest.mark.nightly
@pytest.mark.wall
@pytest.mark.parametrize(
    ("driver", "wires"),
    [
        ("canopen", {"strip.driver": "serial"}),
        ("canopen", {"strip.driver": "canopen"}),
        ("canopen", {"channel": "/dev/gateway", "strip.driver": "canopen",
                     "strip.channel": "/dev/strip"}),
        ("kuka-e1", {"strip.driver": "canopen"}),
    ],
    ids=["a serial strip", "two buses", "two serial lines", "E1 and a bus"],
)  # fmt: skip
def test_a_rail_keeps_every_promise_over_other_wires(driver: str, wires: dict[str, str]) -> None:
    sets = {f"rail.options.{key}": value for key, value in wires.items()}
    with Trial(driver_cell("paper", "rail", driver, sets), "rail") as trial:
        assert [each for each in judge_all("rail", trial) if each.verdict != "held"] == []


def judge_all(port: Port, trial: Trial) -> list[Outcome]:
    trial.begin(promises_of(port))
    return [trial.judge(promise) for promise in promises_of(port)]


def kept(port: Port, names: list[str]) -> list[str]:
    """Return the promises that their broken drivers keep all the same; one trial judges all.

    One that fails by a mistake of its own, as where the driver has changed under it, shows nothing.
    """
    with Trial(load_cell("paper", SHORT), port) as trial:
        outcomes = [judged(trial, port, name) for name in names]
    mistakes = "AttributeError", "NameError", "TypeError"
    return [
        f"{each.promise}: {each.why}"
        for each in outcomes
        if each.verdict != "broken" or not each.why or each.why.startswith(mistakes)
    ]


def judged(trial: Trial, port: Port, name: str) -> Outcome:
    """Return how a promise is judged of the driver that breaks it."""
    trial.try_kind(BROKEN[port][name])
    return trial.judge(named(port, name))


@pytest.mark.parametrize("port", PORTS)
def test_a_broken_driver_breaks_what_is_judged_at_once(port: Port) -> None:
    assert kept(port, [name for name in BROKEN[port] if at_once(named(port, name))]) == []


@pytest.mark.nightly
@pytest.mark.wall
def test_a_driver_that_ignores_the_numbers_of_answers_takes_a_late_one() -> None:
    with Trial(load_cell("paper"), "robot", kind=LateByTag) as trial:
        assert trial.judge(named("robot", "late")).verdict == "broken"


@pytest.mark.nightly
@pytest.mark.wall
@pytest.mark.parametrize(("port", "name"), [(port, n) for port in PORTS for n in BROKEN[port]])
def test_and_no_other(port: Port, name: str) -> None:
    with Trial(load_cell("paper"), port, kind=BROKEN[port][name]) as trial:
        outcomes = [trial.judge(promise) for promise in promises_of(port)]
    assert [each.promise for each in outcomes if each.verdict == "broken"] == [name]


class Endless:
    """Waits until it is stopped, whatever it is asked."""

    def __init__(self, options: Any, clock: Any) -> None:
        self._clock = clock

    def connect(self) -> Any:
        waiting = threading.Event()
        while not waiting.wait(0.001):
            self._clock.check()

    def close(self) -> None:
        """Nothing is open."""


def test_what_nobody_waits_for_any_more_ends() -> None:
    with Trial(load_cell("paper"), "tracker", kind=Endless) as trial:
        trial.begin(promises_of("tracker"))


def test_a_run_that_is_stopped_stops_what_is_judged_beside() -> None:
    stopped = threading.Event()

    def outer() -> None:
        if stopped.is_set():
            raise Stopped("the run is stopped")

    with Trial(load_cell("paper"), "tracker", kind=Endless, outer=outer) as trial:
        trial.begin(promises_of("tracker"))
        stopped.set()
        with pytest.raises(Stopped):
            trial.judge(named("tracker", "silent"))
