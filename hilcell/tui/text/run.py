"""The run's screen as text, from the top: state, run, step, progress, newest point, what follows.

Of the newest point, or the chosen one, |e| alone is large; dx dy dz stand beside it with a signed
bar each, |e| against its limit under it. A value that is old is grey and says so. A tall terminal
has interlocks with readings, next steps and events under the points; where rows are few the events
go first, then the next steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import attrgetter
from typing import ClassVar

from textual.content import Content

from hilcell.alarms.catalogue import SEVERITIES
from hilcell.journal.journal import Record
from hilcell.journal.labels import (
    event_label,
    in_zone,
    local_time_text,
    point_label,
    procedure_label,
    step_label,
    verdict_label,
    with_labels,
)
from hilcell.journal.log import Log
from hilcell.journal.runs import short_run
from hilcell.language import decimal, marked, tr
from hilcell.model.events import Event, OtherEvent, after
from hilcell.model.outcome import Outcome
from hilcell.model.plan import PlannedStep
from hilcell.model.point import CONTROL, HOW, Point, Sent
from hilcell.model.records import Ended, Intended, StateChanged
from hilcell.model.verdicts import Verdict
from hilcell.run.control import DeviceStatus
from hilcell.run.forecast import RemainingSpan
from hilcell.sanitize import harmless
from hilcell.tui.layout import (
    BLANK,
    Bar,
    Cell,
    Col,
    Drawing,
    Fitting,
    Grid,
    Lines,
    Rule,
    SignedBar,
    Stack,
    Text,
    Ticks,
    ends,
    figure,
    large,
    section,
)
from hilcell.tui.plots import step_at_least
from hilcell.tui.run_view import EngineState, RunView
from hilcell.tui.terminal import UNICODE, Glyphs
from hilcell.tui.text.devices import NAMES, DeviceText, short_age
from hilcell.tui.text.points import Deviation, deviation_of

STATES = {
    "looking": (marked("READING"), "label"),
    "idle": (marked("NOT STARTED"), "label"),
    "checking": (marked("CHECKING"), "label"),
    "running": (marked("RUNNING"), "live"),
    "pausing": (marked("PAUSING"), "ask"),
    "paused": (marked("PAUSED"), "ask"),
    "suspended": (marked("NEEDS OPERATOR"), "ask"),
    "stopping": (marked("STOPPING"), "fault"),
    "done": (marked("DONE"), "passed"),
    "intolerant": (marked("OUT OF TOLERANCE"), "fault"),
    "aborted": (marked("ABORTED"), "label"),
    "fault": (marked("FAULT"), "fault"),
    "refused": (marked("REFUSED"), "fault"),
    "silent": (marked("NO ANSWER"), "fault"),
    "unreadable": (marked("UNREADABLE"), "fault"),
    "gone": (marked("ENGINE LOST"), "fault"),
}
NOT_E_STOP = marked("software stop, not the E-stop")


def badge(text: str) -> Content:
    """Return a quiet block: no state, but to be seen."""
    return Content.styled(f" {text} ", "bold $foreground on $badge")


def simulation_block() -> Content:
    """Return the mark of a simulated run, in a colour that nothing else has."""
    edge = "$on-sim 60% on $sim-fill"
    return Content.assemble(
        ("▒", edge), (tr(" SIMULATION "), "bold $on-sim on $sim-fill"), ("▒", edge)
    )


def _labelled(name: str, value: str, most: int) -> Content:
    """Return a value of so many columns at most, which leaves room for others on its line."""
    return Content.assemble((f"{name} ", "$label"), Content(value).truncate(most, ellipsis=True))


def planned_sweeps(steps: Sequence[PlannedStep]) -> int:
    spans = [span for step in steps for span in step.spans]
    return sum(span.measured for span in spans if span.kind == "sweep")


def duration(seconds: float) -> str:
    """Return a duration as M:SS, or H:MM:SS."""
    if not math.isfinite(seconds):
        return "-:--"
    minutes, second = divmod(max(round(seconds), 0), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}" if hours else f"{minute}:{second:02d}"


def moves(*, has_rail: bool) -> str:
    """Return the beginning of a sentence: robot and rail will move."""
    return tr("The robot and the rail will move") if has_rail else tr("The robot will move")


def resume_text(view: RunView | None) -> str:
    if view is not None and view.calibration_lost:
        return tr("Its calibration file is written; nothing moves.")
    what = moves(has_rail=view is None or view.has_rail)
    if view is not None and any(alarm.ended for alarm in view.alarms):
        return tr(
            "{what}. Its fault requires a new run: resumed, it will most likely fault again.",
            what=what,
        )
    return tr(
        "{what}: the devices are connected again, and the tracker's control points verified "
        "before anything counts.",
        what=what,
    )


DeviationOf = Callable[[Log, Point], Deviation | None]
OUTCOME_STYLES: dict[Outcome, tuple[str, str, str, str]] = {  # role, shape, text, text if old
    Outcome.ACCEPTED: ("passed", "fresh", Outcome.ACCEPTED.text, marked("was in tol.")),
    Outcome.UNDECIDED: ("ask", "warned", marked("UNDECIDED"), marked("was undecided")),
    Outcome.REJECTED: ("fault", "warned", marked("OUT OF TOLERANCE"), marked("was out of tol.")),
}


@dataclass(frozen=True, slots=True)
class Shown:
    """The point that is drawn: its deviation, its name, and whether it is too old to be bright."""

    FULL_ROWS: ClassVar = 6
    SMALL_ROWS: ClassVar = 3
    STALE_S: ClassVar = 30.0  # two points of a run are rarely so far apart

    RAW_SCALE_MM: ClassVar = 2.0  # of the signed bars, where there is no limit
    LEAST_LARGE: ClassVar = 41  # columns
    TO_LIMIT: ClassVar = 0.8  # of the tolerance bar

    @classmethod
    def rows_for(cls, height: int) -> int:
        """Return the rows of the newest point on a terminal of this height."""
        if height < 21:
            return cls.SMALL_ROWS
        return cls.FULL_ROWS - (height < 24)

    name: str
    deviation: Deviation | None
    remark: str  # its age, or why there are no digits
    stale: bool = False
    word: str = ""  # where there is no limit: why

    @classmethod
    def of(
        cls,
        log: Log,
        point: Point,
        which: str,
        deviation: DeviationOf,
        remark: str = "",
        *,
        stale: bool = False,
    ) -> Shown:
        name = f"{which}: {point.id.text(point.station)}"
        word = tr("{how}: no limit", how=tr(HOW.get(point.id.how, Sent.BEFORE.text)))
        return cls(name, deviation(log, point), remark, stale, word)

    @property
    def tone(self) -> str:
        if self.stale or self.deviation is None:
            return "$stale"
        judged = self.deviation.limit_mm is not None
        return f"${OUTCOME_STYLES[self.deviation.outcome][0]}" if judged else "$foreground"

    def large(self, deviation: Deviation, glyphs: Glyphs) -> Lines:
        """Return |e| large, and its components with a signed bar each."""
        # The full scale of the signed bars grows so that no bar is cut.
        least_mm = self.RAW_SCALE_MM if deviation.limit_mm is None else deviation.limit_mm / 2
        known_mm = (abs(each) for each in deviation.error_mm if math.isfinite(each))
        scale_mm = step_at_least(max([least_mm, *known_mm]))
        text = "bold $stale" if self.stale else "bold"
        fill = "$stale" if self.stale else "$foreground"
        units = [(unit, "$label") for unit in ("|e|", "mm", "")]
        digits = large(figure(deviation.norm_mm), self.tone, glyphs)
        components = [
            Content.assemble(
                (f"{name} ", "$label"), (f"{self._signed(value_mm):>6}", text), (" mm", "$label")
            )
            for name, value_mm in zip(("dx", "dy", "dz"), deviation.error_mm, strict=True)
        ]
        bars = [SignedBar(value_mm / scale_mm, fill) for value_mm in deviation.error_mm]
        scale = [(each, "$label") for each in (decimal(f"±{scale_mm:g}"), "mm", "")]
        rows = zip(("", "", ""), units, digits, components, bars, scale, strict=True)
        return Grid(rows, Col(), Col(3), Col(21), Col(14), Col(28), Col())

    def one_line(self, deviation: Deviation) -> Content:
        dx, dy, dz = map(self._signed, deviation.error_mm)
        return Content.assemble(
            " ",
            (f"|e| {figure(deviation.norm_mm)} mm", f"bold {self.tone}"),
            (
                tr("   dx {dx}  dy {dy}  dz {dz}", dx=dx, dy=dy, dz=dz),
                "$stale" if self.stale else "$label",
            ),
        )

    def tolerance(self, deviation: Deviation, glyphs: Glyphs) -> list[list[Cell]]:
        """Return what is said of the limit with |e| against it, and under it the scale and U."""
        if deviation.limit_mm is None:
            words = (f"{glyphs.stale} {self.word}", "$stale" if self.stale else "")
            return [["", words, ""], ["", "", ""]]
        role, shape, word, was = OUTCOME_STYLES[deviation.outcome]
        label = (f"{getattr(glyphs, shape)} {tr(word)}", f"bold ${role}")
        if self.stale:
            label = (f"{glyphs.stale} {tr(was)}", "$stale")
        share, guard = (
            self.TO_LIMIT * each / deviation.limit_mm
            for each in (deviation.norm_mm, deviation.U_mm)
        )
        bar = Bar(share, self.tone, self.TO_LIMIT, guard)
        digits = 2 if math.isclose(100 * deviation.limit_mm / 4 % 1, 0, abs_tol=1e-9) else 3
        ticks = [(0.0, Content.styled("0", "$label"))]
        for quarter in (1, 2, 3):
            text = decimal(f"{deviation.limit_mm * quarter / 4:.{digits}f}")
            ticks.append((self.TO_LIMIT * quarter / 4, Content.styled(text, "$label")))
        limit = Content.assemble(
            (decimal(f"{deviation.limit_mm:.{digits}f}"), "bold"), (tr(" limit"), "$label")
        )
        ticks.append((self.TO_LIMIT, limit))
        U = (decimal(f"U {deviation.U_mm:.3f} mm"), "$label")
        return [["", label, bar], ["", U, Ticks(tuple(ticks))]]

    @staticmethod
    def _signed(value_mm: float) -> str:
        return (
            decimal(f"{value_mm:+z.3f}").replace("-", "−") if math.isfinite(value_mm) else "-.---"
        )

    @classmethod
    def newest(cls, view: RunView, deviation: DeviationOf = deviation_of) -> Shown:
        """Return the newest point of a live run; never one of an earlier step in bright digits."""
        point = view.newest
        if point is None:
            return cls(tr("no point measured yet"), None, "")
        age_s = view.newest_age_s
        age = (
            tr("{age} ago", age=short_age(age_s))
            if age_s <= cls.STALE_S
            else tr("{age} old", age=short_age(age_s))
        )
        old = view.newest_is_old or not age_s <= cls.STALE_S or view.stale
        which = tr("last point") if view.newest_is_old else tr("newest point")
        return cls.of(view.log, point, which, deviation, age, stale=old)

    @classmethod
    def chosen(
        cls, view: RunView, key: str, deviation: DeviationOf = deviation_of, *, chosen: bool = True
    ) -> Shown:
        """Return that under the table's cursor; not ``chosen``: the cursor was only there."""
        point = view.log.points.get(key)
        if point is None:
            return cls(tr("no point measured yet"), None, "")
        which = tr("chosen point") if chosen else tr("last point")
        return cls.of(view.log, point, which, deviation)

    def lines(self, glyphs: Glyphs, rows: int = FULL_ROWS) -> Lines:
        """Return at most ``rows`` rows; digits are one line where three have no room."""
        deviation, remark = self.deviation, Content.styled(self.remark, "$label")
        if self.stale and self.remark:
            remark = Content.styled(f"{glyphs.warned} {self.remark}", "$ask")
        head = Rule(Content.styled(self.name, "bold $label"), remark)
        if deviation is None:
            none = tr("no nominal place, so no deviation") if self.remark else ""
            return Stack(head, (f" {none}", "$label"), *[BLANK] * (rows - 2))
        tolerance = self.tolerance(deviation, glyphs)
        columns = Col(), Col(17), Col(10, grows=True, most=55)
        small = Stack(head, ends(self.one_line(deviation), ""), Grid(tolerance[:1], *columns))
        if rows < self.FULL_ROWS - 1:
            return small
        whole = Stack(head, self.large(deviation, glyphs), Grid(tolerance[: rows - 4], *columns))
        return Drawing(lambda width, _: (small if width < self.LEAST_LARGE else whole).lines(width))


PARTS = {
    "flange": marked("{step}: {count} points"),
    "sweep": marked("{step}: {count} sweeps"),
    "leg": marked("Rail to the next station"),
}


def block_rows(height: int, *, live: bool) -> int:
    spare = min(height - 24, 17 if live else RunText.MOST_EVENTS + 1)  # 24: all above it
    return spare if spare >= 4 else 0


def _reading(name: str, devices: Mapping[str, DeviceStatus]) -> str:
    """Return the last readings of the devices that a condition is about."""
    text = {device: status.text for device, status in devices.items() if status.text}
    if name == NAMES["robot move"]:
        strip = tr(", strip {position}", position=text["strip"]) if "strip" in text else ""
        return (
            tr("slide {position}{strip}", position=text["rail"], strip=strip)
            if "rail" in text
            else ""
        )
    if name == NAMES["rail move"]:
        return tr("robot {pose}", pose=text["robot"]) if "robot" in text else ""
    return tr("last reading {position}", position=text["tracker"]) if "tracker" in text else ""


def _merged(parts: Sequence[RemainingSpan]) -> list[RemainingSpan]:
    """Return the parts that are listed; checks between two count for the one before them."""
    merged: list[RemainingSpan] = []
    for part in parts:
        same = bool(merged) and part.kind == merged[-1].kind
        if merged and (same or part.kind not in PARTS):
            before = merged[-1]
            count = before.measured + (part.measured if same else 0)
            merged[-1] = replace(before, measured=count, takes_s=before.takes_s + part.takes_s)
        else:
            merged.append(part)
    return merged


@dataclass(frozen=True, slots=True)
class RunText:
    """The screen's texts of a run, from the top."""

    LOUD: ClassVar = ("ask", "fault")  # roles whose states fill the first row
    NO_PLAN_TEXTS: ClassVar = {  # where there is no plan in the journal
        EngineState.UNKNOWN: marked("reading ..."),
        EngineState.NONE: marked("nothing was recorded"),
        EngineState.STARTING: marked("the engine starts ..."),
        EngineState.ANSWERING: marked("nothing to see yet"),
        EngineState.SILENT: marked("nothing to see yet"),
    }
    MOTIONS: ClassVar = {
        "robot.park": marked("robot sent to its safe pose"),
        "robot.move": marked("robot sent to {point}"),
        "robot.sweep": marked("robot begins the {point}"),
        "rail.home": marked("rail sent to its reference"),
        "rail.approach": marked("rail sent to {station}"),
    }
    MOST_STEPS: ClassVar = 5
    MOST_EVENTS: ClassVar = 6

    view: RunView
    glyphs: Glyphs = UNICODE

    def state_label(self) -> tuple[str, str]:
        """Return the state's word and role: of a run that ended with exit 1, its outcome."""
        view = self.view
        if view.state != "intolerant":
            word, role = STATES[view.state]
            return tr(word), role
        words = view.log.outcome_text.partition(";")[0]
        return tr(words).upper(), "ask" if view.log.outcome is Outcome.UNDECIDED else "fault"

    def role(self) -> str:
        """Return the role of the state's colour; RUNNING is not bright without a fresh status."""
        role = self.state_label()[1]
        return "label" if role == "live" and self.view.stale else role

    def banner(self, background: RunView | None = None) -> Lines:
        """Return the first row: state, LIVE or HISTORIC, SIMULATION, a notice; trouble fills it.

        ``background``: the live run that goes on while this one is shown.
        """
        view = self.view
        tone = self.role()
        fill = f"bold $on-{tone} on ${tone}-fill"
        ground = fill if tone in self.LOUD else ""
        parts = [
            Content.styled(f" {self.glyphs.states[view.state]} {self.state_label()[0]} ", fill)
        ]
        if view.engine is not EngineState.UNKNOWN and background is None:
            parts.append(badge(tr("LIVE") if view.live else tr("HISTORIC")))
        if view.simulated:
            parts.append(simulation_block())
        notices, style = self._notices(background), "$label"
        if background is not None or view.state == "silent":
            style = "bold $fault" if background is None else "bold $ask"
        notice = Fitting(tuple(Content.styled(f"{each} ", ground or style) for each in notices))
        left = Content(" ").join(parts)
        return Grid([(left, notice)], Col(), Col(right=True, grows=True), styles={0: ground})

    def _notices(self, background: RunView | None) -> tuple[str, ...]:
        """Return the notices beside the state, the longest first."""
        view = self.view
        if background is not None:
            word = RunText(background, self.glyphs).state_label()[0]
            stop = tr("use the E-stop") if background.state == "silent" else tr("Esc stops")
            return (
                tr("background: {word}; q shows it, {stop}", word=word, stop=stop),
                tr("background: {word}; {stop}", word=word, stop=stop),
                tr("1 in background"),
            )
        if view.state == "silent":
            since = (
                tr(" for {age}", age=short_age(view.status_age_s))
                if view.status is not None
                else ""
            )
            return tr("silent{since}: use the E-stop", since=since), tr("use the E-stop")
        live = view.live or view.state == "looking"
        return (tr(NOT_E_STOP) if live else tr("nothing is connected"),)

    def end_text(self) -> str:
        worst = max(
            self.view.alarms, key=lambda alarm: SEVERITIES.index(alarm.severity), default=None
        )
        why = f": {worst.code} {worst.title}" if worst is not None else ""
        return tr(
            "the background run {run} has ended: {state}{why}",
            run=self.view.run,
            state=self.state_label()[0],
            why=why,
        )

    def identity(self) -> Lines:
        view = self.view
        plan = view.log.plan
        if plan is None:
            begun = tr(self.NO_PLAN_TEXTS[view.engine])
            return ends(tr("run {run}: {trouble}", run=view.run, trouble=view.trouble or begun), "")
        names = {
            tr("cell"): str(plan.cell.get("name", "?")),
            tr("job"): plan.job,
            tr("operator"): plan.operator,
        }
        parts = [Content.styled(procedure_label(plan.procedure), "bold")]
        parts += [_labelled(name, text, 20) for name, text in names.items() if text]
        parts.append(
            Content.styled(tr("unattended") if plan.unattended else tr("attended"), "$label")
        )
        return ends(Content("   ").join(parts), _labelled(tr("run"), short_run(view.run), 14))

    def step(self) -> Lines:
        """Return the current step in words, and how many of its part are measured."""
        view = self.view
        plan, now = view.log.plan, view.step
        if plan is None or not now:
            return ends((tr("no step yet"), "$label"), "")
        name = step_label(now.name, has_rail=view.has_rail)
        words, (taken, planned) = self._part(), self._of_step(now.number)
        if view.state in ("done", "intolerant"):
            words, planned = tr("finished"), plan.points
            taken = min(sum(map(len, view.measured.values())), planned)
        which = tr("Step {number} of {of}  ", number=now.number, of=now.of), "$label"
        head = Content.assemble(which, (name, "bold"), f": {words}" if words else "")
        return ends(
            head,
            (tr("{taken} of {planned}", taken=taken, planned=planned) if planned else "", "bold"),
        )

    def _part(self) -> str:
        """Return the part in progress, by its last point; "" where the count is of others."""
        view = self.view
        if view.last is None or (view.newest_is_old and view.last is view.newest):
            return ""
        of_nests = view.span is not None and view.span.of_nests
        return "" if view.last.id.group == CONTROL and not of_nests else view.last.id.part

    def _of_step(self, number: int) -> tuple[int, int]:
        """Return how many of the part in progress are measured, and planned; of the step else."""
        view = self.view
        if view.span is not None:
            return view.span.taken, view.span.planned
        steps = view.log.plan.steps if view.log.plan is not None else []
        planned = steps[number - 1].points if number <= len(steps) else 0
        if not planned and (sweeps := planned_sweeps(steps[number - 1 : number])):
            return min(len(view.log.streams), sweeps), sweeps
        return min(len(view.measured.get(number, ())), planned), planned

    def progress(self) -> Lines:
        view = self.view
        tone = self.role()
        calm = not view.live and tone != "passed"
        done = Bar(self.share_done(), "$label" if calm else f"${tone}-fill")
        # A point that is re-measured is beyond the plan, which has nothing left.
        known = bool(view.remaining_s) and view.state != "checking"
        left = tr("{time} left", time=duration(view.remaining_s or 0.0)) if known else ""
        if not view.live:
            ended = bool(view.records) and view.log.end is not None
            left = tr("at {time}", time=local_time_text(view.records[-1].t)) if ended else ""
        elif view.state == "suspended":
            left = tr("at rest")
        row: list[Cell] = [
            done,
            tr("{time} worked", time=duration(view.elapsed_s)),
            (left, "bold"),
        ]
        bar = Col(8, grows=True, most=43)
        return Grid([row], bar, Col(16, right=True), Col(1, right=True, grows=True))

    def share_done(self) -> float:
        """Return the share of the run that is done, by time where it is known, else by points."""
        view = self.view
        if view.state in ("done", "intolerant"):
            return 1.0
        if view.remaining_s is not None and view.elapsed_s + view.remaining_s > 0:
            return view.elapsed_s / (view.elapsed_s + view.remaining_s)
        plan = view.log.plan
        if plan is None or not plan.points:
            return 0.0
        return min(len(view.log.points) / plan.points, 1.0)

    def following(self) -> Content:
        """Return the next step and when it begins; nothing once the run is over."""
        view = self.view
        plan, now = view.log.plan, view.step
        if plan is None or not now or not view.live:
            return BLANK
        words = tr("the end")
        if now.number < len(plan.steps):
            words = step_label(plan.steps[now.number].name, has_rail=view.has_rail)
        known = bool(view.ahead) and view.state == "running" and not view.stale
        left_s = sum(part.takes_s for part in view.ahead if part.step == now.number)
        when = tr(", in {time}", time=duration(left_s)) if known else ""
        return Content.styled(tr("next: {words}{when}", words=words, when=when), "$label")

    def below(self, errors_mm: Mapping[str, float], rows: int) -> Lines:
        """Return the block in at most so many rows; a run that is over has events alone."""
        parts: list[Lines | Text] = []
        if self.view.live:
            locked = DeviceText(self.view, self.glyphs).locks()
            parts, rows = self.interlocks(), rows - 1 - max(len(locked), 1)
            if rows > 1:
                parts += self.steps(rows)
                rows -= 1 + max(min(len(self._spans()), self.MOST_STEPS), 1)
        if rows > 1:
            parts += self._event_lines(errors_mm, min(rows, self.MOST_EVENTS + 1))
        return Stack(*parts)

    def _event_lines(self, errors_mm: Mapping[str, float], rows: int) -> list[Lines | Text]:
        """Return a heading and the newest events, newest first; ``errors_mm`` are |e| by point."""
        view = self.view
        zone = f"{in_zone(view.records[-1].t):%Z}" if view.records else ""
        events: list[list[Cell]] = []
        for record in reversed(view.records):
            if len(events) >= rows - 1:
                break
            if words := self.event_text(record, errors_mm):
                style = "$label" if events else "$foreground"
                time = f" {in_zone(record.t):%H:%M:%S} "
                events.append([(time, "$label"), (harmless(words), style)])
        return [section(tr("newest events"), zone), Grid(events, Col(), Col(grows=True))]

    def event_text(self, record: Record, errors_mm: Mapping[str, float]) -> str:
        """Return an event in words; nothing for what other lines of the screen tell."""
        log = self.view.log
        match record.fact:
            case Point() as point:
                error_mm = errors_mm.get(point.key)
                size = "" if error_mm is None else decimal(f": |e| {error_mm:.3f} mm")
                return tr(
                    "measured {point} again{size}" if point.retaken else "measured {point}{size}",
                    point=point_label(point.key, log),
                    size=size,
                )
            case Intended(action=action, station=station):
                place = with_labels(record.key, log)
                if action in self.MOTIONS:
                    return tr(self.MOTIONS[action], station=station, point=place)
                return f"{action.replace('.', ' ')} {place}".strip()
            case Event() | OtherEvent() as event:
                return event_label(event, log)
            case Ended(state=state, exit=code):
                return tr("the session has ended: {state}, exit {code}", state=state, code=code)
            case StateChanged(machine="run", to=to, reason=reason):
                return tr(
                    "the run is {state}{why}",
                    state=tr(to),
                    why=after(with_labels(reason.replace(chr(10), " "), log)),
                )
            case Verdict(holds=holds) as verdict:
                figures = "".join(
                    tr(
                        ": {name} {value:.3f} {unit}, limit {limit:.3f} {unit}",
                        name=of.name,
                        value=of.value,
                        unit=of.unit,
                        limit=of.limit,
                    )
                    for of in verdict.figures[:1]
                    if of.value is not None and of.limit is not None
                )
                return (
                    f"{verdict_label(record.key)} {tr('passes') if holds else tr('fails')}{figures}"
                )
        return ""

    def interlocks(self) -> list[Lines | Text]:
        """Return each condition of motion with its reason, or with the reading that frees it.

        A reason that is too long for its line is the short one: no figure is cut.
        """
        view = self.view
        locked = DeviceText(view, self.glyphs).locks()
        if not locked or view.status is None:
            return [
                section(tr("interlocks")),
                (f" {self.glyphs.stale} {tr('no reading')}", "$stale"),
            ]
        rows: list[list[Cell]] = []
        for each in locked:
            whys = each.whole or _reading(each.name, view.status.devices), each.short
            why = Fitting(tuple(Content.styled(text, "$label") for text in whys))
            rows.append([(f" {each.shape}", each.tone), (tr(each.name), "bold"), each.word, why])
        return [section(tr("interlocks")), Grid(rows, Col(2), Col(7), Col(6), Col(grows=True))]

    def steps(self, rows: int) -> list[Lines | Text]:
        """Return the step in progress and those after it, their start and duration."""
        heading, starts_s = section(tr("next steps"), tr("starts in   takes")), 0.0
        steps: list[Sequence[Cell]] = []
        start, style, shape = (
            tr("now"),
            "$foreground",
            " " if self.view.at_rest else self.glyphs.moving,
        )
        for words, takes_s in self._spans()[: min(rows - 1, self.MOST_STEPS)]:
            cells = ((text, style) for text in (words, start, duration(takes_s)))
            steps.append(((f" {shape}", "$live"), *cells, ""))
            starts_s += takes_s
            start, style, shape = duration(starts_s), "$label", " "
        if not steps:
            return [heading, (tr("   not known yet"), "$label")]
        columns = Col(2), Col(grows=True), Col(8, right=True), Col(8, right=True), Col(1)
        return [heading, Grid(steps, *columns)]

    def _spans(self) -> list[tuple[str, float]]:
        """Return the parts of the step in progress, then one for each step after it, in words."""
        view = self.view
        plan = view.log.plan
        if plan is None:
            return []
        listed: list[tuple[str, float]] = []
        for number, parts in groupby(view.ahead, key=attrgetter("step")):
            step = step_label(plan.steps[number - 1].name, has_rail=view.has_rail)
            if listed:
                listed.append((step, sum(part.takes_s for part in parts)))
            else:
                for part in _merged([*parts]):
                    other = marked("{step}: {count} readings") if part.measured else "{step}"
                    words = tr(PARTS.get(part.kind, other), step=step, count=part.measured)
                    listed.append((words, part.takes_s))
        return listed
