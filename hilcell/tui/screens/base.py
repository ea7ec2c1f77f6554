"""The base classes of screens, pages and dialogs, and what they use of the application."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Unpack, cast

from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.screen import ModalScreen, Screen
from textual.widget import Widget
from textual.widgets import Input

from hilcell.errors import HilcellError
from hilcell.language import marked, tr
from hilcell.run.control import RELEASE, Subject
from hilcell.tui import process
from hilcell.tui.keys import BY_NAME, Keymap, shown
from hilcell.tui.process import run_in_thread
from hilcell.tui.terminal import Glyphs
from hilcell.tui.text.actions import ELSEWHERE, no_answer_reason, pause_command, refusal
from hilcell.tui.themes import NAMES
from hilcell.tui.widgets import TextPanel

if TYPE_CHECKING:
    from subprocess import Popen

    from hilcell.run.control import Command
    from hilcell.tui.commissioning import Work
    from hilcell.tui.run_view import RunView
    from hilcell.tui.session import Session
    from hilcell.tui.text.alarms import AlarmContext


BACK = marked("back")  # stays in the line of keys at every width


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


class OpenRuns:
    """Holds the sessions; each is closed once it is neither shown nor in the background."""

    def __init__(self) -> None:
        self.shown: Session | None = None
        self.background: Session | None = None

    @property
    def all(self) -> list[Session]:
        """Return both; the live one first, for a past run may lie on a disk that answers late."""
        return [each for each in (self.background, self.shown) if each is not None]

    @property
    def live(self) -> list[Session]:
        return [each for each in self.all if each.view.live]

    def show(self, session: Session | None) -> None:
        """Show a run, or none; a live one goes on in the background."""
        left, visiting = self.shown, self.background is not None
        self.shown = session
        if session is self.background:
            self.background = None
        if left is None:
            return
        again = session is not None and session.folder == left.folder
        if left.view.live and not visiting and not again:
            self.background = left
        else:
            left.close(leave=True)

    def close_ended(self) -> Session | None:
        """Close the background run if it has ended; return it then."""
        ended = self.background
        if ended is None or ended.view.live:
            return None
        self.background = None
        ended.close(leave=True)
        return ended

    def stop(self) -> bool:
        """Stop everything, from any thread; return whether an engine received it."""
        sent = [each.stop() for each in self.all]  # each of them, not the first alone
        return any(sent)

    @property
    def stop_received(self) -> bool:
        """Whether the engine of each live run received a stop, which may have ended it since."""
        return bool(self.live) and all(each.stop_received for each in self.live)

    def leave(self) -> None:
        for each in self.all:
            each.close(leave=True)
        self.shown = self.background = None


class Application(App[int]):
    """The application as its screens see it: the run that is shown, its actions, and notices."""

    def __init__(self, options: Options) -> None:
        self.open_runs = OpenRuns()  # first: the terminal's driver wants its stop
        super().__init__()
        self.options, self.glyphs, self.keymap = options, options.glyphs, options.keymap
        self.key_is_deliberate = True  # whether the current key came by itself, not in a burst
        self.commissioning: Work | None = None  # in work, or the last that was

    @property
    def session(self) -> Session | None:
        return self.open_runs.shown

    @property
    def view(self) -> RunView | None:
        return self.session.view if self.session is not None else None

    @property
    def page(self) -> BaseScreen | Screen[object]:
        pages = (each for each in reversed(self.screen_stack) if isinstance(each, BaseScreen))
        return next(pages, self.screen)

    @property
    def live(self) -> bool:
        return self.view is not None and self.view.live

    @property
    def commissions(self) -> bool:
        """Whether steps of a commissioning are in work."""
        return self.commissioning is not None and self.commissioning.at_work

    @property
    def shown_session(self) -> Session:
        """Return the session of the run that is shown; raises `HilcellError` where none is."""
        if self.session is None:
            raise HilcellError(tr("no run is shown"))
        return self.session

    def attach(self, folder: Path, process: Popen[bytes] | None = None) -> None:
        """Show a run in place of the one shown; a live one goes on in background."""
        raise NotImplementedError

    def open_run(self, folder: Path) -> None:
        if self.session is not None and self.session.folder == folder:
            self.screen.dismiss()
        elif self.live and self.open_runs.background is None:
            self.ask(
                tr("A run is live."),
                tr("It goes on in the background; Esc still stops it, q shows it again."),
                tr("show the other run"),
                lambda: self.attach(folder),
            )
        else:
            self.attach(folder)

    def show_background_run(self) -> None:
        if self.open_runs.background is not None:
            self.attach(self.open_runs.background.folder)

    def show_notice(self, text: str, *, for_now: bool = False, over: bool = True) -> None:
        """Show a notice on the line above the keys, as `BaseScreen.show_notice` does."""
        if isinstance(self.page, BaseScreen):
            self.page.show_notice(text, for_now=for_now, over=over)

    def start_task(self, work: Awaitable[None]) -> None:
        """Start work that may take a while; show its error as a notice."""

        async def guarded() -> None:
            try:
                await work
            except HilcellError as error:
                self._show_error(error)

        self.run_worker(guarded(), exit_on_error=True)

    def _show_error(self, error: HilcellError) -> None:
        from hilcell.journal.labels import with_labels

        self.show_notice(
            str(error) if self.view is None else with_labels(str(error), self.view.log)
        )

    def allowed(self, name: str) -> bool:
        return not self.refusal(name)

    def refusal(self, name: str) -> str:
        if name in ELSEWHERE and not hasattr(self.page, f"do_{name}"):
            return ELSEWHERE[name]
        if self.commissions and name in ("again", "onward"):
            return tr("a step is in work")
        if self.commissions and name in ("stop", "commission"):
            return ""
        unacknowledged = self.session is not None and self.session.latch.waits()
        behind = self.open_runs.background is not None
        return refusal(name, self.view, background=behind, unacknowledged=unacknowledged)

    def label(self, name: str) -> str:
        return self.page.label(name) if isinstance(self.page, BaseScreen) else BY_NAME[name].label

    def ask(self, title: str, text: str, yes: str, act: Callable[[], object]) -> None:
        """Ask before an act; only a yes does it; show its error as a notice."""

        def replied(yes: bool | None) -> None:
            try:
                if yes:
                    act()
            except HilcellError as error:
                self._show_error(error)

        question = Content.assemble((title, "bold $ask"), f"\n{text}\n")
        self.push_screen(Confirm(question, yes), replied)

    # -- keys become commands to the engine, or start one ------------------------------------------

    def do_pause(self) -> None:
        """Pause, go on, answer the prompt, or resume, as the state allows."""
        view = self.shown_session.view
        command = pause_command(view)
        if view.prompt is not None:
            self.answer_prompt()
        elif command == "pause":
            self._command("pause")
        elif command == "resume":
            from hilcell.tui.text.run import resume_text

            self.ask(tr("Resume this run?"), resume_text(view), tr("resume"), self.resume_run)
        else:
            what = tr("The robot and the rail") if view.has_rail else tr("The robot")
            text = tr("{what} may move at once.", what=what)
            self.ask(tr("Go on?"), text, tr("go on"), self.proceed)

    def proceed(self, until: int = 0) -> None:
        """Let the run go on; ``until``: the last record that was known when it was agreed to."""
        subject: Subject = {"until": until} if until else {}
        self._command("proceed", **subject)

    def do_abort(self) -> None:
        self.ask(
            tr("Abort this run?"),
            tr("The point in flight is finished, then the run ends. It can be resumed later."),
            tr("abort"),
            lambda: self._command("abort"),
        )

    def answer_prompt(self, number: int = 0) -> None:
        """Answer the prompt, where the engine answers and the tracker sees the reflector.

        ``number`` is that of a choice, from 1; 0 is "done".
        """
        session = self.shown_session
        prompt = session.view.prompt
        if prompt is None or number > len(prompt.choices):
            return
        if refused := no_answer_reason(session.view):
            self.show_notice(refused)
        elif prompt.check and not prompt.ready and not number:
            from hilcell.tui.text.prompt import lost_devices

            lost = lost_devices(session.view)
            waits = tr("the tracker measures the reflector in its nest")
            if lost:
                waits = tr("no device is lost; now: {lost}", lost=lost)
            self.show_notice(tr("Enter works once {waits}", waits=waits), for_now=True)
        elif not self.key_is_deliberate:
            self.show_notice(tr("the key was ignored, as part of a burst of keys: press it alone"))
        else:
            choice = prompt.choices[number - 1].name if number else ""
            self.start_task(self._ask_once_more(session, choice))

    def retake(self, key: str) -> None:
        """Re-measure a point: in the live run, or by opening a finished one again."""
        from hilcell.journal.labels import point_label, with_labels
        from hilcell.run.states import retake_refusal

        view = self.shown_session.view
        refused = retake_refusal(view.log, key) if key else tr("no point is chosen")
        point = point_label(key, view.log) if key in view.log.points else key
        if refused:
            self.show_notice(with_labels(refused, view.log))
        elif view.live:
            self.ask(
                tr("Re-measure this point?"),
                tr("{point}: before the robot's next point; it moves there.", point=point),
                tr("re-measure"),
                lambda: self._command("retake", key=key),
            )
        else:
            self.ask(
                tr("Open this run again and re-measure the point?"),
                tr(
                    "{point}: devices are connected, control points verified; the robot moves.",
                    point=point,
                ),
                tr("re-measure"),
                lambda: self.resume_run("--retake", key),
            )

    def resume_run(self, *options: str) -> None:
        session = self.shown_session
        folder = session.folder
        attended = [] if not session.view.log.inputs.unattended else ["--unattended"]
        command = ["resume", folder.name, "--runs", str(folder.parent), *attended, *options]
        self.start_engine(folder, command)

    def start_engine(self, folder: Path, arguments: list[str]) -> None:
        started = process.start_engine(folder.parent, folder.name, arguments)
        self.attach(folder, started.process)

        async def watch() -> None:
            if reason := await run_in_thread(started.wait_for_end):
                raise HilcellError(reason)

        self.start_task(watch())

    def begin_commissioning(self, path: Path, operator: str, first: str, only: str) -> None:
        """Perform a cell's steps; each run is an engine that this screen starts and shows."""
        from hilcell.tui.commissioning import Work

        work = Work(path, operator, self.options.runs, self._start_step, self._commissioned)
        self.commissioning = work
        self.start_task(run_in_thread(work.perform, first, only))

    def _start_step(self, folder: Path, arguments: list[str]) -> Callable[[], str]:
        """Start a step's engine, in the thread of the work; return what waits for its end."""
        started = process.start_engine(folder.parent, folder.name, arguments)
        self.call_from_thread(self.show_step, folder, started.process)
        return started.wait_for_end

    def _commissioned(self) -> None:
        """Show what is new; called by any thread."""
        if isinstance(self.page, BaseScreen):
            self.call_later(self.page.show_again)

    def do_new(self) -> None:
        """Show the form of a new run, and nothing else."""
        raise NotImplementedError

    def show_step(self, folder: Path, process: Popen[bytes]) -> None:
        """Show a step's run on the screen of commissioning."""
        raise NotImplementedError

    async def _ask_once_more(self, session: Session, choice: str) -> None:
        self.show_notice(tr("the tracker measures once more ..."))
        subject: Subject = {"choice": choice} if choice else {}
        await run_in_thread(session.ask, "answer", **subject)
        released = tr("the beam is free: put it on the nest, then take its place")
        self.show_notice(released if choice == RELEASE else "")

    def _command(self, command: Command, **subject: Unpack[Subject]) -> None:
        """Send a command to the engine from another thread: keys do not wait."""
        session = self.shown_session
        self.start_task(run_in_thread(session.ask, command, **subject))


class BaseScreen(Screen[None]):
    """A screen with a state line and a key line, which shows the run's view when it changes."""

    footer: ClassVar[tuple[str, ...]] = ()  # actions, in the order of their weight
    fixed: ClassVar[tuple[tuple[str, str], ...]] = ()  # keys that cannot be rebound
    in_text_box: ClassVar[tuple[tuple[str, str], ...]] = ()  # those of a text box

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
    def application(self) -> Application:
        return cast("Application", self.app)

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
        if self.is_shown:
            self.show(self.application.view)

    def show(self, view: RunView | None) -> None:
        self.panel("keys").show(self.key_line())
        if self._notice_state is not None and self._notice_state != self._state_of(view):
            self.show_notice("")
        if view is not None and self.query_one_optional("#banner") is not None:
            from hilcell.tui.text.run import RunText  # reads journals: not for the first screen

            self.mark_simulated(simulated=view.simulated)
            background = self.application.open_runs.background
            other = background.view if background is not None else None
            lines = RunText(view, self.application.glyphs).banner(other)
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
        if self._notice == text:
            self.show_notice("")

    def key_line(self) -> Content:
        """Return element 10: the keys that do something now."""
        typing = isinstance(self.focused, Input)
        fixed = self.in_text_box if typing else self.fixed_keys()
        parts = [(self._key_text(key, label), label == BACK) for key, label in fixed]
        parts += [
            (
                self._key_text(shown(self.application.keymap[name][0]), self.label(name)),
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

    @classmethod
    def all_fixed_keys(cls) -> list[tuple[str, str]]:
        """Return the keys that cannot be rebound, with those of the filter."""
        of_filter = [each for each in cls.in_text_box if each not in cls.fixed]
        return [
            *cls.fixed,
            *((key, tr("in the filter: {text}", text=tr(text))) for key, text in of_filter),
        ]

    def fixed_keys(self) -> Sequence[tuple[str, str]]:
        return self.fixed

    def alarm_context(self) -> AlarmContext:
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
                return marked("answer")
            words = {"proceed": marked("go on"), "resume": marked("resume")}
            return words.get(pause_command(view), marked("pause"))
        return BY_NAME[name].label

    @staticmethod
    def _key_text(key: str, label: str) -> Content:
        return Content.assemble((key, "bold $on-label on $label-fill"), f" {tr(label)}  ")

    @staticmethod
    def _state_of(view: RunView | None) -> tuple[str, bool]:
        if view is None:
            return "", False
        return view.state, view.prompt is not None and view.prompt.ready


class Page(BaseScreen):
    """A whole-screen page over the run: the state stays in sight, q goes back."""

    title_text: ClassVar[str] = ""
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q,backspace", "back", "back", show=False, priority=True)  # in the order typed
    ]
    fixed: ClassVar[tuple[tuple[str, str], ...]] = (("q", BACK),)

    def compose(self) -> ComposeResult:
        yield TextPanel("banner")
        yield TextPanel("title")
        yield from self.body()
        yield TextPanel("notice")
        yield TextPanel("keys")

    def body(self) -> ComposeResult:
        return iter(())

    def begin(self) -> None:
        self.panel("notice").display = False
        self.panel("title").show(Content.styled(tr(self.title_text), "bold"))
        super().begin()
        first = next(iter(self.query("Table, Input, #body").results(Widget)), None)
        if first is not None and first.focusable:
            first.focus()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
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
        self, question: Content, yes: str, no: str = marked("no"), remark: Content | None = None
    ) -> None:
        super().__init__()
        self._question, style = question, "bold $on-label on $label-fill"
        answers = (" Enter ", style), f" {yes}   ", (" q ", style), f" {tr(no)}"
        self._answers = Content.assemble(*answers, *([remark] if remark is not None else []))

    def compose(self) -> ComposeResult:
        with Vertical(id="dialog"):
            yield TextPanel("question")
            yield TextPanel("answers")

    def on_mount(self) -> None:
        self.query_one("#question", TextPanel).show(self._question)
        self.query_one("#answers", TextPanel).show(self._answers)

    def on_resize(self) -> None:
        question, answers = self.query_one("#question"), self.query_one("#answers")
        room = self.app.size.height - self.FRAME - answers.size.height
        question.styles.max_height = max(room, 1)

    def action_reply(self, yes: bool) -> None:
        if not yes or cast("Application", self.app).key_is_deliberate:
            self.dismiss(yes)
