"""Procedures, steps and points in words: *corrected target 50 at S300*.

Keys such as ``validate/S300/chosen/049`` are for files and commands. Targets count from 1.
"""

from __future__ import annotations

from hilcell.journal.point_id import CONTROL, PointId
from hilcell.journal.ways_sent import PAPER, SHORT_WAYS, WAYS

_PROCEDURES = {
    "calibrate": "Calibration",
    "recheck": "Re-check",
    "touch": "Touch station",
    "iso9283": "ISO 9283 test",
    "paper": "Paper's campaign",
}
_STEPS = {
    "home": "Home the rail",
    "validate": "Validation",
    "paper-rows": "Paper's rows",
    "closing": "Closing visits",
    "iso9283": "ISO 9283 test",
}
_WITHOUT_RAIL = {"home": "Park the robot"}
KINDS = {
    "world": ("floor nest", "nest"),
    "control": ("check of floor nest", "check"),
    "length": ("scale: nest", "scale"),
    "held": ("proof of the hold: nest", "held"),
    "slide": ("slide nest", "nest"),
    "three": ("slide nest", "nest"),
    "touch": ("touched pose", "touch"),
    "base": ("base circle", "base"),
    "grid": ("grid point", "grid"),
    "pose": ("chosen pose", "pose"),
    "repeatability": ("repeated pose", "repeat"),
    "revisit": ("revisited pose", "revisit"),
    "closing": ("closing pose", "closing"),
    "reversal": ("reversed pose", "reverse"),
    "recheck": ("re-checked target", "target"),
    "target": ("target", "target"),
    "targets": ("target", "target"),
    "sweep": ("sweep of", "sweep"),
}
NEST_KINDS = ("world", "control", "length", "held", "slide", "three")
OTHERS = "others"  # stations that are judged together


def procedure_words(name: str) -> str:
    """Return a procedure's name in words."""
    return _PROCEDURES.get(name, name.replace("-", " ").capitalize())


def step_words(name: str, *, has_rail: bool) -> str:
    """Return a step's name in words; without a rail the robot alone is homed."""
    names = _STEPS if has_rail else _STEPS | _WITHOUT_RAIL
    return names.get(name, name.replace("-", " ").capitalize())


def part_words(id: PointId) -> str:
    """Return the part of a step that a point is of: *corrected targets at S300*; "" for none."""
    if id.group == CONTROL:
        return "floor nests" if id.kind == CONTROL else "slide nests"
    where = f" at {id.station}" if id.station else ""
    if id.kind == "validate":
        return f"{WAYS.get(id.how, id.how)} targets{where}"
    return where.removeprefix(" ")


def target_words(place: str) -> str:
    """Return where targets were judged, a station or all others together."""
    return "at the other stations" if place == OTHERS else f"at {place}"


def point_words(id: PointId, station: str = "") -> str:
    """Return a point in words; ``station``: where it was measured, if its name does not say it."""
    at = id.station or station
    where = f" at {at}" if at else ""
    if id.kind == "validate":
        return f"{_target(id)}{where}" + (f", {PAPER}" if id.how == "idw" else "")
    if id.kind == "sign":
        return f"sign check {WAYS.get(id.how, id.how)}{where}"
    return f"{KINDS.get(id.kind, (id.kind, ''))[0]} {_which(id)}".rstrip() + where


def short_words(id: PointId) -> str:
    """Return a point in few letters, without its station: *corrected 50*."""
    if id.kind == "validate":
        return f"{SHORT_WAYS.get(id.how, id.how)} {_counted(id)}"
    if id.kind == "sign":
        return f"sign {SHORT_WAYS.get(id.how, id.how)}"
    return f"{KINDS.get(id.kind, ('', id.kind))[1]} {_which(id)}".rstrip()


def _target(id: PointId) -> str:
    name = {"before": "target %s as sent", "idw": "target %s", "chosen": "corrected target %s"}
    return name.get(id.how, f"{id.how} target %s") % _counted(id)


def _counted(id: PointId) -> str:
    side = {1: "+", -1: "-"}.get(id.side, "")
    seat = "" if id.seat is None else f", seat {id.seat}"
    return ("" if id.number is None else f"{id.number + 1}{side}") + seat


def _which(id: PointId) -> str:
    """Return all of an identity that is not its kind or its station."""
    parts = (
        id.nest,
        id.target,
        id.pose,
        "-".join(map(str, id.vertex)),
        id.way,
        id.how,
        "" if id.axis is None else f"A{id.axis}",
        "" if id.place is None else f"{id.place + 1}",
        _counted(id),
    )
    return " ".join(filter(None, parts))
