"""The panel of the alarm that has ended a run: cause, place, steps, who checks them.

It stands where the points are while the run works. Where rows are short, what matters least goes
first.
"""

from __future__ import annotations

from textual.content import Content

from hilcell.alarms import Latched
from hilcell.journal.event_words import NOT_KNOWN
from hilcell.journal.key_words import in_words
from hilcell.journal.log import Log
from hilcell.journal.point_words import point_words
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.keys import shown
from hilcell.tui.text.alarm_words import (
    TONES,
    AlarmContext,
    alarm_title,
    part,
    present_step,
    state_line,
    step_lines,
    where_words,
)
from hilcell.tui.text.deviation import deviation_of
from hilcell.tui.text.devices import short_age
from hilcell.tui.text.frame import BORDERS, DOUBLE, ends, fitted, framed

STATES = ("fault", "refused", "gone")  # of a run whose alarm takes the points' place
MOST, LEAST = 8, 2  # rows of what an alarm means, and of what was found
OUTLOOK = 10  # rank of the last line of words; larger ones are blanks and heads


def panel_is_due(view: RunView, standing: list[Latched]) -> bool:
    """Whether the worst alarm has ended the run and takes the points' place."""
    return view.state in STATES and bool(standing) and standing[0].severity == "fault"


def alarm_panel(
    standing: list[Latched], kept: str, context: AlarmContext, columns: int, rows: int
) -> list[Content]:
    """Return the worst alarm in a box of ``columns`` and ``rows``."""
    latched, room = standing[0], max(rows - 2, 1)
    parts: list[tuple[int, Content]] = []
    for most in range(MOST, LEAST - 1, -1):  # cut only where rows are short
        parts = _parts(latched, kept, context, columns - BORDERS, most)
        if sum(rank <= OUTLOOK for rank, _ in parts) <= room:
            break
    while len(parts) > room:
        least = max(order for order, _ in parts)
        parts.pop(max(n for n, (order, _) in enumerate(parts) if order == least))
    lines = [line for _, line in parts] + [Content("")] * (room - len(parts))
    note, tone = f"alarm 1 of {len(standing)}", TONES[latched.severity]
    title = alarm_title(latched, context.glyphs)
    return framed(lines, columns, title, note, f"${tone}", DOUBLE)


def _parts(
    latched: Latched, kept: str, context: AlarmContext, width: int, most: int
) -> list[tuple[int, Content]]:
    """Return the lines in their order, each with its rank: the largest goes first."""
    alarm, present = latched.alarm, present_step(latched)
    what, *more = part("What", alarm.means, width, most=most)
    found, *rest = part("Found", in_words(alarm.found, context.log), width, "$label", most=most)
    count = Content.styled(f"step {present + 1} of {len(alarm.do)}", "bold $ask")
    where = where_words(alarm, context.log)
    lines = [
        (1, state_line(latched, context, width)),
        (4, what),
        *((9, line) for line in more),
        *((6, line) for line in part("Where", where, width, most=1)),
        (3, found),
        *((8, line) for line in rest),
        *((7, line) for line in part("Kept", kept, width, "$label", most=1)),
        (11, Content("")),
        (2, ends(Content.styled("What to do", "bold"), count, width)),
        (12, ends(Content(""), Content.styled("checked by", "$label"), width)),
    ]
    for index, (first, *others) in step_lines(latched, context, width):
        rank = 0 if index == present else 5
        lines += [(rank, first), *((rank, line) for line in others)]
    return [*lines, (OUTLOOK, Content.styled(f"     {_outlook(latched, context)}", "$label"))]


def _outlook(latched: Latched, context: AlarmContext) -> str:
    """Return whether the key that goes on works, and what is known of the cause."""
    key = shown(context.keymap["pause"][0])
    if context.refused:
        return f"{key} does nothing now: {context.refused}."
    if latched.alarm.ended:
        return "This run keeps its points; it will most likely fault again."
    if latched.gone:
        return f"The cause is gone: {key} works."
    return "Nothing moves before the devices say that the cause is gone."


def kept_words(log: Log) -> str:
    """Return how much is measured, and how the devices were left, as the journal has it."""
    of = f" of {log.plan.points}" if log.plan is not None and log.plan.points else ""
    return f"{log.counted}{of} points; {_left(log)}"


def _left(log: Log) -> str:
    """Return how the session has left the devices."""
    found = {
        each.body["what"]: each.body.get("problems", {})
        for each in log.events
        if each.seq > log.began and each.body["what"] in ("safe stop", "closed")
    }
    failed = sorted({name for problems in found.values() for name in problems})
    if failed:
        return f"look at {' and '.join(failed)}: not stopped or closed as it should be"
    if not log.was_connected:
        return f"{NOT_KNOWN}: look at the cell"
    if "closed" not in found:
        return "how the devices were left is not recorded"
    held = "slide held, " if log.plan is None or log.cell.has_rail else ""
    return f"{held}robot at rest; nothing moves"


def newest_line(view: RunView, width: int) -> Content:
    """Return the newest point with its error and its age."""
    point = view.newest
    if point is None:
        return fitted(Content.styled(" no point is measured yet", "$label"), width)
    found = deviation_of(view.log, point)
    error = "" if found is None else f"|e| {found.norm_mm:.3f} mm"
    age = f"{short_age(view.newest_age_s)} ago"
    name = point_words(point.id, point.station)
    left = Content.styled(f" newest good point: {name}", "$label")
    return ends(left, Content.styled(", ".join(filter(None, (error, age))), "$stale"), width)
