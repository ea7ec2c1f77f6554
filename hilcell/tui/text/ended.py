"""How a run has ended, in one line: the result that it states, or that it has no verdict."""

from __future__ import annotations

from hilcell.clean import harmless
from hilcell.journal.outcome import run_outcome
from hilcell.tui.engine.run_view import RunView


def end_remark(view: RunView) -> str:
    """Return the result in words, else the outcome, else that there is no verdict.

    Nothing where the validation's verdict is shown, or the run has not ended.
    """
    if view.state in ("done", "intolerant"):
        judged = "validation" in (view.log.end or {}).get("result", {})
        return "" if judged else _result_words(view) or run_outcome(view.log)
    return _no_verdict(view)


def _result_words(view: RunView) -> str:
    """Return the result of a procedure that states it in words; nothing of another's."""
    result = (view.log.end or {}).get("result", {})
    found = result.get("recheck", result.get("targets"))
    text = found.get("text") if isinstance(found, dict) else None
    return harmless(text) if isinstance(text, str) else ""


def _no_verdict(view: RunView) -> str:
    """Return that a run has ended before its validation, and after how many of its points."""
    plan = view.log.plan
    if plan is None or view.live or view.state == "idle":
        return ""
    if all(step["name"] != "validate" for step in plan.steps):
        return ""
    measured = min(sum(map(len, view.measured.values())), plan.points)
    return f"no verdict: {measured} of {plan.points} points"
