"""The prompt's box: the task, the reading, its age, and Enter, grey until it answers."""

from __future__ import annotations

import msgspec
import pytest
from textual.content import Content

from hilcell.run.protocol import DeviceStatus, PromptStatus
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.terminal.capabilities import ASCII, UNICODE
from hilcell.tui.text.prompt import prompt_box
from tests.hilcell.tui.sample_runs import PROMPT
from tests.hilcell.tui.test_alarm_panel import _style
from tests.hilcell.tui.views import view_of


def seating() -> RunView:
    """Return a run that asks by itself: no failed reading made it ask."""
    view = view_of("suspended")
    view.log.life[-1] = msgspec.structs.replace(view.log.life[-1], body={"to": "suspended"})
    view.log.seated = "F1"
    return view


def box(prompt: PromptStatus, view: RunView, columns: int = 79, rows: int = 15) -> list[Content]:
    return prompt_box(prompt, view, UNICODE, columns, rows)


def text(prompt: PromptStatus, view: RunView) -> str:
    return "\n".join(line.plain for line in box(prompt, view))


def but(**facts: object) -> PromptStatus:
    return msgspec.structs.replace(PROMPT, **facts)


def test_the_task_is_beside_the_plan() -> None:
    found = text(PROMPT, seating())
    for words in (
        "? Seat the reflector in P1", "from above, to scale", "Take it out of F1",
        "Seat it in P1", "at x 350 y -350 z 60 mm", "off its place, mm", "limit", "5.00",
        "● tracker sees it", "0.3 s ago", "Enter  measure it here", "nothing moves", " tracker ",
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
        assert "last look 40 s ago" in found
        assert "sees" not in found


def test_a_failed_reading_is_told_in_the_driver_s_words() -> None:
    view = view_of("suspended")
    found = text(but(title="No good reading of P1", text="The beam broke. Clear it."), view)
    assert "The beam broke. Clear it." in found
    assert "Take it out" not in found


@pytest.mark.parametrize(
    ("prompt", "stale", "words", "bright"),
    [
        (PROMPT, False, "● tracker sees it", True),
        (PROMPT, True, "last look", False),
        (but(ready=False, seen_mm=9.0), False, "▲ tracker sees it", False),
        (but(ready=False, seen_mm=None), False, "○ sees nothing", False),
        (but(ready=False, age_s=None, seen_mm=None), False, "○ not looked yet", False),
        (but(ready=True, age_s=None, seen_mm=None), False, "○ not looked yet", False),
        (but(check=False, ready=False), False, "when it is done", True),
        (but(expected_mm=None, place="S1100", ready=True), False, "● strip reads well", True),
        (but(expected_mm=None, ready=False), False, "▲ strip reads badly", False),
    ],
)
def test_enter_is_grey_until_it_answers(
    prompt: PromptStatus, stale: bool, words: str, bright: bool
) -> None:
    view = seating()
    if stale:
        view.status_age_s = 60.0
    assert words in text(prompt, view)
    (line,) = [each for each in box(prompt, view) if " Enter " in each.plain]
    assert ("$ask-fill" in _style(line, "Enter")) == bright


def test_an_old_figure_is_dashes() -> None:
    view = seating()
    fresh = text(PROMPT, view)
    view.status_age_s = 60.0
    assert text(PROMPT, view) != fresh
    plain = "\n".join(line.plain for line in prompt_box(PROMPT, view, ASCII, 79, 15))
    assert "-.--" in plain
    assert "1.24" not in plain


@pytest.mark.parametrize("columns", [58, 80])
@pytest.mark.parametrize("rows", [5, 7, 14, 20])
def test_the_box_fits_and_keeps_the_place_and_enter(columns: int, rows: int) -> None:
    for view in (seating(), view_of("suspended")):
        lines = box(PROMPT, view, columns, rows)
        assert len(lines) == rows
        assert {line.cell_length for line in lines} == {columns}
        found = "\n".join(line.plain for line in lines)
        assert "P1" in found
        if rows >= 7:
            assert " Enter " in found
            assert "tracker sees it" in found
