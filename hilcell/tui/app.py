"""The screen as an application: it holds one attachment to a run and passes keys on as commands.

The run's state machine says which actions are allowed; the journal gives all that is shown. The
engine is another process: closing the screen does not stop a run. Modules that read journals
are imported after the first screen is painted.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.command import CommandList, CommandPalette, DiscoveryHit, Hit, Hits, Provider
from textual.content import Content
from textual.driver import Driver
from textual.events import Event, Key, Paste
from textual.filter import LineFilter
from textual.message import Message
from textual.scrollbar import ScrollBar
from textual.widgets import Input
from textual.worker import Worker, WorkerState

from hilcell import __version__
from hilcell.errors import HilcellError
from hilcell.language import tr
from hilcell.sanitize import UNSAFE
from hilcell.tui.driver import LATE_S, StopDriver, WithoutColours
from hilcell.tui.keys import ACTIONS, BY_NAME, shown, wait_until_built, wait_until_processed
from hilcell.tui.process import GarbageCollector, run_in_thread
from hilcell.tui.screens.base import Application, BaseScreen, Options
from hilcell.tui.themes import NAMES, PALETTES, SIXTEEN_COLOURS
from hilcell.tui.widgets import Choice, PlainScrollBar, TextPanel

if TYPE_CHECKING:
    from subprocess import Popen

    from hilcell.tui.run_view import RunView
    from hilcell.tui.session import RunUpdate, Session


ScrollBar.renderer = PlainScrollBar  # Textual's way to choose: a class, for all of its bars


class OpeningScreen(BaseScreen):
    """Says what is being opened."""

    footer = ("quit",)

    def __init__(self, run: str) -> None:
        super().__init__()
        self._run = run

    def compose(self) -> ComposeResult:
        yield TextPanel("title")
        yield TextPanel("what")
        yield TextPanel("notice")
        yield TextPanel("keys")

    def begin(self) -> None:
        self.panel("title").show(Content.styled(f"hilcell {__version__}", "bold"))
        what = (
            tr("opening run {run} ...", run=self._run)
            if self._run
            else tr("looking for a live run ...")
        )
        warning = tr("hilcell is not a safety function: keep the E-stop in reach.")
        self.panel("what").show(f"{what}\n\n{warning}")
        self.panel("notice").display = False
        super().begin()


def folder_to_open(runs: Path, name: str) -> Path | None:
    """Return the folder of the run to show; raises `HilcellError` where the name means none.

    Loads, in the caller's thread, everything that reads a journal.
    """
    for module in ("session", "screens.help"):  # help is on every screen, so it has all
        importlib.import_module(f"hilcell.tui.{module}")
    from hilcell.journal.index import find_run
    from hilcell.journal.runs import live_engine, run_folders

    if name:
        return find_run(runs, name)
    live = [folder for folder in run_folders(runs) if live_engine(folder) is not None]
    return live[-1] if live else None


def pages() -> dict[str, type[BaseScreen]]:
    """Return the page of each action that has one; some need no run."""
    from hilcell.tui.screens import pages
    from hilcell.tui.screens.commissioning import CommissionScreen
    from hilcell.tui.screens.help import HelpPage

    return {
        "alarms": pages.AlarmPage,
        "interlocks": pages.InterlockPage,
        "log": pages.LogPage,
        "report": pages.ReportPage,
        "plots": pages.PlotPage,
        "help": HelpPage,
        "history": pages.HistoryPage,
        "commission": CommissionScreen,
    }


def wants_commissioning(cell: str) -> bool:
    """Whether a cell file is new, or its commissioning has begun and lacks steps."""
    from hilcell.cell.source import built_in_cells
    from hilcell.commission.steps import check_proved

    path = Path(cell)
    if cell in built_in_cells() or path.suffix != ".toml":
        return False
    try:
        check_proved(path)
    except HilcellError:  # of a damaged record, too: the screen shows it
        return True
    return not path.exists()


class Palette(CommandPalette):
    """Textual's own, but its Enter acts at once: a second one in a burst finds it closed."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "enter", show=False, priority=True),
        Binding("backspace", "erase", show=False, priority=True),
        Binding("pageup", "page('page_up')", show=False, priority=True),
        Binding("pagedown", "page('page_down')", show=False, priority=True),
    ]

    def __init__(self) -> None:
        hint = tr("what to do?   ^p or Backspace: back   Esc: STOP")
        super().__init__(placeholder=hint, id="--command-palette")

    def run_worker(self, *args: Any, **options: Any) -> Worker[Any]:
        """Search; a search that finds the palette closed is no error of the screen."""
        return super().run_worker(*args, **options | {"exit_on_error": False})

    def on_worker_state_changed(self, event: Worker.StateChanged) -> None:
        """Raise the error of a search, unless the palette was closed meanwhile."""
        error = event.worker.error
        if event.state is WorkerState.ERROR and error is not None and self.query(CommandList):
            raise error

    async def action_enter(self) -> None:
        await self.query_one(Input).action_submit()

    async def action_page(self, name: str) -> None:
        """Go a page up or down, where the terminal has room for a page: else Textual raises."""
        commands = self.query_one(CommandList)
        if commands.scrollable_content_region.height:
            await commands.run_action(name)

    def action_erase(self) -> None:
        box = self.query_one(Input)
        if box.value:
            box.action_delete_left()
        else:
            self.dismiss()


class ActionProvider(Provider):
    """Provides the palette with the actions allowed now."""

    async def discover(self) -> Hits:
        """Yield every allowed action; the stop last, for it has a key that needs no palette."""
        for words, act in sorted(self._allowed(), key=lambda each: each[0].startswith("STOP")):
            yield DiscoveryHit(words, act)

    async def search(self, query: str) -> Hits:
        matcher = self.matcher(query)
        for words, act in self._allowed():
            if (score := matcher.match(words)) > 0:
                yield Hit(score, words, act)

    def _allowed(self) -> list[tuple[str, Callable[[], None]]]:
        app = cast("HilcellApp", self.app)
        allowed = (action for action in ACTIONS if app.allowed(action.name))
        return [
            (f"{tr(app.label(a.name))}: {tr(a.help)}", partial(app.do, a.name)) for a in allowed
        ]


class RunUpdated(Message):
    """The feed has read something new; the session's inbox holds it."""

    def __init__(self, session: Session) -> None:
        super().__init__()
        self.session = session


class HilcellApp(Application):
    """Shows one run at a time; `open_runs` holds it, and a live one in the background."""

    PERIOD_S, SLOW_PERIOD_S = 0.25, 1.0
    TICK_S = 1.0
    BURST_S = 0.1  # scanners of barcodes and keys held down are quicker, fingers slower

    TITLE = "hilcell"
    CSS_PATH = Path(__file__).with_name("style.tcss")
    COMMANDS: ClassVar = {ActionProvider}
    BINDINGS: ClassVar[list[BindingType]] = [  # all act before widgets see them, in their order
        Binding("tab", "focus_next", show=False, priority=True),
        Binding("shift+tab", "focus_previous", show=False, priority=True),
        *(
            Binding(",".join(action.keys), f"do('{action.name}')", action.label, show=False,
                    id=action.name, priority=True)
            for action in ACTIONS
        ),
    ]  # fmt: skip

    def __init__(self, options: Options) -> None:
        super().__init__(options)
        self.detached: list[str] = []  # the runs that go on without this screen
        self.refused: HilcellError | None = None  # why nothing could be opened
        self._last_key_s = -math.inf  # when the last key came
        self._shown_s = -math.inf  # when the run was last shown
        self._was_late = False  # whether the driver has covered something since
        self._collector: GarbageCollector | None = None
        self._halted = False  # whether the driver's thread has stopped a commissioning
        self.set_keymap({name: ",".join(keys) for name, keys in options.keymap.items()})
        for palette in (*PALETTES, SIXTEEN_COLOURS):
            self.register_theme(palette.theme())
        self.theme = options.theme
        self.animation_level = "none"

    # -- opening ------------------------------------------------------------------------------

    def get_driver_class(self) -> type[Driver]:
        """Give the terminal's driver the calls that must not wait for this thread."""
        calls = {"on_escape": self._stop_at_once, "is_late": self._is_late}
        return type("Stopping", (StopDriver,), {name: staticmethod(calls[name]) for name in calls})

    def _stop_at_once(self) -> bool:
        """Stop everything; called by the driver's thread."""
        self._halted |= self.commissioning is not None and self.commissioning.stop()
        return self.open_runs.stop()

    def get_line_filters(self) -> Sequence[LineFilter]:
        """Return Textual's, but without colours that which leaves none."""
        return [WithoutColours.of(self.theme)] if self.no_color else super().get_line_filters()

    def _is_late(self) -> bool:
        """Whether a live run was not shown for long; called by the driver's thread."""
        late = bool(self.open_runs.live) and time.monotonic() - self._shown_s > LATE_S
        self._was_late |= late
        return late

    async def on_event(self, event: Event) -> None:
        """Process keys in their order, all other events as Textual does."""
        if isinstance(event, Key | Paste) and not event.is_forwarded:
            await self._take_typed(event)
        else:
            await super().on_event(event)

    async def _take_typed(self, event: Key | Paste) -> None:
        """Clean pasted text of control characters, and wait until a key has taken effect."""
        if isinstance(event, Paste):
            event.text = UNSAFE.sub("", event.text.partition("\n")[0])
        receivers = (self.focused or self.screen).ancestors_with_self
        self.key_is_deliberate, self._last_key_s = (
            event.time - self._last_key_s >= self.BURST_S,
            event.time,
        )
        self.show_notice("")  # the last notice has been read
        await super().on_event(event)
        await wait_until_processed(node for node in receivers if node is not self)
        if isinstance(self.screen, Palette):  # its parts exchange messages
            await wait_until_processed([*self.screen.query("*"), self.screen])
        if isinstance(self.screen, BaseScreen):
            await wait_until_built(self.screen.built)

    def on_mount(self) -> None:
        """Paint first, then import what reads journals."""
        if self.glyphs.plain:
            self.add_class("plain")
        self.push_screen(OpeningScreen(self.options.run))
        self.set_interval(
            self.TICK_S, self._tick
        )  # the feed ticks, too: this is for a silent engine
        self.call_after_refresh(lambda: self.start_task(self._open()))

    async def _open(self) -> None:
        try:
            folder = await run_in_thread(folder_to_open, self.options.runs, self.options.run)
            commissions = await run_in_thread(wants_commissioning, self.options.cell)
        except HilcellError as error:
            self.refused = error
            self.exit()
            return
        self._collector = GarbageCollector(time.monotonic())
        if folder is not None:
            self.attach(folder)
        elif commissions:
            self.pop_screen()
            self.do_commission()
        else:
            self.do_new()

    def attach(self, folder: Path, process: Popen[bytes] | None = None) -> None:
        from hilcell.tui.screens.run import PointFilter, RunScreen

        again = self.session is not None and self.session.folder == folder
        point_filter = next(
            (each.point_filter for each in self.screen_stack if isinstance(each, RunScreen)),
            PointFilter(),
        )
        self._follow(folder, process)
        while len(self.screen_stack) > 1:
            self.pop_screen()
        self.push_screen(RunScreen(point_filter if again else PointFilter()))

    def show_step(self, folder: Path, process: Popen[bytes]) -> None:
        session = self._follow(folder, process)
        if self.commissioning is not None and self.commissioning.stopped:
            session.stop()  # before there was a run to stop
        self._close_questions()
        self._turn_to(pages()["commission"])

    def _follow(self, folder: Path, process: Popen[bytes] | None) -> Session:
        before = self.session if self.session and self.session.folder == folder else None
        session = self.open_runs.background
        if session is None or session.folder != folder:
            session = self._session(folder, process)
            if before is not None:  # unacknowledged alarms stay
                session.latch = before.latch
            session.feed.start()
        self._shown_s = time.monotonic()
        self.open_runs.show(session)
        return session

    def _session(self, folder: Path, process: Popen[bytes] | None) -> Session:
        from hilcell.tui.session import Session

        session: Session = Session(
            folder,
            lambda update: self.receive(session, update),
            self.SLOW_PERIOD_S if self.options.slow else self.PERIOD_S,
            process,
            shown(self.keymap["pause"][0]),
        )
        return session

    # -- what comes in ------------------------------------------------------------------------

    def receive(self, session: Session, update: RunUpdate) -> None:
        """Take an update, from any thread; where one waits to be shown, it joins that one."""
        if session.inbox.put(update):
            self.post_message(RunUpdated(session))

    def on_run_updated(self, message: RunUpdated) -> None:
        from hilcell.tui.session import utc_now

        session = message.session
        update = session.inbox.take()
        if session not in self.open_runs.all or update is None:
            return
        view = session.view
        was_live, was_lost, trouble = view.live, view.calibration_lost, view.trouble
        session.take(update, utc_now())
        if session is self.session and was_live and not self.live:
            self._close_questions()  # they were about a live run
        self._show()
        if (ended := self.open_runs.close_ended()) is not None:
            from hilcell.tui.text.run import RunText

            self.show_notice(RunText(ended.view).end_text())
        if session is self.session:
            self._report_changes(session.view, was_lost=was_lost, trouble=trouble)

    def _report_changes(self, view: RunView, *, was_lost: bool, trouble: str) -> None:
        if view.trouble:
            self.show_notice(view.trouble, over=False)
        elif trouble and isinstance(self.page, BaseScreen):
            self.page.clear_notice(trouble)
        if was_lost and not view.calibration_lost:
            self.show_notice(tr("the calibration has its file, calibration.json"))

    def _tick(self) -> None:
        from hilcell.tui.session import utc_now

        for session in self.open_runs.live:
            session.tick(utc_now())
        now_s = time.monotonic()
        if self.open_runs.live and now_s - self._shown_s >= self.TICK_S / 2:
            self._show()
        if self._collector is not None:
            at_rest = all(session.view.at_rest for session in self.open_runs.live)
            self._collector.tick(at_rest=at_rest, now_s=now_s)

    def on_unmount(self) -> None:
        """Leave the process as it was found."""
        if self.commissioning is not None:
            self.commissioning.stop()
        if self._collector is not None:
            self._collector.end()

    def _show(self) -> None:
        if isinstance(self.page, BaseScreen):  # also under a question: nothing may seem fresh
            self.page.show_again()
        self._shown_s = time.monotonic()
        if self._was_late:
            self._was_late = False
            self.screen.refresh()  # the whole of it, over what the driver has written

    # -- keys ---------------------------------------------------------------------------------

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave letters to a text box or a question, and the space bar to a choice."""
        if action != "do":
            return True
        name = str(parameters[0])
        if isinstance(self.focused, Choice):
            return name != "pause"
        typing = isinstance(self.focused, Input) or not isinstance(self.screen, BaseScreen)
        return BY_NAME[name].everywhere or not typing

    def action_do(self, name: str) -> None:
        self.do(name)

    def do(self, name: str) -> None:
        """Do an action, where it is allowed; the screen on top may have its own way."""
        if name == "stop":
            self.do_stop()
        elif isinstance(self.screen, BaseScreen) or name == "quit":
            if refused := self.refusal(name):
                self.show_notice(f"{tr(BY_NAME[name].label)}: {tr(refused)}")
                return
            if name == "detach" and not self.key_is_deliberate:
                name = "quit"  # which asks: no scanned code leaves an attended run alone
            makers = (self.screen, self)
            acts = filter(None, (getattr(each, f"do_{name}", None) for each in makers))
            next(acts, lambda: self._turn_to(pages()[name]))()

    def do_stop(self) -> None:
        """Stop everything; where nothing runs, go back."""
        live = self.open_runs.live
        over = self.view is not None and self.view.ended
        halted, self._halted = self._halted, False
        halted |= self.commissioning is not None and self.commissioning.stop()
        sent = self.open_runs.stop()
        if live or (sent and not over):
            self._close_questions()
            # The key's own thread has stopped already: its engine may be gone by now.
            received = sent or self.open_runs.stop_received
            notice = tr("STOP: no engine received it")
            if received:
                notice = tr("STOP sent") if sent else tr("stopped: the engine has ended")
            if any(session.view.state == "silent" for session in live):
                notice += tr(", but it does not answer: use the E-stop")
            self.show_notice(notice, for_now=received)
        elif halted:
            self.show_notice(tr("commissioning is stopped; nothing moves"))
        elif len(self.screen_stack) > 2:
            self.pop_screen()
        elif self.session is not None:
            self.show_notice(tr("STOP: nothing runs here; if anything moves, use the E-stop"))

    def _close_questions(self) -> None:
        while not isinstance(self.screen, BaseScreen):
            self.pop_screen()

    def _turn_to(self, page: type[BaseScreen]) -> None:
        """Show a page; one that is open already is shown again: keys may be held down."""
        if any(type(each) is page for each in self.screen_stack):
            while type(self.screen) is not page:
                self.pop_screen()
        else:
            self.push_screen(page())

    def action_command_palette(self) -> None:
        if isinstance(self.screen, Palette):
            self.pop_screen()
        else:
            self.push_screen(Palette())

    def do_acknowledge(self) -> None:
        session = self.shown_session
        made = session.acknowledge()
        self._show()
        self.start_task(run_in_thread(session.send, made))

    def do_theme(self) -> None:
        if self.theme in NAMES:
            self.theme = NAMES[(NAMES.index(self.theme) + 1) % len(NAMES)]

    def do_detach(self) -> None:
        self.detached = [session.folder.name for session in self.open_runs.live]
        self.open_runs.leave()
        self.exit(0)

    def do_quit(self) -> None:
        if not self.open_runs.live:
            self.open_runs.leave()
            self.exit(0)
        else:
            self._close_questions()
            again = tr(" Commissioning will repeat its step.") if self.commissions else ""
            self.ask(
                tr("A run is live."),
                tr("Detach: its engine works on without this screen. Esc stops it, from here, too.")
                + again,
                tr("detach"),
                self.do_detach,
            )

    def do_commission(self) -> None:
        """Show the commissioning, with its run where that goes on in the background."""
        behind = self.open_runs.background
        if behind is not None and self.commissions:
            self._follow(behind.folder, None)
        self._turn_to(pages()["commission"])

    def do_new(self) -> None:
        from hilcell.tui.screens.start import StartScreen

        self.open_runs.show(None)
        while len(self.screen_stack) > 1:
            self.pop_screen()
        self.push_screen(StartScreen())
