"""The base classes of screens, pages and dialogs, and what they use of the application."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, cast

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.screen import ModalScreen, Screen
from textual.widget import Widget
from textual.widgets import Input

from hilcell.tui.keys import BY_NAME, Keymap, shown
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.terminal.themes import NAMES
from hilcell.tui.text.actions import pause_command
from hilcell.tui.widgets import TextPanel

if TYPE_CHECKING:
    from hilcell.tui.app import HilcellApp
    from hilcell.tui.engine.run_view import RunView
    from hilcell.tui.text.alarms import AlarmContext


BACK = "back"  # stays in the line of keys at every width


@dataclass(frozen=True, slots=True)
class Options:
    """The options of `hilcell tui`."""

    runs: Path
    keymap: Keymap
    glyphs: Glyphs
    run: str = ""
    cell: str = "paper"
    settings: tuple[str, ...] = ()
    theme: str = NAMES[0]
    slow: bool = False


class BaseScreen(Screen[None]):
    """A screen with a state line and a key line, which shows the run's view when it changes."""

    footer: ClassVar[tuple[str, ...]] = ()  # actions, in the order of their weight
    fixed: ClassVar[tuple[tuple[str, str], ...]] = ()  # keys that cannot be rebound
    in_box: ClassVar[tuple[tuple[str, str], ...]] = ()  # those of a text box

    def __init__(self) -> None:
        super().__init__()
        self.built = asyncio.Event()  # set once every part is built
        self._notice = ""
        self._notice_state: object = None  # the run's state that the notice is about

    @property
    def is_shown(self) -> bool:
        """Whether every part is built and the screen is open: messages come before and after."""
        keys = self.query_one_optional("#keys") if self.built.is_set() else None
        built = keys is not None  # parts are taken down first
        return built and self.app.is_running and self in self.app.screen_stack

    @property
    def application(self) -> HilcellApp:
        return cast("HilcellApp", self.app)

    @property
    def line_width(self) -> int:
        """Return how many columns a line may take, beside the edge of a simulated run."""
        return max(self.app.size.width, 20) - 1

    def panel(self, name: str) -> TextPanel:
        return self.query_one(f"#{name}", TextPanel)

    def on_mount(self) -> None:
        """Begin; subclasses have no ``on_mount``, for Textual calls that of each class."""
        self.begin()

    def begin(self) -> None:
        """Show what is known already."""
        self.built.set()
        self.show(self.application.view)

    def on_resize(self) -> None:
        self.call_after_refresh(self.show_again)

    def on_screen_resume(self) -> None:
        self.show_again()

    def on_descendant_focus(self) -> None:
        if self.is_shown:
            self.panel("keys").show(self.key_line())

    def show_again(self) -> None:
        """Show the current view, while this screen is open."""
        if self.is_shown:
            self.show(self.application.view)

    def show(self, view: RunView | None) -> None:
        self.panel("keys").show(self.key_line())
        if self._notice_state is not None and self._notice_state != self._state_of(view):
            self.show_notice("")
        if view is not None and self.query_one_optional("#banner") is not None:
            from hilcell.tui.text import run as run_text  # reads journals: not for the first screen

            self.mark_simulated(simulated=run_text.is_simulated(view))
            background = self.application.open_runs.background
            other = background.view if background is not None else None
            lines = run_text.banner(view, self.application.glyphs, other)
            self.panel("banner").show(lines)

    def mark_simulated(self, *, simulated: bool) -> None:
        """Mark the edge of the screen; its parts look the same with and without."""
        if self.has_class("simulated") != simulated:
            self.set_class(simulated, "simulated", update=False)
            self.app.stylesheet.update_nodes([self])

    def show_notice(self, text: str, *, for_now: bool = False, over: bool = True) -> None:
        """Show a notice on the line above the keys, until the next key.

        ``for_now``: only while the run's state and its prompt stay as they are. ``over``: also
        over another notice.
        """
        if not self.is_shown or (self._notice and not over):
            return
        self._notice = text
        self._notice_state = self._state_of(self.application.view) if for_now else None
        panel = self.panel("notice")
        panel.display = bool(text)
        panel.show(Content.styled(text, "$ask"))

    def clear_notice(self, text: str) -> None:
        """Remove a notice that is no longer true."""
        if self._notice == text:
            self.show_notice("")

    def key_line(self) -> Content:
        """Return element 10: the keys that do something now."""
        typing = isinstance(self.focused, Input)
        fixed = self.in_box if typing else self.fixed_keys()
        parts = [(self._key_words(key, label), label == BACK) for key, label in fixed]
        parts += [
            (
                self._key_words(shown(self.application.keymap[name][0]), self.label(name)),
                name in ("stop", "alarms"),
            )
            for name in self.footer
            if self.application.allowed(name) and (BY_NAME[name].everywhere or not typing)
        ]
        room = self.line_width + 2 - sum(each.cell_length for each, always in parts if always)
        line = Content("")
        for each, always in parts:
            if always or each.cell_length <= room:
                line = line.append(each)
                room -= 0 if always else each.cell_length
        return line

    def fixed_keys(self) -> Sequence[tuple[str, str]]:
        """Return the screen's own keys and what they do now."""
        return self.fixed

    def alarm_context(self) -> AlarmContext:
        """Return what alarms are shown with now."""
        from hilcell.tui.text.alarms import AlarmContext  # not for the first screen

        app = self.application
        if app.view is None:
            return AlarmContext(None, app.keymap, app.glyphs, app.refusal("pause"))
        now, log = app.view.now, app.view.log
        return AlarmContext(now, app.keymap, app.glyphs, app.refusal("pause"), log)

    def label(self, name: str) -> str:
        view = self.application.view
        if name == "pause" and view is not None:
            if view.prompt is not None:
                return "answer"
            words = {"proceed": "go on", "resume": "resume"}
            return words.get(pause_command(view), "pause")
        return BY_NAME[name].label

    @staticmethod
    def _key_words(key: str, label: str) -> Content:
        return Content.assemble((key, "bold $on-label on $label-fill"), f" {label}  ")

    @staticmethod
    def _state_of(view: RunView | None) -> tuple[str, bool]:
        if view is None:
            return "", False
        return view.state, view.prompt is not None and view.prompt.ready


class Page(BaseScreen):
    """A whole-screen page over the run: the state stays in sight, q goes back."""

    title_text: ClassVar[str] = ""
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q,backspace", "back", "back", show=False, priority=True),  # in the order typed
    ]
    fixed: ClassVar[tuple[tuple[str, str], ...]] = (("q", BACK),)

    def compose(self) -> ComposeResult:
        yield TextPanel("banner")
        yield TextPanel("title")
        yield from self.body()
        yield TextPanel("notice")
        yield TextPanel("keys")

    def body(self) -> ComposeResult:
        """Build the parts between title and keys."""
        return iter(())

    def begin(self) -> None:
        self.panel("notice").display = False
        self.panel("title").show(Content.styled(self.title_text, "bold"))
        super().begin()
        first = next(iter(self.query("Table, Input, #body").results(Widget)), None)
        if first is not None and first.focusable:
            first.focus()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave letters to a text box."""
        return action != "back" or not isinstance(self.focused, Input)

    def action_back(self) -> None:
        self.app.pop_screen()


class Confirm(ModalScreen[bool]):
    """A question and, under it, its two answers, which stay in sight where room is short.

    Returns whether it is a yes. Enter from a scanner, or a held one, is no answer.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y,enter", "reply(True)", show=False, priority=True),
        Binding("n,q,backspace", "reply(False)", show=False, priority=True),
    ]
    FRAME = 2  # rows of the border

    def __init__(
        self, question: Content, yes: str, no: str = "no", remark: Content | None = None
    ) -> None:
        super().__init__()
        self._question, style = question, "bold $on-label on $label-fill"
        answers = (" Enter ", style), f" {yes}   ", (" q ", style), f" {no}"
        self._answers = Content.assemble(*answers, *([remark] if remark is not None else []))

    def compose(self) -> ComposeResult:
        with Vertical(id="dialog"):
            yield TextPanel("question")
            yield TextPanel("answers")

    def on_mount(self) -> None:
        self.query_one("#question", TextPanel).show(self._question)
        self.query_one("#answers", TextPanel).show(self._answers)

    def on_resize(self) -> None:
        """Shorten the question where both do not fit."""
        question, answers = self.query_one("#question"), self.query_one("#answers")
        room = self.app.size.height - self.FRAME - answers.size.height
        question.styles.max_height = max(room, 1)

    def action_reply(self, yes: bool) -> None:
        if not yes or cast("HilcellApp", self.app).key_is_deliberate:
            self.dismiss(yes)
