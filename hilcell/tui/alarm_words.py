"""Alarms in words: one box on the run's screen, one page for all of them."""

from __future__ import annotations

from textual.content import Content

from hilcell.alarms import Alarm, Latch
from hilcell.tui.glyphs import Glyphs
from hilcell.tui.keys import Keymap, shown

_TONES = {"fault": "bad", "warning": "warn", "notice": "info"}


def alarm_lines(latch: Latch, keymap: Keymap, glyphs: Glyphs, width: int) -> Content | None:
    """Return element 8 in three rows: the worst alarm not acknowledged, or None."""
    if not latch.open:
        return None
    worst = latch.worst
    tone = _TONES[worst.severity]
    more = len(latch.open) - 1
    others = f"  (+{more} more: {shown(keymap['alarms'][0])})" if more else ""
    head = Content.assemble(
        (f" {glyphs.lost} {worst.severity.upper()} {worst.code} ", f"bold $on-{tone} on ${tone}"),
        (f" {worst.title}{others}", "bold"),
    )
    found = Content(f"{worst.where}: {worst.found}")
    act = Content.styled(f"do: {' '.join(worst.do[:1])}", "")
    lines = [line.truncate(width, ellipsis=True) for line in (head, found, act)]
    return Content("\n").join(lines)


def alarm_page(latch: Latch, glyphs: Glyphs) -> Content:
    """Return every alarm with what it means and what to do."""
    alarms = latch.all
    if not alarms:
        return Content("No alarm was raised in this run.")
    return Content("\n\n").join(_one(alarm, latch, glyphs) for alarm in reversed(alarms))


def _one(alarm: Alarm, latch: Latch, glyphs: Glyphs) -> Content:
    tone = _TONES[alarm.severity]
    state = "not acknowledged" if alarm in latch.open else "acknowledged"
    steps = "\n".join(f"  {number}. {step}" for number, step in enumerate(alarm.do, start=1))
    return Content.assemble(
        (f" {glyphs.lost} {alarm.severity.upper()} {alarm.code} ", f"bold $on-{tone} on ${tone}"),
        (f" {alarm.title}", "bold"), (f"   {alarm.t[:19]}  {state}", "$dim"), "\n",
        ("where   ", "$dim"), f"{alarm.where}\n",
        ("found   ", "$dim"), f"{alarm.found}\n",
        ("means   ", "$dim"), f"{alarm.means}\n",
        ("do\n", "$dim"), steps,
    )  # fmt: skip
