"""Why a key does nothing now, from the run's state alone; nothing where it does something.

The trap: no run is shown at first, and an engine that starts or stands still takes no commands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hilcell.tui.engine.scene import Scene

POINTS, HISTORY = "only where the points are listed", "only in the history"
ELSEWHERE = {  # actions of certain screens: what is said on others
    "bad": POINTS,
    "sort": POINTS,
    "retake": POINTS,
    "find": "only where there are rows to filter",
    "mark": HISTORY,
    "compare": HISTORY,
}
OF_A_RUN = frozenset(
    ("pause", "retake", "acknowledge", "bad", "sort")
    + ("alarms", "plots", "interlocks", "log", "report")
)
ONE_AT_A_TIME = "a run is live: stop, abort or detach from it first"
NO_POINTS = "no point is measured yet"
NO_RUN = "there is no run here to act on"
NOT_LIVE = "no run is live"
UNHEARD = {
    "looking": "the run is being read",
    "checking": "the engine starts",
    "silent": "the engine does not answer",
}
AT_REST = {"stopping": "the run is being stopped", "done": "the run is over"} | UNHEARD


def pause_command(scene: Scene | None) -> str:
    """Return what the space bar does: pause, proceed, resume, or nothing."""
    if scene is None or scene.key in ("looking", "silent"):
        return ""
    if not scene.live:
        over = scene.key in ("done", "intolerant", "idle") and not scene.lost
        return "" if over else "resume"
    if scene.allows("pause") and scene.key != "pausing":
        return "pause"
    return "proceed" if scene.allows("proceed") or scene.key == "pausing" else ""


def refusal(name: str, scene: Scene | None, *, behind: bool, standing: bool) -> str:
    """Return why an action does nothing now.

    ``behind``: a live run goes on behind the one shown; ``standing``: alarms are unacknowledged.
    """
    live = scene is not None and scene.live
    match name:
        case "stop" | "detach":
            return "" if live or behind else NOT_LIVE
        case "abort":
            return _abort_refusal(scene, behind=behind)
        case "new":
            return ONE_AT_A_TIME if live or behind else ""
    if name not in OF_A_RUN:
        return ""
    if scene is None or scene.log.plan is None:
        return NO_RUN
    match name:
        case "retake":
            return _retake_refusal(scene, behind=behind)
        case "pause":
            return _pause_refusal(scene, behind=behind)
        case "acknowledge":
            return "" if standing else "no alarm waits for it"
    return ""


def unheard(scene: Scene) -> str:
    """Return why the engine of a live run takes no commands, or nothing where it does."""
    return "" if scene.heard else UNHEARD.get(scene.key, UNHEARD["silent"])


def _abort_refusal(scene: Scene | None, *, behind: bool) -> str:
    if scene is None or not scene.live:
        return "not the run behind: go back to it first" if behind else NOT_LIVE
    return unheard(scene)


def _retake_refusal(scene: Scene, *, behind: bool) -> str:
    if not scene.log.points:
        return NO_POINTS
    return unheard(scene) if scene.live else ONE_AT_A_TIME if behind else ""


def _pause_refusal(scene: Scene, *, behind: bool) -> str:
    command = pause_command(scene)
    if command == "resume" and behind:
        return ONE_AT_A_TIME
    return "" if command else AT_REST.get(scene.key, AT_REST["done"])
