"""Alarms: the text of one, the box of the alarm that ended a run, and the page of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime

from textual.app import ComposeResult
from textual.containers import Vertical
from textual.content import Content

from hilcell.alarms import Alarm, Latch, Latched
from hilcell.journal.labels import local_time_text, with_labels
from hilcell.journal.log import Log
from hilcell.language import decimal, marked, tr
from hilcell.model.events import NOT_KNOWN, Closing
from hilcell.sanitize import harmless
from hilcell.tui.keys import Keymap, shown
from hilcell.tui.layout import BLANK, Cell, Col, Grid, Lines, Stack, Text, ends
from hilcell.tui.run_view import RunView
from hilcell.tui.terminal import Glyphs
from hilcell.tui.text.devices import short_age
from hilcell.tui.text.points import deviation_of
from hilcell.tui.text.run import duration
from hilcell.tui.widgets import TextPanel, TitledBox

CHECKED_BY = marked({"you": "you", "controller": "controller"})
SEVERITY_STYLES = {
    "fault": ("lost", "fault"),
    "warning": ("warned", "ask"),
    "notice": ("stale", "label"),
}


@dataclass(frozen=True, slots=True)
class AlarmContext:
    """The facts beside the alarms: ``refused`` is why the key that goes on does nothing now.

    ``log`` is of the run, which says where the points are that an alarm names.
    """

    now: datetime | None
    keymap: Keymap
    glyphs: Glyphs
    refused: str = ""
    log: Log = field(default_factory=Log)

    def _outlook(self, latched: Latched) -> str:
        """Return whether the key that goes on works, and what is known of the cause."""
        key = shown(self.keymap["pause"][0])
        if self.refused:
            return tr("{key} does nothing now: {why}.", key=key, why=tr(self.refused))
        if latched.alarm.ended:
            return tr("This run keeps its points; it will most likely fault again.")
        if latched.gone:
            return tr("The cause is gone: {key} works.", key=key)
        return tr("Nothing moves until the devices report that the cause is gone.")

    def _go_on(self, alarm: Alarm) -> Content:
        """Return the last step with its keys, grey while they do nothing."""
        name = "new" if alarm.ended else "pause"
        style = "$stale on $badge" if self.refused else "bold $foreground on $badge"
        key = (f" {shown(self.keymap[name][0])} ", style)
        if alarm.ended:
            return Content.assemble(tr("Start a new run: "), key)
        return Content.assemble(
            tr("Go on: "), key, tr(" then "), (" Enter ", style), tr("; devices are asked first")
        )

    def page(self, alarms: Sequence[Alarm], latch: Latch) -> Lines:
        """Return every alarm of the session, newest first; older ones that still stand follow."""
        standing = {each.alarm.code: each for each in latch.standing()}
        parts: list[Lines | Text] = []
        for alarm in reversed(alarms):
            latched = standing.get(alarm.code)
            if latched is None or latched.alarm != alarm:  # one that is not latched any more
                latched = Latched(alarm, alarm.severity, 1, acknowledged=latched is None)
            parts += self._whole(latched)
        raised = {alarm.code for alarm in alarms}
        for code, each in standing.items():
            parts += [] if code in raised else self._whole(each)
        return Stack(*parts[:-1] or [tr("No alarm was raised in this run.")])

    def _whole(self, latched: Latched) -> list[Lines | Text]:
        return [self.title(latched), self.facts(latched), self.steps(latched), BLANK]

    def title(self, latched: Latched) -> Content:
        alarm, (shape, tone) = latched.alarm, SEVERITY_STYLES[latched.severity]
        times = tr(" ({count} times)", count=latched.count) if latched.count > 1 else ""
        words = f" {getattr(self.glyphs, shape)} {alarm.code}  {alarm.title}{times} "
        return Content.styled(words, f"bold $on-{tone} on ${tone}-fill")

    def facts(self, latched: Latched, kept: str = "") -> Lines:
        """Return the time of an alarm, its cause, meaning, place and reading."""
        alarm, ago = latched.alarm, ""
        since = Content.styled(tr("of the whole run"), "$label")
        if alarm.t:
            if self.now is not None:
                age_s = (self.now - datetime.fromisoformat(alarm.t)).total_seconds()
                ago = tr(" ({age} ago)", age=duration(age_s))
            at = (local_time_text(alarm.t), "bold")
            since = Content.assemble((tr("since "), "$label"), at, (ago, "$label"))
        state = (
            (tr("acknowledged"), "$label")
            if latched.acknowledged
            else (tr("not acknowledged"), "$ask")
        )
        facts: list[tuple[Cell, Cell]] = [
            ((tr("What"), "$label"), alarm.means),
            ((tr("Where"), "$label"), location_text(alarm, self.log)),
            (
                (tr("Detail"), "$label"),
                (with_labels(alarm.found, self.log), "$label" if kept else ""),
            ),
        ]
        facts += [((tr("Saved"), "$label"), (kept, "$label"))] if kept else []
        return Stack(
            Grid([(since, self._cause(latched), state)], Col(grows=True), Col(), Col(), gap=3),
            Grid(facts, Col(6), Col(grows=True, wraps=True)),
        )

    def _cause(self, latched: Latched) -> Content:
        """Return whether an alarm's cause is gone, as far as it is known."""
        glyphs, cause = (
            self.glyphs,
            (f"{self.glyphs.stale} {tr('not monitored')}", "bold $ask"),
        )
        if latched.gone:
            cause = (
                f"{glyphs.gone} {tr('gone at {time}', time=local_time_text(latched.gone))}",
                "bold $passed",
            )
        elif latched.alarm.cause == "over" or latched.settled:
            cause = f"{glyphs.gone} {tr('over')}", "$label"
        elif latched.alarm.cause == "watched":
            cause = f" {glyphs.locked} {tr('PRESENT')} ", "bold $on-fault on $fault-fill"
        return Content.assemble((tr("cause "), "$label"), cause)

    def steps(self, latched: Latched, *, in_box: bool = False, low: bool = False) -> Lines:
        """Return the steps, each with its mark and who checks it; ``low``: the present one alone.

        In a box, also whether the run can go on.
        """
        alarm, present, glyphs = latched.alarm, present_step(latched), self.glyphs
        rows: list[Sequence[Cell]] = []
        for index, (step, by) in enumerate(zip(alarm.do, alarm.by, strict=True)):
            words = Content.styled(step, "bold" if index == present else "$label")
            if alarm.continues and index == len(alarm.do) - 1:
                words = self._go_on(alarm)
            mark = (glyphs.done, "bold $passed") if _step_done(latched, index) else (" ", "")
            mark = (glyphs.moving, "bold $ask") if index == present else mark
            rows.append((mark, f"{index + 1} ", words, (tr(CHECKED_BY[by]), "$label")))
        columns = Col(), Col(), Col(grows=True, wraps=True), Col(right=True)
        grid = Grid(rows, *columns, styles={present: "on $cursor-row"})
        if low:
            return Grid(rows[present : present + 1], *columns, styles={0: "on $cursor-row"})
        heading = Content.styled(tr("What to do"), "bold")
        if rows:
            count = tr("step {number} of {n}", number=present + 1, n=len(rows))
            heading = Content.assemble((tr("What to do: "), "bold"), (count, "bold $ask"))
        outlook = [(f"     {self._outlook(latched)}", "$label")] if in_box else []
        return Stack(ends(heading, (tr("checked by"), "$label")), grid, *outlook)

    def line(self, standing: list[Latched], skip: int = 0) -> Lines:
        """Return the worst alarm after the first ``skip`` in one line, and the key for all."""
        glyphs = self.glyphs
        if len(standing) <= skip:
            words = tr("no other alarm") if skip else tr("no alarms")
            return ends((f"{glyphs.stale} {words}", "$label"), "")
        latched = standing[skip]
        count = {1: tr("alarms"), 2: tr("both alarms")}.get(
            len(standing), tr("all {n} alarms", n=len(standing))
        )
        key = Content.assemble((shown(self.keymap["alarms"][0]), "bold"), f"  {count}")
        at = f", {local_time_text(latched.alarm.t)}" if latched.alarm.t else ""
        acknowledged = tr(", acknowledged") if latched.acknowledged else ""
        shape, tone = SEVERITY_STYLES[latched.severity]
        left = Content.assemble(
            (f"{getattr(glyphs, shape)} {latched.alarm.code} ", f"bold ${tone}"),
            latched.alarm.title,
            (f"  {tr(latched.severity)}{at}{acknowledged}", "$label"),
        )
        return ends(left, key)


def panel_is_due(view: RunView, standing: list[Latched]) -> bool:
    """Whether the worst alarm has ended the run and takes the points' place."""
    ended = view.state in ("fault", "refused", "gone")
    return ended and bool(standing) and standing[0].severity == "fault"


class AlarmBox(Vertical, TitledBox):
    """The alarm that has ended a run, where the points are while it works."""

    def compose(self) -> ComposeResult:
        """Build the facts, which give way where rows are few, and the steps under them."""
        yield TextPanel("facts")
        yield TextPanel("steps")

    def show(self, standing: list[Latched], kept: str, context: AlarmContext, *, low: bool) -> None:
        latched, (facts, steps) = standing[0], self.query(TextPanel)
        self.show_titles(context.title(latched), tr("alarm 1 of {n}", n=len(standing)))
        facts.show(context.facts(latched, kept))
        steps.show(context.steps(latched, in_box=True, low=low))


def location_text(alarm: Alarm, log: Log) -> str:
    """Return the place of an alarm; of a motion, where the journal's last order has sent it."""
    order = log.order
    crashed = alarm.where == "Cell: crash"  # the engine was lost
    if order is not None and log.began < order.seq <= alarm.seq:
        device, _, how = order.motion.action.partition(".")
        if crashed or alarm.where == f"{device.capitalize()}: move":
            at = order.motion.station if device == "rail" else order.key
            to = {"park": tr("its safe pose"), "home": tr("its reference")}.get(how) or with_labels(
                at, log
            )
            return harmless(
                tr("{device}, on its way to {to}", device=tr(device.capitalize()), to=to)
            )
    if crashed:
        return (
            tr("Engine, between two motions")
            if alarm.seq > log.began
            else tr("Engine, earlier session")
        )
    return with_labels(alarm.where or "-", log)


def present_step(latched: Latched) -> int:
    """Return the index of the first step that is not done, as far as it is known.

    A person's steps are left to the person with the acknowledgement, a controller's are done when
    the cause is known to be gone; where it is not monitored, the controller is asked as the run
    goes on.
    """
    alarm, last = latched.alarm, max(len(latched.alarm.do) - 1, 0)
    for index in range(last):
        asked_later = alarm.cause == "not watched" or alarm.by[index] == "you"
        if not (_step_done(latched, index) or (latched.acknowledged and asked_later)):
            return index
    return last


def _step_done(latched: Latched, index: int) -> bool:
    """Whether a step is known to be done; an acknowledgement says nothing of a person's steps."""
    alarm = latched.alarm
    if alarm.continues and index == len(alarm.do) - 1:
        return False
    return bool(latched.gone) and alarm.by[index] == "controller"


def saved_text(log: Log) -> str:
    """Return how much is measured, and how the devices were left, as the journal has it."""
    of = (
        tr(" of {points}", points=log.plan.points)
        if log.plan is not None and log.plan.points
        else ""
    )
    problems = {
        each.fact.what: each.fact.problems
        for each in log.events
        if each.seq > log.began and isinstance(each.fact, Closing)
    }
    failed = sorted({name for names in problems.values() for name in names})
    if failed:
        left = tr("check {failed}: not stopped or closed properly", failed=tr(" and ").join(failed))
    elif not log.was_connected:
        left = tr("{state}: check the cell", state=tr(NOT_KNOWN))
    elif "closed" not in problems:
        left = tr("how the devices were left is not recorded")
    else:
        rail = tr("slide held, ") if log.plan is None or log.cell.has_rail else ""
        left = tr("{rail}robot at rest; nothing moves", rail=rail)
    return tr("{n}{of} points; {left}", n=log.counted, of=of, left=left)


def newest_line(view: RunView) -> Lines:
    point = view.newest
    if point is None:
        return ends((tr("no point is measured yet"), "$label"), "")
    deviation = deviation_of(view.log, point)
    error = "" if deviation is None else decimal(f"|e| {deviation.norm_mm:.3f} mm, ")
    name = point.id.text(point.station)
    age = error + tr("{age} ago", age=short_age(view.newest_age_s))
    return ends((tr("newest good point: {name}", name=name), "$label"), (age, "$stale"))
