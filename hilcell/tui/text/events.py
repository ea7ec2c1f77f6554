"""The newest events in the words of the work, not of the journal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from textual.content import Content

from hilcell.clean import harmless
from hilcell.journal.journal import Record
from hilcell.journal.old_keys import id_of_key
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.text.plot_figures import section
from hilcell.tui.text.tables import record_words
from hilcell.tui.text.words import point_words

ORDINALS = {1: "1st", 2: "2nd", 3: "3rd"}
HIDDEN = ("state", "plan", "frame")  # kinds that other lines tell
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
    body = record.body
    if record.kind == "point":
        return _measured(view, record, errors_mm)
    if record.kind == "intent":
        return _sent(view, record)
    if record.kind == "event":
        return _happened(view, record)
    if record.kind == "state" and body.get("machine") == "run":
        reason = str(body.get("reason") or "").replace("\n", " ")
        return f"the run is {body.get('to')}{f': {reason}' if reason else ''}"
    return "" if record.kind in HIDDEN else record_words(record)


def _measured(view: RunView, record: Record, errors_mm: Mapping[str, float]) -> str:
    point = view.log.points.get(record.key)
    if point is None:
        return f"measured {record.key}"
    error_mm = errors_mm.get(record.key)
    size = "" if error_mm is None else f": |e| {error_mm:.3f} mm"
    again = " again" if record.body.get("retaken") else ""
    return f"measured {point_words(point.id, point.station)}{again}{size}"


def _sent(view: RunView, record: Record) -> str:
    body, action = record.body, str(record.body.get("action", ""))
    if action in MOTIONS:
        return MOTIONS[action]
    if action == "rail.approach":
        return f"rail sent to {body.get('station')}"
    if action == "robot.sweep":
        return f"robot turns A{body.get('axis')} slowly: {record.key}"
    if action != "robot.move" or not record.key:
        return record_words(record)
    point = view.log.points.get(record.key)  # none yet, mostly: its key is all that is known
    id = id_of_key(record.key) if point is None else point.id
    return f"robot sent to {point_words(id)}"


def _happened(view: RunView, record: Record) -> str:
    body = record.body
    match body.get("what"):
        case "step":
            return f"step {body.get('number')} of {body.get('of')} begins: {body.get('name')}"
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
    return record_words(record)


def _mm(value: Any, digits: int) -> str:
    return f"{value:.{digits}f} mm" if isinstance(value, int | float) else "?"
