"""Which action opens which page; each is imported when it is first wanted."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hilcell.tui.engine.session import Session
    from hilcell.tui.screens.base import SceneScreen

PAGES = ("alarms", "interlocks", "help", "log", "plots", "report", "history")


def page_of(name: str, session: Session | None) -> SceneScreen:
    """Return the page of an action of `PAGES`; only help and history need no run."""
    match name:
        case "alarms":
            from hilcell.tui.screens.pages import AlarmPage

            return AlarmPage()
        case "interlocks":
            from hilcell.tui.screens.pages import InterlockPage

            return InterlockPage()
        case "log":
            from hilcell.tui.screens.log import LogPage

            return LogPage()
        case "plots":
            from hilcell.tui.screens.plots import PlotPage

            return PlotPage()
        case "history":
            from hilcell.tui.screens.history import HistoryPage

            return HistoryPage()
        case "report" if session is not None:
            from hilcell.tui.screens.report import ReportPage

            return ReportPage(session.folder)
    from hilcell.tui.screens.pages import HelpPage

    return HelpPage()
