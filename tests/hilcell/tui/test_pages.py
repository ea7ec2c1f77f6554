"""Pages over a run."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest
from msgspec.structs import replace
from textual.command import CommandList, CommandPalette
from textual.css.query import NoMatches
from textual.widgets import Input
from textual.worker import WorkerFailed

from hilcell.decoding import typed
from hilcell.identity import Identity
from hilcell.journal import index
from hilcell.journal.calibration_facts import CalibrationFacts
from hilcell.journal.journal import Record
from hilcell.model import events
from hilcell.model.outcome import Outcome
from hilcell.model.plan import PlanRecord
from hilcell.model.point import Point
from hilcell.model.records import Ended, Fact, Intended, StateChanged
from hilcell.run.order import Order
from hilcell.tui.keys import load_keys
from hilcell.tui.screens.pages import (
    CHANGE_COLUMNS,
    RUN_COLUMNS,
    Compared,
    HistoryPage,
    InterlockPage,
    RecordRow,
    record_text,
    run_tone,
)
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import PlanSummary
from hilcell.tui.text.finished import report_lines
from hilcell.tui.themes import NAMES
from hilcell.tui.widgets import Table
from tests.hilcell.identification.test_sweeps import FOUND
from tests.hilcell.tui.all_screens import COMPARISON, PLAN, RUNS, SAID, SHOWN, isolated
from tests.hilcell.tui.recording_app import (
    PAGES,
    Press,
    Stage,
    footer,
    on_screen,
    press,
    run_app,
    settle,
    text_of,
    type_ahead,
    until,
)
from tests.hilcell.tui.sample_runs import measuring, sample_runs
from tests.hilcell.tui.views import cells, drawn
from tests.hilcell.verdicts import BACKLASH, WORLD

__all__ = ["isolated"]

pytestmark = pytest.mark.usefixtures("isolated")


# -- rows, filters, alarms -------------------------------------------------------------------------


def test_letters_typed_into_a_filter_do_not_act() -> None:
    typed = "adnkrwbopileht q"

    async def act(app: Stage, pilot: Press) -> None:
        type_ahead(app, "slash", *("space" if letter == " " else letter for letter in typed))
        await settle(pilot)
        assert isinstance(app.screen, RunScreen)
        assert app.screen.query_one("#find", Input).value == typed
        assert "no such point" in text_of(app)

    app = run_app(act, "running")
    assert (app.recorded.asked, app.recorded.closed, app.theme) == ([], [], "calm")


@pytest.mark.parametrize("first", ["h", "l"])
def test_what_is_typed_ahead_goes_where_it_was_meant_to(first: str) -> None:
    """A thin link delivers keys in bursts: an "a" meant for a filter must not abort."""

    async def act(app: Stage, pilot: Press) -> None:
        type_ahead(app, first, "slash", "a", "d", "space", "y", "enter")
        await settle(pilot)
        assert app.screen.query_one("#find", Input).value == "ad y"

    app = run_app(act, "running")
    assert (app.recorded.asked, app.recorded.closed) == ([], [])


@on_screen("running")
async def test_enter_twice_in_the_palette_closes_nothing_else(app: Stage, pilot: Press) -> None:
    await press(pilot, "ctrl+p", *"theme")
    await until(pilot, lambda: "the next theme" in text_of(app))
    type_ahead(app, "enter", "enter", "enter")
    await settle(pilot)
    assert len(app.screen_stack) in (2, 3)  # the run, perhaps with its point
    assert app.theme == "daylight"
    await press(pilot, "ctrl+p", "escape")


@on_screen("running")
async def test_a_filter_is_kept_and_an_empty_one_closes(app: Stage, pilot: Press) -> None:
    rows = app.screen.query_one(Table)
    await press(pilot, "slash", *"0-0-3", "enter")
    assert [row.key for row in rows.rows] == ["grid/0-0-3"]
    assert app.screen.focused is rows
    await press(pilot, "slash", *["backspace"] * 5, "enter")
    assert len(rows.rows) == 8
    assert not app.screen.query_one("#find").display


@on_screen("intolerant")
async def test_the_worst_and_the_bad_are_found_with_a_key(app: Stage, pilot: Press) -> None:
    rows = app.screen.query_one(Table)
    await press(pilot, "w")
    assert rows.key == "validate/S1100/chosen/001"  # raw errors are larger, but meant to be
    assert "w order" in footer(app)
    assert " worst first " in text_of(app)
    await press(pilot, "b")
    assert [row.key for row in rows.rows] == ["validate/S1100/chosen/001"]
    assert " bad by |e| " in text_of(app)
    await press(pilot, "slash", *"paper", "enter")
    assert "no such point is bad; b shows all" in text_of(app)
    await press(pilot, "slash", "ctrl+u", "enter", "b", "w")
    assert " point  " in text_of(app)
    assert rows.rows[0].key == "world/F1"


@on_screen("fault")
async def test_an_alarm_whose_cause_nobody_watches_stands_though_it_is_acknowledged(
    app: Stage, pilot: Press
) -> None:
    assert "beam broken" in text_of(app)
    await press(pilot, "k")
    assert "beam broken" in text_of(app)
    assert isinstance(app.screen, RunScreen)
    assert not app.screen.footer_key("acknowledge").works
    await press(pilot, "e")
    assert "beam broken" in text_of(app)
    assert "not acknowledged" not in text_of(app)


@on_screen("running")
async def test_pages_open_and_close(app: Stage, pilot: Press) -> None:
    for number, (key, page) in enumerate(PAGES.items()):
        await press(pilot, key)
        assert isinstance(app.screen, page)
        await press(pilot, ("q", "backspace")[number % 2])
        assert isinstance(app.screen, RunScreen)


@on_screen("done", size=(120, 36))
async def test_plots_are_turned_by_arrows_and_numbers(app: Stage, pilot: Press) -> None:
    await press(pilot, "p", "right")
    assert "in rising order" in text_of(app)
    await press(pilot, "left", "left")
    assert "strip's reading" in text_of(app)
    await press(pilot, "3")
    assert "nothing measured for this plot yet" in text_of(app)
    await press(pilot, "5")
    assert "nothing measured for this plot yet" in text_of(app)  # there were no sweeps


@on_screen("done", size=(120, 36))
async def test_station_scale_and_series_of_a_plot_have_keys(app: Stage, pilot: Press) -> None:
    await press(pilot, "p")
    assert "S  all stations" in text_of(app)
    assert "log scale" in text_of(app)
    await press(pilot, "S", "g", "v")
    text = text_of(app)
    assert "S  all stations" not in text
    assert "S  S1100" in text
    assert "log scale" not in text
    assert "■ as sent" in text
    assert "■ paper" not in text
    await press(pilot, "4", "g")
    assert "linear scale only" in text_of(app)


@on_screen("running")
async def test_the_palette_does_what_it_names(app: Stage, pilot: Press) -> None:
    await press(pilot, "ctrl+p", *"interlocks")
    assert isinstance(app.screen, CommandPalette)
    await until(pilot, lambda: "what may move" in text_of(app))
    await pilot.press("enter")
    await until(pilot, lambda: isinstance(app.screen, InterlockPage))


@pytest.mark.parametrize("closing", [True, False])
def test_a_search_that_finds_the_palette_closed_ends_no_screen(closing: bool) -> None:
    async def act(app: Stage, pilot: Press) -> None:
        await press(pilot, "ctrl+p")
        palette = app.screen
        if closing:
            await palette.query_one(CommandList).remove()

        async def search() -> None:
            raise NoMatches

        worker = palette.run_worker(search())
        with pytest.raises(WorkerFailed):
            await worker.wait()
        await pilot.pause()

    if closing:
        run_app(act, "running")
    else:  # an error of the search itself is shown
        with pytest.raises(NoMatches):
            run_app(act, "running")


@on_screen("running", size=(137, 45))
async def test_the_palette_names_all_that_can_be_done_before_one_types(
    app: Stage, pilot: Press
) -> None:
    await press(pilot, "ctrl+p")
    await until(pilot, lambda: "stop everything now" in text_of(app))
    for action in ("abort", "re-measure", "bad only", "worst first", "filter"):
        assert action in text_of(app)
    assert "new run" not in text_of(app)  # not while one is live


@on_screen("running")
async def test_the_next_theme_comes_with_a_key(app: Stage, pilot: Press) -> None:
    seen = []
    for _ in NAMES:
        await press(pilot, "t")
        seen.append(app.theme)
    assert seen == [*NAMES[1:], NAMES[0]]


@pytest.mark.parametrize("which", ["abort", "plan"])
@on_screen("running", size=(80, 24))
async def test_a_question_yields_to_its_answers(app: Stage, pilot: Press, which: str) -> None:
    if which == "abort":
        await press(pilot, "a")
    else:
        app.push_screen(PlanSummary(Order(runs=Path("r")), PLAN))
    await settle(pilot)
    assert "Enter" in text_of(app)
    await pilot.resize_terminal(24, 6)
    await settle(pilot)
    assert "Enter" in text_of(app)


# -- other keys ------------------------------------------------------------------------------------


def test_keys_from_a_file_act_in_place_of_the_usual_ones(tmp_path: Path) -> None:
    file = tmp_path / "keys.toml"
    file.write_text('[keys]\nabort = "z"\npause = ["f8", "g"]\nstop = "s"\nquit = "Q"\n')

    async def act(app: Stage, pilot: Press) -> None:
        assert " z  abort " in text_of(app)
        assert " f8  pause " in text_of(app)
        await press(pilot, "a", "space", "ctrl+q", "ctrl+c")
        assert isinstance(app.screen, RunScreen)
        assert app.recorded.asked == []
        await press(pilot, "g")
        assert app.recorded.asked == [("pause", {})]
        await press(pilot, "z", "y")
        assert app.recorded.asked == [("pause", {}), ("abort", {})]
        await press(pilot, "s", "escape")
        assert app.recorded.stops == 2
        await press(pilot, "question_mark")
        assert "f8 g" in text_of(app)

    run_app(act, "running", keymap=load_keys(file))


def test_an_index_that_takes_long_is_read_once_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    reads: list[Path] = []
    reading, go_on = threading.Event(), threading.Event()

    def slow(runs: Path) -> list[index.RunRow]:
        reads.append(runs)
        reading.set()
        go_on.wait()
        return []

    async def act(app: Stage, pilot: Press) -> None:
        monkeypatch.setattr(index, "read_index", slow)
        page = HistoryPage()
        await app.push_screen(page)
        await asyncio.to_thread(reading.wait)
        for _ in range(3):
            page._read_index()
        go_on.set()
        await settle(pilot)
        assert len(reads) == 1

    run_app(act, "done")


@pytest.mark.parametrize("key", ["l", "h", "e", "p"])
@on_screen("running", size=(80, 24))
async def test_every_page_of_a_simulated_run_has_its_edge(
    app: Stage, pilot: Press, key: str
) -> None:
    await press(pilot, key)
    assert app.screen.styles.border_left[0] == "outer"
    assert app.screen.has_class("simulated")


@on_screen("running", size=(80, 24))
async def test_what_is_cut_in_the_log_has_its_mark(app: Stage, pilot: Press) -> None:
    await press(pilot, "l")
    held = next(line for line in text_of(app).splitlines() if "rail held" in line)
    assert held.rstrip("▌ ").endswith("…")


@pytest.mark.parametrize("width", [38, 59, 78, 99, 139])
def test_the_figures_are_in_words_and_fit(width: int) -> None:
    lines = report_lines(SHOWN, None).lines(width)
    text = "\n".join(line.plain for line in lines)
    assert max(line.cell_length for line in lines) <= width
    assert not set("│┃━┏…") & set(text)
    for raw in ("True", "machine_seed", "idw", "chosen:", "station_held", "None"):
        assert raw not in text
    for words in ("yes, no device moved", "station held", "as sent", "paper method", "corrected"):
        assert words in " ".join(text.split())
    assert text.count("0.1100") == 3


def test_a_run_that_did_not_finish_states_its_fault_and_no_table() -> None:
    found = SHOWN | {"state": "faulted", "fault": "Tracker: measure: beam broken; " * 5}
    text = drawn(report_lines(found, None))
    assert " ".join(text.split()).count("beam broken;") == 5
    assert "paper method" not in text


@pytest.mark.usefixtures("isolated")
@on_screen("done")
async def test_output_of_another_kind_is_refused(
    app: Stage, pilot: Press, monkeypatch: pytest.MonkeyPatch
) -> None:
    for text in ("", "no JSON", "[1]", "{\n}"):
        monkeypatch.setitem(SAID, "show", text)
        await press(pilot, "o")
        assert "no figures" in text_of(app)
        await press(pilot, "q")


T = "2026-03-04T08:00:01.250+00:00"
SAMPLES = {record.kind: record for record in measuring().records}
RECORDED_PLAN, POINT = SAMPLES["plan"].fact, SAMPLES["point"].fact
assert isinstance(RECORDED_PLAN, PlanRecord)
assert isinstance(POINT, Point)
DRIVE = Identity(device="Rail", model="drive", serial="1")
RECORD_TEXTS: list[tuple[str, Fact, str]] = [
    ("", RECORDED_PLAN, "calibrate, 21 points, seed 1"),
    ("", replace(RECORDED_PLAN, machine_seed=7), "calibrate, 21 points, seed 1, machine 7"),
    ("", StateChanged(machine="run", to="paused"), "run is paused"),
    ("", StateChanged(machine="run", to="faulted", reason="a"), "run is faulted: a"),
    ("grid/0", POINT, "grid/0 at S1100"),
    ("world/F1", replace(POINT, station=""), "world/F1"),
    ("grid/0", replace(POINT, station="", retaken=True), "grid/0, re-measured"),
    ("grid/0", Intended(action="robot.move", joints_deg=(0.0,)), "robot.move grid/0"),
    ("", Intended(action="rail.move", position_mm=5.0), "rail.move to 5.000 mm"),
    ("", Intended(action="rail.approach", station="S1"), "rail.approach S1"),
    ("sweep/A1/up", Intended(action="robot.sweep", axis=1), "robot.sweep sweep/A1/up axis 1"),
    ("world", replace(WORLD, points=["world/F1", "world/F2"]), "world by 2 points"),
    ("world", replace(WORLD, calibration="1-made"), "world of calibration 1-made"),
    ("backlash", BACKLASH, f"backlash in tolerance: {BACKLASH.text}"),
    ("", events.Closed(problems={}), "devices closed"),
    (
        "",
        events.SafeStopSent(problems={"Tracker": "gone"}),
        "a stop was sent to all devices, but check Tracker: gone",
    ),
    ("", events.Connected(devices=[DRIVE]), "devices connected: drive, serial 1"),
    ("", events.DeviceBack(device="Rail"), "device back: Rail answers again"),
    (
        "",
        events.CommandRefused(command="pause", state="paused"),
        "command refused: pause is not possible while paused",
    ),
    ("", events.ChangesAccepted(changes=["a", "b"], by="Ann"), "changes accepted by Ann: a; b"),
    ("", events.StepBegun(name="fit", number=6, of=7), "step 6 of 7 begins: fit"),
    (
        "",
        events.LinkCounted(frames=9, bad_lines=0, refused=0, malformed=0),
        "rail's wire: 9 frames, 0 bad lines, 0 refused, 0 malformed (0.00 % lost)",
    ),
    ("", events.OtherEvent("drift", {"off_mm": 0.1, "axis": 2}), "drift off_mm 0.1, axis 2"),
    ("", events.OtherEvent("drift seen", {}), "drift seen"),
    ("", FOUND, "curve of A2: 31.6 urad at 40.0, 20.0 urad at 203.5; lag 12.3 ms"),
    ("", Ended(state="finished", exit=0), "finished, exit 0"),
]


@pytest.mark.parametrize(("key", "fact", "wanted"), RECORD_TEXTS)
def test_each_kind_has_its_words(key: str, fact: Fact, wanted: str) -> None:
    assert record_text(key, fact) == wanted


def test_every_record_of_a_run_becomes_one_line() -> None:
    whats = [RecordRow.of(r).what for run in sample_runs().values() for r in run.records]
    assert all(what and "\n" not in what for what in whats)
    body = {"machine": "run", "to": "faulted", "reason": "a\nb"}
    row = RecordRow.of(Record(17, T, "state", "", body))
    assert row == ("17", "08:00:01.250", "state", "run is faulted: a b", "fault")


# -- the history -----------------------------------------------------------------------------------


def test_the_history_says_how_a_run_came_out() -> None:
    suspected = CalibrationFacts(suspected=True)
    both = CalibrationFacts(suspected=True, outcome=Outcome.REJECTED)
    runs = [*RUNS, *(replace(RUNS[1], facts=facts) for facts in (suspected, both))]
    (said,) = [column.of for column in RUN_COLUMNS if column.title == "verdict or state"]
    outcomes = ["in tolerance", "out of tolerance", "engine gone", "unreadable"]
    assert [said(run) for run in runs] == [*outcomes, "suspected", "out of tolerance"]
    assert [run_tone(run) for run in RUNS[:2]] == ["", "fault"]


@pytest.mark.parametrize("width", [58, 79, 80, 119, 138, 200])
def test_the_history_always_has_date_procedure_verdict_and_operator(width: int) -> None:
    row = cells(RUN_COLUMNS, RUNS[0], width)
    assert 2 + sum(column.width + 1 for column in row) <= width - 1, "beside mark and edge"
    found = {column.title: text for column, text in row.items()}
    date = found.get("begun UTC") or found["begun"]
    assert date.startswith("2026-03-04")
    assert found["procedure"] == "calibrate"
    assert found["verdict or state"] == "in tolerance"
    assert found["operator"] == "Ann"
    if width >= 79:
        assert (found["cell"], found["kind"]) == ("paper", "SIM")
    if width >= 119:
        assert found["after"] == "0.110"


def test_a_comparison_tells_stations_apart_in_80_columns() -> None:
    rows = [cells(CHANGE_COLUMNS, change) for change in typed(COMPARISON, Compared).changes]
    shown = [[text[: column.width] for column, text in row.items()][:2] for row in rows]
    assert len(set(map(tuple, shown))) == len(rows)
    assert shown[0] == ["S1100 targets", "corrected: mean, mm"]
    assert sum(column.width + 1 for column in CHANGE_COLUMNS) <= 79
