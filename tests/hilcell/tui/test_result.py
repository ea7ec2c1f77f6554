"""The result of a run without a validation: large words and figures, whole sentences, tables."""

from __future__ import annotations

import asyncio
from itertools import product
from operator import itemgetter
from pathlib import Path
from typing import Any

import msgspec
import pytest

from hilcell.calibration.recheck import CheckedPose, ChiSquare, ChiSquares, RecheckResult
from hilcell.present.table import Column, Table
from hilcell.tui.layout import large_rows
from hilcell.tui.run_view import EngineState, RunView
from hilcell.tui.session import RunUpdate
from hilcell.tui.terminal import ASCII, UNICODE
from hilcell.tui.text.finished import Result, result_of, table_lines
from tests.hilcell.calibration.pose_tests import made_up
from tests.hilcell.tui.recording_app import RecordingApp, options, press, settle, text_of
from tests.hilcell.tui.sample_runs import SampleRun, validated
from tests.hilcell.tui.views import drawn, view_of

ROWS = 16
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
def test_it_fits_where_there_is_little_room(result: dict[str, Any]) -> None:
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
    story = SampleRun()
    story.records = list(validated().state("finished").records)
    story.add("end", state="finished", exit=0, result={"iso9283": TEST})
    update = RunUpdate(story.records, EngineState.NONE, None, "")

    async def look() -> None:
        app = RecordingApp(options(Path("/runs")), update=update)
        async with app.run_test(size=(80, 24)) as pilot:
            await settle(pilot)
            assert "worst AP_p, mm" in text_of(app)
            assert "nothing may move" in text_of(app)
            await press(pilot, "w")
            assert "worst first" in text_of(app)
            await press(pilot, "q")
            assert "worst AP_p, mm" in text_of(app)

    asyncio.run(look())
