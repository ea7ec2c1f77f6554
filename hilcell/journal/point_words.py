"""Procedures, steps and points in words: *corrected target 50 at S300*.

Keys such as ``validate/S300/chosen/049`` are for files and commands. Targets count from 1.
"""

from __future__ import annotations

from typing import NamedTuple

from hilcell.journal.ways_sent import TEXTS, Sent
from hilcell.model.point import CONTROL, PointId

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
    "two-face": "Tracker in both faces",
    "reflectors": "Reflectors compared",
    "two-face-closing": "Tracker in both faces, at the end",
    "iso9283": "ISO 9283 test",
}
_WITHOUT_RAIL = {"home": "Park the robot"}


class Kind(NamedTuple):
    """A kind of points: one of them, one in few letters, and all of them, as they are counted."""

    one: str
    short: str
    all: str


KINDS = {
    "world": Kind("floor nest", "nest", "floor nests"),
    "control": Kind("check of floor nest", "check", "checks of the floor nests"),
    "length": Kind("scale: nest", "scale", "nests of certified lengths"),
    "back": Kind("second face: nest", "back", "nests in the second face"),
    "reflector": Kind("compared: reflector of", "compare", "reflectors in the same nest"),
    "held": Kind("proof of the hold: nest", "held", "proofs of the hold"),
    "slide": Kind("slide nest", "nest", "slide nests"),
    "three": Kind("slide nest", "nest", "slide nests, one reading"),
    "six": Kind("slide nest, all once more", "nest", "slide nests, all once more"),
    "survey": Kind("rail survey", "survey", "rail survey"),
    "repeat": Kind("approach of the station", "approach", "approaches of the station"),
    "touch": Kind("touched pose", "touch", "touched poses"),
    "base": Kind("base circle", "base", "base circles"),
    "frames": Kind("repeated base circle", "circle", "repeated base circles"),
    "grid": Kind("grid point", "grid", "grid points"),
    "oriented": Kind("turned grid point", "turned", "grid points, turned tool"),
    "pose": Kind("chosen pose", "pose", "chosen poses"),
    "repeatability": Kind("repeated pose", "repeat", "repeated poses"),
    "revisit": Kind("revisited pose", "revisit", "revisited poses"),
    "closing": Kind("closing pose", "closing", "closing poses"),
    "reversal": Kind("reversed pose", "reverse", "reversed poses"),
    "recheck": Kind("re-checked target", "target", "re-checked targets"),
    "target": Kind("target", "target", "targets"),
    "targets": Kind("target", "target", "targets"),
    "sweep": Kind("sweep of", "sweep", "sweeps"),
    "validate": Kind("target", "target", "targets"),
    "sign": Kind("sign check", "sign", "sign check"),
    "iso9283": Kind("ISO 9283 pose", "pose", "ISO 9283 poses"),
    "campaign": Kind("recorded pose", "pose", "recorded poses"),
}
SIDES = {"one_side": "from one side", "random": "from random sides"}
HOLDS = {"plain": "drive alone", "strip": "by the strip"}
_DETAILS = TEXTS | SIDES | HOLDS  # of `PointId.how` and `PointId.way`
_SHORT: dict[str, str] = {way: way.short for way in Sent}
NEST_KINDS = ("world", "control", "length", "back", "reflector", "held", "slide", "three")
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
        return f"{TEXTS.get(id.how, id.how)} targets{where}"
    return where.removeprefix(" ")


def target_words(place: str) -> str:
    """Return where targets were judged, a station or all others together."""
    return "at the other stations" if place == OTHERS else f"at {place}"


def point_words(id: PointId, station: str = "") -> str:
    """Return a point in words; ``station``: where it was measured, if its name does not say it."""
    at = id.station or station
    where = f" at {at}" if at else ""
    if id.kind == "validate":
        return f"{_target(id)}{where}" + (f", {Sent.IDW.text}" if id.how == Sent.IDW else "")
    if id.kind == "sign":
        return f"sign check {TEXTS.get(id.how, id.how)}{where}"
    return f"{_kind(id).one} {_which(id)}".rstrip() + where


def short_words(id: PointId) -> str:
    """Return a point in few letters, without its station: *corrected 50*."""
    if id.kind == "validate":
        return f"{_SHORT.get(id.how, id.how)} {_counted(id)}"
    if id.kind == "sign":
        return f"sign {_SHORT.get(id.how, id.how)}"
    return f"{_kind(id).short} {_which(id)}".rstrip()


def counted_words(id: PointId) -> str:
    """Return the points that are counted with this one: *targets, corrected*."""
    parts = (
        _kind(id).all,
        "" if id.place is None else f"place {id.place + 1}",
        _DETAILS.get(id.how, id.how),
        _DETAILS.get(id.way, id.way),
        "" if id.axis is None else f"axis {id.axis}",
        "" if id.seat is None else "other reflectors",
    )
    return ", ".join(filter(None, parts))


def _kind(id: PointId) -> Kind:
    """Return the kind's words; a procedure of others may have one of its own."""
    return KINDS.get(id.kind, Kind(id.kind, id.kind, id.kind))


def _target(id: PointId) -> str:
    if id.how == Sent.BEFORE:
        return f"target {_counted(id)} {Sent.BEFORE.text}"
    how = "" if id.how == Sent.IDW else f"{TEXTS.get(id.how, id.how)} "
    return f"{how}target {_counted(id)}"


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
        _DETAILS.get(id.way, id.way),
        _DETAILS.get(id.how, id.how),
        "" if id.axis is None else f"A{id.axis}",
        "" if id.place is None else f"{id.place + 1}",
        _counted(id),
    )
    return " ".join(filter(None, parts))
