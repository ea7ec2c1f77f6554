"""The operator's prompt and its drawing of the cell."""

from __future__ import annotations

from itertools import combinations

import msgspec
import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply
from hilcell.model.records import StateChanged
from hilcell.run.control import DeviceStatus, PromptStatus
from hilcell.tui.run_view import RunView
from hilcell.tui.terminal import ASCII, UNICODE
from hilcell.tui.text.prompt import Place, PromptText, Site
from tests.hilcell.tui.recording_app import Press, Stage, run_app, text_of
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
    async def look(app: Stage, pilot: Press) -> None:
        seen = text_of(app)
        for words in ("? Seat the reflector in P1", "At P1", "reflector visible", " Enter "):
            assert words in seen

    run_app(look, "suspended", size=(columns, rows))


def test_a_low_box_has_its_figure_in_a_line() -> None:
    found = text(PROMPT, seating(), low=True)
    assert "off 1.24 mm limit 5.00" in found
    assert "Place it in P1" in found


CELLS = ("paper", "six-r", "hard", "replay")


def site(cell_name: str, wanted: str, done: str = "") -> Site:
    cell = load_cell(cell_name)
    layout, base = cell.layout, cell.layout.nominal_base(cell.station[-1].rail_mm)
    slide = {n.name: _xy(apply(base, n.xyz_mm[None])[0]) for n in layout.slide}
    standing = {n.name: _xy(n.xyz_mm) for n in layout.fixed_nests}
    nests = slide if wanted in slide else standing
    return Site(
        nests=nests, done=frozenset(filter(None, [done])), asked=wanted, asked_mm=nests[wanted],
        robot_mm=_xy(base[:3, 3]), tracker_mm=_xy(cell.tracker.pose.matrix()[:3, 3]),
        along=layout.rail_direction[:2],
        stations={s.name: _xy(layout.nominal_base(s.rail_mm)[:3, 3]) for s in cell.station},
    )  # fmt: skip


def _xy(xyz: np.ndarray) -> Place:
    return float(xyz[0]), float(xyz[1])


def sketch_lines(found: Site, columns: int = 46, rows: int = 11) -> list[str]:
    return [line.plain for line in found.drawn(columns, rows)]


@pytest.mark.parametrize("name", CELLS)
def test_every_nest_is_named_once_and_the_wanted_one_is_there(name: str) -> None:
    layout = load_cell(name).layout
    for nests in (layout.fixed_nests, layout.slide):
        for nest in nests:
            lines = sketch_lines(site(name, nest.name))
            assert len(lines) == 11
            assert {len(line) for line in lines} == {46}
            text = "\n".join(lines)
            assert all(text.count(f" {each.name} ") == 1 for each in nests), text


@pytest.mark.parametrize("name", CELLS)
def test_right_is_right_and_up_is_up(name: str) -> None:
    found = site(name, load_cell(name).layout.floor[0].name)
    lines = sketch_lines(found)
    at = {n: _at(lines, n) for n in found.nests}
    for one, other in combinations(found.nests, 2):
        (x, y), (u, v) = found.nests[one], found.nests[other]
        if abs(x - u) > 1000.0:  # names stand beside their nests
            assert (at[one][0] > at[other][0]) == (x > u)
        if abs(y - v) > 1000.0:
            assert (at[one][1] < at[other][1]) == (y > v)


def _at(lines: list[str], name: str) -> tuple[int, int]:
    (row,) = [n for n, line in enumerate(lines) if f" {name} " in line]
    return lines[row].index(f" {name} "), row


def test_the_scale_is_that_of_the_drawing() -> None:
    found = site("paper", "F2")
    lines = sketch_lines(found)
    bar = lines[-1]
    assert "┤ 1 m   x ►  y up" in bar
    columns = bar.index("┤") - bar.index("├")
    apart = abs(lines[_at(lines, "F1")[1]].index("○") - _at(lines, "F2")[0] - 2)
    assert abs(apart / 1.5 - columns) <= 1.0


def test_what_is_done_is_filled_and_the_tracker_has_its_beam() -> None:
    text = "\n".join(sketch_lines(site("paper", "F2", done="F1")))
    assert "● F1" in text
    assert "○ F3" in text
    assert "▲" in text
    assert " tracker " in text
    assert "· ·" in text
    assert "─ S300 " in text
    assert "│ │" in text


def test_a_tracker_beyond_the_edge_is_drawn_at_it() -> None:
    lines = sketch_lines(site("paper", "P1"))
    (row,) = [line for line in lines if "▲" in line]
    assert row.endswith("▲")


def test_a_robot_on_the_floor_has_no_rail() -> None:
    found = site("paper", "F2")
    parts = {name: getattr(found, name) for name in Site.__slots__}
    parts["along"] = (0.0, 0.0)
    bare = Site(**parts)
    assert not any("│" in line for line in sketch_lines(bare))


def test_where_there_is_no_room_there_is_no_drawing() -> None:
    found = site("paper", "F2")
    assert found.drawn(Site.LEAST_COLUMNS - 1, 11) == []
    assert found.drawn(46, Site.LEAST_ROWS - 1) == []
    for columns, rows in ((Site.LEAST_COLUMNS, Site.LEAST_ROWS), (100, 30)):
        lines = sketch_lines(found, columns, rows)
        assert len(lines) == rows
        assert {len(line) for line in lines} == {columns}
        assert " F2 " in "\n".join(lines)


@pytest.mark.parametrize(
    ("ready", "words"), [(False, "no reflector yet"), (True, "reflector measured")]
)
def test_a_beam_that_a_person_puts_on_a_nest_has_no_place_yet(ready: bool, words: str) -> None:
    view = seating()
    waits = StateChanged(machine="run", to="suspended", prompt={"by_itself": True})
    view.log.life[-1] = view.log.life[-1]._replace(change=waits)
    found = text(but(place="a floor nest", expected_mm=None, ready=ready), view)
    assert words in found
    assert "strip" not in found
    assert "Place it" not in found
