"""What a key may do now, from the run's state alone.

The trap: no run is shown at first, and an engine that is being started takes no commands yet.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hilcell.tui.scene import Scene

OF_THE_POINTS = frozenset(("bad", "sort", "find", "retake"))
OF_A_RUN = OF_THE_POINTS | {"alarms", "plots", "interlocks", "log", "report"}


def pause_command(scene: Scene | None) -> str:
    """Return what the space bar does: pause, proceed, resume, or nothing."""
    if scene is None:
        return ""
    if not scene.live:
        return "" if scene.key in ("done", "intolerant", "idle") else "resume"
    if scene.allows("pause") and scene.key != "pausing":
        return "pause"
    return "proceed" if scene.allows("proceed") or scene.key == "pausing" else ""


def allowed(name: str, scene: Scene | None, *, behind: bool, standing: bool) -> bool:
    """Whether an action does something now.

    ``behind``: a live run goes on behind the one shown; ``standing``: alarms are unacknowledged.
    """
    live = scene is not None and scene.live
    has_run = scene is not None and scene.log.plan is not None
    match name:
        case "stop":
            return live or behind
        case "detach":
            return live
        case "abort":
            return scene is not None and scene.live and scene.heard
        case "new":
            return not live
        case "pause":
            return has_run and pause_command(scene) != ""
        case "acknowledge":
            return has_run and standing
    return has_run or name not in OF_A_RUN
