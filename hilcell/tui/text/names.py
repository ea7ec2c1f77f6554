"""Points and steps by the names of the work; their keys are for the log and for commands."""

from __future__ import annotations

from hilcell.journal.point_id import PointId

SENT = {"before": "as sent", "idw": "paper method", "chosen": "corrected"}
STEPS = {"hold-station": "Hold station", "validate": "Validation"}


def point_words(id: PointId, station: str = "") -> str:
    """Return a point's name, targets from 1: ``corrected target 50 at S300``."""
    at = f" at {station}" if station else ""
    match id.kind:
        case "validate":
            how = {"before": "target", "idw": "paper method's target"}.get(
                id.how, "corrected target"
            )
            sent = " as sent" if id.how == "before" else ""
            return f"{how} {(id.number or 0) + 1}{sent}{at}"
        case "grid":
            return f"grid point {'-'.join(map(str, id.vertex))}{at}"
        case "world":
            return f"floor nest {id.nest}"
        case "repeatability":
            return f"place {(id.place or 0) + 1}, visit {(id.number or 0) + 1}{at}"
    return f"{id.key}{at if station and station not in id.key else ''}"


def step_words(name: str) -> str:
    """Return a step's name: ``Robot grid`` of ``robot-grid``."""
    return STEPS.get(name) or name.replace("-", " ").capitalize()
