"""One checker judges the journal of every run, from its events alone, by the invariants.

It knows nothing of the code that wrote them. Each broken invariant is one line.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

STRIP_TOLERANCE_MM = 0.02 + 1e-9  # the approach's tolerance and one flickering count
ENDED = ("idle", "finished", "aborted", "faulted")


class Trace:
    """Replays the events of one journal."""

    def __init__(self) -> None:
        self.broken: list[str] = []
        self._state = "idle"
        self._strip_mm: dict[str, float] = {}
        self._last_motion: dict[str, Any] = {}
        self._parked = True
        self._points: set[str] = set()
        self._closings = 0
        self._seq = 0

    def take(self, event: dict[str, Any]) -> None:
        if event["seq"] != self._seq + 1:
            self._say("I8", event, f"record {self._seq} came before")
        self._seq = event["seq"]
        match event["kind"]:
            case "plan":
                self._strip_mm = {s["name"]: s["strip_mm"] for s in event["cell"]["station"]}
            case "state" if event["machine"] == "run":
                self._life(event)
            case "intent":
                self._motion(event)
            case "point":
                self._point(event)
            case "event" if event["what"] == "tracker moved":
                self._points -= set(event["invalid"])
            case "event" if event["what"] == "closed":
                self._closings += 1

    def _say(self, invariant: str, event: dict[str, Any], what: str) -> None:
        self.broken.append(f"{invariant} at record {event['seq']}: {what}")

    def _life(self, event: dict[str, Any]) -> None:
        if event["from"] != self._state:
            self._say("I9", event, f"state was {self._state}, not {event['from']}")
        self._state = event["to"]
        if self._state == "checking":
            self._closings, self._last_motion = 0, {}
        if self._state in ENDED and self._closings != 1:
            self._say("I7", event, f"teardown ran {self._closings} times")

    def _motion(self, event: dict[str, Any]) -> None:
        action = event["action"]
        if self._state in ENDED:
            self._say("I5", event, f"{action} while {self._state}")
        if self._state in ("paused", "suspended"):
            self._say("I5", event, f"{action} begun while {self._state}")
        if action.startswith("rail.") and self._last_motion.get("action") == "robot.move":
            self._say("I1", event, "the robot was not parked before")
        self._last_motion = event

    def _point(self, event: dict[str, Any]) -> None:
        key, station = event["key"], event["station"]
        if key in self._points and not event.get("retaken"):
            self._say("I8", event, f"{key} counted twice")
        self._points.add(key)
        if self._state in ENDED:
            self._say("I3", event, f"{key} measured while {self._state}")
        if station and not abs(event["strip_mm"] - self._strip_mm[station]) <= STRIP_TOLERANCE_MM:
            self._say("I2", event, f"{key}: strip {event['strip_mm']} at {station}")
        by_robot = event["group"] != "campaign" and event.get("commanded_deg")
        if by_robot and self._last_motion.get("key") != key:
            self._say("I4", event, f"{key}: last motion was {self._last_motion}")
        missing = [name for name in ("reflector", "temperature_c", "frame") if name not in event]
        if missing:
            self._say("I4", event, f"{key} lacks {missing}")


def judge(events: Iterable[dict[str, Any]]) -> list[str]:
    """Return the invariants that the events of a journal break."""
    trace = Trace()
    for event in events:
        trace.take(event)
    return trace.broken
