"""Pages over a run: alarms, interlocks, one point, plots, report, event log, and earlier runs."""

from __future__ import annotations

import math
import os
import time
import webbrowser
from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from operator import attrgetter
from pathlib import Path
from typing import ClassVar, NamedTuple, Self

import msgspec
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.content import Content
from textual.widgets import Input

from hilcell.decoding import Json, decoded
from hilcell.errors import HilcellError
from hilcell.journal.index import RunRow
from hilcell.journal.journal import Record
from hilcell.journal.labels import in_zone
from hilcell.language import marked, tr
from hilcell.model.events import Closing, Connected, Event, LinkCounted, OtherEvent, after
from hilcell.model.frame import Frame
from hilcell.model.plan import PlanRecord
from hilcell.model.point import Point
from hilcell.model.records import Ended, Fact, Intended, StateChanged
from hilcell.model.verdicts import Verdict
from hilcell.report.comparison import CHANGES, Change, Setting
from hilcell.tui import process
from hilcell.tui.keys import shown
from hilcell.tui.layout import BLANK, Lines, Stack
from hilcell.tui.plots import PlotStyle
from hilcell.tui.process import run_in_thread
from hilcell.tui.run_view import RunView
from hilcell.tui.screens.base import BaseScreen, Page
from hilcell.tui.text.devices import DeviceText
from hilcell.tui.text.finished import report_lines
from hilcell.tui.text.plots import MOST_TABS, Choice, Measured, plot_lines, tab_line, tabs_for
from hilcell.tui.text.points import point_page
from hilcell.tui.themes import SIXTEEN
from hilcell.tui.widgets import Column, Table, TextField, TextPanel


class TextPage(Page):
    """A page of text that scrolls."""

    fixed = (*Page.fixed, ("▲▼", marked("scroll")))

    def body(self) -> ComposeResult:
        with VerticalScroll(classes="scroll", id="body", can_focus=True):
            yield TextPanel("text")

    def show(self, view: RunView | None) -> None:
        super().show(view)
        self.panel("text").show(self.text(view))

    @abstractmethod
    def text(self, view: RunView | None) -> Content | Lines:
        """Return the text of the page."""


class AlarmPage(TextPage):
    """Every alarm: its meaning, its place, the steps to take."""

    title_text = marked("Alarms")
    footer = ("stop", "acknowledge", "pause", "quit")

    def text(self, view: RunView | None) -> Content | Lines:
        if view is None:
            return Content("")
        return self.alarm_context().page(view.alarms, self.application.shown_session.latch)


class InterlockPage(TextPage):
    """The interlocks: each condition of motion, and the last reading of each device."""

    title_text = marked("Interlocks: conditions before anything moves")
    footer = ("stop", "pause", "quit")

    def text(self, view: RunView | None) -> Content:
        return (
            DeviceText(view, self.application.glyphs).interlock_page()
            if view is not None
            else Content("")
        )


class DetailPage(TextPage):
    """One point, with everything that is known of it."""

    title_text = marked("One point")
    footer = ("stop", "pause", "alarms", "retake", "quit")

    def __init__(self, key: str) -> None:
        super().__init__()
        self._key = key

    def text(self, view: RunView | None) -> Content | Lines:
        return point_page(view, self._key) if view is not None else BLANK

    def do_retake(self) -> None:
        self.application.retake(self._key)


BEGIN = "1970-01-01T00:00:00+00:00"  # before any record is read
CHOOSE = ("▲▼", marked("move"))


class FilterScreen(BaseScreen):
    """A screen with rows and a filter; ``filter_text`` is the text typed."""

    in_text_box = (("Enter", marked("to the rows")),)  # from the filter
    filter_text = ""

    def filter_box(self, hint: str) -> Input:
        box = TextField(placeholder=hint, id="find")
        box.display = False
        return box

    @abstractmethod
    def filter_rows(self) -> None:
        """Show the rows that match the filter."""

    def do_find(self) -> None:
        box = self.query_one("#find", Input)
        box.display = True
        self.set_focus(box)  # at once: keys typed ahead belong into it

    def on_input_changed(self, message: Input.Changed) -> None:
        self.filter_text = message.value
        message.input.display = bool(message.value) or message.input.has_focus  # never unseen
        self.filter_rows()

    def on_input_submitted(self) -> None:
        """Keep the filter and go back to the rows; an empty one closes."""
        box = self.query_one("#find", Input)
        box.display = bool(box.value)
        self.set_focus(self.query_one(Table))  # at once, as above


class LogPage(FilterScreen, Page):
    """Element 13: the newest two thousand records; the journal keeps all."""

    title_text = marked("Event log")
    fixed = (*Page.fixed, CHOOSE)
    footer = ("stop", "find", "pause", "quit")

    def __init__(self) -> None:
        super().__init__()
        self._rows: list[RecordRow] = []
        self._seq = 0

    def body(self) -> ComposeResult:
        rows = Table(
            log_columns(BEGIN), attrgetter("seq"), empty=tr("no records"), tone=attrgetter("tone")
        )
        rows.follow = True
        yield rows
        yield self.filter_box(tr("filter: text of a record"))

    def begin(self) -> None:
        super().begin()
        self.query_one(Table).action_to(-1)

    def show(self, view: RunView | None) -> None:
        super().show(view)
        if view is None:
            return
        fresh = [record for record in view.records if record.seq > self._seq]
        if fresh:
            self._seq = fresh[-1].seq
            self._rows += [RecordRow.of(record) for record in fresh]
            self.filter_rows()

    def filter_rows(self) -> None:
        words = self.filter_text.lower().split()
        matching = [row for row in self._rows if all(w in row.searched for w in words)]
        view = self.application.view
        begun = view.records[0].t if view is not None and view.records else BEGIN
        self.query_one(Table).show_rows(matching, log_columns(begun))


class ReportPage(TextPage):
    """Element 17. Both are recomputed from the journal, by the commands of the same names."""

    title_text = marked("Report")
    footer = ("stop", "history", "quit")

    def __init__(self) -> None:
        super().__init__()
        self._where = tr("writing the report ...")
        self._state = tr("computing the figures from the journal ...")
        self._figures: Json | None = None

    def begin(self) -> None:
        super().begin()
        folder = self.application.shown_session.folder
        self.application.start_task(self._show_figures(folder))
        self.application.start_task(self._write(folder))

    def text(self, view: RunView | None) -> Lines:
        where = self._where, "bold"
        if self._figures is None:
            return Stack(where, BLANK, self._state)
        log = view.log if view is not None else None
        return Stack(where, BLANK, report_lines(self._figures, log))

    async def _show_figures(self, folder: Path) -> None:
        runs = str(folder.parent)
        try:
            text = await process.run_command("show", folder.name, "--json", "--runs", runs)
            self._figures = decoded(text.partition("\n")[0], Json)  # remarks follow
        except (HilcellError, msgspec.DecodeError) as error:
            self._state = tr("the figures could not be computed")
            if isinstance(error, HilcellError):
                raise
            raise HilcellError(f"hilcell show: no figures in its output: {error}") from error
        finally:
            self.show_again()

    async def _write(self, folder: Path) -> None:
        path, runs = (folder / "report.html").resolve(), str(folder.parent)
        try:
            await process.run_command("report", folder.name, "--runs", runs, "-o", str(path))
        except Exception:
            self._where = tr("the report was not written")
            self.show_again()
            raise
        self._where = tr("report written: {path}", path=path)
        if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
            webbrowser.open(path.as_uri())
        self.show_again()


def plot_style(screen: BaseScreen) -> PlotStyle:
    """Return what the terminal shows of a plot: letters where colours tell nothing."""
    plain = screen.application.glyphs.plain
    few = screen.app.theme == SIXTEEN or bool(screen.app.no_color)
    return PlotStyle(letters=plain or few, plain=plain)


class Pace:
    """Draws something twice a second at most."""

    REDRAW_S = 0.5

    def __init__(self) -> None:
        self._drawn_s = -math.inf

    def is_due(self) -> bool:
        """Whether it was not drawn just now; then it is drawn now."""
        now_s = time.monotonic()
        due = now_s - self._drawn_s >= self.REDRAW_S
        self._drawn_s = now_s if due else self._drawn_s
        return due


class PlotPage(Page):
    """Draws twice a second at most, and only what is new."""

    TALL = 28  # rows, from which tabs and title stand apart

    footer = ("stop", "pause", "alarms", "quit")
    fixed: ClassVar[tuple[tuple[str, str], ...]] = (
        ("◄ ►", marked("other plot")),
        (f"1-{MOST_TABS}", marked("choose")),
        ("S", marked("station")),
        ("g", marked("log/linear scale")),
        ("v", marked("series on or off")),
        *Page.fixed,
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "turn(-1)", show=False),
        Binding("right", "turn(1)", show=False),
        *[Binding(str(n + 1), f"choose({n})", show=False) for n in range(MOST_TABS)],
        Binding("S,s", "change('pick')", show=False),
        Binding("g", "change('scale')", show=False),
        Binding("v", "change('series')", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._choice = Choice()
        self._pace = Pace()
        self._seen: tuple[object, ...] = ()

    def fixed_keys(self) -> Sequence[tuple[str, str]]:
        first, _, *others = self.fixed
        numbers = [(f"1-{self._count}", tr("choose"))] if self._count > 1 else []
        return (first, *numbers, *others)

    def body(self) -> ComposeResult:
        yield TextPanel("plot")

    def show(self, view: RunView | None) -> None:
        """Draw the chosen plot, if there is anything new to draw and room for it."""
        super().show(view)
        self.panel("title").display = False
        if view is None or view.log.plan is None:
            return
        size = self.panel("plot").size
        state = (size, self.app.theme, len(view.log.points), len(view.log.curves))
        if state == self._seen or not size.height:
            return
        if self._seen[:2] == state[:2] and not self._pace.is_due():
            return
        self._seen = state
        self.panel("plot").show(self._lines(Measured(view.log), size.width, size.height))

    def _lines(self, of: Measured, width: int, height: int) -> Content:
        style, gap = plot_style(self), [Content("")] if height >= self.TALL else []
        tabs = [*gap, tab_line(of, self._choice, width, style), *gap]
        lines = plot_lines(of, self._choice, width, height - len(tabs) - len(gap), style)
        return Content("\n").join([*tabs, *lines])

    def action_turn(self, step: int) -> None:
        if count := self._count:
            self.action_choose((self._choice.tab + step) % count)

    def action_choose(self, index: int) -> None:
        if index < self._count:
            self._choice.tab, self._choice.series = index, 0
            self._draw_again()

    def action_change(self, part: str) -> None:
        view = self.application.view
        if view is None or view.log.plan is None:
            return
        tab = tabs_for(view.log)[self._choice.tab]
        if part == "pick":
            self._choice.picks[self._choice.tab] += 1
        elif part == "series":
            self._choice.turn_series(len(tab.make(Measured(view.log), "").series))
        elif tab.is_log is not None:
            self._choice.turned[self._choice.tab] += 1
        else:
            why = tr("its values are not all above zero")
            self.show_notice(tr("this plot has a linear scale only: {why}", why=why))
        self._draw_again()

    def _draw_again(self) -> None:
        self._seen = ()
        self.show_again()

    @property
    def _count(self) -> int:
        view = self.application.view
        return len(tabs_for(view.log)) if view is not None and view.log.plan is not None else 0


def _outcome(run: RunRow) -> str:
    if run.live:
        return tr("LIVE ") + tr(run.state)
    return tr(run.verdict.partition(";")[0] or ("engine gone" if run.gone else run.condition))


def _kind(run: RunRow) -> str:
    if not run.readable:
        return ""
    return tr("SIM") if run.simulated else tr("real")


def _local(run: RunRow) -> str:
    with suppress(ValueError):  # "", or untrusted text in its place
        return f"{in_zone(run.begun):%H:%M %Z}"
    return ""


def _figure(name: str, form: str) -> Callable[[RunRow], str]:
    value = attrgetter(name)
    return lambda run: "" if value(run) is None else format(value(run), form)


RUN_COLUMNS: tuple[Column[RunRow], ...] = (  # after the mark; |e| before and after in mm
    Column("begun UTC", 16, lambda run: run.begun.replace("T", " ")[:16], least=63),
    Column("begun", 10, lambda run: run.begun[:10], below=63),
    Column("procedure", 13, lambda run: run.procedure or run.name[-13:]),
    Column("verdict or state", 16, _outcome),
    Column("operator", 10, attrgetter("operator")),
    Column("kind", 4, _kind, least=68),
    Column("cell", 10, attrgetter("cell"), least=79),
    Column("points", 6, lambda run: str(run.points or ""), right=True, least=111),
    Column("before", 6, _figure("before_mean_mm", ".3f"), right=True, least=93),
    Column("after", 6, _figure("chosen_mean_mm", ".3f"), right=True, least=86),
    Column("max mm", 6, _figure("chosen_max_mm", ".3f"), right=True, least=131),
    Column("local time", 10, _local, least=104),
    Column("job", 12, attrgetter("job"), least=124),
    Column("run", 36, attrgetter("name"), least=168),
)  # fmt: skip


def run_tone(run: RunRow) -> str:
    tones = {"finished": "", "aborted": "label", "faulted": "fault"}
    return "live" if run.live else "fault" if run.exit in (1, 3) else tones.get(run.state, "ask")


class RecordRow(NamedTuple):
    """One line of the event log."""

    seq: str
    time: str
    kind: str
    what: str
    tone: str

    @classmethod
    def of(cls, record: Record) -> Self:
        tones = {"faulted": "fault", "suspended": "ask", "aborted": "ask"}
        fact, moment = record.fact, in_zone(record.t)
        tone = tones.get(fact.to, "") if isinstance(fact, StateChanged) else ""
        utc = record.t[11:23]
        time = f"{moment:%H:%M:%S} ({utc[:8]})" if moment.utcoffset() else utc
        what = record_text(record.key, fact).replace("\n", " ")
        return cls(str(record.seq), time, record.kind, what, tone)

    @property
    def searched(self) -> str:
        return " ".join(self[:4]).lower()


def log_columns(t: str) -> tuple[Column[RecordRow], ...]:
    """Return the columns of the event log; ``t``, a time in it, says whether local time is UTC."""
    moment = in_zone(t)
    title, width = (f"{moment:%Z} (UTC)", 19) if moment.utcoffset() else ("UTC", 12)
    return (
        Column("record", 6, attrgetter("seq"), right=True),
        Column(title, width, attrgetter("time")),
        Column("kind", 8, attrgetter("kind")),
        Column("what", 20, attrgetter("what"), grows=True),
    )


def record_text(key: str, fact: Fact) -> str:
    match fact:
        case PlanRecord(seed=seed, machine_seed=machine):
            own = tr(", machine {machine}", machine=machine) if machine not in (None, seed) else ""
            return tr(
                "{procedure}, {points} points, seed {seed}{own}",
                procedure=fact.procedure,
                points=fact.points,
                seed=seed,
                own=own,
            )
        case StateChanged():
            return tr(
                "{machine} is {to}{after}",
                machine=fact.machine,
                to=fact.to,
                after=after(fact.reason),
            )
        case Point():
            station = tr(" at {station}", station=fact.station) if fact.station else ""
            again = tr(", re-measured") if fact.retaken else ""
            return f"{key}{station}{again}"
        case Intended(position_mm=position_mm):
            place = (
                ""
                if position_mm is None
                else tr("to {position_mm:.3f} mm", position_mm=position_mm)
            )
            axis = tr("axis {axis}", axis=fact.axis) if fact.axis else ""
            return " ".join(filter(None, (fact.action, key, fact.station, axis, place)))
        case Frame():
            by = tr("by {n} points", n=len(fact.points)) if fact.points else ""
            taken_over = (
                tr("of calibration {calibration}", calibration=fact.calibration)
                if fact.calibration
                else ""
            )
            return " ".join(filter(None, (key, by, taken_over)))
        case Verdict():
            return f"{key} {tr(fact.outcome.text)}{after(fact.text)}"
        case Ended():
            return tr("{state}, exit {exit}", state=fact.state, exit=fact.exit)
        case _:
            return _event_text(fact)


def _event_text(event: Event | OtherEvent) -> str:
    """Return an event's own words, and such facts of it as they leave out."""
    match event:
        case Connected(devices=devices):
            return event.text + after("; ".join(each.text for each in devices))
        case Closing(problems=problems):
            return event.text + after("; ".join(problems.values()))
        case LinkCounted():
            return tr("rail's wire: {counts}", counts=event.counts)
        case OtherEvent():
            facts = ", ".join(f"{name} {value}" for name, value in event.fields.items())
            return f"{event.what} {facts}".strip()
    return event.text or event.what


class HistoryPage(FilterScreen, Page):
    """Element 12. The rows come from the index; a run is read only when it is opened."""

    TO_COMPARE = 2
    AGAIN_S = 3.0

    title_text = marked("History")
    footer = ("mark", "compare", "find", "stop", "quit")
    fixed: ClassVar[tuple[tuple[str, str], ...]] = (*Page.fixed, ("Enter", marked("open")), CHOOSE)

    def __init__(self) -> None:
        super().__init__()
        self._runs: list[RunRow] = []
        self._marked: list[str] = []
        self._reading = False

    def body(self) -> ComposeResult:
        mark = Column[RunRow]("", 1, lambda run: "*" * (run.name in self._marked))
        columns = (mark, *RUN_COLUMNS)
        yield Table(columns, attrgetter("name"), empty=tr("reading the index ..."), tone=run_tone)
        yield self.filter_box(tr("filter: words, state:faulted, operator:ann, -word"))

    def begin(self) -> None:
        """Read the index off the thread that takes keys."""
        super().begin()
        self._read_index()
        self.set_interval(self.AGAIN_S, self._read_index)  # runs begin and end

    def _read_index(self) -> None:
        """Read, once at a time: the first index of many runs takes a while."""
        if not self._reading:
            self._reading = True
            self.application.start_task(self._read())

    async def _read(self) -> None:
        from hilcell.journal.index import read_index

        try:
            self._runs = await run_in_thread(read_index, self.application.options.runs)
        finally:
            self._reading = False
        if self.is_shown:
            self.query_one(Table).empty = tr("no such run")
            self.filter_rows()

    def filter_rows(self) -> None:
        from hilcell.journal.index import matches

        runs = [run for run in self._runs if matches(run, self.filter_text)]
        self.query_one(Table).show_rows(runs)
        title = tr("History: {n} of {all} runs; errors in mm", n=len(runs), all=len(self._runs))
        self.panel("title").show(Content.styled(title, "bold"))

    def on_table_row_selected(self, message: Table.RowSelected) -> None:
        if message.key:
            self.application.open_run(self.application.options.runs / message.key)

    def do_mark(self) -> None:
        """Mark a run, or take its mark away; of more than two the oldest mark goes."""
        key = self.query_one(Table).key
        if key in self._marked:
            self._marked.remove(key)
        elif key:
            self._marked = [*self._marked, key][-self.TO_COMPARE :]
        self.filter_rows()

    def do_compare(self) -> None:
        if len(self._marked) != self.TO_COMPARE:
            self.show_notice(
                tr(
                    "mark two runs with {key} first",
                    key=shown(self.application.keymap["mark"][0]),
                )
            )
            return
        first, second = sorted(self._marked)
        self.app.push_screen(ComparePage(first, second))


def _change(n: int) -> Callable[[Change], str]:
    return lambda change: CHANGES[n].text(CHANGES[n].of(change), minus="-")


CHANGE_COLUMNS: tuple[Column[Change], ...] = (
    Column("where", 16, _change(0)),
    Column("what", 20, lambda change: f"{_change(1)(change)}, {change.unit}"),
    Column("first", 7, _change(2), right=True),
    Column("second", 7, _change(3), right=True),
    Column("change", 8, _change(4), right=True),
    Column("limit", 7, _change(5), right=True),
    Column("verdict", 7, _change(7)),
)


class ComparePage(Page):
    """Shows the output of `hilcell compare` for two runs."""

    title_text = marked("Comparison")
    footer = ("stop", "quit")

    def __init__(self, first: str, second: str) -> None:
        super().__init__()
        self._first, self._second = first, second

    def body(self) -> ComposeResult:
        yield TextPanel("comparison_text")
        yield Table(
            CHANGE_COLUMNS,
            lambda change: f"{change.place}/{change.what}",
            empty=tr("reading both journals ..."),
            tone=lambda change: "fault" if change.verdict == "beyond" else "",
        )

    def begin(self) -> None:
        super().begin()
        self.application.start_task(self._compare())

    async def _compare(self) -> None:
        runs = str(self.application.options.runs)
        command = ("compare", self._first, self._second, "--runs", runs, "--json")
        try:
            comparison = decoded(await process.run_command(*command), Compared)
        except HilcellError:
            if self.is_shown:
                self.query_one(Table).empty = tr("nothing to compare")
                self.query_one(Table).refresh()
            raise
        if self.is_shown:
            self.panel("comparison_text").show(comparison.words)
            self.query_one(Table).show_rows(comparison.changes)


class Compared(msgspec.Struct, frozen=True, kw_only=True):
    """Two runs as `hilcell compare --json` prints them, by their names."""

    first: str
    second: str
    verdict: str
    settings: list[Setting]
    changes: list[Change]

    @property
    def words(self) -> Content:
        lines = [f"{self.first}  ->  {self.second}"]
        lines += [
            f"{each.key}: {each.first or '-'} -> {each.second or '-'}" for each in self.settings[:4]
        ]
        return Content.assemble("\n".join(lines), "\n", (self.verdict, "bold"))
