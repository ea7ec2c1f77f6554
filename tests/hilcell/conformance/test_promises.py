"""The kit judges rightly: shipped drivers keep every promise, each broken one breaks its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from drivers.tracker_leica_emscon import LeicaEmsconTracker
from hilcell.cell.file import load_cell
from hilcell.conformance.bench import Benches
from hilcell.conformance.kit import judge_all, promises_of
from hilcell.conformance.promise import judge
from hilcell.conformance.verdicts import PORTS, Port
from tests.hilcell.conformance.broken_drivers import BROKEN

PAIRS = [(port, name) for port in PORTS for name in BROKEN[port]]
# A rail that homes and a tracker that warms up in real time take long.
LONG = {
    (port, promise.name)
    for port in ("rail", "tracker")
    for promise in promises_of(port)
    if promise.paced
}
QUICK_FIRST = [
    pytest.param(*pair, marks=[pytest.mark.nightly] if pair in LONG else []) for pair in PAIRS
]


class QuickTracker(LeicaEmsconTracker):
    """The shipped driver with short deadlines: its own take minutes where no answer comes."""

    REPLY_S = 1.0
    MOVE_S = 1.0
    RESULT_S = 1.0


@pytest.fixture(scope="module")
def benches() -> Iterator[dict[Port, Benches]]:
    cell = load_cell("paper")
    with ExitStack() as stack:
        yield {port: stack.enter_context(Benches(cell, port)) for port in PORTS}


def test_every_promise_has_a_driver_that_breaks_it() -> None:
    for port in PORTS:
        names = [promise.name for promise in promises_of(port)]
        assert sorted(names) == sorted(BROKEN[port])


@pytest.mark.parametrize("port", PORTS)
def test_a_shipped_driver_keeps_every_promise(port: Port, benches: dict[Port, Benches]) -> None:
    benches[port].try_kind(QuickTracker if port == "tracker" else None)
    outcomes = list(judge_all(port, benches[port]))
    assert [each for each in outcomes if each.verdict != "held"] == []


@pytest.mark.parametrize(("port", "name"), QUICK_FIRST)
def test_a_broken_driver_breaks_its_promise(
    port: Port, name: str, benches: dict[Port, Benches]
) -> None:
    benches[port].try_kind(BROKEN[port][name])
    promise = next(each for each in promises_of(port) if each.name == name)
    outcome = judge(promise, benches[port].of(paced=promise.paced))
    assert outcome.verdict == "broken"
    assert outcome.why


@pytest.mark.nightly
@pytest.mark.parametrize(("port", "name"), PAIRS)
def test_and_no_other(port: Port, name: str, benches: dict[Port, Benches]) -> None:
    benches[port].try_kind(BROKEN[port][name])
    outcomes = list(judge_all(port, benches[port]))
    assert [each.promise for each in outcomes if each.verdict == "broken"] == [name]


def test_promises_that_are_none_of_a_driver_say_why(benches: dict[Port, Benches]) -> None:
    benches["tracker"].try_kind(_Still)
    for name in ("stream-times", "stream-gaps", "stream-place", "stream-ends"):
        promise = next(each for each in promises_of("tracker") if each.name == name)
        outcome = judge(promise, benches["tracker"].of(paced=False))
        assert (outcome.verdict, outcome.why) == ("not applicable", "it does not stream")


class _Still:
    """A tracker that does not stream."""

    def __init__(self, options: Any, clock: Any) -> None:
        tracker = LeicaEmsconTracker(options, clock)
        self.connect, self.measure = tracker.connect, tracker.measure
        self.stop, self.close = tracker.stop, tracker.close
