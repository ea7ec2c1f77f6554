"""Records of a journal: each kind as a type, decoded from JSON on first use. A record is
acknowledged and never changed.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import msgspec
from msgspec import field

from hilcell.decoding import Json, typed
from hilcell.model import events
from hilcell.model.events import Event, OtherEvent
from hilcell.model.frame import Frame, decode_frame
from hilcell.model.plan import PlanRecord
from hilcell.model.point import Point
from hilcell.model.verdicts import Verdict, decode_verdict

Kind: TypeAlias = Literal["plan", "state", "intent", "point", "frame", "verdict", "event", "end"]

# -- the states of a run and of its calibration; `hilcell.run.states` has the transitions ----------

RunState = Literal[
    "idle",
    "checking",  # identities and interlocks; nothing moves
    "running",
    "pausing",  # after the point in progress
    "paused",
    "suspended",  # waits for the answer to a prompt
    "aborting",  # after the point in progress
    "stopping",
    "finished",
    "aborted",
    "faulted",
]
CalibrationState = Literal[
    "unknown",
    "connected",
    "referenced",
    "world_framed",
    "station_held",
    "base_framed",
    "grid_measured",
    "stations_framed",
    "fitted",
    "validated",
]

OVER: tuple[RunState, ...] = ("finished", "aborted", "faulted")
WAITING: tuple[RunState, ...] = ("paused", "suspended")  # for the operator; nothing moves
WORKING: tuple[RunState, ...] = ("checking", "running", "pausing", "aborting", "stopping")
PASSING: tuple[RunState, ...] = ("pausing", "aborting")  # the key ``pausing`` of `status`

# -- the records -----------------------------------------------------------------------------------


class StateChanged(msgspec.Struct, frozen=True, kw_only=True):
    """A transition of a state machine; ``by``: the cause that resumed a waiting run."""

    machine: str
    before: str = field(name="from", default="")
    to: str
    trigger: str = ""
    reason: str = ""
    by: str = ""
    prompt: Json | None = None  # of a run that waits for an answer
    error: Json = field(default_factory=dict)


class Change(NamedTuple):
    """A change of the run's state, with its record's number and time."""

    seq: int
    t: str
    change: StateChanged

    @property
    def to(self) -> str:
        return self.change.to


class SeenBefore(msgspec.Struct, frozen=True, kw_only=True):
    """The reading that admits a motion: of the robot for the slide's, of the rail for the robot's.
    Times in s of the PC's monotonic clock; ``age_s``: its age when the motion was journalled.
    """

    taken_s: float
    age_s: float
    still: bool
    ended_s: float | None = None
    powered: bool | None = None
    strip_mm: float | None = None
    joints_deg: tuple[float, ...] = ()


class Intended(msgspec.Struct, frozen=True, kw_only=True):
    """A motion about to begin: its target, and the reading that admits it.

    A slide goes to a ``station`` by the strip or to ``position_mm`` by its drive; the robot to
    ``joints_deg`` with the slide at ``strip_mm``, straight from ``from_deg`` unless that is empty.
    """

    action: str = ""
    session: int = 0
    seen: SeenBefore | None = None
    station: str = ""
    position_mm: float | None = None
    axis: int = 0
    joints_deg: tuple[float, ...] = ()
    strip_mm: float | None = None
    from_deg: tuple[float, ...] = ()
    distance_mm: float | None = None
    bound_mm: float | None = None
    speed_percent: float | None = None


class Ended(msgspec.Struct, frozen=True, kw_only=True):
    """A session has ended, with an exit code and its procedure's result, or why it has none."""

    state: str
    exit: int
    result: Json = field(default_factory=dict)
    reason: str = ""
    error: Json = field(default_factory=dict)


EVENTS: dict[str, type[Event]] = {
    str(each.__struct_config__.tag): each
    for each in vars(events).values()
    if isinstance(each, type) and issubclass(each, Event) and not each.__subclasses__()
}
Fact: TypeAlias = (
    PlanRecord | Event | OtherEvent | StateChanged | Intended | Point | Frame | Verdict | Ended
)


def fact_of(kind: Kind, key: str, body: Json) -> Fact:
    match kind:
        case "event":
            return decode_event(body)
        case "point":
            return typed(body | {"key": key}, Point)
        case "state":
            return typed(body, StateChanged)
        case "intent":
            return typed(body, Intended)
        case "frame":
            return decode_frame(key, body)
        case "verdict":
            return decode_verdict(key, body)
        case "end":
            return typed(body, Ended)
        case "plan":
            return typed(body, PlanRecord)


def decode_event(body: Json) -> Event | OtherEvent:
    what = str(body["what"])
    if what in EVENTS:
        return typed(body, EVENTS[what])
    return OtherEvent(what, {name: value for name, value in body.items() if name != "what"})
