"""The newest point: one large number, its components, its limit; and when it is grey."""

from __future__ import annotations

import math
from datetime import timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.model.point import PointId
from hilcell.tui.run_view import EngineState, RunView
from hilcell.tui.terminal import ASCII, UNICODE
from hilcell.tui.text.points import Deviation
from hilcell.tui.text.run import Shown
from tests.hilcell.tui.sample_runs import SampleRun, measuring, status, validated
from tests.hilcell.tui.views import drawn

ANY = st.floats(allow_nan=True, allow_infinity=True)


def view_after(story: SampleRun, age_s: float = 0.4) -> RunView:
    """Return a live run's view some time after its last record."""
    view = RunView("r", engine=EngineState.ANSWERING, status=status("running"))
    for record in story.records:
        view.take(record)
    view.now = story.now + timedelta(seconds=age_s - 1.0)
    return view


def shown(norm_mm: float, limit_mm: float | None = 1.0, U_mm: float = 0.1, **more: bool) -> Shown:
    found = Deviation("p", (norm_mm, 0.0, 0.0), (0.0, 0.0, 0.0), limit_mm, U_mm)
    return Shown("newest point: p", found, "0.4 s ago", word="as sent: no limit", **more)


@pytest.mark.parametrize(
    ("norm_mm", "limit_mm", "said", "style"),
    [
        (0.5, None, "○ as sent: no limit", "foreground"),
        (0.5, 1.0, "● in tolerance", "passed"),
        (1.5, 1.0, "▲ OUT OF TOLERANCE", "fault"),
        (0.95, 1.0, "▲ UNDECIDED", "ask"),
        (1.05, 1.0, "▲ UNDECIDED", "ask"),
        (math.nan, 1.0, "▲ OUT OF TOLERANCE", "fault"),
        (math.inf, 1.0, "▲ OUT OF TOLERANCE", "fault"),
    ],
)
def test_it_says_what_the_decision_rule_says(
    norm_mm: float, limit_mm: float | None, said: str, style: str
) -> None:
    lines = shown(norm_mm, limit_mm).lines(UNICODE).lines(79)
    assert len(lines) == Shown.FULL_ROWS
    assert lines[4].plain.strip().startswith(said)
    assert style in str(lines[1].spans)  # the digits


@pytest.mark.parametrize(
    ("norm_mm", "word"), [(0.5, "was in tol."), (1.5, "was out of tol."), (0.95, "was undecided")]
)
def test_an_old_value_is_grey_and_says_that_it_was(norm_mm: float, word: str) -> None:
    lines = shown(norm_mm, stale=True).lines(UNICODE).lines(79)
    assert f"○ {word}" in lines[4].plain
    for line in lines[1:5]:
        for role in ("passed", "fault"):
            assert role not in str(line.spans)
    assert "▲ 0.4 s ago" in lines[0].plain


def test_the_newest_point_ages() -> None:
    assert Shown.newest(view_after(validated())).remark == "0.4 s ago"
    assert not Shown.newest(view_after(validated())).stale
    found = Shown.newest(view_after(validated(), Shown.STALE_S + 6))
    assert (found.stale, found.remark) == (True, "36 s old")


def test_a_point_is_not_bright_where_nothing_is_heard() -> None:
    view = view_after(validated())
    view.status_age_s = 2.1
    assert Shown.newest(view).stale


def test_the_digits_of_a_step_before_are_grey() -> None:
    found = Shown.newest(view_after(validated().step(7)))
    assert not found.stale
    found = Shown.newest(view_after(measuring().step(6)))
    assert found.stale
    assert found.name.startswith("last point: grid point 0-0-4")


def test_a_point_without_a_nominal_place_has_no_digits_of_the_one_before() -> None:
    story = measuring().point(PointId("repeatability", place=0, number=2), None)
    found = Shown.newest(view_after(story))
    assert found.deviation is None
    text = drawn(found.lines(UNICODE))
    assert "repeated pose 1 3 at S1100" in text
    assert "no nominal place, so no deviation" in text
    assert "█" not in text


def test_a_chosen_point_says_that_it_is_chosen() -> None:
    view = view_after(validated())
    found = Shown.chosen(view, "validate/S1100/idw/000")
    assert found.name == "chosen point: target 1 at S1100, paper method"
    assert found.word == "paper method: no limit"
    assert Shown.chosen(view, "none").deviation is None


def test_a_point_that_nobody_chose_is_the_last_one() -> None:
    found = Shown.chosen(view_after(measuring()), "grid/0-0-4", chosen=False)
    assert found.name == "last point: grid point 0-0-4 at S1100"


@given(ANY, ANY, ANY, st.one_of(st.none(), st.floats(1e-3, 1e3)), st.integers(20, 200))
def test_any_deviation_fits_any_width(
    dx: float, dy: float, dz: float, limit: float | None, width: int
) -> None:
    found = Deviation("p", (dx, dy, dz), (0.0, 0.0, 0.0), limit)
    for rows in (Shown.FULL_ROWS, Shown.FULL_ROWS - 1, Shown.SMALL_ROWS):
        for glyphs in (UNICODE, ASCII):
            lines = Shown("p", found, "").lines(glyphs, rows).lines(width)
            assert len(lines) <= rows
            assert max(line.cell_length for line in lines) <= max(width, 20)


@pytest.mark.parametrize("width", [20, 39, 41, 45, 60])
def test_digits_are_never_cut(width: int) -> None:
    text = drawn(shown(12.345).lines(UNICODE), width)
    assert "12.345" in text or "▄█  ▀▀█   ▀▀█ █ █ █▀▀" in text


@pytest.mark.parametrize(
    ("error_mm", "scale"),
    [((0.0, 0.0, 0.1), "±0.2"), ((0.2, -0.51, 0.0), "±1"), ((math.nan, -math.inf, 3.0), "±5")],
)
def test_bars_have_a_scale_of_1_2_5_that_holds_them(
    error_mm: tuple[float, float, float], scale: str
) -> None:
    found = Deviation("p", error_mm, (0.0, 0.0, 0.0), 0.3)
    assert scale in drawn(Shown("p", found, "").lines(UNICODE)).split()


@pytest.mark.parametrize(("U_mm", "hatched"), [(0.0, 0), (0.1, 9), (math.nan, 0), (9.0, 32)])
def test_the_guard_band_is_hatched_around_the_limit(U_mm: float, hatched: int) -> None:
    line = shown(0.5, U_mm=U_mm).lines(UNICODE).lines(79)[4].plain
    assert line.count("▒") == hatched
    assert "│" in line
    if hatched == 9:
        assert "▒▒▒▒│▒▒▒▒" in line
