"""Navigation: the first screen, the run to show first, the page of each action, the palette."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.command import CommandList, CommandPalette, DiscoveryHit, Hit, Hits, Provider
from textual.content import Content
from textual.widgets import Input
from textual.worker import Worker, WorkerState

from hilcell import __version__
from hilcell.tui.keys import ACTIONS, Action
from hilcell.tui.screens.base import Application, BaseScreen
from hilcell.tui.widgets import TextPanel

if TYPE_CHECKING:
    from hilcell.tui.engine.session import Session


NOT_A_SAFETY_FUNCTION = "hilcell is not a safety function: keep the E-stop in reach."


class OpeningScreen(BaseScreen):
    """Says what is being opened."""

    footer = ("quit",)

    def __init__(self, run: str) -> None:
        super().__init__()
        self._run = run

    def compose(self) -> ComposeResult:
        """Build the lines."""
        yield TextPanel("title")
        yield TextPanel("what")
        yield TextPanel("notice")
        yield TextPanel("keys")

    def on_mount(self) -> None:
        """Show them."""
        self.panel("title").show(Content.styled(f"hilcell {__version__}", "bold"))
        what = f"opening run {self._run} ..." if self._run else "looking for a live run ..."
        self.panel("what").show(f"{what}\n\n{NOT_A_SAFETY_FUNCTION}")
        self.panel("notice").display = False
        super().on_mount()


LATER = (
    "hilcell.tui.engine.session",
    "hilcell.journal.index",
    *(
        f"hilcell.tui.screens.{name}"
        for name in ("run", "pages", "plots", "history", "start", "help")
    ),
)


def run_to_open(runs: Path, name: str) -> Path | None:
    """Return the folder of the run to show; raises `HilcellError` where the name means none.

    Loads, in the caller's thread, everything that reads a journal.
    """
    for module in LATER:
        importlib.import_module(module)
    from hilcell.journal.engine_file import live_engine
    from hilcell.journal.find_run import find_run
    from hilcell.journal.runs import run_folders

    if name:
        return find_run(runs, name)
    live = [folder for folder in run_folders(runs) if live_engine(folder) is not None]
    return live[-1] if live else None


PAGES = ("alarms", "interlocks", "help", "log", "plots", "report", "history")


def page_of(name: str, session: Session | None) -> BaseScreen:
    """Return the page of an action of `PAGES`; only help and history need no run."""
    from hilcell.tui.screens import history, pages, plots
    from hilcell.tui.screens.help import HelpPage

    if name == "report" and session is not None:
        return pages.ReportPage(session.folder)
    found: dict[str, type[BaseScreen]] = {
        "alarms": pages.AlarmPage,
        "interlocks": pages.InterlockPage,
        "log": pages.LogPage,
        "plots": plots.PlotPage,
        "history": history.HistoryPage,
    }
    return found.get(name, HelpPage)()


class Palette(CommandPalette):
    """Textual's own, but its Enter acts at once: a second one in a burst finds it closed."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "enter", show=False, priority=True),
        Binding("backspace", "erase", show=False, priority=True),
        Binding("pageup", "page('page_up')", show=False, priority=True),
        Binding("pagedown", "page('page_down')", show=False, priority=True),
    ]

    def __init__(self) -> None:
        hint = "what to do?   ^p or Backspace: back   Esc: STOP"
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
        """Choose what is highlighted."""
        await self.query_one(Input).action_submit()

    async def action_page(self, name: str) -> None:
        """Go a page up or down, where the terminal has room for a page: else Textual raises."""
        found = self.query_one(CommandList)
        if found.scrollable_content_region.height:
            await found.run_action(name)

    def action_erase(self) -> None:
        """Take a letter back; with none left, go back."""
        box = self.query_one(Input)
        if box.value:
            box.action_delete_left()
        else:
            self.dismiss()


class ActionProvider(Provider):
    """Provides the palette with the actions allowed now."""

    async def discover(self) -> Hits:
        """Yield every allowed action; the stop last, for it has a key that needs no palette."""
        for action in sorted(self._allowed(), key=lambda action: action.name == "stop"):
            yield DiscoveryHit(
                self._words(action), lambda name=action.name: self._application.do(name)
            )

    async def search(self, query: str) -> Hits:
        """Yield the allowed actions that match."""
        matcher = self.matcher(query)
        for action in self._allowed():
            score = matcher.match(self._words(action))
            if score > 0:
                yield Hit(
                    score, self._words(action), lambda name=action.name: self._application.do(name)
                )

    def _allowed(self) -> list[Action]:
        return [action for action in ACTIONS if self._application.allowed(action.name)]

    @property
    def _application(self) -> Application:
        return cast("Application", self.app)

    def _words(self, action: Action) -> str:
        return f"{self._application.label(action.name)}: {action.help}"
