"""Texts of alarms and events with every key in them replaced by its words.

Errors name a point by its key: ``measure grid/1-0-0``. Raw keys are for the log and for the details
of a point; everywhere else the screen says *grid point 1-0-0 at S1100*.
"""

from __future__ import annotations

import re
from typing import Any

from hilcell.journal.log import Log
from hilcell.journal.point_words import (
    HOLDS,
    KINDS,
    NEST_KINDS,
    SIDES,
    point_words,
    target_words,
)
from hilcell.model.point import SEAT, PointId
from hilcell.model.verdicts import VALIDATION, verdict_title

_KEY = re.compile(rf"(?<![\w/.])(?:{'|'.join(KINDS)})/[^\s,;:()]*[^\s,;:().]")
_VERDICT = re.compile(r"(?<![\w/])verdict (?P<key>[^\s,;:]*[^\s,;:.])")
_NUMBERED = re.compile(
    rf"(?P<number>\d{{3}})(?P<side>[+-])?|(?P<place>\d)|axis(?P<axis>\d)|{SEAT}(?P<seat>\d{{1,3}})"
)


def in_words(text: str, log: Log) -> str:
    """Return a text with its keys of points and verdicts in words."""
    text = _VERDICT.sub(lambda found: verdict_words(found["key"]), text)
    return _KEY.sub(lambda found: key_words(found[0], log), text)


def key_words(key: str, log: Log) -> str:
    """Return a key in words, with the station where that is known."""
    point = log.points.get(key)
    if point is not None:
        return point_words(point.id, point.station)
    id = id_of(key, log)
    of_grid = id.kind == "grid" and log.plan is not None and not id.station
    return point_words(id, log.cell.grid.station if of_grid else "")


def verdict_words(key: str) -> str:
    """Return the subject of a verdict: *validation at S1100*."""
    if key.startswith(VALIDATION):
        return f"validation {target_words(key.removeprefix(VALIDATION))}"
    return verdict_title(key)


def id_of(key: str, log: Log) -> PointId:
    """Return a point's identity, as far as its key shows it where it is not measured."""
    if key in log.points:
        return log.points[key].id
    kind, *parts = key.split("/")
    stations = {each.name for each in log.cell.station} if log.plan is not None else set()
    found: dict[str, Any] = {}
    rest: list[str] = []
    for part in parts:
        if part in stations:
            found["station"] = part
        elif match := _NUMBERED.fullmatch(part):
            digits = match.groupdict() | {"side": match["side"] and f"{match['side']}1"}
            found |= {name: int(text) for name, text in digits.items() if text}
        elif kind in ("sign", "validate") or part in HOLDS:
            found["how"] = part
        else:
            rest.append(SIDES.get(part, part))
    if kind in NEST_KINDS:  # before it stands how often the nest was measured
        rest = rest[-1:]
    return PointId(kind, target=" ".join(rest), **found)
