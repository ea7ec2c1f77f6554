"""Alarms and interlocks as text: the alarm box of the run's screen, and a page for each."""

from __future__ import annotations

from collections.abc import Sequence

from textual.content import Content

from hilcell.alarms import Alarm, Latch, Latched, Severity
from hilcell.run.protocol import DeviceStatus
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.keys import Keymap, shown
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.run import lamp, lamps_of

MOST_ROWS, SPARE = 2, 12  # of a part; the cost of breaking lines at words
_TONES = {"fault": "fault", "warning": "ask", "notice": "label"}


def alarm_lines(
    standing: Sequence[Latched], keymap: Keymap, glyphs: Glyphs, width: int, rows: int = 3
) -> Content | None:
    """Return element 8: the worst alarm not acknowledged, in ``rows`` parts of at most two rows."""
    if not standing:
        return None
    worst, more = standing[0], len(standing) - 1
    alarm = worst.alarm
    others = f"  (+{more} more: {shown(keymap['alarms'][0])})" if more else ""
    times = f" ({worst.count} times)" if worst.count > 1 else ""
    head = _block(alarm, worst.severity, glyphs).append(
        Content.styled(f" {alarm.title}{times}{others}", "bold")
    )
    found = Content(f"{alarm.where}: {alarm.found}" if alarm.where else alarm.found)
    act = Content(f"do: {alarm.do[0]}" if alarm.do else alarm.means)
    lines = [head.truncate(width, ellipsis=True)]
    lines += [each.truncate(MOST_ROWS * width - SPARE, ellipsis=True) for each in (found, act)]
    return Content("\n").join(lines[:rows])


def alarm_page(alarms: Sequence[Alarm], latch: Latch, glyphs: Glyphs) -> Content:
    """Return every alarm of the session, newest first, with what it means and what to do.

    Unacknowledged alarms from before the run was resumed follow.
    """
    raised = {alarm.code for alarm in alarms}
    standing = {each.alarm.code: each.alarm for each in latch.standing()}
    waits = {each.alarm.code for each in latch.standing() if not each.acknowledged}
    earlier = [alarm for code, alarm in standing.items() if code not in raised]
    if not alarms and not earlier:
        return Content("No alarm was raised in this run.")
    return Content("\n\n").join(
        _one(alarm, glyphs, open_=alarm.code in waits) for alarm in (*reversed(alarms), *earlier)
    )


def _shape(severity: Severity, glyphs: Glyphs) -> str:
    return {"fault": glyphs.lost, "warning": glyphs.warned, "notice": glyphs.stale}[severity]


def _block(alarm: Alarm, severity: Severity, glyphs: Glyphs) -> Content:
    tone = _TONES[severity]
    return Content.styled(
        f" {_shape(severity, glyphs)} {severity.upper()} {alarm.code} ",
        f"bold $on-{tone} on ${tone}-fill",
    )


def _one(alarm: Alarm, glyphs: Glyphs, *, open_: bool) -> Content:
    state = "not acknowledged" if open_ else "acknowledged"
    steps = "\n".join(f"  {number}. {step}" for number, step in enumerate(alarm.do, start=1))
    return Content.assemble(
        _block(alarm, alarm.severity, glyphs),
        (f" {alarm.title}", "bold"),
        (f"   {alarm.t[:19]}  {state}", "$label"),
        "\n",
        ("where   ", "$label"),
        f"{alarm.where or '-'}\n",
        ("found   ", "$label"),
        f"{alarm.found}\n",
        ("means   ", "$label"),
        f"{alarm.means}\n",
        ("do\n", "$label"),
        steps,
    )


def interlock_page(view: RunView, glyphs: Glyphs) -> Content:
    """Return element 15 whole: each condition, then each device's last reading."""
    status = view.status
    if status is None or not view.live:
        return Content("No engine is at work on this run: nothing can move from here.")
    lines = [
        Content.styled(f"{glyphs.lost} {each.name} blocked: {each.blocked}", "bold $ask")
        if each.blocked
        else Content.styled(f"{glyphs.fresh} {each.name}: free", "$passed")
        for each in status.interlocks
    ]
    lines.append(Content(""))
    for name in lamps_of(view):
        device = status.devices.get(name, DeviceStatus())
        head = lamp(name, device, view, glyphs)
        detail = device.reason or device.text
        lines.append(head.append(f"   {detail}" if detail else ""))
    lines += [
        Content(""),
        Content.styled(
            "These interlocks protect the measurement. They are no safety function: guards, "
            "enabling switch and E-stop work without hilcell.",
            "$label",
        ),
    ]
    return Content("\n").join(lines)
