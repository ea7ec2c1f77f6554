"""The newest events in the words of the work, not of the journal."""

from __future__ import annotations

from collections.abc import Mapping

from textual.content import Content

from hilcell.clean import harmless
from hilcell.journal.event_words import after, happened_words, length_words
from hilcell.journal.journal import Record
from hilcell.journal.key_words import in_words, key_words, verdict_words
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.text.lines import section

MOTIONS = {"robot.park": "robot sent to its safe pose", "rail.home": "rail sent to its reference"}


def event_lines(
    view: RunView, errors_mm: Mapping[str, float], width: int, height: int
) -> list[Content]:
    """Return a heading and the newest events, newest first; ``errors_mm`` are |e| by point."""
    lines = [section("newest events", width)]
    for record in reversed(view.records):
        if len(lines) >= height:
            break
        if words := event_words(view, record, errors_mm):
            style = "$foreground" if len(lines) == 1 else "$label"
            line = Content.assemble((f" {record.t[11:19]}  ", "$label"), (harmless(words), style))
            lines.append(line.truncate(width, ellipsis=True))
    return lines


def event_words(view: RunView, record: Record, errors_mm: Mapping[str, float]) -> str:
    """Return an event in words; nothing for what other lines of the screen tell."""
    body, log = record.body, view.log
    match record.kind:
        case "point":
            return _measured(view, record, errors_mm)
        case "intent":
            return _sent(view, record)
        case "event":
            return happened_words(body, log)
        case "verdict":
            return _judged(record)
        case "end":
            return f"the session has ended: {body.get('state')}, exit {body.get('exit')}"
        case "state" if body.get("machine") == "run":
            reason = in_words(str(body.get("reason") or "").replace("\n", " "), log)
            return f"the run is {body.get('to')}{after(reason)}"
    return ""


def _measured(view: RunView, record: Record, errors_mm: Mapping[str, float]) -> str:
    error_mm = errors_mm.get(record.key)
    size = "" if error_mm is None else f": |e| {error_mm:.3f} mm"
    again = " again" if record.body.get("retaken") else ""
    return f"measured {key_words(record.key, view.log)}{again}{size}"


def _sent(view: RunView, record: Record) -> str:
    body, action = record.body, str(record.body.get("action", ""))
    if action in MOTIONS:
        return MOTIONS[action]
    if action == "rail.approach":
        return f"rail sent to {body.get('station')}"
    words = in_words(record.key, view.log)
    if action == "robot.sweep":
        return f"robot begins the {words}"
    if action == "robot.move":
        return f"robot sent to {words}"
    return f"{action.replace('.', ' ')} {words}".strip()


def _judged(record: Record) -> str:
    """Return a verdict: its subject, whether it holds, and the mean error that it is about."""
    body, words = record.body, verdict_words(record.key)
    mean_mm, limit_mm = body.get("mean_mm"), body.get("mean_tolerance_mm")
    figures = (
        ""
        if limit_mm is None
        else f": mean {length_words(mean_mm, 3)}, limit {length_words(limit_mm, 3)}"
    )
    return f"{words} {'holds' if body.get('holds') else 'does not hold'}{figures}"
