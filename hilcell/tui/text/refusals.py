"""The reasons why an action is refused now, from the run's state alone; empty where it is not.

At first no run is shown, and an engine that starts or does not answer takes no commands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hilcell.tui.engine.run_view import RunView

POINTS, HISTORY = "only where the points are listed", "only in the history"
ELSEWHERE = {  # actions of certain screens: the refusal on all others
    "bad": POINTS,
    "sort": POINTS,
    "retake": POINTS,
    "find": "only where there are rows to filter",
    "mark": HISTORY,
    "compare": HISTORY,
}
ONE_AT_A_TIME = "a run is live: stop, abort or detach from it first"
NOT_LIVE = "no run is live"
NO_ANSWER_REASONS = {
    "looking": "the run is being read",
    "checking": "the engine starts",
    "silent": "the engine does not answer",
}
AT_REST = {"stopping": "the run is being stopped", "done": "the run is over"} | NO_ANSWER_REASONS


def pause_command(view: RunView | None) -> str:
    """Return what the space bar does: pause, proceed, resume, or nothing."""
    if view is None or view.state in ("looking", "silent"):
        return ""
    if not view.live:
        over = view.state in ("done", "intolerant", "idle") and not view.calibration_lost
        return "" if over else "resume"
    if view.allows("pause"):
        return "pause"
    return "proceed" if view.allows("proceed") else ""


def refusal(name: str, view: RunView | None, *, background: bool, unacknowledged: bool) -> str:
    """Return why an action does nothing now.

    ``background``: another run is live in the background; ``unacknowledged``: alarms are.
    """
    live = view is not None and view.live
    match name:
        case "stop" | "detach":
            return "" if live or background else NOT_LIVE
        case "abort":
            if view is None or not live:
                return "not the run behind: go back to it first" if background else NOT_LIVE
            return no_answer_reason(view)
        case "new":
            return ONE_AT_A_TIME if live or background else ""
    acts, pages = ("pause", "retake", "acknowledge"), ("alarms", "interlocks", "log", "report")
    if name not in (*acts, *pages, "plots", "bad", "sort"):
        return ""
    if view is None or view.log.plan is None:
        return "there is no run here to act on"
    match name:
        case "retake":
            waits = no_answer_reason(view) if live else ONE_AT_A_TIME if background else ""
            return waits if view.log.points else "no point is measured yet"
        case "pause":
            return _pause_refusal(view, background=background)
        case "acknowledge":
            return "" if unacknowledged else "no alarm waits for it"
    return ""


def no_answer_reason(view: RunView) -> str:
    """Return why the engine of a live run takes no commands, or nothing where it does."""
    return "" if view.answers else NO_ANSWER_REASONS.get(view.state, NO_ANSWER_REASONS["silent"])


def _pause_refusal(view: RunView, *, background: bool) -> str:
    command = pause_command(view)
    if command == "resume" and background:
        return ONE_AT_A_TIME
    return "" if command else AT_REST.get(view.state, AT_REST["done"])
