"""A walk through every screen that can be opened over a run, by keys alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from textual.command import CommandList, CommandPalette
from textual.pilot import Pilot

from hilcell.commission.sequence import STEPS as STEPS_OF_CELL
from hilcell.journal.calibration_facts import CalibrationFacts
from hilcell.journal.index import RunRow
from hilcell.model.outcome import Outcome
from hilcell.model.plan import PlannedStep
from hilcell.run.order import Order
from hilcell.tui import keys, process
from hilcell.tui.commissioning import Work
from hilcell.tui.screens import start
from hilcell.tui.screens.base import Confirm
from hilcell.tui.screens.pages import DetailPage
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import PlanSummary, StartScreen
from tests.hilcell.tui.recording_app import (
    RecordingApp,
    paint_at_rest,
    parse_once,
    press,
    settle,
    text_at_rest,
)
from tests.hilcell.tui.sample_runs import BEGAN, RUN, STEPS

PAGES = {"alarms": "e", "interlocks": "i", "log": "l", "help": "question_mark", "report": "o"}
QUESTIONS = {"pause": "space", "abort": "a", "quit": "ctrl+q", "retake": "r"}
RUNS = [
    RunRow(
        name=RUN, begun="2026-03-04T08:00:00+00:00", state="finished", exit=0,
        procedure="calibrate", job="J-7", operator="Ann", cell="paper", simulated=True, points=21,
        before_mean_mm=1.2, chosen_mean_mm=0.11, chosen_max_mm=0.31,
        facts=CalibrationFacts(
            kind="made", validated=True, judged=True, outcome=Outcome.ACCEPTED
        ),
    ),
    RunRow(
        name="20260303-070000-calibrate-cd34", begun="2026-03-03T07:00:00+00:00", state="finished",
        exit=1, procedure="calibrate", operator="Bob", cell="paper", simulated=True, points=21,
        before_mean_mm=1.3, chosen_mean_mm=0.24, chosen_max_mm=0.52,
    ),
    RunRow(
        name="20260302-060000-home-ef56", begun="2026-03-02T06:00:00+00:00", state="running",
        procedure="home", cell="paper",
    ),
    RunRow(name="20260301-broken", begun="2026-03-01T05:00:00+00:00", state="unreadable",
           reason="journal: damaged"),
]  # fmt: skip
PLAN = process.DryRun(
    procedure="calibrate",
    cell="paper",
    simulated=True,
    rail=True,
    points=sum(p for _, p, _ in STEPS),
    steps=[PlannedStep(name=n, points=p, duration_s=d) for n, p, d in STEPS],
    duration_s=sum(d for _, _, d in STEPS),
)
PROCEDURES = {
    "calibrate": "the whole calibration",
    "home": "home the rail",
    "rail-survey": "survey the rail",
}
COMPARISON: dict[str, Any] = {
    "first": "20260303-070000-calibrate-cd34", "second": RUN,
    "verdict": "drift: 1 of 2 judged changes are beyond it",
    "settings": [{"key": "tracker.max_std_mm", "first": "0.05", "second": ""}],
    "changes": [
        {"group": "validation", "place": "S1100", "what": "chosen mean", "unit": "mm",
         "first": 0.24, "second": 0.11, "change": -0.13, "limit": None,
         "verdict": "", "where": "S1100 targets", "figure": "corrected: mean"},
        {"group": "frames", "place": "station S1100", "what": "moved", "unit": "mm",
         "first": None, "second": None, "change": 0.32, "limit": 0.2,
         "verdict": "beyond", "where": "S1100 frame", "figure": "moved"},
        {"group": "frames", "place": "station S1900", "what": "moved", "unit": "mm",
         "first": None, "second": None, "change": 0.02, "limit": 0.2,
         "verdict": "within", "where": "S1900 frame", "figure": "moved"},
    ],
    "notes": [],
}  # fmt: skip
FIGURES = {"mean": 0.11, "p95": 0.2, "max": 0.31}
SHOWN: dict[str, Any] = {
    "run": RUN, "procedure": "calibrate", "cell": "paper", "simulated": True, "operator": "Ann",
    "job": "J-7", "seed": 1, "machine_seed": 1, "points": 21, "calibration": "station_held",
    "state": "finished", "verdict": "in tolerance", "standing": {"text": "current"},
    "result": {
        "method": "kinematic",
        "validation": {
            "S1100": {
                "points": 2, "points_sent": {"before": 2},
                "before": FIGURES, "idw": FIGURES, "chosen": FIGURES,
            },
        },
    },
}  # fmt: skip
SAID = {
    "show": msgspec.json.encode(SHOWN).decode(),
    "report": "",
    "compare": msgspec.json.encode(COMPARISON).decode(),
}

PATIENT_S = 60.0
Capture = Callable[[RecordingApp], str]


class _Entry:
    def __init__(self, name: str) -> None:
        self.name = name


class _Ended:
    """An engine that has ended before it did anything."""

    def poll(self) -> int:
        return 0

    def wait(self) -> int:
        return 0


@pytest.fixture
def isolated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace everything outside the screen: the terminal, processes, the index, the browser."""
    paint_at_rest(monkeypatch)
    parse_once(monkeypatch)

    async def run_command(*words: str) -> str:
        return SAID[words[0]]

    async def dry_run(order: Order) -> process.DryRun:
        return PLAN

    for name in ("LONGEST_S", "BUILT_S"):  # a slow machine keeps keys in their order, too
        monkeypatch.setattr(keys, name, PATIENT_S)
    monkeypatch.setattr(CommandPalette, "_NO_MATCHES_COUNTDOWN", 0.01)
    monkeypatch.setattr(process, "run_command", run_command)
    monkeypatch.setattr(process, "dry_run", dry_run)
    monkeypatch.setattr(process, "start_engine", lambda *_: _Ended())
    monkeypatch.setattr("hilcell.journal.index.read_index", lambda _: RUNS)
    monkeypatch.setattr(start, "entry_points", lambda group: [_Entry(name) for name in PROCEDURES])
    monkeypatch.setattr(start.StartScreen, "QUIET_S", 0.0)
    monkeypatch.setattr(start, "now", lambda: BEGAN)
    monkeypatch.setattr(start, "summaries", lambda names: {n: PROCEDURES[n] for n in names})
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)


async def screens_of(
    app: RecordingApp, pilot: Pilot[int], capture: Capture = text_at_rest
) -> dict[str, str]:
    """Return what every screen shows, or whatever ``capture`` sees, by the screens' names."""
    await settle(pilot)
    home = app.screen
    seen = {"run": capture(app)}
    for name, key in PAGES.items():
        await press(pilot, key)
        if app.screen is not home:
            seen[name] = capture(app)
            await press(pilot, "q")
    seen |= await _plots(app, pilot, capture)
    seen |= await _history(app, pilot, capture)
    seen |= await _questions(app, pilot, capture)
    seen |= await _point(app, pilot, capture)
    seen |= await _palette(app, pilot, capture)
    assert app.screen is home
    return seen


async def _plots(app: RecordingApp, pilot: Pilot[int], capture: Capture) -> dict[str, str]:
    seen, home = {}, app.screen
    await press(pilot, "p")
    if app.screen is not home:
        for number in "1234":
            await press(pilot, number)
            seen[f"plot-{number}"] = capture(app)
        await press(pilot, "q")
    return seen


async def _history(app: RecordingApp, pilot: Pilot[int], capture: Capture) -> dict[str, str]:
    await press(pilot, "h")
    seen = {"history": capture(app)}
    await press(pilot, "x", "down", "x", "c")
    seen["compare"] = capture(app)
    await press(pilot, "q", "q")
    return seen


async def _questions(app: RecordingApp, pilot: Pilot[int], capture: Capture) -> dict[str, str]:
    seen = {}
    for name, key in QUESTIONS.items():
        if name == "quit" and not app.live:
            continue
        await press(pilot, key)
        if isinstance(app.screen, Confirm):
            seen[f"asks-{name}"] = capture(app)
            await press(pilot, "n")
    return seen


async def _point(app: RecordingApp, pilot: Pilot[int], capture: Capture) -> dict[str, str]:
    seen = {}
    await press(pilot, "enter")
    if isinstance(app.screen, RunScreen) and app.screen.points_open:
        seen["points"] = capture(app)  # in place of the verdict, or of the alarm
        await press(pilot, "enter")
    if isinstance(app.screen, DetailPage):
        seen["point"] = capture(app)
        await press(pilot, "q")
    if isinstance(app.screen, RunScreen) and app.screen.points_open:
        await press(pilot, "q")
    return seen


async def _palette(app: RecordingApp, pilot: Pilot[int], capture: Capture) -> dict[str, str]:
    await press(pilot, "ctrl+p", *"alarm")
    assert isinstance(app.screen, CommandPalette)
    while not app.screen.query_one(CommandList).option_count:
        await settle(pilot)
    await settle(pilot)
    seen = {"palette": capture(app)}
    app.pop_screen()
    await settle(pilot)
    return seen


async def form_of(
    app: RecordingApp, pilot: Pilot[int], capture: Capture = text_at_rest
) -> dict[str, str]:
    """Return what the form for a new run shows, and the summary of its plan."""
    await settle(pilot)
    assert isinstance(app.screen, StartScreen)
    seen = {"form": capture(app)}
    await press(pilot, "enter")
    assert isinstance(app.screen, PlanSummary)
    seen["plan"] = capture(app)
    await press(pilot, "q")
    return seen


def work_of(step: str) -> Work:
    """Return a commissioning at a step, whose thread does nothing more."""

    def start(folder: Path, arguments: list[str]) -> Callable[[], str]:
        raise AssertionError(folder)

    work = Work(Path("/runs/hall.toml"), "Ann", Path("/runs"), start, lambda: None)
    work.begin(step, {each.name: each.title for each in STEPS_OF_CELL}[step], 4, 10)
    work.motion = "it moves, in sequence:\n  the slide by 5 and 20 mm and back, at 5 mm/s"
    return work
