"""The prompt's box: the task, the reading, its age, and Enter, grey until it answers."""

from __future__ import annotations

import msgspec
import pytest
from textual.pilot import Pilot

from hilcell.model.records import StateChanged
from hilcell.run.control import DeviceStatus, PromptStatus
from hilcell.tui.run_view import RunView
from hilcell.tui.terminal import ASCII, UNICODE
from hilcell.tui.text.prompt import PromptText
from tests.hilcell.tui.recording_app import RecordingApp, run_app, text_of
from tests.hilcell.tui.sample_runs import PROMPT
from tests.hilcell.tui.test_alarm_panel import _style
from tests.hilcell.tui.views import drawn, view_of


def seating() -> RunView:
    """Return a run that asks by itself: no failed reading made it ask."""
    view = view_of("suspended")
    waits = StateChanged(machine="run", to="suspended")
    view.log.life[-1] = view.log.life[-1]._replace(change=waits)
    view.log.seated = "F1"
    return view


def text(prompt: PromptStatus, view: RunView, *, low: bool = False) -> str:
    """Return both sides, one under the other."""
    said = PromptText(prompt, view, UNICODE)
    return "\n".join((drawn(said.picture(), 48, 13), drawn(said.task(low=low)), said.enter().plain))


def but(**facts: object) -> PromptStatus:
    return msgspec.structs.replace(PROMPT, **facts)


def test_the_task_is_beside_the_plan() -> None:
    found = text(PROMPT, seating())
    for words in (
        "from above, to scale", "Take it out of F1",
        "Place it in P1", "at x 350 y -350 z 60 mm", "off its place, mm", "limit", "5.00",
        "● reflector visible", "0.3 s ago", "Enter  measure it here", "nothing moves", "tracker",
    ):  # fmt: skip
        assert words in found, words


def test_devices_that_are_lost_are_named_in_the_prompt() -> None:
    view = seating()
    assert view.status is not None
    devices = dict(view.status.devices)
    for name, words in (
        ("tracker", "× tracker lost"),
        ("robot", "× robot and tracker lost"),
        ("rail", "× 3 devices lost"),
    ):
        devices[name] = DeviceStatus("lost", 40.0, "", "link lost")
        view.status = msgspec.structs.replace(view.status, devices=devices)
        found = text(but(ready=False, seen_mm=None, age_s=40.0), view)
        assert words in found
        assert "last reading 40 s ago" in found
        assert "sees" not in found


def test_a_failed_reading_is_told_in_the_driver_s_words() -> None:
    view = view_of("suspended")
    found = text(but(title="No good reading of P1", text="The beam broke. Clear it."), view)
    assert "The beam broke. Clear it." in found
    assert "Take it out" not in found


@pytest.mark.parametrize(
    ("prompt", "stale", "words", "bright"),
    [
        (PROMPT, False, "● reflector visible", True),
        (PROMPT, True, "last reading", False),
        (but(ready=False, seen_mm=9.0), False, "▲ reflector visible", False),
        (but(ready=False, seen_mm=None), False, "○ not visible", False),
        (but(ready=False, age_s=None, seen_mm=None), False, "○ no reading yet", False),
        (but(ready=True, age_s=None, seen_mm=None), False, "○ no reading yet", False),
        (but(check=False, ready=False), False, "when it is done", True),
        (but(expected_mm=None, place="S1100", ready=True), False, "● strip reading valid", True),
        (but(expected_mm=None, ready=False), False, "▲ strip reading invalid", False),
    ],
)
def test_enter_is_grey_until_it_answers(
    prompt: PromptStatus, stale: bool, words: str, bright: bool
) -> None:
    view = seating()
    if stale:
        view.status_age_s = 60.0
    assert words in text(prompt, view)
    assert ("$ask-fill" in _style(PromptText(prompt, view, UNICODE).enter(), "Enter")) == bright


def test_an_old_figure_is_dashes() -> None:
    view = seating()
    fresh = text(PROMPT, view)
    view.status_age_s = 60.0
    assert text(PROMPT, view) != fresh
    plain = drawn(PromptText(PROMPT, view, ASCII).task())
    assert "-.--" in plain
    assert "1.24" not in plain


@pytest.mark.parametrize("columns", [60, 80, 140])
@pytest.mark.parametrize("rows", [16, 20, 24, 40])
def test_the_box_keeps_the_place_the_reading_and_enter(columns: int, rows: int) -> None:
    async def look(app: RecordingApp, pilot: Pilot[int]) -> None:
        seen = text_of(app)
        for words in ("? Seat the reflector in P1", "At P1", "reflector visible", " Enter "):
            assert words in seen

    run_app(look, "suspended", size=(columns, rows))


def test_a_low_box_has_its_figure_in_a_line() -> None:
    found = text(PROMPT, seating(), low=True)
    assert "off 1.24 mm limit 5.00" in found
    assert "Place it in P1" in found
