"""Events of the journal in the words of the work, for the screen and for the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hilcell.journal.curve_record import CurveRecord
from hilcell.journal.key_words import in_words
from hilcell.journal.link_record import HELD_BY_SDO
from hilcell.journal.log import Log
from hilcell.journal.point_words import step_words
from hilcell.typed import typed

ORDINALS = {1: "1st", 2: "2nd", 3: "3rd"}
NOT_KNOWN = "devices were not all connected, and how they stand is not known"
CLOSINGS = {"closed": "devices closed", "safe stop": "a stop was sent to all devices"}
SAID = {
    "seated": "reflector seated in", "announced": "announced:", "promise": "promise",
    "order": "goes on as session",
}  # fmt: skip
FACTS = {
    "seated": ("place",), "announced": ("motion",), "promise": ("port", "promise", "verdict"),
    "order": ("number",),
}  # fmt: skip
NAMED = {  # events that say which point, station, run or alarms they are about
    "first pass": "first pass of",
    "stream": "recorded",
    "station found held": "rail found held at",
    "no reading": "no reading of",
    "retake asked": "re-measurement asked of",
    "retake refused": "not re-measured:",
    "outlier measured again": "stands out and is measured again:",
    "station decided": "enough targets at",
    "visited once more": "visited once more:",
    "acknowledged": "alarms acknowledged:",
}


def happened_words(body: Mapping[str, Any], log: Log) -> str:
    """Return an event in words, its points by name; "" where there is nothing to say."""
    what = str(body.get("what"))
    match what:
        case "step":
            has_rail = log.plan is None or log.cell.has_rail
            name = step_words(str(body.get("name")), has_rail=has_rail)
            return f"step {body.get('number')} of {body.get('of')} begins: {name}"
        case "station held":
            tries = int(body.get("tries", 1))
            which = ORDINALS.get(tries, f"{tries}th")
            return (
                f"rail held at {body.get('station')}: {length_words(body.get('strip_mm'), 2)} "
                f"by the strip, {which} approach"
            )
        case "tracker proven" | "tracker moved":
            return _tracker(body)
        case "slide proven":
            return f"slide checked by a nest: off {length_words(body.get('off_mm'), 3)}"
        case "connected":
            return "devices connected"
        case "closed" | "safe stop":
            problems = body.get("problems", {})
            left = f", but look at {' and '.join(problems)}" if problems else ""
            moves = what == "closed" and not {"Rail", "Robot"}.isdisjoint(problems)
            return f"{CLOSINGS[what]}{left}{': not seen at rest' if moves else ''}"
        case "link":
            return _wire(body)
        case "curve":
            return f"curve of {typed(body, CurveRecord).words}"
        case "seated" | "announced" | "promise" | "order":
            return " ".join([SAID[what], *(str(body.get(key)) for key in FACTS[what])])
    codes = ", ".join(body.get("codes", ()))
    subject = body.get("key") or body.get("station") or body.get("run") or codes
    words = in_words(" ".join(filter(None, (NAMED.get(what, what), str(subject)))), log)
    return words + after(in_words(str(body.get("reason") or ""), log))


def after(reason: str) -> str:
    """Return a reason as it follows what it is the reason of."""
    return f": {reason}" if reason else ""


def length_words(value: Any, digits: int) -> str:
    """Return a length of a record, which may lack it."""
    return f"{value:.{digits}f} mm" if isinstance(value, int | float) else "?"


def _tracker(body: Mapping[str, Any]) -> str:
    """Return by how much the tracker has moved, and what that costs."""
    if "invalid" not in body:
        moved_mm = max((abs(each) for each in body.get("off_mm", [])), default=None)
        return f"floor nests checked: tracker moved {length_words(moved_mm, 3)}"
    lost = len(body["invalid"])
    again = f"{lost} point{'s are' if lost != 1 else ' is'} measured again"
    return f"tracker moved by {length_words(body.get('moved_mm'), 3)}: {again}"


def _wire(body: Mapping[str, Any]) -> str:
    """Return what was lost on the rail's wire; nothing where all was well."""
    lost = sum(int(body.get(name, 0)) for name in ("bad_lines", "refused", "malformed"))
    found = [f"{lost} of {body.get('frames')} frames lost"] if lost else []
    found += [HELD_BY_SDO] if body.get("held_by_sdo") else []
    return f"rail's wire: {'; '.join(found)}" if found else ""
