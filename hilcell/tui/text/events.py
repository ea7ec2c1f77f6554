"""The newest events in the words of the work, not of the journal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
from textual.content import Content

from hilcell.clean import harmless
from hilcell.journal.curve_record import CurveRecord
from hilcell.journal.journal import Record
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.text.key_words import in_words, key_words, verdict_words
from hilcell.tui.text.lines import section
from hilcell.tui.text.words import step_words

ORDINALS = {1: "1st", 2: "2nd", 3: "3rd"}
MOTIONS = {"robot.park": "robot sent to its safe pose", "rail.home": "rail sent to its reference"}
CLOSINGS = {"closed": "devices closed", "safe stop": "devices stopped safely"}
NAMED = {  # events that say which point, station or run they are about
    "first pass": "first pass of",
    "stream": "recorded",
    "station found held": "rail found held at",
    "no reading": "no reading of",
    "retake asked": "re-measurement asked of",
    "retake refused": "not re-measured:",
    "outlier measured again": "stands out and is measured again:",
    "visited once more": "visited once more:",
}


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
            return _happened(view, body)
        case "verdict":
            return _judged(record)
        case "end":
            return f"the session has ended: {body.get('state')}, exit {body.get('exit')}"
        case "state" if body.get("machine") == "run":
            reason = in_words(str(body.get("reason") or "").replace("\n", " "), log)
            return f"the run is {body.get('to')}{_after(reason)}"
    return ""


def _after(reason: str) -> str:
    return f": {reason}" if reason else ""


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


def _happened(view: RunView, body: Mapping[str, Any]) -> str:
    what, log = str(body.get("what")), view.log
    match what:
        case "step":
            name = step_words(str(body.get("name")))
            return f"step {body.get('number')} of {body.get('of')} begins: {name}"
        case "station held":
            tries = int(body.get("tries", 1))
            which = ORDINALS.get(tries, f"{tries}th")
            return (
                f"rail held at {body.get('station')}: {_mm(body.get('strip_mm'), 2)} by the strip, "
                f"{which} approach"
            )
        case "tracker proven":
            moved_mm = max((abs(each) for each in body.get("off_mm", [])), default=None)
            return f"floor nests checked: tracker moved {_mm(moved_mm, 3)}"
        case "slide proven":
            return f"slide checked by a nest: off {_mm(body.get('off_mm'), 3)}"
        case "connected":
            return "devices connected"
        case "closed" | "safe stop":
            left = " and ".join(body.get("problems", {}))
            return f"{CLOSINGS[what]}{f', but look at {left}' if left else ''}"
        case "link":
            return _wire(body)
        case "curve":
            return f"curve of {msgspec.convert(body, CurveRecord).words}"
        case "seated":
            return f"reflector seated in {body.get('place')}"
    subject = body.get("key") or body.get("station") or body.get("run") or ""
    words = in_words(" ".join(filter(None, (NAMED.get(what, what), str(subject)))), log)
    return words + _after(in_words(str(body.get("reason") or ""), log))


def _wire(body: Mapping[str, Any]) -> str:
    """Return what was lost on the rail's wire; nothing where all was well."""
    lost = sum(int(body.get(name, 0)) for name in ("bad_lines", "refused", "malformed"))
    return f"rail's wire: {lost} of {body.get('frames')} frames lost" if lost else ""


def _judged(record: Record) -> str:
    """Return a verdict: its subject, whether it holds, and the mean error that it is about."""
    body, words = record.body, verdict_words(record.key)
    mean_mm, limit_mm = body.get("mean_mm"), body.get("mean_tolerance_mm")
    figures = "" if limit_mm is None else f": mean {_mm(mean_mm, 3)}, limit {_mm(limit_mm, 3)}"
    return f"{words} {'holds' if body.get('holds') else 'does not hold'}{figures}"


def _mm(value: Any, digits: int) -> str:
    return f"{value:.{digits}f} mm" if isinstance(value, int | float) else "?"
