"""The base classes of screens, pages and dialogs, and what they use of the application."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar, cast

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
from hilcell.tui.text.refusals import pause_command
from hilcell.tui.widgets import TextPanel

if TYPE_CHECKING:
    from hilcell.tui.app import HilcellApp
    from hilcell.tui.engine.run_view import RunView
    from hilcell.tui.text.alarms import AlarmContext


BACK, ALWAYS = "back", ("stop", "alarms")  # in the line of keys of every width
PAUSE_WORDS = {"proceed": "go on", "resume": "resume"}  # by what the key does


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
        """Return the application."""
        return cast("HilcellApp", self.app)

    @property
    def line_width(self) -> int:
        """Return how many columns a line may take, beside the edge of a simulated run."""
        return max(self.app.size.width, 20) - 1

    def panel(self, name: str) -> TextPanel:
        """Return a panel by its name."""
        return self.query_one(f"#{name}", TextPanel)

    def on_mount(self) -> None:
        """Show what is known already."""
        self.built.set()
        self.show(self.application.view)

    def on_resize(self) -> None:
        """Lay the lines out again."""
        self.call_after_refresh(self.show_again)

    def on_screen_resume(self) -> None:
        """Show the changes since another screen was on top."""
        self.show_again()

    def on_descendant_focus(self) -> None:
        """Show the keys that do something there."""
        if self.is_shown:
            self.panel("keys").show(self.key_line())

    def show_again(self) -> None:
        """Show the current view, while this screen is open."""
        if self.is_shown:
            self.show(self.application.view)

    def show(self, view: RunView | None) -> None:
        """Show the view."""
        self.panel("keys").show(self.key_line())
        if self._notice_state is not None and self._notice_state != _notice_state(view):
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
        self._notice_state = _notice_state(self.application.view) if for_now else None
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
        parts = [(_key(key, label), label == BACK) for key, label in fixed]
        parts += [
            (_key(shown(self.application.keymap[name][0]), self.label(name)), name in ALWAYS)
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
        """Return the current label of an action."""
        view = self.application.view
        if name == "pause" and view is not None:
            if view.prompt is not None:
                return "answer"
            return PAUSE_WORDS.get(pause_command(view), "pause")
        return BY_NAME[name].label


def _key(key: str, label: str) -> Content:
    return Content.assemble((key, "bold $on-label on $label-fill"), f" {label}  ")


def _notice_state(view: RunView | None) -> tuple[str, bool]:
    """Return the state that a notice is about, and whether a prompt can be answered."""
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
        """Build banner, title, body and key line."""
        yield TextPanel("banner")
        yield TextPanel("title")
        yield from self.body()
        yield TextPanel("notice")
        yield TextPanel("keys")

    def body(self) -> ComposeResult:
        """Build the parts between title and keys."""
        return iter(())

    def on_mount(self) -> None:
        """Show title and view."""
        self.panel("notice").display = False
        self.panel("title").show(Content.styled(self.title_text, "bold"))
        super().on_mount()
        first = next(iter(self.query("Table, Input, #body").results(Widget)), None)
        if first is not None and first.focusable:
            first.focus()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave letters to a text box."""
        return action != "back" or not isinstance(self.focused, Input)

    def action_back(self) -> None:
        """Go back to the screen below."""
        self.app.pop_screen()


T = TypeVar("T")
FRAME = 2  # rows of a dialog's border


class Dialog(ModalScreen[T]):
    """A question and, under it, the answers, which stay in sight where room is short."""

    def compose(self) -> ComposeResult:
        """Build the box."""
        with Vertical(id="dialog"):
            yield TextPanel("question")
            yield TextPanel("answers")

    @property
    def deliberate(self) -> bool:
        """Whether the current key is an answer: Enter from a scanner, or a held one, is not."""
        return cast("HilcellApp", self.app).key_is_deliberate

    def show_texts(self, question: Content, answers: Content) -> None:
        """Show both."""
        self.query_one("#question", TextPanel).show(question)
        self.query_one("#answers", TextPanel).show(answers)

    def on_resize(self) -> None:
        """Shorten the question where both do not fit."""
        question, answers = self.query_one("#question"), self.query_one("#answers")
        room = self.app.size.height - FRAME - answers.size.height
        question.styles.max_height = max(room, 1)


def answer_keys(yes: str, no: str) -> Content:
    """Return the two keys of a dialog and their meaning."""
    return Content.assemble(
        (" Enter ", "bold $on-label on $label-fill"),
        f" {yes}   ",
        (" q ", "bold $on-label on $label-fill"),
        f" {no}",
    )


class Confirm(Dialog[str]):
    """Returns the key that was pressed: ``yes``, ``no``, or one of the others offered."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y,enter", "reply('yes')", show=False, priority=True),
        Binding("n,q,backspace", "reply('no')", show=False, priority=True),
    ]

    def __init__(self, title: str, text: str, yes: str) -> None:
        super().__init__()
        self._title, self._text, self._yes = title, text, yes

    def on_mount(self) -> None:
        """Show the question."""
        question = Content.assemble((self._title, "bold $ask"), "\n", self._text, "\n")
        self.show_texts(question, answer_keys(self._yes, "no"))

    def action_reply(self, answer: str) -> None:
        """Close with the answer."""
        if answer != "yes" or self.deliberate:
            self.dismiss(answer)
