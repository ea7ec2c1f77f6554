"""Labels of procedures, steps, points, verdicts, events and times for display.

Errors name a point by its key: ``measure grid/1-0-0``. Keys are for the log and for the details of
a point; elsewhere the screen shows *grid point 1-0-0 at S1100*. Journals are dated in UTC; times of
day are shown in a zone, too.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta, timezone, tzinfo

from msgspec.structs import replace

from hilcell.decoding import Json
from hilcell.journal.log import Log
from hilcell.language import date_text, tr
from hilcell.model.events import Event, OtherEvent, StationAlreadyHeld, StepBegun
from hilcell.model.point import CHECKS, HOLDS, KINDS, SEAT, SIDES, PointId
from hilcell.model.verdicts import OTHERS, VALIDATION, verdict_title


def with_labels(text: str, log: Log) -> str:
    """Return a text with labels in place of keys of points and verdicts."""
    verdict = r"(?<![\w/])verdict ([^\s,;:]*[^\s,;:.])"
    text = re.sub(verdict, lambda found: verdict_label(found[1]), text)
    key = rf"(?<![\w/.])(?:{'|'.join(KINDS)})/[^\s,;:()]*[^\s,;:().]"
    return re.sub(key, lambda found: point_label(found[0], log), text)


def point_label(key: str, log: Log) -> str:
    """Return the label of a point's key, with its station if known."""
    point = log.points.get(key)
    if point is not None:
        return point.id.text(point.station)
    id = point_id(key, log)
    of_grid = id.kind == "grid" and log.plan is not None and not id.station
    return id.text(log.cell.grid.station if of_grid else "")


def verdict_label(key: str) -> str:
    """Return the label of a verdict's key: *validation at S1100*."""
    if key.startswith(VALIDATION):
        place = key.removeprefix(VALIDATION)
        return (
            tr("validation at the other stations")
            if place == OTHERS
            else tr("validation at {station}", station=place)
        )
    return verdict_title(key)


def point_id(key: str, log: Log) -> PointId:
    """Return a point's identity; of an unmeasured point as far as its key has it."""
    if key in log.points:
        return log.points[key].id
    kind, *parts = key.split("/")
    stations = {each.name for each in log.cell.station} if log.plan is not None else set()
    numbered = (
        r"(?P<number>\d{3})(?P<side>[+-])?|(?P<place>\d)|axis(?P<axis>\d)|"
        rf"{SEAT}(?P<seat>\d{{1,3}})"
    )
    fields: Json = {}
    rest: list[str] = []
    for part in parts:
        if part in stations:
            fields["station"] = part
        elif match := re.fullmatch(numbered, part):
            digits = match.groupdict() | {"side": match["side"] and f"{match['side']}1"}
            fields |= {name: int(text) for name, text in digits.items() if text}
        elif kind in ("sign", "validate") or part in HOLDS:
            fields["how"] = part
        else:
            rest.append(SIDES.get(part, part))
    if kind in ("world", "control", *CHECKS, "slide", "three"):  # its nest is the last part
        rest = rest[-1:]
    return PointId(kind, target=" ".join(rest), **fields)


def procedure_label(name: str) -> str:
    special = {
        "calibrate": "Calibration",
        "recheck": "Re-check",
        "touch": "Touch station",
        "iso9283": "ISO 9283 test",
        "paper": "Paper's campaign",
    }
    return tr(special.get(name, name.replace("-", " ").capitalize()))


def step_label(name: str, *, has_rail: bool) -> str:
    without_rail = {
        "home": "Park the robot",
        "hold-station": "No slide to hold",
        "station-frames": "No other stations",
    }
    special = {
        "home": "Home the rail",
        "validate": "Validation",
        "paper-rows": "Paper's rows",
        "closing": "Closing visits",
        "two-face": "Tracker in both faces",
        "reflectors": "Reflectors compared",
        "nests": "Nests and certified lengths",
        "axes": "Axes of the tracker",
        "drift": "Drift of the tracker",
        "two-face-closing": "Tracker in both faces, at the end",
        "iso9283": "ISO 9283 test",
    } | ({} if has_rail else without_rail)
    return tr(special.get(name, name.replace("-", " ").capitalize()))


def event_label(event: Event | OtherEvent, log: Log) -> str:
    """Return an event's text with labels; "" for none."""
    has_rail = log.plan is None or log.cell.has_rail
    if isinstance(event, StepBegun):
        return replace(event, name=step_label(event.name, has_rail=has_rail)).text
    if isinstance(event, StationAlreadyHeld) and not has_rail:
        return ""
    return with_labels(event.text, log)


def in_zone(t: str, zone: tzinfo | None = None) -> datetime:
    """Return a journal's time in a zone, by default the PC's."""
    return datetime.fromisoformat(t).astimezone(zone)


def zone_of(offset_min: int) -> timezone:
    return timezone(timedelta(minutes=offset_min))


def offset_min() -> int:
    """Return the PC's present offset from UTC, minutes."""
    ahead = datetime.now(UTC).astimezone().utcoffset()
    return 0 if ahead is None else round(ahead.total_seconds() / 60)


def local_time_text(t: str, zone: tzinfo | None = None) -> str:
    return f"{in_zone(t, zone):%H:%M:%S %Z}"


def time_text(t: str, zone: tzinfo | None = None) -> str:
    """Return the time of day with its zone, and in UTC if different."""
    ahead = in_zone(t, zone).utcoffset()
    return f"{local_time_text(t, zone)}, {t[11:19]} UTC" if ahead else local_time_text(t, zone)


def period_text(first: str, last: str, zone: tzinfo | None = None) -> str:
    """Return begin and end to the second with the zone, and in UTC if different."""
    begin, end = in_zone(first, zone), in_zone(last, zone)
    same_day = begin.date() == end.date()
    last_day = "" if same_day else f"{date_text(end)} "
    words = tr(
        "{begin} to {end}",
        begin=f"{date_text(begin)} {begin:%H:%M:%S}",
        end=f"{last_day}{end:%H:%M:%S}",
    )
    utc = f" ({first[11:19]} to {last[11:19]} UTC)" if begin.utcoffset() else ""
    return f"{words} {begin:%Z}{utc}"
