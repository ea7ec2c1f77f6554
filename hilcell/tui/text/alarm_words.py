"""The words of an alarm: its title, since when it stands, whether its cause is gone, its steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime

from textual.content import Content

from hilcell.alarms import Alarm, Latched
from hilcell.clean import harmless
from hilcell.journal.key_words import in_words
from hilcell.journal.log import Log
from hilcell.journal.times import local_words, time_words
from hilcell.tui.keys import Keymap, shown
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.frame import ends, fitted, hanging, wrapped
from hilcell.tui.text.run import duration

LABEL = 7  # columns of `What`, `Where`
CRASH = "Cell: crash"  # where the engine was lost
ORDERS = {"park": "its safe pose", "home": "its reference"}
INDENT = 5  # columns before a step
TONES = {"fault": "fault", "warning": "ask", "notice": "label"}


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


def alarm_title(latched: Latched, glyphs: Glyphs) -> Content:
    """Return an alarm's shape, code and title, inverse."""
    alarm, tone = latched.alarm, TONES[latched.severity]
    times = f" ({latched.count} times)" if latched.count > 1 else ""
    words = f" {shape(latched, glyphs)} {alarm.code}  {alarm.title}{times} "
    return Content.styled(words, f"bold $on-{tone} on ${tone}-fill")


def shape(latched: Latched, glyphs: Glyphs) -> str:
    """Return the shape of an alarm's severity."""
    shapes = {"fault": glyphs.lost, "warning": glyphs.warned, "notice": glyphs.stale}
    return shapes[latched.severity]


def state_line(latched: Latched, context: AlarmContext, width: int) -> Content:
    """Return since when an alarm stands, its cause, and whether it is acknowledged."""
    ages = (
        _since(latched.alarm, context.now, time_words),
        _since(latched.alarm, context.now, local_words),
        _since(latched.alarm, None, local_words),
    )
    cause = cause_words(latched, context.glyphs)
    tone = "$label" if latched.acknowledged else "$ask"
    words = ("acknowledged", "ack.") if latched.acknowledged else ("not acknowledged", "not ack.")
    for since in ages:
        for word in words:
            left = Content("   ").join([since, cause])
            if left.cell_length + len(word) + 2 <= width:
                return ends(left, Content.styled(word, tone), width)
    return ends(cause, Content.styled(words[1], tone), width)


def _since(alarm: Alarm, now: datetime | None, clock: Callable[[str], str]) -> Content:
    if not alarm.t:
        return Content.styled("of the whole run", "$label")
    age = ""
    if now is not None:
        age = f" ({duration((now - datetime.fromisoformat(alarm.t)).total_seconds())} ago)"
    return Content.assemble(("since ", "$label"), (clock(alarm.t), "bold"), (age, "$label"))


def cause_words(latched: Latched, glyphs: Glyphs) -> Content:
    """Return whether an alarm's cause is gone, as far as it is known."""
    if latched.gone:
        found = Content.styled(f"{glyphs.gone} gone at {local_words(latched.gone)}", "bold $passed")
    elif latched.alarm.cause == "over" or latched.settled:
        found = Content.styled(f"{glyphs.gone} over", "$label")
    elif latched.alarm.cause == "watched":
        found = Content.styled(f" {glyphs.locked} STILL THERE ", "bold $on-fault on $fault-fill")
    else:
        found = Content.styled(f"{glyphs.stale} not watched", "bold $ask")
    return Content.assemble(("cause ", "$label"), found)


def where_words(alarm: Alarm, log: Log) -> str:
    """Return the place of an alarm; of a motion, where the journal's last order has sent it."""
    order = log.order
    crashed = alarm.where == CRASH
    if order is not None and log.began < order.seq <= alarm.seq:
        device, _, how = str(order.body.get("action", "")).partition(".")
        if crashed or alarm.where == f"{device.capitalize()}: move":
            at = str(order.body.get("station", "")) if device == "rail" else order.key
            to = ORDERS.get(how) or in_words(at, log)
            return harmless(f"{device.capitalize()}, on its way to {to}")
    if crashed:
        return f"Engine, {'between two motions' if alarm.seq > log.began else 'earlier session'}"
    return in_words(alarm.where or "-", log)


def part(name: str, text: str, width: int, style: str = "", most: int = 0) -> list[Content]:
    """Return a part of an alarm with its name before it, in as many lines as it needs."""
    return hanging(Content.styled(f"{name:<{LABEL}}", "$label"), text, width, style, most)


def present_step(latched: Latched) -> int:
    """Return the index of the first step that is not done, as far as it is known.

    A person's steps are left to the person with the acknowledgement, a controller's are done when
    the cause is seen to be gone; where nobody watches the cause, the controller is asked as the run
    goes on.
    """
    alarm, last = latched.alarm, max(len(latched.alarm.do) - 1, 0)
    for index in range(last):
        asked_later = alarm.cause == "not watched" or alarm.by[index] == "you"
        if not (step_done(latched, index) or (latched.acknowledged and asked_later)):
            return index
    return last


def step_done(latched: Latched, index: int) -> bool:
    """Whether a step is known to be done; an acknowledgement says nothing of a person's steps."""
    alarm = latched.alarm
    if alarm.goes_on and index == len(alarm.do) - 1:
        return False
    return bool(latched.gone) and alarm.by[index] == "controller"


def step_lines(
    latched: Latched, context: AlarmContext, width: int
) -> Iterator[tuple[int, list[Content]]]:
    """Yield each step's index and lines: its mark, its number, its words, who checks it."""
    alarm, present = latched.alarm, present_step(latched)
    for index, (step, by) in enumerate(zip(alarm.do, alarm.by, strict=True)):
        last = alarm.goes_on and index == len(alarm.do) - 1
        style = "bold" if index == present else "$label"
        room = width - INDENT - len(by) - 2
        lines = [_go_on(alarm, context)] if last else wrapped(step, room, style)
        done, glyphs = step_done(latched, index), context.glyphs
        mark = (glyphs.done, "bold $passed") if done else (" ", "")
        if index == present:
            mark = (glyphs.moving, "bold $ask")
        drawn = []
        for number, line in enumerate(lines):
            head = [mark, f" {index + 1}  "] if number == 0 else [" " * INDENT]
            who = Content.styled(by if number == 0 else "", "$label")
            row = ends(Content.assemble(*head, line), who, width)
            drawn.append(row.stylize_before("on $cursor-row") if index == present else row)
        yield index, drawn


def _go_on(alarm: Alarm, context: AlarmContext) -> Content:
    """Return the last step with its keys, grey while they do nothing."""
    name = "new" if alarm.ended else "pause"
    style = "$stale on $badge" if context.refused else "bold $foreground on $badge"
    key = (f" {shown(context.keymap[name][0])} ", style)
    if alarm.ended:
        return Content.assemble("Start a new run: ", key)
    return Content.assemble(
        "Go on: ", key, " then ", (" Enter ", style), "; devices are asked first"
    )


def alarm_line(
    standing: list[Latched], context: AlarmContext, width: int, skip: int = 0
) -> Content:
    """Return the worst alarm after the first ``skip`` in one line, and the key for all of them."""
    glyphs = context.glyphs
    if len(standing) <= skip:
        words = "no other alarm" if skip else "no alarms"
        return fitted(Content.styled(f"{glyphs.stale} {words}", "$label"), width)
    latched = standing[skip]
    count = {1: "alarms", 2: "both alarms"}.get(len(standing), f"all {len(standing)} alarms")
    key = Content.assemble((shown(context.keymap["alarms"][0]), "bold"), f"  {count}")
    tone = TONES[latched.severity]
    state = (
        f"{latched.severity}, {local_words(latched.alarm.t)}"
        if latched.alarm.t
        else latched.severity
    )
    left = Content.assemble(
        (f"{shape(latched, glyphs)} {latched.alarm.code} ", f"bold ${tone}"),
        latched.alarm.title,
        (f"  {state}{', acknowledged' if latched.acknowledged else ''}", "$label"),
    )
    return ends(left, key, width)
