"""Runs in every state, made of records as an engine writes them, with times that stand still."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Any

import msgspec
import numpy as np

from hilcell.cell.file import load_cell
from hilcell.journal.journal import Record
from hilcell.model.point import PointId
from hilcell.model.records import Kind
from hilcell.run.control import DeviceStatus, Interlock, PromptStatus, Status
from hilcell.run.prompts import Prompt
from hilcell.tui.run_view import EngineState
from hilcell.tui.session import RunUpdate
from tests.hilcell.verdicts import FITTED, plain

BEGAN = datetime(2026, 3, 4, 8, 0, tzinfo=UTC)
RUN = "20260304-080000-calibrate-ab12"
STEPS = (
    ("home", 0, 16.0),
    ("world-frame", 3, 17.0),
    ("hold-station", 0, 9.0),
    ("base-frame", 4, 20.0),
    ("robot-grid", 8, 40.0),
    ("fit", 0, 0.0),
    ("validate", 6, 60.0),
)
UNIT = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
FAULT = {
    "code": "HC-T99",
    "device": "Tracker",
    "operation": "measure grid/1-0-0",
    "found": "beam broken",
    "wanted": "a reflector",
    "act": "clear the beam",
}
FAULT_TEXT = (
    "Tracker: measure grid/1-0-0: beam broken, expected a reflector; clear the beam, resume"
)


class SampleRun:
    """Writes records one second apart."""

    def __init__(self) -> None:
        self.records: list[Record] = []

    @property
    def now(self) -> datetime:
        """Return the moment of the last record."""
        return BEGAN + timedelta(seconds=len(self.records))

    def add(self, kind: Kind, key: str = "", **body: Any) -> SampleRun:
        """Write one record."""
        moment = self.now.isoformat(timespec="milliseconds")
        self.records.append(Record(len(self.records) + 1, moment, kind, key, body))
        return self

    def state(self, to: str, **more: Any) -> SampleRun:
        """Take the run to a state."""
        return self.add("state", machine="run", to=to, **more)

    def step(self, number: int) -> SampleRun:
        """Begin a step."""
        return self.add(
            "event", what="step", name=STEPS[number - 1][0], number=number, of=len(STEPS)
        )

    def point(
        self, id: PointId, nominal: Any = None, off: Any = (0, 0, 0), **more: Any
    ) -> SampleRun:
        """Measure a point ``off`` its nominal."""
        at = nominal or (1000.0, 200.0, 300.0)
        body = {
            "id": msgspec.to_builtins(id), "group": id.group,
            "station": more.pop("station", "S1100"), "reflector": "SMR 1.5in",
            "xyz_mm": [a + b for a, b in zip(at, off, strict=True)],
            "std_mm": [0.01, 0.01, 0.01], "samples": 1, "temperature_c": 22.5,
            "pressure_mbar": 1010.0, "humidity_percent": 45.0, "session": 1, "frame": "tracker",
            "nominal_mm": nominal, "rail_mm": 1100.2, "strip_mm": 1100.0,
            "commanded_deg": [0.0, -90.0, 90.0, 0.0, -30.0, 0.0], "joints_deg": [0.0] * 6,
        } | more  # fmt: skip
        return self.add("point", id.key, **body)


@cache
def _plan() -> dict[str, Any]:
    cell = load_cell("paper", {})
    return {
        "procedure": "calibrate", "cell": msgspec.to_builtins(cell), "digest": cell.digest,
        "seed": 1, "machine_seed": 1, "cell_file": "paper", "speed": None,
        "unattended": False, "operator": "Ann", "job": "J-7",
        "simulated": True, "versions": {"hilcell": "0.1.0"}, "settings": {},
        "steps": [{"name": n, "points": p, "duration_s": d} for n, p, d in STEPS],
        "points": sum(p for _, p, _ in STEPS), "duration_s": sum(d for _, _, d in STEPS),
    }  # fmt: skip


def begun() -> SampleRun:
    """Return a run whose devices are being connected."""
    return SampleRun().add("plan", **_plan()).state("checking")


def measuring(points: int = 5) -> SampleRun:
    """Return a run on its grid."""
    story = begun().add("event", what="connected", devices=[]).state("running")
    story.step(1).step(2)
    for name, apart in (("F1", (0, 0, 0)), ("F2", (900, 0, 0)), ("F3", (0, 900, 0))):
        story.point(PointId("world", nest=name), off=apart, station="", commanded_deg=None)
    story.add("frame", "world", matrix=UNIT)
    story.step(3).add(
        "event", what="station held", station="S1100", tries=2, strip_mm=1100.0, rail_mm=1100.2
    )
    story.step(5)
    for number in range(points):
        off = (0.4 + 0.1 * number, -0.3, 0.2 * number)
        vertex = PointId("grid", vertex=(0, 0, number))
        story.add("intent", vertex.key, action="robot.move")
        story.point(vertex, (1000.0, 200.0 + number, 300.0), off)
    return story


def validated(*, worst_mm: float = 0.1) -> SampleRun:
    """Return a run that has measured everything; the last point is the worst."""
    fitted = msgspec.structs.replace(FITTED, method="trilinear")
    story = measuring(8).step(6).add("verdict", "fit", **plain(fitted)).step(7)
    for how, size in (("before", 1.2), ("idw", 0.2), ("chosen", 0.1)):
        for number in range(2):
            off = (size + number, 0.0, 0.0) if how == "idw" else (0.0, size, 0.01 * number)
            off = (0.0, worst_mm, 0.01) if (how, number) == ("chosen", 1) else off
            nominal = (1100.0, 300.0 + number, 400.0)
            id = PointId("validate", station="S1100", how=how, number=number)
            story.point(id, nominal, off)
    return story


FIGURES = {"mean": 0.1, "p95": 0.1, "max": 0.1}
JUDGED = {
    "mean_mm": 0.1, "mean_tolerance_mm": 0.12, "mean_U_mm": 0.005,
    "max_mm": 0.1, "max_tolerance_mm": 0.3, "max_U_mm": 0.0,
}  # fmt: skip
RESULT = {
    "method": "trilinear",
    "validation": {
        "S1100": {
            "points": 2,
            "points_sent": {"before": 2, "idw": 2, "chosen": 2},
            "before": FIGURES | {"mean": 1.2},
            "idw": FIGURES,
            "chosen": FIGURES,
        }
    },
}


STORIES: dict[str, Callable[[], SampleRun]] = {
    "looking": SampleRun,
    "idle": SampleRun,
    "checking": begun,
    "running": measuring,
    "pausing": lambda: measuring().state("pausing"),
    "paused": lambda: measuring().state("paused"),
    "suspended": lambda: measuring().state("suspended", reason=FAULT_TEXT, error=FAULT),
    "stopping": lambda: measuring().state("stopping"),
    "done": lambda: validated().add(
        "verdict", "validation.S1100", **JUDGED, holds=True, outcome="accepted", decision="",
    ).state("finished").add(
        "end", state="finished", exit=0, result=RESULT),
    "intolerant": lambda: validated(worst_mm=1.2).add(
        "verdict", "validation.S1100", **JUDGED | {"mean_mm": 0.3}, holds=False,
        outcome="rejected", decision="",
    ).state("finished").add("end", state="finished", exit=1, result=RESULT),
    "aborted": lambda: measuring().state("stopping").state("aborted").add(
        "end", state="aborted", exit=4, result={}, reason="stopped by the operator"),
    "fault": lambda: measuring().state("faulted", reason=FAULT_TEXT, error=FAULT).add(
        "end", state="faulted", exit=3, result={}, reason=FAULT_TEXT),
    "refused": lambda: begun().state("faulted", reason=FAULT_TEXT, error=FAULT).add(
        "end", state="faulted", exit=2, result={}, reason=FAULT_TEXT),
    "silent": measuring,
    "gone": measuring,
    "unreadable": SampleRun,
}  # fmt: skip


def sample_run(name: str) -> SampleRun:
    """Return a run in one state."""
    return STORIES[name]()


def sample_runs() -> dict[str, SampleRun]:
    """Return a run in every state that the screen can be shown."""
    return {name: sample_run(name) for name in STORIES}


HEARD = ("checking", "running", "pausing", "paused", "suspended", "stopping")
LIVE = (*HEARD, "silent", "looking")
PROMPT = PromptStatus(
    title="Seat the reflector in P1",
    text=Prompt.placement(
        load_cell("paper"), "P1", "F1", np.array([4007.5, -238.7, -480.3]), 5.0
    ).text,
    place="P1",
    expected_mm=(4007.5, -238.7, -480.3),
    limit_mm=5.0,
    seen_mm=1.24,
    age_s=0.3,
    ready=True,
)


def fresh(name: str) -> RunUpdate:
    """Return what one look at a run in a state brings."""
    unheard = {"silent": EngineState.SILENT, "looking": EngineState.UNKNOWN}
    engine = EngineState.ANSWERING if name in HEARD else unheard.get(name, EngineState.NONE)
    reported = status(name) if engine in (EngineState.ANSWERING, EngineState.SILENT) else None
    trouble = "journal: damaged or not a journal" if name == "unreadable" else ""
    return RunUpdate(sample_run(name).records, engine, reported, trouble)


def status(name: str) -> Status:
    """Return what the engine of such a run says."""
    at_rest = name in ("paused", "suspended")
    return Status(
        state=name,
        pausing=name == "pausing",
        screens=1,
        devices={
            "rail": DeviceStatus("fresh", 0.2, "1100.20 mm, held"),
            "strip": DeviceStatus("fresh", 0.2, "1100.00 mm"),
            "robot": DeviceStatus("fresh" if at_rest else "moving", 0.2, "at rest"),
            "tracker": DeviceStatus("fresh", 1.2, "SMR 1.5in"),
        },
        interlocks=[
            Interlock("rail move", "robot not at safe pose, A2 -53.017 deg", "HC-B32"),
            Interlock("robot move"),
            Interlock("measurement"),
        ],
        prompt=PROMPT if name == "suspended" else None,
    )
