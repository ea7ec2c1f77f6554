"""The application on a stage: a terminal of any size, an engine that only listens."""

from __future__ import annotations

from pathlib import Path


from hilcell.tui.app import HilcellApp, Options
from hilcell.tui.glyphs import ASCII, UNICODE
from hilcell.tui.keys import ACTIONS
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.session import Session
from tests.hilcell.tui.scenes import RUN, fresh, stories

DEFAULT_KEYS = {action.name: action.keys for action in ACTIONS}


class Listener(Session):
    """A session whose commands are written down; its stop, too."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, lambda _: None, 0.25)
        self.asked: list[tuple[str, dict[str, str]]] = []
        self.stops = 0

    def ask(self, command: str, **facts: str) -> None:
        """Write a command down."""
        self.asked.append((command, facts))

    def stop(self) -> None:
        """Count a stop."""
        self.stops += 1


class Stage(HilcellApp):
    """Opens a made-up run in place of looking for one."""

    def __init__(self, options: Options, name: str) -> None:
        super().__init__(options)
        self.heard = Listener(options.runs / RUN)
        self.story = name

    async def _open(self) -> None:
        self.session = self.heard
        self.heard.take(fresh(self.story), stories()[self.story].now)
        self.push_screen(RunScreen())

    def _tick(self) -> None:
        """Time stands still on this stage."""


def options(folder: Path, *, ascii_only: bool = False, theme: str = "calm") -> Options:
    """Return how the stage is set."""
    glyphs = ASCII if ascii_only else UNICODE
    return Options(runs=folder, keymap=DEFAULT_KEYS, glyphs=glyphs, theme=theme)


def text_of(app: HilcellApp) -> str:
    """Return what the terminal shows, without spaces at the ends of lines."""
    strips = app.screen._compositor.render_strips()
    lines = ["".join(segment.text for segment in strip).rstrip() for strip in strips]
    return "\n".join(lines) + "\n"
