"""How a run has ended, in one line: its outcome in a word, or that it has no verdict."""

from __future__ import annotations

from hilcell.journal.outcome import run_outcome
from hilcell.tui.engine.run_view import RunView


def end_remark(view: RunView) -> str:
    """Return the outcome, else that there is no verdict and after how many points.

    Nothing where the validation's verdict is shown, or the run has not ended.
    """
    if view.state in ("done", "intolerant"):
        judged = "validation" in (view.log.end or {}).get("result", {})
        return "" if judged else run_outcome(view.log)
    return _no_verdict(view)


def _no_verdict(view: RunView) -> str:
    """Return that a run has ended before its validation, and after how many of its points."""
    plan = view.log.plan
    if plan is None or view.live or view.state == "idle":
        return ""
    if all(step["name"] != "validate" for step in plan.steps):
        return ""
    measured = min(sum(map(len, view.measured.values())), plan.points)
    return f"no verdict: {measured} of {plan.points} points"
