"""The operator's prompt in a box: where things stand, the task, and what the tracker sees there."""

from __future__ import annotations

import msgspec
from textual.content import Content

from hilcell.clean import harmless
from hilcell.journal.key_words import in_words
from hilcell.run.protocol import PromptStatus
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.devices import short_age
from hilcell.tui.text.digits import large
from hilcell.tui.text.frame import BORDERS, SINGLE, fitted, framed, wrapped
from hilcell.tui.text.site import site_of
from hilcell.tui.text.sketch import sketch

RIGHT = 25  # columns of the task and the reading
BETWEEN = " │ "
LIMIT_AT = 18  # column of the limit beside the digits
MOST_NAMES = 2  # that fit beside the plan
CAPTION = "from above, to scale"
AT_REST = "robot at safe pose, slide held: nothing moves"


def prompt_box(
    prompt: PromptStatus, view: RunView, glyphs: Glyphs, columns: int, rows: int
) -> list[Content]:
    """Return one prompt in a box of ``columns`` and ``rows``; its words may be a device's."""
    prompt = msgspec.structs.replace(
        prompt,
        title=harmless(prompt.title),
        text=in_words(harmless(prompt.text.replace("\n", " ")), view.log),
        place=harmless(prompt.place),
    )
    room = max(rows - 2, 1)
    right = _task(prompt, view, glyphs, room)[:room]
    wide = columns - BORDERS - RIGHT - len(BETWEEN)
    left = _picture(prompt, view, wide, room)
    blank = Content("")
    lines = [
        fitted(left[n] if n < len(left) else blank, wide)
        .append(Content.styled(BETWEEN, "$stale"))
        .append(fitted(right[n] if n < len(right) else blank, RIGHT))
        for n in range(room)
    ]
    title = Content.styled(f" ? {prompt.title} ", "bold $on-ask on $ask-fill")
    return framed(lines, columns, title, _count(view), "$ask", SINGLE)


def seats(view: RunView) -> bool:
    """Whether the prompt asks to seat a reflector, and no failed reading made it ask."""
    return bool(view.log.life) and "error" not in view.log.life[-1].body


def _count(view: RunView) -> str:
    """Return how far a step has come that measures where reflectors are seated."""
    plan = view.log.plan
    if plan is None or not view.step or not seats(view):
        return ""
    number = int(view.step["number"])
    planned = plan.steps[number - 1]["points"] if number <= len(plan.steps) else 0
    done = len(view.measured.get(number, ()))
    return f"{done + 1} of {planned}" if done < planned else ""


def _picture(prompt: PromptStatus, view: RunView, columns: int, rows: int) -> list[Content]:
    """Return the left side: the plan, over it the words where they say more than the right side."""
    site = site_of(view, prompt)
    if site is not None and seats(view):
        drawn = sketch(site, columns, rows - 2)
        if drawn:
            rest = AT_REST if view.has_rail else "robot at safe pose: nothing moves"
            caption, end = Content.styled(CAPTION, "$label"), Content.styled(rest, "$label")
            return [caption, *drawn, end]
    words = wrapped(prompt.text, columns, most=rows)
    drawn = [] if site is None else sketch(site, columns, rows - len(words) - 1)
    return [*words, *([Content("")] if drawn else []), *drawn]


def _task(prompt: PromptStatus, view: RunView, glyphs: Glyphs, rows: int) -> list[Content]:
    """Return the right side: the task, how far it is off, who sees it, and Enter."""
    task, enter = _place(prompt, view), _enter(prompt, view)
    seen = [] if not prompt.check else _seen(prompt, view, glyphs)
    off = [] if not prompt.check else _off(prompt, view, glyphs, short=False)
    spare = rows - len([*task, *off, *seen, enter])
    if spare < 0:
        off = off and _off(prompt, view, glyphs, short=True)
        return [*task[-2:], *off, *seen[: max(rows - 4, 1)], enter]
    above, below, under = (min(1, max(spare - n, 0)) for n in (1, 0, 2))
    blank = Content("")
    lines = [*task, *[blank] * above, *off, *[blank] * below, *seen, *[blank] * under]
    return [*lines, *[blank] * (rows - len(lines) - 1), enter]


def _place(prompt: PromptStatus, view: RunView) -> list[Content]:
    """Return where the reflector is taken from and where it belongs."""
    at = _coordinates(prompt, view)
    if not seats(view):
        return [Content.styled(f"At {prompt.place}" if prompt.place else "", "bold"), at]
    take = view.log.seated
    lines = [Content.assemble(("Take ", "$label"), f"it out of {take}")] if take else []
    return [*lines, Content.assemble(("Seat ", "$label"), (f"it in {prompt.place}", "bold")), at]


def _coordinates(prompt: PromptStatus, view: RunView) -> Content:
    layout = view.log.cell.layout
    for nests in (layout.standing, layout.slide):
        for nest in nests:
            if nest.name == prompt.place:
                return _at(nest.x_mm, nest.y_mm, nest.z_mm)
    return Content("")


def _at(x_mm: float, y_mm: float, z_mm: float) -> Content:
    """Return coordinates with their unit, closer together where the column is narrow."""
    for head, gap in (("at   ", "  "), ("at ", " "), ("", " ")):
        xyz = gap.join((f"x {x_mm:.0f}", f"y {y_mm:.0f}", f"z {z_mm:.0f}"))
        line = Content.assemble((head, "$label"), f"{xyz} mm")
        if line.cell_length <= RIGHT:
            break
    return line


def is_ready(prompt: PromptStatus, view: RunView) -> bool:
    """Whether Enter answers: the last look was good, or nothing is looked at."""
    return not prompt.check or (prompt.ready and not view.stale and prompt.age_s is not None)


def _off(prompt: PromptStatus, view: RunView, glyphs: Glyphs, *, short: bool) -> list[Content]:
    """Return how far the reflector is off its place, large, and the limit."""
    known = prompt.seen_mm is not None and prompt.age_s is not None and not view.stale
    style = "$stale" if not known else "$passed" if is_ready(prompt, view) else "$ask"
    text = _figure(prompt.seen_mm) if known and prompt.seen_mm is not None else "-.--"
    limit = "" if prompt.limit_mm is None else f"{prompt.limit_mm:.2f}"
    what = "off its place, mm" if prompt.expected_mm is not None else "strip off drive, mm"
    if short:
        words = ("off ", "$label"), (f"{text} mm", f"bold {style}"), (f" limit {limit}", "$label")
        return [Content.assemble(*words)]
    named = Content.styled("limit" if limit else "", "$label")
    beside = [Content(""), named, Content.styled(limit, "bold")]
    return [
        Content.styled(what, "$label"),
        *(
            fitted(row, LIMIT_AT).append(word)
            for row, word in zip(large(text, style, glyphs), beside, strict=True)
        ),
    ]


def _figure(value_mm: float) -> str:
    return f"{value_mm:.2f}" if value_mm < 100 else f"{value_mm:.0f}"


def _seen(prompt: PromptStatus, view: RunView, glyphs: Glyphs) -> list[Content]:
    """Return who sees the reflector, and how old that is; devices that are lost come first."""
    lost = "" if view.stale else lost_devices(view)
    if lost:
        return [Content.styled(f"{glyphs.lost} {lost}", "bold $fault"), *_last_look(prompt, view)]
    if prompt.age_s is None:
        return [Content.styled(f"{glyphs.stale} not looked yet", "$label")]
    age = short_age(prompt.age_s + view.status_age_s)
    ago = Content.styled(f"  {age} ago", "$label")
    if view.stale:
        return [Content.styled(f"{glyphs.stale} last look {age} ago", "$stale")]
    if prompt.expected_mm is None:
        words = "strip reads well" if prompt.ready else "strip reads badly"
    else:
        words = "sees nothing" if prompt.seen_mm is None else "tracker sees it"
    if prompt.ready:
        return [Content.styled(f"{glyphs.fresh} {words}", "bold $passed"), ago]
    shape = glyphs.stale if prompt.seen_mm is None else glyphs.warned
    return [Content.styled(f"{shape} {words}", "$ask"), ago]


def lost_devices(view: RunView) -> str:
    """Return which devices are lost while the run waits; "" where none is."""
    devices = view.status.devices if view.status is not None else {}
    names = [name for name, device in devices.items() if device.state == "lost"]
    few = " and ".join(names) if len(names) <= MOST_NAMES else f"{len(names)} devices"
    return f"{few} lost" if names else ""


def _last_look(prompt: PromptStatus, view: RunView) -> list[Content]:
    """Return how old the last look is that was answered."""
    if prompt.age_s is None:
        return []
    age = short_age(prompt.age_s + view.status_age_s)
    return [Content.styled(f"  last look {age} ago", "$label")]


def _enter(prompt: PromptStatus, view: RunView) -> Content:
    """Return the key that answers, grey until it would."""
    ready = is_ready(prompt, view)
    words = "measure it here" if prompt.expected_mm is not None and seats(view) else "go on"
    if not prompt.check:
        words = "when it is done"
    style = "bold $on-ask on $ask-fill" if ready else "$stale on $badge"
    return Content.assemble((" Enter ", style), (f" {words}", "bold" if ready else "$stale"))
