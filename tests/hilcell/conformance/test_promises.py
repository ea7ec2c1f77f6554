"""The kit judges rightly: shipped drivers keep every promise, each broken one breaks its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from importlib.metadata import entry_points
from typing import Any

import pytest

from hilcell.cell.file import load_cell
from hilcell.conformance.kit import driver_cell, judge_all, promises_of
from hilcell.conformance.promise import Outcome, Promise
from hilcell.conformance.trial import Trial
from hilcell.conformance.verdicts import PORTS, Port
from hilcell.errors import Stopped
from tests.hilcell.conformance.broken_drivers import BROKEN, NUMBERLESS

PAIRS = [(port, name) for port in PORTS for name in BROKEN[port]]
# A rail that homes and a tracker that warms up in real time take long.
LONG = {
    (port, promise.name)
    for port in ("rail", "tracker")
    for promise in promises_of(port)
    if promise.paced
}
QUICK = {port: [name for name in BROKEN[port] if (port, name) not in LONG] for port in PORTS}
PARTS = 2  # of each port's broken drivers: each takes some 15 s


# Every shipped driver, in a cell to which it belongs, and the promises that are none of its own.
NO_RAIL = "the cell has no rail: no device answers, and nothing moves"
OF_NONE = ["connect-twice", "close-twice", "stop-twice", "taken", "no-number", "reads-back",
           "at-rest", "travel"]  # fmt: skip
NO_SERIAL = {"identity-wrong": "its options name no serial number"}
NO_STREAM = {
    promise.name: "it does not stream"
    for promise in promises_of("tracker")
    if promise.name.startswith("stream")
}
SHIPPED: list[tuple[Port, str, str, dict[str, str]]] = [
    ("rail", "canopen", "paper", {}),
    ("rail", "kuka-e1", "paper", {}),
    ("rail", "none", "fixed", {
        promise.name: NO_RAIL
        for promise in promises_of("rail")
        if promise.name not in OF_NONE
    } | NO_SERIAL),
    ("robot", "kuka-c3", "paper", {}),
    ("robot", "kuka-eki", "paper", {}),
    ("robot", "ur-rtde", "lab", {}),
    ("tracker", "leica-emscon", "paper", {}),
    ("tracker", "leica-geocom", "paper", NO_STREAM),
    ("tracker", "t2sa", "paper", NO_STREAM | NO_SERIAL),
]  # fmt: skip


# Another make at a port: by day the promises that are judged in a few seconds.
FIRST = ("canopen", "none", "kuka-c3", "leica-emscon")
SECOND = [each for each in SHIPPED if each[1] not in FIRST]


@pytest.fixture(scope="module")
def trials() -> Iterator[dict[Port, Trial]]:
    cell = load_cell("paper")
    with ExitStack() as stack:
        yield {port: stack.enter_context(Trial(cell, port)) for port in PORTS}


def test_every_driver_is_put_through_the_kit() -> None:
    installed = {
        (port, each.name) for port in PORTS for each in entry_points(group=f"hilcell.{port}s")
    }
    assert {(port, name) for port, name, _, _ in SHIPPED} == installed


def test_every_promise_has_a_driver_that_breaks_it() -> None:
    for port in PORTS:
        names = [promise.name for promise in promises_of(port)]
        assert sorted(names) == sorted(BROKEN[port])


@pytest.mark.long
@pytest.mark.parametrize(
    ("port", "name", "cell", "others"),
    [
        pytest.param(*each, id=each[1], marks=[pytest.mark.nightly] if each in SECOND else [])
        for each in SHIPPED
    ],
)
def test_a_shipped_driver_keeps_every_promise(
    port: Port, name: str, cell: str, others: dict[str, str]
) -> None:
    with Trial(driver_cell(cell, port, name, {}), port) as trial:
        outcomes = list(judge_all(port, trial))
    assert [each for each in outcomes if each.verdict == "broken"] == []
    assert {each.promise: each.why for each in outcomes if each.verdict != "held"} == others


@pytest.mark.parametrize(
    ("port", "name", "cell", "others"), SECOND, ids=[name for _, name, _, _ in SECOND]
)
def test_a_second_make_keeps_what_is_judged_without_waiting(
    port: Port, name: str, cell: str, others: dict[str, str]
) -> None:
    quick = [each for each in promises_of(port) if not (each.waits or each.paced)]
    with Trial(driver_cell(cell, port, name, {}), port) as trial:
        outcomes = [trial.judge(promise) for promise in quick]
    found = {each.promise: each.why for each in outcomes if each.verdict != "held"}
    names = [promise.name for promise in quick]
    assert found == {promise: why for promise, why in others.items() if promise in names}


@pytest.mark.nightly
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


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("port", PORTS)
def test_a_broken_driver_breaks_its_promise(port: Port, part: int) -> None:
    """Many in one trial: to begin one takes longer than to judge."""
    with Trial(load_cell("paper"), port) as trial:
        outcomes = [judged(trial, port, name) for name in QUICK[port][part::PARTS]]
    assert [each.promise for each in outcomes if each.verdict != "broken" or not each.why] == []


@pytest.mark.long
@pytest.mark.parametrize(("port", "name", "sets", "kind"), NUMBERLESS)
def test_a_driver_that_ignores_the_numbers_of_answers_takes_a_late_one(
    port: Port, name: str, sets: dict[str, str], kind: type[Any]
) -> None:
    with Trial(driver_cell("paper", port, name, sets), port, kind=kind) as trial:
        outcome = trial.judge(named(port, "late"))
    assert (outcome.verdict, bool(outcome.why)) == ("broken", True)


def judged(trial: Trial, port: Port, name: str) -> Outcome:
    """Return how a promise is judged of the driver that breaks it."""
    trial.try_kind(BROKEN[port][name])
    return trial.judge(named(port, name))


@pytest.mark.nightly
@pytest.mark.parametrize(("port", "name"), sorted(LONG))
def test_a_broken_driver_breaks_its_long_promise(
    port: Port, name: str, trials: dict[Port, Trial]
) -> None:
    outcome = judged(trials[port], port, name)
    assert outcome.verdict == "broken"
    assert outcome.why


@pytest.mark.nightly
@pytest.mark.parametrize(("port", "name"), PAIRS)
def test_and_no_other(port: Port, name: str, trials: dict[Port, Trial]) -> None:
    trials[port].try_kind(BROKEN[port][name])
    outcomes = [trials[port].judge(promise) for promise in promises_of(port)]
    broken = {each.promise: each.why for each in outcomes if each.verdict == "broken"}
    assert list(broken) == [name], broken


def named(port: Port, name: str) -> Promise:
    return next(each for each in promises_of(port) if each.name == name)


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


def test_what_nobody_waits_for_any_more_ends_at_once() -> None:
    began_s = time.monotonic()
    with Trial(load_cell("paper"), "tracker", kind=Endless) as trial:
        trial.begin(promises_of("tracker"))
    assert time.monotonic() - began_s < 10.0


def test_a_run_that_is_stopped_stops_what_is_judged_beside() -> None:
    stopped = threading.Event()

    def outer() -> None:
        if stopped.is_set():
            raise Stopped("the run is stopped")

    with Trial(load_cell("paper"), "tracker", kind=Endless, outer=outer) as trial:
        trial.begin(promises_of("tracker"))
        stopped.set()
        with pytest.raises(Stopped, match="the run is stopped"):
            trial.judge(named("tracker", "silent"))
