"""Rows 5 and 6 of the run's screen: lamps with the age of their readings, air, and interlocks."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from textual.content import Content

from hilcell.alarms.alarm import DRIFT_LIMIT_K
from hilcell.journal.labels import local_time_text, time_text, with_labels
from hilcell.journal.states import WAITING
from hilcell.model.events import NOT_KNOWN
from hilcell.run.control import DeviceStatus, Interlock
from hilcell.tui.layout import BLANK, Col, Fitting, Grid, Lines, ends
from hilcell.tui.run_view import RunView
from hilcell.tui.terminal import Glyphs


def end_note(view: RunView) -> str:
    """Return the outcome, else that there is no verdict and after how many points.

    Nothing where the validation's verdict is shown, or the run has not ended.
    """
    if view.state in ("done", "intolerant"):
        return "" if "validation" in view.log.result else view.log.outcome
    plan = view.log.plan
    if plan is None or view.live or view.state == "idle":
        return ""
    if all(step.name != "validate" for step in plan.steps):
        return ""
    measured = min(sum(map(len, view.measured.values())), plan.points)
    return f"no verdict: {measured} of {plan.points} points"


REASONS = {  # in short, by the code of the interlock; the whole one is on the interlocks' page
    "HC-B30": "no fresh robot reading",
    "HC-B31": "robot moves",
    "HC-B32": "robot not at safe pose",
    "HC-R40": "no fresh rail reading",
    "HC-R41": "slide moves",
    "HC-R42": "drive has power",
    "HC-S05": "slide not at its station",
}
NAMES = {"rail move": "Rail", "robot move": "Robot", "measurement": "Tracker"}


def device_names(view: RunView) -> tuple[str, ...]:
    return (*(("rail", "strip") if view.has_rail else ()), "robot", "tracker")


def lamps(view: RunView, glyphs: Glyphs) -> Lines:
    """Return the lamps with the age of their readings, and the air."""
    devices = view.status.devices if view.status is not None and view.live else {}
    drawn = [
        lamp(name, devices.get(name, DeviceStatus()), view, glyphs) for name in device_names(view)
    ]
    columns = Col(13), *[Col(14)] * (len(drawn) - 2), Col(), Col(1, right=True, grows=True)
    return Grid([[*drawn, air(view, glyphs)]], *columns)


def lamp(name: str, device: DeviceStatus, view: RunView, glyphs: Glyphs) -> Content:
    """Return one lamp; a stale reading is grey and shows its age."""
    title = name.capitalize()
    if device.state == "lost":
        return Content.styled(f"{glyphs.lost} {title} lost", "bold $fault")
    if device.age_s is None:
        return Content.styled(f"{glyphs.stale} {title} -", "$stale")
    age_s = device.age_s + view.status_age_s
    aged, age = not age_s <= 5.0, short_age(age_s)
    if device.state not in ("fresh", "moving") or view.stale or aged:
        return Content.styled(f"{glyphs.stale} {title} {age}", "$stale")
    moves = device.state == "moving"
    shape, tone = (glyphs.moving, "$live") if moves else (glyphs.fresh, "$passed")
    return Content.assemble((shape, tone), f" {title} ", (age, "$label"))


def short_age(seconds: float) -> str:
    """Return an age in at most five columns."""
    if not seconds < math.inf:
        return "?"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    for size_s, unit in ((1, "s"), (60, "m"), (3600, "h")):
        if seconds / size_s < 99.5:
            return f"{seconds / size_s:.0f} {unit}"
    return f"{seconds / 86400:.0f} d"


def air(view: RunView, glyphs: Glyphs) -> Content:
    """Return the air's temperature at the tracker, and its drift since the first point."""
    if view.last is None:
        return BLANK
    celsius, measured_c = view.last.temperature_c, view.log.temperatures_c()
    if celsius is None or not measured_c:
        return Content.styled("air not measured", "$label")
    drift_k = celsius - measured_c[0]
    text = f"{celsius:.1f} {glyphs.degree}C {drift_k:+z.1f} K".replace("-", "−")
    if abs(drift_k) <= DRIFT_LIMIT_K:
        return Content(text)
    return Content.styled(f"{glyphs.warned} {text}", "$ask")


def interlocks(view: RunView, glyphs: Glyphs) -> Lines:
    """Return what may move and, in short, why not; of a run that is over, that nothing may."""
    if not view.live:
        closed = Fitting((*_nothing_moves(view, glyphs), BLANK))
        return Grid([(closed, end_note(view))], Col(grows=True), Col(), gap=3)
    locked = locks(view, glyphs)
    if not locked:
        known = view.status is not None and bool(view.status.interlocks)
        age = f" for {short_age(view.status_age_s)}" if known else ""
        return ends((f"{glyphs.stale} interlocks: no reading{age}", "$stale"), "")
    parts = [
        Content.assemble((each.shape, each.tone), f" {each.name} {each.word}") for each in locked
    ]
    if why := locked[0].short:
        parts[0] = parts[0].append(Content.styled(f": {why}", locked[0].tone))
    columns = Col(43), *[Col(14)] * (len(parts) - 2), *[Col()] * (len(parts) > 1)
    return Grid([parts], *columns)


def _nothing_moves(view: RunView, glyphs: Glyphs) -> list[Content]:
    """Return that nothing may move, the longest words first."""
    if view.state == "gone":
        gone = "the run process has died: cell unsupervised"
        return [Content.styled(f"{glyphs.lost} {gone}", "$ask")]
    end = view.records[-1] if view.records and view.log.end is not None else None
    at = [f" at {time_text(end.t)}", f" at {local_time_text(end.t)}"] if end is not None else []
    known = end is None or view.log.was_connected
    words = "devices closed{}; nothing may move" if known else f"closed{{}}; {NOT_KNOWN}"
    texts = (f"{glyphs.stale} {words.format(each)}" for each in (*at, ""))
    return [Content.styled(each, "$label") for each in texts]


@dataclass(frozen=True, slots=True)
class Lock:
    """One interlock, alike wherever it is shown; ``short`` and ``whole`` say why, "" where free."""

    name: str
    word: str
    shape: str
    tone: str
    short: str = ""
    whole: str = ""

    @classmethod
    def of(cls, each: Interlock, person: str, glyphs: Glyphs) -> Lock:
        name = NAMES.get(each.name, each.name)
        if not each.blocked and not person:
            return cls(name, "free", glyphs.moving, "$live")
        first = each.blocked.partition(",")[0]  # of an engine that states no code
        first = first if len(first) <= 26 else "see the interlocks"
        short = person or REASONS.get(each.code) or first
        # The signs of figures as they are printed.
        signed = re.sub(r"(?<![\w.])-(?=\d)", "−", each.blocked.replace("+-", "±"))
        whole = "; ".join(filter(None, (person, signed)))
        if each.name == "measurement":
            why = short.removeprefix("waits "), whole.removeprefix("waits ")
            return cls(name, "waits", glyphs.stale, "$label", *why)
        return cls(name, "locked", glyphs.locked, "$ask" if person else "$label", short, whole)


def locks(view: RunView, glyphs: Glyphs) -> list[Lock]:
    """Return the interlocks as they are now; none where that is not known."""
    if view.status is None or view.stale or not view.live:
        return []
    person = ""  # why one has to act before anything moves, unless the step goes on itself
    if view.prompt is not None or view.state in WAITING:
        is_paused = view.prompt is None and view.state != "suspended"
        person = "paused" if is_paused else "waits for the operator"
    return [Lock.of(each, person, glyphs) for each in view.status.interlocks]


def interlock_text(view: RunView, glyphs: Glyphs) -> Content:
    """Return element 15 whole: each condition, then each device's last reading."""
    status = view.status
    if status is None or not view.live:
        return Content("No engine is at work on this run: nothing can move from here.")
    lines = [
        Content.assemble(
            (f"{each.shape} {each.name} {each.word}", f"bold {each.tone}"),
            f": {each.whole}" if each.whole else "",
        )
        for each in locks(view, glyphs)
    ] or [Content.styled(f"{glyphs.stale} no reading", "$stale")]
    lines.append(BLANK)
    for name in device_names(view):
        device = status.devices.get(name, DeviceStatus())
        head = lamp(name, device, view, glyphs)
        detail = device.reason or device.text
        lines.append(head.append(f"   {with_labels(detail, view.log)}" if detail else ""))
    words = (
        "These interlocks protect the measurement. They are no safety function: guards, "
        "enabling switch and E-stop work without hilcell."
    )
    return Content("\n").join([*lines, BLANK, Content.styled(words, "$label")])
