"""Alarms and interlocks as pages of text."""

from __future__ import annotations

from collections.abc import Sequence

from textual.content import Content

from hilcell.alarms import Alarm, Latch, Latched
from hilcell.journal.key_words import in_words
from hilcell.run.protocol import DeviceStatus
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.alarm_words import (
    AlarmContext,
    alarm_title,
    part,
    present_step,
    state_line,
    step_lines,
    where_words,
)
from hilcell.tui.text.devices import lamp, lamps_of, locks
from hilcell.tui.text.frame import ends


def alarm_page(alarms: Sequence[Alarm], latch: Latch, context: AlarmContext, width: int) -> Content:
    """Return every alarm of the session, newest first, in the words of the run's panel.

    Alarms that stand from before the run was resumed follow.
    """
    standing = {each.alarm.code: each for each in latch.standing()}
    raised = {alarm.code for alarm in alarms}
    shown = [_latched(alarm, standing) for alarm in reversed(alarms)]
    shown += [each for code, each in standing.items() if code not in raised]
    if not shown:
        return Content("No alarm was raised in this run.")
    return Content("\n\n").join(_one(each, context, width) for each in shown)


def _latched(alarm: Alarm, standing: dict[str, Latched]) -> Latched:
    """Return how an alarm stands; one that stands no more is acknowledged and over."""
    found = standing.get(alarm.code)
    if found is not None and found.alarm == alarm:
        return found
    return Latched(alarm, alarm.severity, 1, acknowledged=found is None)


def _one(latched: Latched, context: AlarmContext, width: int) -> Content:
    alarm = latched.alarm
    count = f"step {present_step(latched) + 1} of {len(alarm.do)}" if alarm.do else ""
    lines = [
        alarm_title(latched, context.glyphs),
        state_line(latched, context, width),
        *part("What", alarm.means, width),
        *part("Where", where_words(alarm, context.log), width),
        *part("Found", in_words(alarm.found, context.log), width),
        ends(Content.styled("What to do", "bold"), Content.styled(count, "bold $ask"), width),
    ]
    for _, drawn in step_lines(latched, context, width):
        lines += drawn
    return Content("\n").join(lines)


def interlock_page(view: RunView, glyphs: Glyphs) -> Content:
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
    lines.append(Content(""))
    for name in lamps_of(view):
        device = status.devices.get(name, DeviceStatus())
        head = lamp(name, device, view, glyphs)
        detail = device.reason or device.text
        lines.append(head.append(f"   {in_words(detail, view.log)}" if detail else ""))
    lines += [
        Content(""),
        Content.styled(
            "These interlocks protect the measurement. They are no safety function: guards, "
            "enabling switch and E-stop work without hilcell.",
            "$label",
        ),
    ]
    return Content("\n").join(lines)
