"""The panel of the alarm that has ended a run, its words, its steps and who checks them."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import pytest
from textual.content import Content

from hilcell.alarms import Alarm, Latch, Latched, alarms_of
from hilcell.journal.log import Log
from hilcell.model.point import PointId
from hilcell.tui.terminal import UNICODE
from hilcell.tui.text.alarms import (
    AlarmContext,
    location_text,
    newest_line,
    panel_is_due,
    present_step,
    saved_text,
)
from tests.hilcell.alarms.journals import BEGUN, event, log_of, point, state
from tests.hilcell.tui.recording_app import DEFAULT_KEYS, Press, Stage, run_app, text_of
from tests.hilcell.tui.sample_runs import measuring
from tests.hilcell.tui.views import drawn, view_of

T = "2026-03-04T08:00:23.000+00:00"
NOW = datetime(2026, 3, 4, 8, 2, 37, tzinfo=UTC)
CONTEXT = AlarmContext(NOW, DEFAULT_KEYS, UNICODE)
STOP = Alarm(
    "HC-B10", "fault", "Robot emergency stop", "Robot: move", "$ALARM_STOP is FALSE, expected TRUE",
    "An emergency stop of the robot is pressed.",
    ("Find out why it was pressed.", "Release it at the panel.", "Continue: space."), T, 7,
    cause="watched", by=("you", "controller", "you"), continues=True,
)  # fmt: skip
THERE = Latched(STOP, "fault", 1)
GONE = replace(THERE, gone="2026-03-04T08:02:31.000+00:00")
UNWATCHED = replace(THERE, alarm=replace(STOP, cause="not watched"))
NOTICE = Latched(
    replace(STOP, code="HC-V05", title="Point measured again", severity="notice", cause="over",
            do=("PlotStyle at the beam's way.",), by=("you",), continues=False), "notice", 1,
)  # fmt: skip


def panel(latched: Latched, refused: str = "") -> str:
    context = replace(CONTEXT, refused=refused)
    facts, steps = context.facts(latched, "kept"), context.steps(latched, in_box=True)
    return f"{drawn(facts)}\n{drawn(steps)}"


@pytest.mark.parametrize(
    ("latched", "words"),
    [
        (THERE, "■ PRESENT"),
        (GONE, "□ gone at 08:02:31 UTC"),
        (UNWATCHED, "○ not monitored"),
        (replace(UNWATCHED, gone=GONE.gone), "gone at"),
        (NOTICE, "□ over"),
    ],
)
def test_the_cause_is_gone_only_where_that_is_known(latched: Latched, words: str) -> None:
    assert words in drawn(CONTEXT.facts(latched))


def test_the_panel_says_since_when_where_and_what() -> None:
    text = panel(THERE)
    for words in (
        "since 08:00:23 UTC (2:14 ago)",
        "not acknowledged", "Where  Robot: move", "Detail $ALARM_STOP is FALSE", "Saved  kept",
        "step 1 of 3", "checked by", "space  then  Enter",
    ):  # fmt: skip
        assert words in text, words


@pytest.mark.parametrize(
    ("latched", "present"),
    [
        (THERE, 0),
        (GONE, 0),
        (replace(THERE, acknowledged=True), 1),
        (replace(GONE, acknowledged=True), 2),
        (UNWATCHED, 0),
        (replace(UNWATCHED, acknowledged=True), 2),
        (NOTICE, 0),
    ],
)
def test_the_present_step_is_the_first_that_is_not_done(latched: Latched, present: int) -> None:
    assert present_step(latched) == present


def test_only_steps_that_are_known_to_be_done_are_ticked() -> None:
    ticked = [line for line in panel(replace(GONE, acknowledged=True)).splitlines() if "√" in line]
    assert [line.split()[1] for line in ticked] == ["2"], "nobody has seen the person's step"
    assert ticked[0].endswith("controller")
    assert "√" not in panel(UNWATCHED), "nobody knows yet"
    (controller,) = [line for line in panel(GONE).splitlines() if "controller" in line]
    assert "√ 2" in controller


@pytest.mark.parametrize("columns", [60, 80, 140])
@pytest.mark.parametrize("rows", [14, 16, 20, 24, 40])
def test_the_box_keeps_its_title_its_cause_and_the_present_step(columns: int, rows: int) -> None:
    async def look(app: Stage, pilot: Press) -> None:
        text = text_of(app)
        for words in ("HC-T99  Tracker fault", "alarm 1 of 1", "cause ○", "► 1  Clear"):
            assert words in text

    run_app(look, "fault", size=(columns, rows))


def test_no_word_is_cut() -> None:
    means = "Every point that is shown is safe; drive and robot hold by themselves. " * 3
    alarm = replace(STOP, means=means + "End.", found="figure " * 30 + "last.")
    text = panel(replace(THERE, alarm=alarm))
    assert "…" not in text
    for words in ("End.", "last."):
        assert words in text


def _style(line: Content, word: str) -> str:
    at = line.plain.index(word)
    return " ".join(str(span.style) for span in line.spans if span.start <= at < span.end)


def test_the_key_that_goes_on_is_grey_until_it_would_work() -> None:
    for refused, style in (("", "$foreground"), ("a run is live", "$stale")):
        lines = replace(CONTEXT, refused=refused).steps(THERE, in_box=True).lines(79)
        (line,) = [each for each in lines if "Go on:" in each.plain]
        assert style in _style(line, "space")
        assert any(refused in each.plain for each in lines)
    ended = replace(THERE, alarm=replace(STOP, ended=True))
    assert "Start a new run:  n " in panel(ended)


def test_one_line_names_the_next_alarm_and_the_key_of_all() -> None:
    both = [THERE, NOTICE]
    line = drawn(CONTEXT.line(both, skip=1))
    assert line.startswith("○ HC-V05 Point measured again  notice, 08:00:23 UTC")
    assert line.endswith("e  both alarms")
    assert drawn(CONTEXT.line(both)).startswith("× HC-B10 ")
    assert drawn(CONTEXT.line([])).startswith("○ no alarms")
    assert "acknowledged" in drawn(CONTEXT.line([replace(THERE, acknowledged=True)]))


@pytest.mark.parametrize(
    ("where", "key", "body", "words"),
    [
        ("Robot: move", "validate/S300/chosen/050", {"action": "robot.move"},
         "Robot, on its way to corrected target 51 at S300"),
        ("Cell: crash", "", {"action": "robot.park"}, "Robot, on its way to its safe pose"),
        ("Cell: crash", "", {"action": "rail.approach", "station": "S300"},
         "Rail, on its way to S300"),
        ("Robot: move", "p\x1b[31m", {"action": "robot.move"}, "Robot, on its way to p\ufffd[31m"),
        ("Rail: move", "", {"action": "robot.park"}, "Rail: move"),
        ("Tracker: measure", "", {"action": "robot.park"}, "Tracker: measure"),
    ],
)  # fmt: skip
def test_a_place_is_where_the_last_order_sent_it(
    where: str, key: str, body: dict[str, str], words: str
) -> None:
    log = log_of(*BEGUN, ("intent", key, body))
    alarm = replace(STOP, where=where, seq=5)
    assert location_text(alarm, log) == words
    assert f"Where  {words}" in drawn(replace(CONTEXT, log=log).page([alarm], Latch()))
    for after, engine in (
        (point("validate/S300/chosen/050"), "between two motions"),
        (event("station held", station="S1"), "between two motions"),
        (state("suspended"), "between two motions"),
        (state("checking"), "earlier session"),
    ):
        ended = location_text(alarm, log_of(*BEGUN, ("intent", key, body), after))
        assert ended == (f"Engine, {engine}" if "crash" in where else where)


def test_the_page_has_those_that_stand_and_those_that_are_over() -> None:
    latch = Latch()
    assert drawn(CONTEXT.page([], latch)) == "No alarm was raised in this run."
    latch.take([STOP])
    for alarms in ([STOP], []):  # of this session, and of one before
        page = drawn(CONTEXT.page(alarms, latch))
        assert page.count("HC-B10") == 1
        assert "not acknowledged" in page
    latch.acknowledge()
    latch.take([], "t")
    assert "not acknowledged" not in drawn(CONTEXT.page([STOP], latch))


def test_what_is_kept_is_what_the_journal_says() -> None:
    stopped = event("safe stop", problems={})
    closed = event("closed", problems={})
    assert saved_text(log_of(*BEGUN)).endswith("how the devices were left is not recorded")
    assert saved_text(log_of(*BEGUN, stopped, closed)).endswith("nothing moves")
    failed = event("safe stop", problems={"robot": "no answer"})
    assert "check robot" in saved_text(log_of(*BEGUN, failed, closed))


def test_devices_that_were_not_connected_are_not_said_to_stand() -> None:
    """A robot that plays another program was left alone, and may move."""
    ended = (event("safe stop", problems={}), event("closed", problems={}))
    assert saved_text(log_of(BEGUN[0], *ended)).endswith("not known: check the cell")


def test_the_panel_is_of_runs_that_have_ended_by_a_fault() -> None:
    assert panel_is_due(view_of("fault"), [THERE])
    assert panel_is_due(view_of("gone"), [THERE])
    assert not panel_is_due(view_of("fault"), [NOTICE])
    assert not panel_is_due(view_of("running"), [THERE])


def test_the_newest_point_is_named_with_its_age() -> None:
    line = drawn(newest_line(view_of("fault")))
    assert "|e| 1.170 mm" in line
    assert line.endswith(" ago")
    assert drawn(newest_line(view_of("checking"))) == "no point is measured yet"


def test_an_alarm_counts_points_as_the_line_of_the_kept_ones_does() -> None:
    """Proofs of nests are no points of the plan: one count, not two beside each other."""
    log = Log(measuring().point(PointId("control", session=1, pass_number=0, nest="F1")).records)
    [alarm] = alarms_of(log, "r", live=False)
    assert alarm.found.endswith("with 8 points")
    assert saved_text(log).startswith("8 of 21 points;")
