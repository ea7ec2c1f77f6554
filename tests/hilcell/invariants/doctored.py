"""A small journal that holds every invariant, and its doctored copies.

Two sessions: home, {W}, a station, a point; a pause; a bump that costs a point; a fault, and the
resume to the end.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hilcell.journal.journal import Record
from hilcell.model.records import Kind

Row = tuple[str, Kind, str, dict[str, Any]]  # a name for the tests, then kind, key, body

SAFE_DEG = [0.0, -100.0, 110.0, 0.0, -30.0, 0.0]
NESTS = {"F1": [0.0, 0.0, 0.0], "F2": [1500.0, 0.0, 0.0], "F3": [0.0, 1500.0, 0.0]}
BUMP_MM = [5.0, 0.0, 0.0]
PLAN = {
    "cell": {
        "station": [{"name": "S1", "strip_mm": 10.0}],
        "rail": {"strip_tolerance_mm": 0.01},
        "robot": {"safe_deg": SAFE_DEG},
        "settle": {"robot_s": 1.0, "rail_s": 2.0, "reading_age_s": 0.5},
        "layout": {"reflectors": "mounted"},
        "uncertainty": {"drift_limit_mm": 0.02},
    },
    "procedure": "calibrate", "digest": "d", "seed": 1, "speed": None, "unattended": True,
    "operator": "", "job": "", "simulated": False, "versions": {"hilcell": "0.1.0"},
    "settings": {}, "steps": [], "points": 2, "duration_s": 1.0, "machine_seed": None,
    "cell_file": "",
}  # fmt: skip
FRAME = {"matrix": np.eye(4).tolist()}
BASE = FRAME | {"circle_rms_mm": [0.01, 0.01], "radius_mm": [1500.0, 200.0]}
DEVICES = [
    {"device": "Robot", "kind": "robot", "model": "KR", "serial": "1"},
    {"device": "Tracker", "kind": "tracker", "model": "AT", "serial": "2"},
]


def state(name: str, before: str, after: str, /, **facts: Any) -> Row:
    return name, "state", "", {"machine": "run", "from": before, "to": after} | facts


def event(name: str, what: str, /, **facts: Any) -> Row:
    return name, "event", "", {"what": what} | facts


def rail(name: str, session: int) -> Row:
    seen = {"taken_s": 5.0, "age_s": 0.01, "ended_s": 4.0, "still": True, "joints_deg": SAFE_DEG}
    return name, "intent", "", {"action": "rail.approach", "session": session, "seen": seen}


def robot(name: str, key: str, session: int) -> Row:
    seen = {"taken_s": 9.0, "age_s": 0.01, "ended_s": 6.0, "still": True, "powered": False}
    body = {"action": "robot.move" if key else "robot.park", "session": session}
    return name, "intent", key, body | {"seen": seen | {"strip_mm": 10.01}}


def point(name: str, key: str, session: int, set_up: int = 0, **facts: Any) -> Row:
    body: dict[str, Any] = {
        "id": {"kind": key.partition("/")[0]},
        "group": key.partition("/")[0],
        "session": session,
        "set_up": set_up,
        "station": "",
        "frame": "tracker",
        "reflector": "SMR",
        "temperature_c": 22.0,
        "xyz_mm": [2000.0, 100.0, 50.0],
        "std_mm": [0.01, 0.01, 0.01],
        "samples": 4,
        "strip_mm": 10.0,
        "readings": {
            "tracker": {"taken_s": 20.0, "age_s": 0.02},
            "rail": {"taken_s": 20.01, "age_s": 0.01, "ended_s": 8.0},
        },
    }
    return name, "point", key, body | facts


def flange(name: str, key: str, session: int, set_up: int = 0) -> Row:
    readings = {
        "tracker": {"taken_s": 20.0, "age_s": 0.02},
        "rail": {"taken_s": 20.01, "age_s": 0.01, "ended_s": 8.0},
        "robot": {"taken_s": 18.0, "age_s": 2.0, "ended_s": 18.0},
        "began": {"taken_s": 9.0, "age_s": 0.3, "ended_s": 8.0},
    }
    facts = {"station": "S1", "commanded_deg": SAFE_DEG, "smr_mm": [98.0, 0.0, 127.0]}
    return point(name, key, session, set_up, readings=readings, **facts)


def nests(name: str, head: str, session: int, set_up: int = 0) -> list[Row]:
    """The points of all floor nests, as the tracker sees them at a set-up."""
    return [
        point(
            f"{name} {nest}", f"{head}/{nest}", session, set_up,
            xyz_mm=[each + set_up * off for each, off in zip(at_mm, BUMP_MM, strict=True)],
        )
        for nest, at_mm in NESTS.items()
    ]  # fmt: skip


def world(name: str, key: str, head: str) -> Row:
    return name, "frame", key, FRAME | {"points": [f"{head}/{nest}" for nest in NESTS]}


def rows() -> list[Row]:
    return [
        ("plan", "plan", "", PLAN),
        state("begin", "idle", "checking"),
        event("connected", "connected", devices=DEVICES, hilcell="0.1.0"),
        state("run", "checking", "running"),
        *nests("world", "world", 1),
        world("frame world", "world", "world"),
        event("step grid", "step", name="grid"),
        rail("approach", 1),
        event("held", "station held", station="S1", began={"taken_s": 5.0, "age_s": 0.02}),
        robot("move 1", "grid/1", 1),
        flange("point 1", "grid/1", 1),
        *nests("control", "control/1-1", 1),
        event("proven", "tracker proven"),
        ("base", "frame", "base", BASE | {"points": ["grid/1"]}),
        event("lost", "screen lost"),
        event("read", "acknowledged", codes=["HC-C08"], until=3),
        state("pausing", "running", "pausing"),
        state("paused", "pausing", "paused"),
        state("proceed", "paused", "running", by="command"),
        *nests("after pause", "control/1-2", 1),
        event("proven after pause", "tracker proven"),
        robot("move 2", "grid/2", 1),
        flange("point 2", "grid/2", 1),
        *nests("bumped", "control/1-3", 1),
        event("moved", "tracker moved", set_up=1, invalid=["grid/2"]),
        *nests("world.1", "world/001", 1, 1),
        world("frame world.1", "world.1", "world/001"),
        robot("move 2 again", "grid/2", 1),
        flange("point 2 again", "grid/2", 1, 1),
        *nests("control 1", "control/1-4", 1, 1),
        event("proven 1", "tracker proven"),
        event("step frames", "step", name="frames"),
        robot("park", "", 1),
        event("safe stop", "safe stop", cause="Robot: collision", problems={}),
        event("closed", "closed", problems={}, took_s=0.1),
        state("fault", "running", "faulted", reason="Robot: collision"),
        ("end 1", "end", "", {"state": "faulted", "exit": 3, "reason": "Robot: collision"}),
        state("resume", "faulted", "checking"),
        event("connected again", "connected", devices=DEVICES, hilcell="0.1.0"),
        state("run again", "checking", "running"),
        *nests("resumed", "control/2-5", 2, 1),
        event("proven again", "tracker proven"),
        event("found", "station found held", station="S1"),
        robot("move 3", "grid/3", 2),
        flange("point 3", "grid/3", 2, 1),
        *nests("control 2", "control/2-6", 2, 1),
        event("proven 2", "tracker proven"),
        ("verdict", "verdict", "own", {"holds": True}),
        event("closed again", "closed", problems={}, took_s=0.1),
        state("finish", "running", "finished"),
        ("end 2", "end", "", {"state": "finished", "exit": 0, "result": {"points": COUNTS}}),
    ]


COUNTS = {"world": 6, "grid": 3, "control": 18}


class Doctored:
    """A journal that a test changes by the names of its rows."""

    def __init__(self) -> None:
        self.rows = rows()

    def at(self, name: str) -> int:
        (found,) = (n for n, row in enumerate(self.rows) if row[0] == name)
        return found

    def change(self, name: str, **facts: Any) -> Doctored:
        """Change facts of a body; ``a__b`` is b within a; None removes it."""
        n = self.at(name)
        label, kind, key, body = self.rows[n]
        for path, value in facts.items():
            body = _changed(body, path.split("__"), value)
        self.rows[n] = label, kind, key, body
        return self

    def without(self, *names: str) -> Doctored:
        self.rows = [row for row in self.rows if row[0] not in names]
        return self

    def after(self, name: str, *more: Row) -> Doctored:
        n = self.at(name) + 1
        self.rows[n:n] = more
        return self

    def move(self, name: str, after: str) -> Doctored:
        row = self.rows.pop(self.at(name))
        return self.after(after, row)

    def records(self) -> list[Record]:
        numbered = enumerate(self.rows, start=1)
        return [Record(seq, "", kind, key, body) for seq, (_, kind, key, body) in numbered]


def _changed(body: dict[str, Any], path: list[str], value: Any) -> dict[str, Any]:
    name, *rest = path
    if rest:
        return body | {name: _changed(body[name], rest, value)}
    if value is None:
        return {key: each for key, each in body.items() if key != name}
    return body | {name: value}
