"""What a screen asks of the application, so that screens need not know who holds them."""

from __future__ import annotations

from collections.abc import Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from hilcell.tui.keys.table import Keymap
from hilcell.tui.terminal.glyphs import Glyphs
from hilcell.tui.terminal.themes import NAMES

if TYPE_CHECKING:
    from hilcell.alarms import Latch
    from hilcell.tui.app.actions import Acts
    from hilcell.tui.engine.open_runs import OpenRuns
    from hilcell.tui.engine.scene import Scene


@dataclass(frozen=True, slots=True)
class Options:
    """How the screen was asked for."""

    runs: Path
    keymap: Keymap
    glyphs: Glyphs
    run: str = ""
    cell: str = "paper"
    settings: tuple[str, ...] = ()
    theme: str = NAMES[0]
    slow: bool = False


class Application(Protocol):
    """The application as its screens see it."""

    options: Options
    glyphs: Glyphs
    keymap: Keymap
    attached: OpenRuns
    acts: Acts
    unhurried: bool  # whether the key under way came by itself, not in a burst

    @property
    def scene(self) -> Scene | None:
        """Return what is known of the run that is shown."""

    @property
    def latch(self) -> Latch:
        """Return its alarms; raises `HilcellError` where no run is shown."""

    def allowed(self, name: str) -> bool:
        """Whether an action does something now."""

    def label(self, name: str) -> str:
        """Return what an action is called now."""

    def do(self, name: str) -> None:
        """Do an action, where it is allowed."""

    def background(self, work: Coroutine[Any, Any, None]) -> None:
        """Do something that may take a while; what goes wrong is said."""

    def attach(self, folder: Path, process: Any = None) -> None:
        """Show a run in place of the one shown."""

    def go_back(self) -> None:
        """Show the live run again that goes on behind this one."""

    def open_run(self, folder: Path) -> None:
        """Show another run; leaving a live one asks."""
