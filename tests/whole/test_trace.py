"""The checker itself: a good trace passes, every planted break is found."""

from typing import Any

import pytest

from tests.whole.trace import judge


def good() -> list[dict[str, Any]]:
    def state(before: str, after: str) -> dict[str, Any]:
        return {"kind": "state", "machine": "run", "from": before, "to": after}

    point = {
        "kind": "point",
        "key": "grid/0",
        "group": "grid",
        "station": "S1",
        "strip_mm": 10.0,
        "commanded_deg": [0.0],
        "reflector": "SMR",
        "temperature_c": 22.0,
        "frame": "tracker",
    }
    return [
        {"kind": "plan", "cell": {"station": [{"name": "S1", "strip_mm": 10.0}]}},
        state("idle", "checking"),
        state("checking", "running"),
        {"kind": "intent", "action": "rail.approach"},
        {"kind": "intent", "action": "robot.move", "key": "grid/0"},
        point,
        {"kind": "intent", "action": "robot.park"},
        {"kind": "intent", "action": "rail.approach"},
        {"kind": "event", "what": "closed"},
        state("running", "finished"),
    ]


def numbered(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{**event, "seq": n} for n, event in enumerate(events, start=1)]


def test_a_good_trace_passes() -> None:
    assert judge(numbered(good())) == []


def without(at: int) -> list[dict[str, Any]]:
    events = good()
    del events[at]
    return events


def changed(at: int, **values: Any) -> list[dict[str, Any]]:
    events = good()
    events[at] = events[at] | values
    return events


def moved(events: list[dict[str, Any]], at: int, to: int) -> list[dict[str, Any]]:
    events.insert(to, events.pop(at))
    return events


def while_in(state: str) -> list[dict[str, Any]]:
    """A motion that begins while the run is paused."""
    events = good()
    life = {"kind": "state", "machine": "run", "from": "running", "to": state}
    events.insert(3, life)
    return events


@pytest.mark.parametrize(
    ("events", "invariant"),
    [
        (without(6), "I1"),
        (changed(5, strip_mm=10.03), "I2"),
        (changed(5, strip_mm=float("nan")), "I2"),
        (moved(good(), 5, 9), "I3"),
        (without(4), "I4"),
        (moved(good(), 7, 9), "I5"),
        (while_in("paused"), "I5"),
        (while_in("suspended"), "I5"),
        (without(8), "I7"),
        ([*good()[:6], good()[5], *good()[6:]], "I8"),
        (without(2), "I9"),
    ],
)
def test_every_break_is_found(events: list[dict[str, Any]], invariant: str) -> None:
    assert any(line.startswith(invariant) for line in judge(numbered(events)))


def test_a_gap_is_found() -> None:
    events = numbered(good())
    del events[3]
    assert any(line.startswith("I8") for line in judge(events))
