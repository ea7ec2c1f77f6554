"""The operator's prompt in a box: where things stand, the task, and what the tracker sees there.

The cell is drawn from above, to scale, in letters: x to the right, y up, a row twice a column's
height. Places are the frozen cell's in {W}, frames those that the run has measured, nominal before.
The widest view in which every nest has its name is drawn: the whole cell, or the nests alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import ClassVar

import msgspec
import numpy as np
from rich.cells import cell_len
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.content import Content

from hilcell.calibration.frames import Frames
from hilcell.geometry.frames import apply
from hilcell.journal.labels import with_labels
from hilcell.language import decimal, retold, tr
from hilcell.model.events import StationHeld
from hilcell.ports import Array
from hilcell.run.control import PromptStatus
from hilcell.run.prompts import TEXTS
from hilcell.sanitize import harmless
from hilcell.tui.keys import CHOICE_KEYS
from hilcell.tui.layout import BLANK, Cell, Col, Drawing, Grid, Lines, large
from hilcell.tui.plots import Canvas, step_at_most
from hilcell.tui.run_view import RunView
from hilcell.tui.terminal import Glyphs
from hilcell.tui.text.devices import short_age
from hilcell.tui.widgets import TextPanel, TitledBox


class PromptBox(Horizontal, TitledBox):
    """One prompt in a box: the plan or the words at the left, the task at the right."""

    def compose(self) -> ComposeResult:
        yield TextPanel("picture")
        with Vertical(id="task"):
            yield TextPanel("enter")
            yield TextPanel("reading")

    def show(self, prompt: PromptStatus, view: RunView, glyphs: Glyphs, *, low: bool) -> None:
        """Show a prompt, with few rows without large digits; its words may be a device's."""
        prompt = msgspec.structs.replace(
            prompt,
            title=retold(harmless(prompt.title), TEXTS.values()),
            text=with_labels(
                retold(harmless(prompt.text.replace("\n", " ")), TEXTS.values()), view.log
            ),
            place=harmless(prompt.place),
        )
        picture, enter, reading = self.query(TextPanel)
        title = Content.styled(f" ? {prompt.title} ", "bold $on-ask on $ask-fill")
        text = PromptText(prompt, view, glyphs)
        self.show_titles(title, text.count)
        picture.show(text.picture())
        enter.show(text.enter())
        reading.show(text.task(low=low))


@dataclass(frozen=True, slots=True)
class PromptText:
    """The text of the prompt of a run."""

    prompt: PromptStatus
    view: RunView
    glyphs: Glyphs

    @property
    def asks_to_place(self) -> bool:
        """Whether the prompt asks to place a reflector, and no failed reading made it ask."""
        return bool(self.view.log.life) and not self.view.log.life[-1].change.error

    @property
    def aims(self) -> bool:
        """Whether a person puts the beam on a reflector whose place is not known yet."""
        asked = self.view.log.life[-1].change.prompt if self.view.log.life else None
        by_itself = asked is not None and bool(asked.get("by_itself"))
        return by_itself and self.prompt.expected_mm is None

    @property
    def count(self) -> str:
        """Return how far a step has come that measures with reflectors placed by hand."""
        plan, step = self.view.log.plan, self.view.step
        if plan is None or not step or not self.asks_to_place:
            return ""
        planned = plan.steps[step.number - 1].points if step.number <= len(plan.steps) else 0
        done = len(self.view.measured.get(step.number, ()))
        return tr("{done} of {planned}", done=done + 1, planned=planned) if done < planned else ""

    def picture(self) -> Lines:
        """Return the plan, over it the words where they say more than the task."""
        site, placing = Site.of(self.view, self.prompt), self.asks_to_place
        rest = (
            tr("robot at safe pose, slide held: nothing moves")
            if self.view.has_rail
            else tr("robot at safe pose: nothing moves")
        )

        def draw(width: int, height: int) -> list[Content]:
            if width < 1:  # beside the task there is no column left
                return []
            drawn = [] if site is None or not placing else site.drawn(width, height - 2)
            if drawn:
                above = Content.styled(tr("from above, to scale"), "$label")
                return [above, *drawn, Content.styled(rest, "$label")]
            words = Content(self.prompt.text).wrap(width)
            drawn = [] if site is None else site.drawn(width, height - len(words) - 1)
            return [*words, *([BLANK] if drawn else []), *drawn]

        return Drawing(draw)

    def task(self, *, low: bool = False) -> Lines:
        """Return the task, how far the reflector is off, and whether it is visible."""
        place, off, seen, low = self._place(), [], [], low or bool(self.prompt.choices)
        if self.prompt.check:
            off, seen = [] if self.aims else self._off(low=low), self._visibility()
        choices = [
            Content.assemble((f" {key} ", "bold $foreground on $badge"), f" {choice.text}")
            for key, choice in zip(CHOICE_KEYS, self.prompt.choices, strict=False)
        ]
        lines = [*place[-2:], *choices, *off, *seen]
        if not low:
            lines = [*place, BLANK, *off, BLANK, *seen]
        return Grid([[line] for line in lines], Col(grows=True))

    def _place(self) -> list[Content]:
        at, place, layout = BLANK, self.prompt.place, self.view.log.cell.layout
        nests = {nest.name: nest for nest in (*layout.slide, *layout.fixed_nests)}
        if nest := nests.get(place):
            xyz = decimal(f"x {nest.x_mm:.0f} y {nest.y_mm:.0f} z {nest.z_mm:.0f} mm")
            at = Content.assemble((tr("at "), "$label"), xyz)
        if self.aims:
            return [BLANK]
        if not self.asks_to_place:
            return [Content.styled(tr("At {place}", place=place) if place else "", "bold"), at]
        take = self.view.log.seated
        lines = (
            [Content.assemble((tr("Take "), "$label"), tr("it out of {take}", take=take))]
            if take
            else []
        )
        task = Content.assemble(
            (tr("Place "), "$label"), (tr("it in {place}", place=place), "bold")
        )
        return [*lines, task, at]

    @property
    def is_ready(self) -> bool:
        """Whether Enter answers: the last reading was good, or none is needed."""
        prompt, view = self.prompt, self.view
        return not prompt.check or (prompt.ready and not view.stale and prompt.age_s is not None)

    def _off(self, *, low: bool) -> list[Content]:
        prompt, view = self.prompt, self.view
        known = prompt.seen_mm is not None and prompt.age_s is not None and not view.stale
        style = "$stale" if not known else "$passed" if self.is_ready else "$ask"
        text = "-.--"
        if known and prompt.seen_mm is not None:
            text = decimal(f"{prompt.seen_mm:.{2 if prompt.seen_mm < 100 else 0}f}")
        limit = "" if prompt.limit_mm is None else decimal(f"{prompt.limit_mm:.2f}")
        what = (
            tr("off its place, mm") if prompt.expected_mm is not None else tr("strip off drive, mm")
        )
        if low:
            figure = f"{text} mm", f"bold {style}"
            return [
                Content.assemble(
                    (tr("off "), "$label"), figure, (tr(" limit {limit}", limit=limit), "$label")
                )
            ]
        beside: list[Cell] = ["", (tr("limit") if limit else "", "$label"), (limit, "bold")]
        digits = Grid(zip(large(text, style, self.glyphs), beside, strict=True), Col(17), Col())
        return [Content.styled(what, "$label"), *digits.lines(25)]

    def _visibility(self) -> list[Content]:
        """Return whether the reflector is visible, and the age of that; lost devices come first."""
        prompt, view, glyphs = self.prompt, self.view, self.glyphs
        lost = "" if view.stale else lost_devices(view)
        age = "" if prompt.age_s is None else short_age(prompt.age_s + view.status_age_s)
        if lost:
            look = (
                [Content.styled(tr("  last reading {age} ago", age=age), "$label")] if age else []
            )
            return [Content.styled(f"{glyphs.lost} {lost}", "bold $fault"), *look]
        if not age:
            return [Content.styled(f"{glyphs.stale} {tr('no reading yet')}", "$label")]
        ago = Content.styled(tr("  {age} ago", age=age), "$label")
        if view.stale:
            return [
                Content.styled(f"{glyphs.stale} {tr('last reading {age} ago', age=age)}", "$stale")
            ]
        if self.aims:
            words = tr("reflector measured") if prompt.ready else tr("no reflector yet")
        elif prompt.expected_mm is None:
            words = tr("strip reading valid") if prompt.ready else tr("strip reading invalid")
        else:
            words = tr("not visible") if prompt.seen_mm is None else tr("reflector visible")
        if prompt.ready:
            return [Content.styled(f"{glyphs.fresh} {words}", "bold $passed"), ago]
        shape = glyphs.stale if prompt.seen_mm is None else glyphs.warned
        return [Content.styled(f"{shape} {words}", "$ask"), ago]

    def enter(self) -> Content:
        """Return the key that answers, grey until it would."""
        ready, prompt = self.is_ready, self.prompt
        measures = prompt.expected_mm is not None and self.asks_to_place
        words = tr("measure it here") if measures else tr("go on")
        if not prompt.check:
            words = tr("when it is done")
        style = "bold $on-ask on $ask-fill" if ready else "$stale on $badge"
        return Content.assemble((" Enter ", style), (f" {words}", "bold" if ready else "$stale"))


def lost_devices(view: RunView) -> str:
    """Return which devices are lost while the run waits; "" where none is."""
    devices = view.status.devices if view.status is not None else {}
    names = [name for name, device in devices.items() if device.state == "lost"]
    few = tr(" and ").join(names) if len(names) <= 2 else tr("{n} devices", n=len(names))
    return tr("{device} lost", device=few) if names else ""


Place = tuple[float, float]  # x and y in {W}, mm


@dataclass(frozen=True, slots=True)
class Site:
    """Places of the cell; ``nests`` are those of the asked one's frame, ``done`` the measured."""

    LEAST_COLUMNS: ClassVar = 24  # for which a drawing is worth it
    LEAST_ROWS: ClassVar = 5

    nests: dict[str, Place]
    done: frozenset[str]
    asked: str
    asked_mm: Place
    robot_mm: Place
    tracker_mm: Place
    along: Place  # the rail's direction, of length 1; 0, 0 where there is none
    stations: dict[str, Place]

    @classmethod
    def of(cls, view: RunView, prompt: PromptStatus) -> Site | None:
        """Return the places around what a prompt asks for; None where it has no place."""
        if prompt.expected_mm is None:
            return None
        log, layout = view.log, view.log.cell.layout
        T_W_L = Frames(log.cell, log).tracker_in_world()
        asked = apply(T_W_L, np.array([prompt.expected_mm]))[0]
        last = [*log.points][-1:]
        rail_mm = log.points[last[0]].rail_mm if last else None
        if rail_mm is None:  # not recorded yet: where it was held last, the grid's station before
            held = log.happened(StationHeld)
            rail_mm = held[-1].rail_mm if held else log.cell.reference.rail_mm
        T_W_B = layout.nominal_base(rail_mm)
        slide = {nest.name: cls._above(apply(T_W_B, nest.xyz_mm[None])[0]) for nest in layout.slide}
        standing = {nest.name: cls._above(nest.xyz_mm) for nest in layout.fixed_nests}
        nests = slide if prompt.place in slide else standing
        keys = view.measured.get(view.step.number, set()) if view.step else set()
        done = frozenset(log.points[key].id.nest for key in keys if key in log.points)
        return cls(
            nests=nests,
            done=done & nests.keys(),
            asked=prompt.place,
            asked_mm=nests.get(prompt.place, cls._above(asked)),
            robot_mm=cls._above(T_W_B[:3, 3]),
            tracker_mm=cls._above(T_W_L[:3, 3]),
            along=(layout.rail_direction[0], layout.rail_direction[1]),
            stations={
                each.name: cls._above(layout.nominal_base(each.rail_mm)[:3, 3])
                for each in log.cell.station
                if log.cell.has_rail
            },
        )

    @staticmethod
    def _above(xyz_mm: Array) -> Place:
        return float(xyz_mm[0]), float(xyz_mm[1])

    def drawn(self, columns: int, rows: int) -> list[Content]:
        """Return ``rows`` lines of ``columns``; none where that is too small for a drawing."""
        if columns < self.LEAST_COLUMNS or rows < self.LEAST_ROWS:
            return []
        nests = [self.asked_mm, *self.nests.values()]
        views = ([*nests, self.robot_mm, self.tracker_mm], [*nests, self.robot_mm], nests)
        drawn = (_Drawing(self, places, columns, rows) for places in views)
        complete = next((each for each in drawn if not each.unnamed), None)
        return (complete or _Drawing(self, nests, columns, rows)).lines()


class _Drawing:
    """One view; ``unnamed`` are the nests whose names found no room."""

    MARGIN = 4  # columns at either side, for names
    ASIDE = (0, 1, -1, 2, -2, 3, -3)  # columns by which a nest may be moved
    ASIDE_MM = 150.0  # at most
    SLIDE_MM = (350.0, 450.0)  # half of it, as drawn
    RAIL_MM = 160.0  # half the distance of its rails, as drawn

    def __init__(self, site: Site, places: Sequence[Place], columns: int, rows: int) -> None:
        self._site, self._columns, self._rows = site, columns, rows - 1  # one for the scale
        xs, ys = zip(*places, strict=True)
        room, height = columns - 1 - 2 * self.MARGIN, 2 * (self._rows - 1)
        # The width of a column at which all places are inside the margins, in the middle.
        self._mm = mm = max((max(xs) - min(xs)) / room, (max(ys) - min(ys)) / height, 1.0)
        self._left_mm = (min(xs) + max(xs) - mm * (columns - 1)) / 2
        self._top_mm = (min(ys) + max(ys) + mm * height) / 2
        self._canvas = Canvas(columns, self._rows)
        self._taken: set[tuple[int, int]] = set()
        self._asked_nest()
        self.unnamed = self._nests()
        self._tracker()
        self._slide()
        if any(site.along):
            self._rail()
        self._beam()

    def lines(self) -> list[Content]:
        return [*self._canvas.lines(), self._bar()]

    def _cell(self, place: Place) -> tuple[int, int]:
        column = round((place[0] - self._left_mm) / self._mm)
        return column, round((self._top_mm - place[1]) / (2 * self._mm))

    def _put(self, column: int, row: int, text: str, style: str) -> bool:
        """Write where all of it is free; return whether it was."""
        cells = {(column + n, row) for n in range(len(text))}
        inside = column >= 0 and column + len(text) <= self._columns and 0 <= row < self._rows
        if not inside or cells & self._taken:
            return False
        self._taken |= cells
        self._canvas.text(row, column, text, style)
        return True

    def _named(self, column: int, row: int, name: str, style: str) -> bool:
        """Write a name beside its cell, where there is room for it."""
        text = f" {_short(name)} "
        left, middle = column - len(text), column - len(text) // 2
        around = (
            (column + 1, row), (left, row), (middle, row - 1), (middle, row + 1),
            (column + 1, row - 1), (column + 1, row + 1), (left, row - 1), (left, row + 1),
        )  # fmt: skip
        return any(self._put(*at, text, style) for at in around)

    def _asked_nest(self) -> None:
        column, row = self._cell(self._site.asked_mm)
        text = f" {_short(self._site.asked)} "
        column = min(max(column - len(text) // 2, 0), self._columns - len(text))
        self._put(column, row, text, "bold $on-ask on $ask-fill")

    def _nests(self) -> list[str]:
        """Draw the other nests; return those without a name."""
        others = {
            name: self._cell(place)
            for name, place in sorted(self._site.nests.items(), key=itemgetter(1))
            if name != self._site.asked
        }
        shown = {name: at for name, near in others.items() if (at := self._marked(name, near))}
        named = {
            name
            for name, at in shown.items()
            if self._named(*at, name, "$label" if name in self._site.done else "$foreground")
        }
        return [name for name in others if name not in named]

    def _marked(self, name: str, near: tuple[int, int]) -> tuple[int, int] | None:
        """Draw a nest, a little aside where something else is drawn; return where."""
        mark = ("●", "$passed") if name in self._site.done else ("○", "$foreground")
        (column, row), most = near, self.ASIDE_MM / self._mm
        places = ((column + aside, row) for aside in self.ASIDE if abs(aside) <= most)
        return next((at for at in places if self._put(*at, *mark)), None)

    def _tracker(self) -> None:
        """Draw the tracker, at the edge towards it where it is beyond."""
        column, row = self._cell(self._site.tracker_mm)
        column, row = min(max(column, 0), self._columns - 1), min(max(row, 0), self._rows - 1)
        self._put(column, row, "▲", "bold $foreground")
        under = column - len(tr(" tracker ")) // 2, row + 1
        if not self._put(*under, tr(" tracker "), "$label"):
            self._named(column, row, tr("tracker"), "$label")

    def _slide(self) -> None:
        """Draw the slide that carries the robot, to scale, at most five columns wide."""
        column, row = self._cell(self._site.robot_mm)
        across = min(round(self.SLIDE_MM[0] / self._mm), 2)
        up = min(round(self.SLIDE_MM[1] / (2 * self._mm)), 1)
        for y in range(row - up, row + up + 1):
            for x in range(column - across, column + across + 1):
                core = y == row and abs(x - column) <= max(across - 1, 0)
                self._put(x, y, *(("█", "$label") if core else ("▒", "$stale")))
        self._named(column + across, row, tr("robot"), "$foreground")

    def _rail(self) -> None:
        along, at = self._site.along, self._site.robot_mm
        steep = abs(along[1]) >= abs(along[0])
        reach_mm = self._mm * (self._columns + 2 * self._rows)
        step_mm = self._mm * (1.0 if steep else 0.5)
        side = max(self.RAIL_MM, self._mm * (1 if steep else 2))
        for name, place in self._site.stations.items():
            mark = (place[0] + side * -along[1], place[1] + side * along[0])
            other = (place[0] - side * -along[1], place[1] - side * along[0])
            column, row = max(self._cell(mark), self._cell(other))
            tick = "─" if steep else ""
            self._put(column + 1, row, f"{tick} {_short(name)} ", "$label")
        for n in range(-int(reach_mm / step_mm), int(reach_mm / step_mm) + 1):
            for way in (-1.0, 1.0):
                x = at[0] + n * step_mm * along[0] - way * side * along[1]
                y = at[1] + n * step_mm * along[1] + way * side * along[0]
                self._put(*self._cell((x, y)), "│" if steep else "─", "$stale")

    def _beam(self) -> None:
        (x0, y0), (x1, y1) = self._site.asked_mm, self._site.tracker_mm
        steps = math.ceil(math.hypot(x1 - x0, (y1 - y0) / 2) / self._mm)
        for n in range(0, min(steps, 4 * self._columns), 2):
            at = (x0 + (x1 - x0) * n / steps, y0 + (y1 - y0) * n / steps)
            self._put(*self._cell(at), "·", "$ask")

    def _bar(self) -> Content:
        length_mm = step_at_most(10 * self._mm)
        across = max(round(length_mm / self._mm), 2)
        unit = (
            decimal(f"{length_mm / 1000:g} m")
            if length_mm >= 1000
            else decimal(f"{length_mm:g} mm")
        )
        text = f"├{'─' * (across - 1)}┤ {unit}   {tr('x ►  y up')}"
        return Content.styled(text.center(self._columns)[: self._columns], "$label")


def _short(name: str) -> str:
    """Return the first seven letters of a name, each of one column."""
    return "".join(letter if cell_len(letter) == 1 else "?" for letter in name[:7])
