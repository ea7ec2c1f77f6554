"""The six phases of a run in which a fault strikes, and how a run is brought to each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

Event = dict[str, Any]


class Phase(Enum):
    """A phase, by its name in the catalogue of faults."""

    RAIL = "rail moving"
    ROBOT = "robot moving"
    MEASURING = "measuring"
    PAUSED = "paused"
    RESUMING = "resuming"
    TEARDOWN = "tearing down"


@dataclass(frozen=True)
class Moments:
    """Where a procedure's phases begin: keys of its records.

    ``halted``: the point after which a run is paused, or stopped.
    """

    rail: int  # the n-th approach
    robot: str
    measuring: str  # a point after which another is measured, with nothing moved between
    halted: str


MOMENTS = {
    "base-frame": Moments(1, "base/axis1/002", "world/F1", "base/axis1/001"),
    "calibrate": Moments(2, "grid/1-1-1", "control/1-2/F1", "grid/1-0-0"),
}


def begins(phase: Phase, moments: Moments, seen: list[Event]) -> bool:
    """Whether the newest of the events seen begins a phase that needs no command before it."""
    event = seen[-1]
    match phase:
        case Phase.RAIL:
            approaches = [each for each in seen if each.get("action") == "rail.approach"]
            return event.get("action") == "rail.approach" and len(approaches) == moments.rail
        case Phase.ROBOT:
            return (event.get("action"), event.get("key")) == ("robot.move", moments.robot)
        case Phase.MEASURING:
            return is_point(event, moments.measuring)
        case Phase.PAUSED:
            return _enters(event, "paused")
        case Phase.RESUMING:
            return _enters(event, "checking") and event["from"] != "idle"
        case Phase.TEARDOWN:
            return _enters(event, "stopping")


def is_point(event: Event, key: str) -> bool:
    """Whether an event is a point that is durable now."""
    return bool(event["kind"] == "point" and event["key"] == key)


def _enters(event: Event, state: str) -> bool:
    return bool(event["kind"] == "state" and event["machine"] == "run" and event["to"] == state)
