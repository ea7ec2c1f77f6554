"""Rows that a tall terminal has under the points: interlocks with readings, next steps, events.

Where rows are few the events go first, then the next steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from operator import attrgetter

from textual.content import Content

from hilcell.clean import harmless
from hilcell.journal.journal import Record
from hilcell.journal.times import in_zone
from hilcell.journal.words import happened_words, in_words, key_words, step_words, verdict_words
from hilcell.model.events import Event, OtherEvent, after
from hilcell.model.point import Point
from hilcell.model.records import Ended, Intended, StateChanged
from hilcell.model.verdicts import Verdict
from hilcell.run.forecast import Ahead
from hilcell.run.protocol import DeviceStatus
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import Cell, Col, Fitting, Grid, Lines, Stack, Text, section
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.devices import NAMES, locks
from hilcell.tui.text.run import duration

MOTIONS = {
    "robot.park": "robot sent to its safe pose",
    "robot.move": "robot sent to {point}",
    "robot.sweep": "robot begins the {point}",
    "rail.home": "rail sent to its reference",
    "rail.approach": "rail sent to {station}",
}


def event_lines(view: RunView, errors_mm: Mapping[str, float], rows: int) -> list[Lines | Text]:
    """Return a heading and the newest events, newest first; ``errors_mm`` are |e| by point."""
    zone = f"{in_zone(view.records[-1].t):%Z}" if view.records else ""
    events: list[list[Cell]] = []
    for record in reversed(view.records):
        if len(events) >= rows - 1:
            break
        if words := event_words(view, record, errors_mm):
            style = "$label" if events else "$foreground"
            time = f" {in_zone(record.t):%H:%M:%S} "
            events.append([(time, "$label"), (harmless(words), style)])
    return [section("newest events", zone), Grid(events, Col(), Col(grows=True))]


def event_words(view: RunView, record: Record, errors_mm: Mapping[str, float]) -> str:
    """Return an event in words; nothing for what other lines of the screen tell."""
    log = view.log
    match record.fact:
        case Point() as point:
            error_mm = errors_mm.get(point.key)
            size = "" if error_mm is None else f": |e| {error_mm:.3f} mm"
            return f"measured {key_words(point.key, log)}{' again' * point.retaken}{size}"
        case Intended(action=action, station=station):
            place = in_words(record.key, log)
            if action in MOTIONS:
                return MOTIONS[action].format(station=station, point=place)
            return f"{action.replace('.', ' ')} {place}".strip()
        case Event() | OtherEvent() as event:
            return happened_words(event, log)
        case Ended(state=state, exit=code):
            return f"the session has ended: {state}, exit {code}"
        case StateChanged(machine="run", to=to, reason=reason):
            return f"the run is {to}{after(in_words(reason.replace(chr(10), ' '), log))}"
        case Verdict(holds=holds) as verdict:
            figures = "".join(
                f": {each.name} {each.value:.3f} {each.unit}, limit {each.limit:.3f} {each.unit}"
                for each in verdict.figures[:1]
                if each.value is not None and each.limit is not None
            )
            return f"{verdict_words(record.key)} {'holds' if holds else 'does not hold'}{figures}"
    return ""


MOST_STEPS, MOST_EVENTS = 5, 6
PARTS = {
    "flange": "{step}: {count} points",
    "sweep": "{step}: {count} sweeps",
    "leg": "Rail to the next station",
}


def block_rows(height: int, *, live: bool) -> int:
    """Return how many rows the block has on a terminal of this height."""
    spare = min(height - 24, 17 if live else MOST_EVENTS + 1)  # 24: all above it
    return spare if spare >= 4 else 0


def below_lines(view: RunView, errors_mm: Mapping[str, float], glyphs: Glyphs, rows: int) -> Lines:
    """Return the block in at most so many rows; a run that is over has events alone."""
    parts: list[Lines | Text] = []
    if view.live:
        found = locks(view, glyphs)
        parts, rows = interlock_lines(view, glyphs), rows - 1 - max(len(found), 1)
        if rows > 1:
            parts += step_lines(view, glyphs, rows)
            rows -= 1 + max(min(len(_parts(view)), MOST_STEPS), 1)
    if rows > 1:
        parts += event_lines(view, errors_mm, min(rows, MOST_EVENTS + 1))
    return Stack(*parts)


def interlock_lines(view: RunView, glyphs: Glyphs) -> list[Lines | Text]:
    """Return each condition of motion with its reason, or with the reading that frees it.

    A reason that is too long for its line is the short one: no figure is cut.
    """
    found = locks(view, glyphs)
    if not found or view.status is None:
        return [section("interlocks"), (f" {glyphs.stale} no reading", "$stale")]
    rows: list[list[Cell]] = []
    for each in found:
        whys = (
            (each.whole, each.short) if each.whole else (_reading(each.name, view.status.devices),)
        )
        why = Fitting(tuple(Content.styled(text, "$label") for text in whys))
        rows.append([(f" {each.shape}", each.tone), (each.name, "bold"), each.word, why])
    return [section("interlocks"), Grid(rows, Col(2), Col(7), Col(6), Col(grows=True))]


def _reading(name: str, devices: Mapping[str, DeviceStatus]) -> str:
    """Return the last readings of the devices that a condition is about."""
    text = {device: status.text for device, status in devices.items() if status.text}
    if name == NAMES["robot move"]:
        strip = f", strip {text['strip']}" if "strip" in text else ""
        return f"slide {text['rail']}{strip}" if "rail" in text else ""
    if name == NAMES["rail move"]:
        return f"robot {text['robot']}" if "robot" in text else ""
    return f"last reading {text['tracker']}" if "tracker" in text else ""


def step_lines(view: RunView, glyphs: Glyphs, rows: int) -> list[Lines | Text]:
    """Return the step under way and those after it, when each starts and how long it takes."""
    heading, starts_s, steps = section("next steps", "starts in   takes"), 0.0, []
    for n, (words, takes_s) in enumerate(_parts(view)[: min(rows - 1, MOST_STEPS)]):
        start = "now" if n == 0 else duration(starts_s)
        style = "$foreground" if n == 0 else "$label"
        shape = glyphs.moving if n == 0 and not view.at_rest else " "
        steps.append(
            ((f" {shape}", "$live"), (words, style), (start, style), (duration(takes_s), style), "")
        )
        starts_s += takes_s
    if not steps:
        return [heading, ("   not known yet", "$label")]
    columns = Col(2), Col(grows=True), Col(8, right=True), Col(8, right=True), Col(1)
    return [heading, Grid(steps, *columns)]


def _parts(view: RunView) -> list[tuple[str, float]]:
    """Return the parts of the step under way, then one for each step after it, in words."""
    plan = view.log.plan
    if plan is None:
        return []
    found: list[tuple[str, float]] = []
    for number, parts in groupby(view.ahead, key=attrgetter("step")):
        step = step_words(plan.steps[number - 1].name, has_rail=view.has_rail)
        if found:
            found.append((step, sum(part.takes_s for part in parts)))
        else:
            for part in _merged([*parts]):
                other = "{step}: {count} readings" if part.measured else "{step}"
                words = PARTS.get(part.kind, other).format(step=step, count=part.measured)
                found.append((words, part.takes_s))
    return found


def _merged(parts: Sequence[Ahead]) -> list[Ahead]:
    """Return the parts that are listed; checks between two count for the one before them."""
    found: list[Ahead] = []
    for part in parts:
        same = bool(found) and part.kind == found[-1].kind
        if found and (same or part.kind not in PARTS):
            before = found[-1]
            count = before.measured + (part.measured if same else 0)
            found[-1] = replace(before, measured=count, takes_s=before.takes_s + part.takes_s)
        else:
            found.append(part)
    return found
