"""Alarms in words: one box on the run's screen, one page for all of them."""

from __future__ import annotations

from collections.abc import Sequence

from textual.content import Content

from hilcell.alarms import Alarm, Latch, Latched, Severity
from hilcell.tui.glyphs import Glyphs
from hilcell.tui.keys import Keymap, shown

_TONES = {"fault": "bad", "warning": "warn", "notice": "info"}


def alarm_lines(
    standing: Sequence[Latched], keymap: Keymap, glyphs: Glyphs, width: int, rows: int = 3
) -> Content | None:
    """Return element 8 in at most three rows: the worst alarm not acknowledged, or None."""
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
    lines = [line.truncate(width, ellipsis=True) for line in (head, found, act)[:rows]]
    return Content("\n").join(lines)


def alarm_page(alarms: Sequence[Alarm], latch: Latch, glyphs: Glyphs) -> Content:
    """Return every alarm of the run, newest first, with what it means and what to do."""
    if not alarms:
        return Content("No alarm was raised in this run.")
    standing = {each.alarm.code for each in latch.standing()}
    return Content("\n\n").join(
        _one(alarm, glyphs, open_=alarm.code in standing) for alarm in reversed(alarms)
    )


def _shape(severity: Severity, glyphs: Glyphs) -> str:
    return {"fault": glyphs.lost, "warning": "!", "notice": "i"}[severity]


def _block(alarm: Alarm, severity: Severity, glyphs: Glyphs) -> Content:
    tone = _TONES[severity]
    return Content.styled(
        f" {_shape(severity, glyphs)} {severity.upper()} {alarm.code} ",
        f"bold $on-{tone} on ${tone}",
    )


def _one(alarm: Alarm, glyphs: Glyphs, *, open_: bool) -> Content:
    state = "not acknowledged" if open_ else "acknowledged"
    steps = "\n".join(f"  {number}. {step}" for number, step in enumerate(alarm.do, start=1))
    return Content.assemble(
        _block(alarm, alarm.severity, glyphs),
        (f" {alarm.title}", "bold"),
        (f"   {alarm.t[:19]}  {state}", "$dim"),
        "\n",
        ("where   ", "$dim"),
        f"{alarm.where or '-'}\n",
        ("found   ", "$dim"),
        f"{alarm.found}\n",
        ("means   ", "$dim"),
        f"{alarm.means}\n",
        ("do\n", "$dim"),
        steps,
    )
