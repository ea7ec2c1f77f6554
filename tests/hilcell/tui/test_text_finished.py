"""A finished run: its words and figures, its verdict, its own table."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from operator import itemgetter
from typing import Any

import msgspec
import pytest

from hilcell.alarms.alarm import Alarm, Cause, alarms_of
from hilcell.calibration.recheck import CheckedPose, ChiSquare, ChiSquares, RecheckResult
from hilcell.journal.journal import Record
from hilcell.model.outcome import Outcome
from hilcell.model.records import Ended
from hilcell.model.verdicts import Judged
from hilcell.present.table import Column, Table
from hilcell.tui.layout import large_rows
from hilcell.tui.run_view import RunView
from hilcell.tui.session import RunUpdate
from hilcell.tui.terminal import ASCII, UNICODE
from hilcell.tui.text.finished import (
    Figure,
    Finished,
    Head,
    Result,
    finished_verdict,
    gravest,
    result_of,
    table_lines,
)
from hilcell.tui.text.run import RunText
from tests.hilcell.calibration.pose_tests import made_up
from tests.hilcell.tui.recording_app import Press, Stage, press, run_app, text_of
from tests.hilcell.tui.sample_runs import sample_runs, validated
from tests.hilcell.tui.views import drawn, view_of

ROWS = 16  # of the box at 80x24
NAN = math.nan
PLACES = {
    "S300": {"mean": 0.113, "p95": 0.192, "max": 0.218},
    "S1100": {"mean": 0.110, "p95": 0.195, "max": 0.310},
    "S1900": {"mean": 0.108, "p95": 0.207, "max": 0.238},
}


def finished(state: str, places: dict[str, dict[str, float]], U_mm: float = 0.005) -> RunView:
    """Return a run that has ended with these errors."""
    view = view_of(state)
    validation: dict[str, Any] = {
        name: {
            "points": 75,
            "points_sent": {"before": 75},
            "before": each | {"mean": 1.2},
            "chosen": each,
        }
        for name, each in places.items()
    }
    validation["others"] = validation[next(iter(places))]
    assert view.log.end is not None
    view.log.end = msgspec.structs.replace(view.log.end, result={"validation": validation})
    for name, each in places.items():
        holds = each["mean"] <= 0.12
        view.log.verdicts[f"validation.{name}"] = Judged(
            holds=holds, decided=Outcome.ACCEPTED if holds else Outcome.REJECTED, decision="",
            mean_mm=each["mean"], mean_tolerance_mm=0.12, mean_U_mm=U_mm,
            max_mm=each["max"], max_tolerance_mm=0.3, max_U_mm=0.0,
        )  # fmt: skip
    return view


def verdict(view: RunView) -> Finished:
    found = finished_verdict(view)
    assert found is not None
    return found


def verdict_text(view: RunView, width: int = 79, rows: int = ROWS) -> str:
    return drawn(verdict(view).lines(view, UNICODE), width, rows)


def judge(view: RunView, name: str, **changed: Any) -> None:
    """Change the verdict on a station."""
    key = f"validation.{name}"
    view.log.verdicts[key] = msgspec.structs.replace(view.log.verdicts[key], **changed)


def test_the_worst_mean_and_the_worst_single_are_named_with_their_stations() -> None:
    view = finished("done", PLACES)
    found = verdict(view)
    assert (found.worst_mean.name, found.worst_single.name) == ("S300", "S1100")
    assert [each.name for each in found.stations] == ["S300", "S1100", "S1900"]
    text = verdict_text(view)
    for figure in ("PASS", "0.113", "0.310"):
        assert large_rows(figure)[1] in text
    for words in ("● at S300, limit 0.120", "▲ at S1100, limit 0.300", "SIMULATION"):
        assert words in text
    assert "below 0.118 mm at S300" in text  # the true mean
    judge(view, "S1100", mean_mm=0.1, max_mm=0.25)
    assert "0.310" not in verdict_text(view)  # the figures that it was judged by


def test_a_failure_says_its_reason_and_steps() -> None:
    view = finished("intolerant", PLACES | {"S1900": {"mean": 0.222, "p95": 0.4, "max": 1.084}})
    found = verdict(view)
    assert found.words == ("FAIL", "out of tolerance")
    text = verdict_text(view)
    row = next(line for line in text.split("\n") if line.startswith(" S1900"))
    assert row.split() == ["S1900", "75", "1.200", "0.222", "0.400", "1.084", "▲", "FAIL"]
    assert "▲ HC-V01 S1900: mean 0.222 over 0.120, single 1.084 over 0.300" in text
    assert "validation." not in text
    assert "\n 3 " in text
    assert large_rows("FAIL")[0] in text


def test_no_reason_and_no_step_of_a_failure_is_cut() -> None:
    places = PLACES | {name: {"mean": 0.222, "p95": 0.4, "max": 1.084} for name in PLACES}
    view = finished("intolerant", places)
    for width, rows in ((59, 22), (79, ROWS + 5)):
        text = " ".join(verdict_text(view, width, rows).split())
        assert "…" not in text
        assert all(f"{name}: mean 0.222 over 0.120, single 1.084" in text for name in PLACES)
        assert all(step in text for step in view.alarms[0].do)


def test_a_station_that_is_not_shown_to_hold_names_its_uncertainty() -> None:
    view = finished("intolerant", PLACES, U_mm=0.01)
    judge(view, "S300", holds=False, decided=Outcome.UNDECIDED)
    assert verdict(view).reasons == "S300: mean 0.113, U 0.010: not shown below 0.120"
    assert "▲ at S300, limit 0.120" in verdict_text(view)
    view = finished("intolerant", PLACES | {"S1100": {"mean": 0.05, "p95": 0.1, "max": 0.298}})
    judge(view, "S1100", holds=False, decided=Outcome.UNDECIDED, max_U_mm=0.005)
    assert "▲ at S1100, limit 0.300" in verdict_text(view)


def test_a_nan_is_the_worst_and_fails() -> None:
    view = finished("intolerant", PLACES | {"S300": dict.fromkeys(("mean", "p95", "max"), NAN)})
    found = verdict(view)
    assert found.worst_mean.name == found.worst_single.name == "S300"
    assert "▲ at S300" in verdict_text(view)


def test_an_undecided_run_is_not_called_out_of_tolerance() -> None:
    view = finished("intolerant", PLACES)
    judge(view, "S300", holds=False, decided=Outcome.UNDECIDED)
    found = verdict(view)
    assert found.words == ("UNDECIDED", "neither pass nor fail")
    assert "UNDECIDED" in drawn(RunText(view).banner())
    assert "OUT OF TOLERANCE" not in drawn(RunText(view).banner())
    lines = verdict_text(view, 78).split("\n")
    assert not any("FAIL" in line for line in lines)
    assert "UNDECIDED" in lines[2]
    [row] = [line for line in lines if line.startswith(" S300")]
    assert row.endswith("▲ undecided")


def test_more_stations_than_there_is_room_for_are_counted() -> None:
    many = {f"P{n}": {"mean": 0.01 * n, "p95": 0.1, "max": 0.2} for n in range(9)}
    view = finished("done", many)
    text = verdict_text(view)
    assert "P8 " in text  # the worst
    assert "more in the report" in text


@pytest.mark.parametrize("simulated", [True, False])
def test_a_simulation_is_marked_inside_the_verdict(simulated: bool) -> None:
    view = finished("done", PLACES)
    assert view.log.plan is not None
    view.log.plan = msgspec.structs.replace(view.log.plan, simulated=simulated)
    found = verdict(view)
    for width, rows in ((79, ROWS), (59, 8)):
        text = drawn(found.lines(view, ASCII), width, rows)
        assert ("SIMULATION" in text) == simulated


@pytest.mark.parametrize("name", sample_runs())
def test_only_a_finished_run_has_a_verdict(name: str) -> None:
    assert (finished_verdict(view_of(name)) is not None) == (name in ("done", "intolerant"))


@pytest.mark.parametrize(
    "result",
    [
        {},
        {"validation": {}},
        {"validation": {"S1100": {"points": 2}}},
        {"validation": {"S1100": {"before": {"mean": 1.0}}}},
        {"validation": [1.0]},
        {"validation": {"S1100": {"before": {"mean": None}, "chosen": {"mean": None}}}},
    ],
)
def test_a_result_of_another_kind_has_no_verdict(result: dict[str, object]) -> None:
    view = view_of("done")
    view.log.end = Ended(state="finished", exit=0, result=result)
    assert finished_verdict(view) is None


def test_it_fits_where_there_is_little_room() -> None:
    view = view_of("done")
    found = verdict(view)
    for width, rows in product((20, 38, 58, 79), (4, 8, 13, ROWS)):
        lines = found.lines(view, UNICODE).lines(width, rows)
        assert max(line.cell_length for line in lines) <= width
        assert "PASS" in lines[0].plain or large_rows("PASS")[0] in lines[1].plain


@pytest.mark.parametrize(
    ("max_deg", "U_deg", "outcome", "said"),
    [
        (0.08, 0.01, "rejected", "S300: orientation 0.0800° over 0.05°"),
        (0.045, 0.01, "undecided", "S300: orientation 0.0450°, U 0.0100°: not shown below 0.05°"),
    ],
)
def test_an_orientation_over_its_limit_is_the_reason(
    max_deg: float, U_deg: float, outcome: str, said: str
) -> None:
    view = finished("intolerant", PLACES | {"S1100": PLACES["S1900"]})
    limited(view, max_deg=max_deg, max_U_deg=U_deg, decided=Outcome(outcome), holds=False)
    found = verdict(view)
    assert found.reasons == said
    assert said in " ".join(verdict_text(view, 79, ROWS + 5).split())


def test_an_orientation_in_its_limit_is_shown() -> None:
    view = finished("done", PLACES | {"S1100": PLACES["S1900"]})
    limited(view, max_deg=0.0123, max_U_deg=0.01)
    text = verdict_text(view)
    assert "orientation, worst: 0.0123° at S300, limit 0.05°" in text


def limited(view: RunView, **judged: object) -> None:
    """State a limit of orientation in a run's cell, and what S300 was judged by."""
    seats = {"more_smr_mm": [[-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]]}
    cell = dict(view.log.inputs.cell)
    cell["validation"] |= {"max_tolerance_deg": 0.05}
    cell["robot"] |= seats
    view.log.plan = msgspec.structs.replace(view.log.inputs, cell=cell)
    view.log._cell = None
    judge(view, "S300", max_tolerance_deg=0.05, **judged)


LONG = "Heck-Spantaktstation-Nord-Linie-2-Bauabschnitt-4-Platz-11"


def test_a_long_name_of_a_station_hides_no_limit_and_no_figure() -> None:
    view = finished("done", {LONG: PLACES["S300"]})
    for width, rows in ((79, ROWS), (59, 9)):
        text = verdict_text(view, width, rows)
        assert "…, limit 0.120" in text
        assert "…, limit 0.300" in text
        assert "below 0.118 mm" in text


def test_a_phrase_without_room_is_left_out_whole() -> None:
    view = finished("done", PLACES)
    assert view.log.end is not None
    view.log.end.result["validation"]["S300"]["floor"] = {"mean": 0.031, "p95": 0.05}
    wide = verdict_text(view, 79, 9)
    small = verdict_text(view, 59, 9)
    assert "floor: 0.031 mm" in wide
    assert "floor:" not in small
    assert "…" not in small


def test_what_to_do_about_a_u_that_is_too_large_is_seen_in_24_rows() -> None:
    view = finished("intolerant", PLACES, U_mm=0.03)
    for name in PLACES:
        judge(view, name, holds=False, decided=Outcome.UNDECIDED)
    t = view.records[-1].t
    view.log.verdict_records = {
        key: Record(900, t, "verdict", key, msgspec.to_builtins(verdict))
        for key, verdict in view.log.verdicts.items()
        if key.startswith("validation.")
    }
    view.alarms = alarms_of(view.log, "r", live=False)
    found = verdict(view)
    assert [found.reasons.count(name) for name in PLACES] == [1] * len(PLACES)
    text = " ".join(verdict_text(view).split())
    assert "HC-V17" in text
    assert view.alarms[0].do[0] in text


@pytest.mark.parametrize(
    ("causes", "standing", "words"),
    [
        ([], 0, "● no alarms"),
        ([], 1, "▲ 1 alarm: e"),
        ([], 2, "▲ 2 alarms: e"),
        (["over"], 0, "● no alarms; 1 that is over: e"),
        (["over", "over"], 0, "● no alarms; 2 that are over: e"),
        (["watched"], 0, "▲ 1 alarm: e"),
        (["over", "watched", "not watched"], 0, "▲ 2 alarms: e; 1 that is over: e"),
    ],
)
def test_alarms_are_counted_beside_a_pass_but_not_those_that_are_over(
    causes: list[Cause], standing: int, words: str
) -> None:
    view = finished("done", PLACES)
    alarm = Alarm("HC-T10", "notice", "Beam broken", "Tracker", "broke", "means", ("do",), "", 0)
    view.alarms = [replace(alarm, seq=n, cause=cause) for n, cause in enumerate(causes)]
    lines = verdict(view).lines(view, UNICODE, standing)
    assert f" {words}" in drawn(lines, 79, ROWS)


@pytest.mark.parametrize(
    ("value_mm", "limit_mm", "U_mm", "over"),
    [
        (0.110, 0.120, 0.010, False),
        (0.111, 0.120, 0.010, True),
        (0.121, 0.120, 0.0, True),
        (NAN, 0.120, 0.0, True),
        (0.110, 0.120, NAN, True),
        (9.0, None, 0.0, False),
    ],
)
def test_a_figure_keeps_its_limit_with_its_uncertainty(
    value_mm: float, limit_mm: float | None, U_mm: float, over: bool
) -> None:
    assert Figure("AP_p, mm", value_mm, "at P1", limit_mm, U_mm).over is over


def test_what_is_no_length_is_graver_than_any() -> None:
    assert max((0.2, NAN, 5.0), key=gravest) is NAN
    assert max((-math.inf, 5.0), key=gravest) == -math.inf
    assert max((0.2, 5.0), key=gravest) == 5.0


@pytest.mark.parametrize(
    ("width", "rows", "small"), [(78, 14, False), (77, 14, True), (78, 13, True)]
)
def test_the_large_head_needs_its_width_and_its_rows(width: int, rows: int, small: bool) -> None:
    assert Head.is_small(width, rows) is small


@pytest.mark.parametrize(
    ("value_mm", "limit_mm", "filled", "sign", "role"),
    [
        (0.06, 0.12, Figure.TO_LIMIT / 2, "●", "$passed"),
        (0.12, 0.12, Figure.TO_LIMIT, "●", "$passed"),
        (0.50, 0.12, Figure.BAR, "▲", "$fault"),
        (0.06, None, 0.0, "○", "$label"),
    ],
)
def test_the_bar_reaches_the_limit_where_the_figure_does(
    value_mm: float, limit_mm: float | None, filled: float, sign: str, role: str
) -> None:
    figure = Figure("mean, mm", value_mm, "at S300", limit_mm)
    other = Figure("max, mm", 0.2, "at S1100", 0.3)
    head = Head(("PASS",), "in tolerance", "passed", (figure, other))
    lines = head.lines(view_of("done"), UNICODE, 79, 16)
    bar = lines[5].plain[26 : 26 + Figure.BAR].replace("│", "█" if filled > Figure.TO_LIMIT else "")
    assert bar.count("█") + bar.count("▌") / 2 == filled
    [at] = [line for line in lines if "at S300" in line.plain]
    signs = {at.plain[span.start : span.end]: span.style for span in at.spans if span.start == 26}
    assert (at.plain[26], signs[sign]) == (sign, role)


TEST: dict[str, Any] = msgspec.to_builtins(made_up())
TEXT = (
    "Still valid: the errors are as calibration 20261123-033616-calibrate-22df predicts; drift "
    "0.000 mm, uncertainty 0.043 mm. As found, 7 corrected poses are 0.033 mm off in the mean and "
    "0.045 mm at most, within tolerance."
)
HOLDS = ChiSquare(4.0, 6, 20.3)
RECHECK: dict[str, Any] = msgspec.to_builtins(
    RecheckResult(
        verdict="valid",
        calibration="20261123-033616-calibrate-22df",
        station="S1100",
        points=7,
        drift_mm=0.0,
        drift_u_mm=0.043,
        shift_mm=0.01,
        u_mm=0.02,
        turn_urad=5.0,
        turn_u_urad=20.0,
        chi2=12.0,
        tests=ChiSquares(HOLDS, HOLDS, HOLDS),
        risk=0.01,
        mean_mm=0.033,
        max_mm=0.045,
        mean_tolerance_mm=0.12,
        max_tolerance_mm=0.3,
        mean_U_mm=0.0,
        max_U_mm=0.0,
        in_tolerance=True,
        temperature_c=None,
        calibrated_c=None,
        poses=[
            CheckedPose(
                f"recheck/{n:03d}", [1850.0, 0.0, 950.0], 0.03 + 0.001 * n, 0.098, 0.034, 1.0
            )
            for n in range(7)
        ],
        suspicions=[],
        text=TEXT,
    )
)


def ended(result: dict[str, Any], state: str = "done", procedure: str = "calibrate") -> RunView:
    """Return a run that has ended with a result."""
    view = view_of(state)
    assert view.log.end is not None
    assert view.log.plan is not None
    view.log.end = msgspec.structs.replace(view.log.end, result=result)
    view.log.plan = msgspec.structs.replace(view.log.plan, procedure=procedure)
    return view


def shown(view: RunView, width: int = 79, rows: int = ROWS) -> str:
    found = result_of(view)
    assert found is not None
    return drawn(found.lines(view, UNICODE), width, rows)


def test_a_pose_test_shows_its_worst_figures_large_and_a_table_by_pose() -> None:
    text = shown(ended({"iso9283": TEST}))
    lines = text.split("\n")
    for figure in ("1.504", "0.075"):
        assert large_rows(figure)[1].rstrip() in text
    assert text.count("at P3") == 2
    for figure in ("P2-P4", "+0.387", "0.037", "±0.073", "0.019"):
        assert figure in text
    assert ["P1", "1.210", "0.149", "0.066", "0.011"] in [line.split() for line in lines]
    assert "PASS" not in text
    assert "verdict" not in text


@pytest.mark.parametrize(("state", "limit_mm"), [("done", 2.0), ("intolerant", 1.6)])
def test_a_pose_is_judged_only_by_a_limit_that_is_stated(state: str, limit_mm: float) -> None:
    """U counts against the limit: 1.504 with U 0.149 does not keep 1.6."""
    view = ended({"iso9283": TEST | {"limits": {"ap_limit_mm": limit_mm}}}, state)
    text = shown(view)
    word, each = ("PASS", "pass") if state == "done" else ("FAIL", "FAIL")
    assert large_rows(word)[0] in text
    assert f"at P3, limit {limit_mm:.3f}" in text
    rows = {line.split()[0]: line.split()[-1] for line in text.split("\n") if " P" in line[:3]}
    assert rows == {"P1": "pass", "P3": each}


@pytest.mark.parametrize(
    ("verdict", "words"),
    [("valid", ("STILL", "VALID")), ("update", ("UPDATE",)), ("redo", ("REDO",))],
)
def test_a_recheck_says_large_what_to_do_and_its_whole_sentence(
    verdict: str, words: tuple[str, ...]
) -> None:
    text = shown(ended({"recheck": RECHECK | {"verdict": verdict}}))
    for word in words:
        assert all(row in text for row in large_rows(word))
    assert TEXT in " ".join(text.split())
    assert "…" not in text
    assert "limit 0.120" in text
    assert "limit 0.300" in text
    head = next(line for line in text.split("\n") if "predicted below mm" in line)
    assert "now mm" in head


@pytest.mark.parametrize("procedure", ["home", "rail-survey", "sign-check", "no-such-procedure"])
@pytest.mark.parametrize("result", [{}, {"points": {"world": 3}}, {"iso9283": [1]}, {"recheck": 3}])
def test_a_result_that_cannot_be_read_breaks_nothing(
    procedure: str, result: dict[str, Any]
) -> None:
    text = shown(ended(result, procedure=procedure))
    assert ("world" in text) == (procedure == "home" and bool(result.get("points")))


@pytest.mark.parametrize("result", [{"iso9283": TEST}, {"recheck": RECHECK}])
def test_it_fits_where_there_is_little_room_result(result: dict[str, Any]) -> None:
    view = ended(result)
    found = result_of(view)
    assert isinstance(found, Result)
    for width, rows, glyphs in product((20, 38, 58, 79), (4, 13, 30), (UNICODE, ASCII)):
        lines = found.lines(view, glyphs).lines(width, rows)
        assert max(line.cell_length for line in lines) <= width
        assert "…" not in "".join(line.plain for line in lines)


@pytest.mark.parametrize("width", [20, 38, 58, 79, 119])
def test_a_table_is_drawn_to_the_width_and_cuts_no_number(width: int) -> None:
    numbers = [1234.5678 + n for n in range(12)]
    columns: list[Column[list[str | float]]] = [
        Column("pose", itemgetter(0)),
        *(Column(f"figure {n}", itemgetter(n + 1), "mm", ".4f") for n in range(12)),
        Column("why", itemgetter(13)),
    ]
    row: list[str | float] = ["P1", *numbers, "because it is so, and for no other"]
    lines = table_lines(Table(columns, [row])).lines(width)
    text = "\n".join(line.plain for line in lines)
    assert all(f"{number:.4f}" in text for number in numbers)
    assert max(line.cell_length for line in lines) <= width
    assert not set("│┃━…") & set(text)


def test_the_screen_shows_the_result_and_its_points_at_a_key() -> None:
    story = validated().state("finished")
    story.add("end", state="finished", exit=0, result={"iso9283": TEST})

    async def look(app: Stage, pilot: Press) -> None:
        assert "worst AP_p, mm" in text_of(app)
        assert "nothing may move" in text_of(app)
        await press(pilot, "w")
        assert "worst first" in text_of(app)
        await press(pilot, "q")
        assert "worst AP_p, mm" in text_of(app)

    run_app(look, update=RunUpdate(story.records), size=(80, 24))
