"""The help page, made of the keys that the screens really have."""

from __future__ import annotations

from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import Lines
from hilcell.tui.screens.base import BaseScreen
from hilcell.tui.screens.history import HistoryPage
from hilcell.tui.screens.pages import LogPage, TextPage
from hilcell.tui.screens.plots import PlotPage
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import StartScreen
from hilcell.tui.text.help import help_lines

SCREENS: dict[str, type[BaseScreen]] = {  # those whose keys are explained, by their titles
    "the run": RunScreen,
    "a new run": StartScreen,
    "the plots": PlotPage,
    "the runs": HistoryPage,
    "the log": LogPage,
    "other pages": TextPage,
}


class HelpPage(TextPage):
    """The meaning of the keys and of the lines."""

    title_text = "Help"
    footer = ("stop", "quit")

    def text(self, view: RunView | None) -> Lines:
        """Return the help."""
        fixed = {title: keys_of(each) for title, each in SCREENS.items()}
        return help_lines(self.application.keymap, self.application.glyphs, fixed)


def keys_of(screen: type[BaseScreen]) -> list[tuple[str, str]]:
    """Return the keys of a screen that cannot be rebound, and those of its filter."""
    of_filter = [each for each in screen.in_box if each not in screen.fixed]
    return [*screen.fixed, *((key, f"in the filter: {words}") for key, words in of_filter)]
