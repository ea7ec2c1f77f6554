"""Rows 5 and 6 of the run's screen: lamps with the age of their readings, air, and interlocks."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from textual.content import Content

from hilcell.alarms.alarm import DRIFT_LIMIT_K
from hilcell.journal.labels import local_time_text, time_text, with_labels
from hilcell.language import decimal, marked, tr
from hilcell.model.events import NOT_KNOWN
from hilcell.model.records import WAITING
from hilcell.run.control import DeviceStatus, Interlock
from hilcell.tui.layout import BLANK, Col, Fitting, Grid, Lines, ends
from hilcell.tui.run_view import RunView
from hilcell.tui.terminal import UNICODE, Glyphs

REASONS = {  # in short, by the code of the interlock; the whole one is on the interlocks' page
    "HC-B30": marked("no fresh robot reading"),
    "HC-B31": marked("robot moves"),
    "HC-B32": marked("robot not at safe pose"),
    "HC-R40": marked("no fresh rail reading"),
    "HC-R41": marked("slide moves"),
    "HC-R42": marked("drive has power"),
    "HC-S05": marked("slide not at its station"),
}
TITLES = marked({"rail": "Rail", "strip": "Strip", "robot": "Robot", "tracker": "Tracker"})
NAMES = marked({"rail move": "Rail", "robot move": "Robot", "measurement": "Tracker"})


def short_age(seconds: float) -> str:
    """Return an age in at most five columns."""
    if not seconds < math.inf:
        return "?"
    if seconds < 9.95:
        return decimal(f"{seconds:.1f} s")
    for size_s, unit in ((1, "s"), (60, "m"), (3600, "h")):
        if seconds / size_s < 99.5:
            return f"{seconds / size_s:.0f} {unit}"
    return tr("{days:.0f} d", days=seconds / 86400)


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
            return cls(name, tr("free"), glyphs.moving, "$live")
        first = each.blocked.partition(",")[0]  # of an engine that states no code
        first = first if len(first) <= 26 else tr("see the interlocks")
        short = person or tr(REASONS.get(each.code) or first)
        # The signs of figures as they are printed.
        signed = re.sub(r"(?<![\w.])-(?=\d)", "−", each.blocked.replace("+-", "±"))
        whole = "; ".join(filter(None, (person, signed)))
        if each.name == "measurement":
            why = short.removeprefix("waits "), whole.removeprefix("waits ")
            return cls(name, tr("waits"), glyphs.stale, "$label", *why)
        return cls(name, tr("locked"), glyphs.locked, "$ask" if person else "$label", short, whole)


@dataclass(frozen=True, slots=True)
class DeviceText:
    """The devices of a run as the screen shows them."""

    view: RunView
    glyphs: Glyphs = UNICODE

    def end_note(self) -> str:
        """Return the outcome, else that there is no verdict and after how many points.

        Nothing where the validation's verdict is shown, or the run has not ended.
        """
        view = self.view
        if view.state in ("done", "intolerant"):
            return "" if "validation" in view.log.result else view.log.outcome_text
        plan = view.log.plan
        if plan is None or view.live or view.state == "idle":
            return ""
        if all(step.name != "validate" for step in plan.steps):
            return ""
        measured = min(sum(map(len, view.measured.values())), plan.points)
        return tr(
            "no verdict: {measured} of {points} points", measured=measured, points=plan.points
        )

    def device_names(self) -> tuple[str, ...]:
        return (*(("rail", "strip") if self.view.has_rail else ()), "robot", "tracker")

    def lamps(self) -> Lines:
        view = self.view
        devices = view.status.devices if view.status is not None and view.live else {}
        drawn = [self.lamp(name, devices.get(name, DeviceStatus())) for name in self.device_names()]
        columns = Col(13), *[Col(14)] * (len(drawn) - 2), Col(), Col(1, right=True, grows=True)
        return Grid([[*drawn, self.air()]], *columns)

    def lamp(self, name: str, device: DeviceStatus) -> Content:
        """Return one lamp; a stale reading is grey and shows its age."""
        glyphs = self.glyphs
        title = tr(TITLES.get(name, name.capitalize()))
        if device.state == "lost":
            return Content.styled(
                f"{glyphs.lost} {tr('{device} lost', device=title)}", "bold $fault"
            )
        if device.age_s is None:
            return Content.styled(f"{glyphs.stale} {title} -", "$stale")
        age_s = device.age_s + self.view.status_age_s
        aged, age = not age_s <= 5.0, short_age(age_s)
        if device.state not in ("fresh", "moving") or self.view.stale or aged:
            return Content.styled(f"{glyphs.stale} {title} {age}", "$stale")
        moves = device.state == "moving"
        shape, tone = (glyphs.moving, "$live") if moves else (glyphs.fresh, "$passed")
        return Content.assemble((shape, tone), f" {title} ", (age, "$label"))

    def air(self) -> Content:
        view = self.view
        if view.last is None:
            return BLANK
        celsius, measured_c = view.last.temperature_c, view.log.temperatures_c()
        if celsius is None or not measured_c:
            return Content.styled(tr("air not measured"), "$label")
        drift_k = celsius - measured_c[0]
        text = decimal(f"{celsius:.1f} {self.glyphs.degree}C {drift_k:+z.1f} K").replace("-", "−")
        if abs(drift_k) <= DRIFT_LIMIT_K:
            return Content(text)
        return Content.styled(f"{self.glyphs.warned} {text}", "$ask")

    def interlocks(self) -> Lines:
        """Return what may move and, in short, why not; of a run that is over, that nothing may."""
        view = self.view
        if not view.live:
            closed = Fitting((*self._nothing_moves(), BLANK))
            return Grid([(closed, self.end_note())], Col(grows=True), Col(), gap=3)
        locked = self.locks()
        if not locked:
            known = view.status is not None and bool(view.status.interlocks)
            age = tr(" for {age}", age=short_age(view.status_age_s)) if known else ""
            return ends(
                (
                    f"{self.glyphs.stale} {tr('interlocks: no reading{age}', age=age)}",
                    "$stale",
                ),
                "",
            )
        parts = [
            Content.assemble((each.shape, each.tone), f" {tr(each.name)} {each.word}")
            for each in locked
        ]
        if why := locked[0].short:
            parts[0] = parts[0].append(Content.styled(f": {why}", locked[0].tone))
        columns = Col(43), *[Col(14)] * (len(parts) - 2), *[Col()] * (len(parts) > 1)
        return Grid([parts], *columns)

    def _nothing_moves(self) -> list[Content]:
        """Return that nothing may move, the longest words first."""
        view = self.view
        if view.state == "gone":
            gone = tr("the run process has died: cell unsupervised")
            return [Content.styled(f"{self.glyphs.lost} {gone}", "$ask")]
        end = view.records[-1] if view.records and view.log.end is not None else None
        at = (
            [
                tr(" at {time}", time=time_text(end.t)),
                tr(" at {time}", time=local_time_text(end.t)),
            ]
            if end is not None
            else []
        )
        known = end is None or view.log.was_connected
        texts = (
            tr("devices closed{at}; nothing may move", at=each)
            if known
            else tr("closed{at}; {state}", at=each, state=tr(NOT_KNOWN))
            for each in (*at, "")
        )
        return [Content.styled(f"{self.glyphs.stale} {each}", "$label") for each in texts]

    def locks(self) -> list[Lock]:
        """Return the interlocks as they are now; none where that is not known."""
        view = self.view
        if view.status is None or view.stale or not view.live:
            return []
        person = ""  # why one has to act before anything moves, unless the step goes on itself
        if view.prompt is not None or view.state in WAITING:
            is_paused = view.prompt is None and view.state != "suspended"
            person = tr("paused") if is_paused else tr("waits for the operator")
        return [Lock.of(each, person, self.glyphs) for each in view.status.interlocks]

    def interlock_page(self) -> Content:
        """Return element 15 whole: each condition, then each device's last reading."""
        view = self.view
        status = view.status
        if status is None or not view.live:
            return Content(tr("No engine is at work on this run: nothing can move from here."))
        lines = [
            Content.assemble(
                (f"{each.shape} {tr(each.name)} {each.word}", f"bold {each.tone}"),
                f": {each.whole}" if each.whole else "",
            )
            for each in self.locks()
        ] or [Content.styled(f"{self.glyphs.stale} {tr('no reading')}", "$stale")]
        lines.append(BLANK)
        for name in self.device_names():
            device = status.devices.get(name, DeviceStatus())
            head = self.lamp(name, device)
            detail = device.reason or device.text
            lines.append(head.append(f"   {with_labels(detail, view.log)}" if detail else ""))
        words = tr(
            "These interlocks protect the measurement. They are no safety function: guards, "
            "enabling switch and E-stop work without hilcell."
        )
        return Content("\n").join([*lines, BLANK, Content.styled(words, "$label")])
