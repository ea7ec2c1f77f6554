"""The operator's prompt in a box: where things stand, the task, and what the tracker sees there."""

from __future__ import annotations

import msgspec
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.content import Content

from hilcell.clean import harmless
from hilcell.journal.words import in_words
from hilcell.run.protocol import PromptStatus
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import BLANK, Cell, Col, Drawing, Grid, Lines
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.devices import short_age
from hilcell.tui.text.digits import large
from hilcell.tui.text.sketch import site_of, sketch
from hilcell.tui.widgets import TextPanel, Titled


class PromptBox(Horizontal, Titled):
    """One prompt in a box: the plan or the words at the left, the task at the right."""

    def compose(self) -> ComposeResult:
        """Build both sides; Enter stays in sight."""
        yield TextPanel("picture")
        with Vertical(id="task"):
            yield TextPanel("enter")
            yield TextPanel("reading")

    def show(self, prompt: PromptStatus, view: RunView, glyphs: Glyphs, *, low: bool) -> None:
        """Show a prompt, with few rows without large digits; its words may be a device's."""
        prompt = msgspec.structs.replace(
            prompt,
            title=harmless(prompt.title),
            text=in_words(harmless(prompt.text.replace("\n", " ")), view.log),
            place=harmless(prompt.place),
        )
        picture, enter, reading = self.query(TextPanel)
        title = Content.styled(f" ? {prompt.title} ", "bold $on-ask on $ask-fill")
        self.show_titles(title, self._count(view))
        picture.show(prompt_picture(prompt, view))
        enter.show(enter_line(prompt, view))
        reading.show(prompt_task(prompt, view, glyphs, low=low))

    @staticmethod
    def _count(view: RunView) -> str:
        """Return how far a step has come that measures where reflectors are seated."""
        plan = view.log.plan
        if plan is None or not view.step or not seats(view):
            return ""
        number = view.step.number
        planned = plan.steps[number - 1].points if number <= len(plan.steps) else 0
        done = len(view.measured.get(number, ()))
        return f"{done + 1} of {planned}" if done < planned else ""


def seats(view: RunView) -> bool:
    """Whether the prompt asks to seat a reflector, and no failed reading made it ask."""
    return bool(view.log.life) and not view.log.life[-1].change.error


def prompt_picture(prompt: PromptStatus, view: RunView) -> Lines:
    """Return the plan, over it the words where they say more than the task."""
    site, seating = site_of(view, prompt), seats(view)
    rest = f"robot at safe pose{', slide held' if view.has_rail else ''}: nothing moves"

    def draw(width: int, height: int) -> list[Content]:
        drawn = [] if site is None or not seating else sketch(site, width, height - 2)
        if drawn:
            return [
                Content.styled("from above, to scale", "$label"),
                *drawn,
                Content.styled(rest, "$label"),
            ]
        words = Content(prompt.text).wrap(width)
        drawn = [] if site is None else sketch(site, width, height - len(words) - 1)
        return [*words, *([BLANK] if drawn else []), *drawn]

    return Drawing((prompt.text, site, seating), draw)


def prompt_task(prompt: PromptStatus, view: RunView, glyphs: Glyphs, *, low: bool = False) -> Lines:
    """Return the task, how far the reflector is off, and who sees it."""
    place = _place(prompt, view)
    off = _off(prompt, view, glyphs, low=low) if prompt.check else []
    seen = _seen(prompt, view, glyphs) if prompt.check else []
    lines = [*place[-2:], *off, *seen] if low else [*place, BLANK, *off, BLANK, *seen]
    return Grid([[line] for line in lines], Col(grows=True))


def _place(prompt: PromptStatus, view: RunView) -> list[Content]:
    """Return where the reflector is taken from and where it belongs."""
    at, layout = BLANK, view.log.cell.layout
    for nest in (*layout.standing, *layout.slide):
        if nest.name == prompt.place:
            xyz = f"x {nest.x_mm:.0f} y {nest.y_mm:.0f} z {nest.z_mm:.0f} mm"
            at = Content.assemble(("at ", "$label"), xyz)
            break
    if not seats(view):
        return [Content.styled(f"At {prompt.place}" if prompt.place else "", "bold"), at]
    take = view.log.seated
    lines = [Content.assemble(("Take ", "$label"), f"it out of {take}")] if take else []
    return [*lines, Content.assemble(("Seat ", "$label"), (f"it in {prompt.place}", "bold")), at]


def is_ready(prompt: PromptStatus, view: RunView) -> bool:
    """Whether Enter answers: the last look was good, or nothing is looked at."""
    return not prompt.check or (prompt.ready and not view.stale and prompt.age_s is not None)


def _off(prompt: PromptStatus, view: RunView, glyphs: Glyphs, *, low: bool) -> list[Content]:
    """Return how far the reflector is off its place, large, and the limit."""
    known = prompt.seen_mm is not None and prompt.age_s is not None and not view.stale
    style = "$stale" if not known else "$passed" if is_ready(prompt, view) else "$ask"
    text = "-.--"
    if known and prompt.seen_mm is not None:
        text = f"{prompt.seen_mm:.{2 if prompt.seen_mm < 100 else 0}f}"
    limit = "" if prompt.limit_mm is None else f"{prompt.limit_mm:.2f}"
    what = "off its place, mm" if prompt.expected_mm is not None else "strip off drive, mm"
    if low:
        words = ("off ", "$label"), (f"{text} mm", f"bold {style}"), (f" limit {limit}", "$label")
        return [Content.assemble(*words)]
    beside: list[Cell] = ["", ("limit" if limit else "", "$label"), (limit, "bold")]
    digits = Grid(zip(large(text, style, glyphs), beside, strict=True), Col(17), Col())
    return [Content.styled(what, "$label"), *digits.lines(25)]


def _seen(prompt: PromptStatus, view: RunView, glyphs: Glyphs) -> list[Content]:
    """Return who sees the reflector, and how old that is; devices that are lost come first."""
    lost = "" if view.stale else lost_devices(view)
    age = "" if prompt.age_s is None else short_age(prompt.age_s + view.status_age_s)
    if lost:
        look = [Content.styled(f"  last look {age} ago", "$label")] if age else []
        return [Content.styled(f"{glyphs.lost} {lost}", "bold $fault"), *look]
    if not age:
        return [Content.styled(f"{glyphs.stale} not looked yet", "$label")]
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
    few = " and ".join(names) if len(names) <= 2 else f"{len(names)} devices"
    return f"{few} lost" if names else ""


def enter_line(prompt: PromptStatus, view: RunView) -> Content:
    """Return the key that answers, grey until it would."""
    ready = is_ready(prompt, view)
    words = "measure it here" if prompt.expected_mm is not None and seats(view) else "go on"
    if not prompt.check:
        words = "when it is done"
    style = "bold $on-ask on $ask-fill" if ready else "$stale on $badge"
    return Content.assemble((" Enter ", style), (f" {words}", "bold" if ready else "$stale"))
