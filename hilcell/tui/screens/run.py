"""The run: state, step, lamps, deviation, alarms, prompt and points on one screen of 80x24."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Input

from hilcell.tui.engine.scene import Scene
from hilcell.tui.keys import shown
from hilcell.tui.screens.pages import Finding
from hilcell.tui.text import run as words
from hilcell.tui.text.alarms import alarm_lines
from hilcell.tui.text.deviation import deviation_lines, deviation_of
from hilcell.tui.text.plots import side_lines
from hilcell.tui.text.points import PointTable, columns_for, filtered
from hilcell.tui.text.prompt import prompt_lines
from hilcell.tui.widgets import Panel, Rows

WIDE = 120  # columns, as in the style sheet
LINES = ("banner", "identity", "step", "progress", "lamps", "interlock")


@dataclass(frozen=True, slots=True)
class View:
    """How the points were looked at: kept when a run is opened again."""

    bad_only: bool = False
    worst_first: bool = False
    key: str = ""


class RunScreen(Finding):
    """One run, live or past."""

    footer = (
        "stop", "pause", "help", "acknowledge", "retake", "abort", "report", "sort", "plots",
        "history", "detach", "new", "bad", "find", "log", "interlocks", "alarms", "quit",
    )  # fmt: skip
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "enter", "answer", show=False),
        Binding("q,backspace", "go_back", show=False, priority=True),
    ]

    def __init__(self, view: View | None = None) -> None:
        super().__init__()
        start = view or View()
        self.bad_only, self.worst_first, self._chosen = start.bad_only, start.worst_first, start.key
        self._table = PointTable()
        self._points_seen: tuple[object, ...] = ()
        self._side_seen: tuple[object, ...] = ()

    def compose(self) -> ComposeResult:
        """Build the lines, the box of points and the panel beside it."""
        for name in LINES:
            yield Panel(name)
        yield Panel("deviation")
        yield Panel("alarm")
        yield Panel("prompt")
        with Horizontal(id="middle"):
            with Vertical():
                yield Rows(
                    columns_for(80),
                    empty="no points yet",
                    id="points",
                    plain=self.cell.glyphs.plain,
                )
                yield self.find_box("filter: words of name, station or state")
            yield Panel("side")
        yield Panel("notice")
        yield Panel("keys")

    def on_mount(self) -> None:
        """Hide what has nothing to say yet."""
        for name in ("alarm", "prompt", "notice"):
            self.panel(name).display = False
        rows = self.query_one(Rows)
        rows.follow = True
        rows.focus()
        super().on_mount()

    def show(self, scene: Scene | None) -> None:
        """Show every line of the scene."""
        super().show(scene)
        if scene is None:
            return
        glyphs, width = self.cell.glyphs, self.wide
        self.panel("identity").show(words.identity(scene, width))
        self.panel("step").show(words.step(scene, width))
        self.panel("progress").show(words.progress(scene, glyphs, width))
        self.panel("lamps").show(words.lamps(scene, glyphs, width))
        self.panel("interlock").show(words.interlocks(scene, width))
        self._show_boxes(scene)
        self._show_points(scene)
        self._show_side(scene)
        self._show_deviation(scene)

    def _show_deviation(self, scene: Scene) -> None:
        """Show the newest point of a live run, the chosen one of a past run."""
        key = self.query_one(Rows).key
        point = scene.newest_target if scene.live or not key else scene.log.points.get(key)
        found = None if point is None else deviation_of(scene.log, point)
        none = f"{key}: no nominal place, so no deviation" if key else "no point measured yet"
        lines = deviation_lines(found, self.cell.glyphs, self.wide, none)
        self.panel("deviation").show(lines)

    def on_rows_moved(self) -> None:
        """Show the point that is chosen now."""
        scene = self.cell.scene
        if scene is not None:
            self._show_deviation(scene)

    def _show_boxes(self, scene: Scene) -> None:
        alarm, prompt = self.panel("alarm"), self.panel("prompt")
        asked = scene.prompt
        rows = 3 if asked is None else 1  # what is asked comes first
        lines = alarm_lines(
            self.cell.latch.standing(), self.cell.keymap, self.cell.glyphs, self.wide, rows
        )
        alarm.display = lines is not None
        if lines is not None:
            alarm.show(lines)
        prompt.display = asked is not None
        self.panel("deviation").display = asked is None
        if asked is not None:
            prompt.show(prompt_lines(asked, scene, self.cell.glyphs, self.wide - 4))

    @property
    def view(self) -> View:
        """Return how the points are looked at."""
        rows = self.query(Rows)
        return View(self.bad_only, self.worst_first, rows.first().key if rows else "")

    def _show_points(self, scene: Scene) -> None:
        rows = self.query_one(Rows)
        waiting = frozenset(scene.status.retakes) if scene.status is not None else frozenset()
        wide = rows.size.width or self.wide
        newest = scene.records[-1].seq if scene.records else 0
        state = (newest, self.wanted, self.bad_only, self.worst_first, waiting, wide)
        if state == self._points_seen:
            return
        self._points_seen = state
        points = self._table.rows(scene.log)
        found = filtered(points, self.wanted, bad_only=self.bad_only, worst=self.worst_first)
        rows.empty = "no such point" if self.wanted else "no points yet"
        if self.bad_only and scene.log.points:
            all_key = shown(self.cell.keymap["bad"][0])
            rows.empty = f"no such point is bad; {all_key} shows all"
        rows.follow = not self.worst_first
        rows.put(
            [self._table.drawn(each, waiting, wide) for each in found],
            columns_for(wide, bad_only=self.bad_only, worst=self.worst_first),
        )
        if self._chosen in scene.log.points:
            rows.choose(self._chosen)
            self._chosen = ""

    def _show_side(self, scene: Scene) -> None:
        """Draw the panel beside the points, where there is room and something new."""
        side = self.panel("side")
        state = (len(scene.log.points), side.size)
        if self.app.size.width < WIDE or not side.size.height or state == self._side_seen:
            return
        self._side_seen = state
        side.show(side_lines(scene, side.size.width, side.size.height))

    def label(self, name: str) -> str:
        """Return what a key does now."""
        if name == "sort":
            return "as measured" if self.worst_first else "worst first"
        if name == "bad":
            return "all" if self.bad_only else "bad only"
        return super().label(name)

    def action_enter(self) -> None:
        """Answer the prompt, or open the chosen point."""
        self._enter(self.query_one(Rows).key)

    def on_rows_chosen(self, message: Rows.Chosen) -> None:
        """Answer the prompt, or open the chosen point."""
        self._enter(message.key)

    def _enter(self, key: str) -> None:
        scene = self.cell.scene
        if scene is not None and scene.prompt is not None:
            self.cell.acts.answer()
        elif key:
            from hilcell.tui.screens.pages import DetailPage

            self.app.push_screen(DetailPage(key))

    # -- keys of this screen ------------------------------------------------------------------

    def do_bad(self) -> None:
        """Show bad points only, or all."""
        self.bad_only = not self.bad_only
        self.show(self.cell.scene)

    def do_sort(self) -> None:
        """Order by |e|, or as measured."""
        self.worst_first = not self.worst_first
        self.show(self.cell.scene)
        if self.worst_first:
            self.query_one(Rows).action_to(0)

    def filter_rows(self) -> None:
        """Show the points with all the words."""
        self.show(self.cell.scene)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave letters to the filter; go back only where there is something behind."""
        typing = isinstance(self.focused, Input)
        return action != "go_back" or (self.cell.attached.behind is not None and not typing)

    def action_go_back(self) -> None:
        """Show the live run again that was left to look at this one."""
        self.cell.go_back()

    def do_retake(self) -> None:
        """Re-measure the chosen point."""
        self.cell.acts.retake(self.query_one(Rows).key)
