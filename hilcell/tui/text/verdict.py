"""Rows 7 to 22 of a finished run: PASS or FAIL where the digits were, and its stations.

The worst station decides. *95 % sure* bounds the mean of a station, *95 % below* is a share of its
targets: never one word for both. A run that ended before has no verdict.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
from textual.content import Content

from hilcell.alarms import Alarm
from hilcell.alarms.catalogue import SEVERITIES, entry_of
from hilcell.calibration.decision import limits_of
from hilcell.clean import harmless
from hilcell.journal.calibration_facts import run_judged
from hilcell.journal.words import in_words
from hilcell.model.events import TrackerProven
from hilcell.model.outcome import Outcome
from hilcell.model.results import Place
from hilcell.model.verdicts import VALIDATION, Judged, Limits
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import Cell, Col, Drawing, Fitting, Grid, Lines, Stack, Text
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.digits import figure
from hilcell.tui.text.head import NEXT, Figure, Head, gravest, head_lines, is_small
from hilcell.typed import typed

TALL, MOST_OF_A_NAME = 40, 20  # rows that hold everything; columns
SHOWN: dict[Outcome, tuple[str, str]] = {  # the shape's name, the style
    Outcome.ACCEPTED: ("fresh", "$passed"),
    Outcome.UNDECIDED: ("warned", "$ask"),
    Outcome.REJECTED: ("warned", "bold $fault"),
}


@dataclass(frozen=True, slots=True)
class Station:
    """Errors (mm) of one station's targets: as sent, and as they were judged."""

    name: str
    targets: int
    before_mm: float
    p95_mm: float
    judged: Judged

    @property
    def sure_mm(self) -> float:
        """Return the length below which the true mean is, 95 % sure."""
        return self.judged.mean_mm + self.judged.mean_U_mm

    @property
    def short(self) -> str:
        """Return its name, which leaves room for figures."""
        return Content(harmless(self.name)).truncate(MOST_OF_A_NAME, ellipsis=True).plain

    @property
    def reason(self) -> str:
        """Return which limits it does not keep, or is not shown to."""
        over, unsure = [], []
        for name, each in zip(("mean", "single", "orientation"), self.judged.figures, strict=False):
            value = math.nan if each.value is None else each.value
            written, limit, U = (
                (f"{value:.4f}°", f"{each.limit:g}°", f"{each.U or 0.0:.4f}°")
                if each.unit == "deg"
                else (figure(value), f"{each.limit:.3f}", f"{each.U or 0.0:.3f}")
            )
            if each.limit is not None and not value <= each.limit:
                over.append(f"{name} {written} over {limit}")
            elif each.outcome is not Outcome.ACCEPTED:
                unsure.append(f"{name} {written}, U {U}: not shown below {limit}")
        return ", ".join(over or unsure) or "too few targets to show it"

    def cells(self, limits: Limits, glyphs: Glyphs) -> list[Cell]:
        """Return its row of the table."""
        judged, outcome = self.judged, self.judged.outcome
        shape, tone = SHOWN[outcome]
        word = outcome.short.upper() if outcome is Outcome.REJECTED else outcome.short
        mean_style = "bold" if judged.mean_mm <= limits.mean_mm else "bold $fault"
        max_style = "" if judged.max_mm <= limits.max_mm else "bold $fault"
        return [
            "",
            Content(harmless(self.name)).truncate(13, ellipsis=True),
            (str(self.targets), "$label"),
            (f"{self.before_mm:.3f}", "$label"),
            (figure(judged.mean_mm), mean_style),
            figure(self.p95_mm),
            (figure(judged.max_mm), max_style),
            (f"{getattr(glyphs, shape)} {word}", tone),
        ]


@dataclass(frozen=True, slots=True)
class Finished:
    """A finished validation: its stations, its limits and the run's outcome."""

    passed: bool
    outcome: Outcome
    stations: tuple[Station, ...]
    limits: Limits
    floor_mm: float

    @property
    def undecided(self) -> bool:
        """Whether neither that the limits are kept is shown nor the contrary."""
        return self.outcome is Outcome.UNDECIDED

    @property
    def worst_mean(self) -> Station:
        """Return the station of the largest mean."""
        return max(self.stations, key=lambda each: gravest(each.judged.mean_mm))

    @property
    def worst_single(self) -> Station:
        """Return the station of the largest single error."""
        return max(self.stations, key=lambda each: gravest(each.judged.max_mm))

    @property
    def words(self) -> tuple[str, str]:
        """Return the verdict in one word, and what it states."""
        outcome = Outcome.ACCEPTED if self.passed else self.outcome
        said = "neither pass nor fail" if outcome is Outcome.UNDECIDED else outcome.words
        return outcome.short.upper(), said

    @property
    def reason_words(self) -> str:
        """Return which stations do not keep which limit, the worst first.

        Of those that are only not shown to keep it the first says why: the table has their figures.
        """
        failed = [each for each in self.stations if each.judged.outcome is not Outcome.ACCEPTED]
        failed.sort(key=lambda each: -gravest(each.judged.mean_mm))
        undecided = [each.name for each in failed if each.judged.outcome is Outcome.UNDECIDED]
        whole = [each for each in failed if each.name not in undecided[1:]]
        words = [f"{each.name}: {each.reason}" for each in whole]
        return "; ".join([*words, *([f"also {', '.join(undecided[1:])}"] if undecided[1:] else [])])

    @property
    def head(self) -> Head:
        """Return the verdict in large, with its two figures."""
        word, stated = self.words
        mean, single, limits = self.worst_mean, self.worst_single, self.limits
        figures = (
            Figure("worst mean |e|, mm", mean.judged.mean_mm, f"at {mean.name}", limits.mean_mm,
                   mean.judged.mean_U_mm),
            Figure("worst single |e|, mm", single.judged.max_mm, f"at {single.name}", limits.max_mm,
                   single.judged.max_U_mm),
        )  # fmt: skip
        role = "passed" if self.passed else "ask" if self.undecided else "fault"
        return Head((word,), stated, role, figures)

    @property
    def orientation(self) -> list[Lines | Text]:
        """Return the largest error of orientation beside its limit, where one is stated."""
        turns = [(each, each.judged.turn) for each in self.stations]
        known = [(each, turn) for each, turn in turns if turn is not None]
        if not known:
            return []
        worst, turn = max(known, key=lambda each: gravest(each[1].max_deg))
        words = f"{turn.max_deg:.4f}° at {worst.short}, limit {self.limits.max_deg:g}°"
        return [Content.assemble((" orientation, worst: ", "$label"), words)]

    def table(self, glyphs: Glyphs, room: int) -> Lines:
        """Return the stations, the worst ones in ``room`` rows with header and limit."""
        order = sorted(self.stations, key=lambda each: -gravest(each.judged.mean_mm))
        kept = order[: room - 2]
        shown = [each for each in self.stations if each in kept]
        left = len(self.stations) - len(shown)
        titles = "station", "targets", "mean as sent", "mean", "95 % below", "max mm", " verdict"
        limits = (f"{self.limits.mean_mm:.3f}", "-", f"{self.limits.max_mm:.3f}")
        name = f"limit ({left} more in the report)" if left else "limit"
        rows: list[list[Cell]] = [["", *((title, "$label") for title in titles)]]
        rows += [each.cells(self.limits, glyphs) for each in shown]
        rows.append(["", (name, "$label"), "", "", *((each, "$label") for each in limits), ""])
        numbers = [Col(width, right=True) for width in (7, 12, 8, 11, 8)]
        return Grid(rows, Col(), Col(13), *numbers, Col(9, grows=True), styles={0: "on $panel"})


def verdict_of(view: RunView) -> Finished | None:
    """Return the verdict of a finished run with a validation; None for every other run.

    Stations that were also judged together are shown one by one.
    """
    if view.state not in ("done", "intolerant"):
        return None
    try:
        places = typed(view.log.result.get("validation", {}), dict[str, Place])
    except msgspec.ValidationError:  # of another procedure's result
        return None
    order = [each.name for each in view.log.cell.station]
    names = [name for name in order if name in places] or list(places)
    found = {name: view.log.verdict(Judged, f"{VALIDATION}{name}") for name in names}
    judged = {name: each for name, each in found.items() if each is not None}
    if not judged:
        return None
    floors = [place.floor.mean for place in places.values() if place.floor is not None]
    return Finished(
        passed=view.state == "done",
        outcome=run_judged(view.log) or Outcome.REJECTED,
        stations=tuple(
            Station(name, place.points, place.before.mean, place.chosen.p95, each)
            for name, each in judged.items()
            for place in (places[name],)
        ),
        limits=limits_of(view.log.cell),
        floor_mm=max(floors, default=math.nan),
    )


# -- drawing ---------------------------------------------------------------------------------------


def verdict_lines(view: RunView, found: Finished, glyphs: Glyphs, standing: int = 0) -> Lines:
    """Return the block, the two worst figures, the stations, and what is to be known or done.

    ``standing`` alarms are latched, also those that the journal raises no more.
    """
    facts = Stack(*_facts(view, found, glyphs, standing))

    def draw(width: int, height: int) -> list[Content]:
        rows = height or TALL
        lines, said = head_lines(view, found.head, glyphs, width, rows), facts.lines(width)
        if is_small(width, rows):
            return [*lines, *said]
        said = said[: max(rows - len(lines) - len(found.stations) - 2, 2)]
        room = max(rows - len(lines) - len(said), 3)
        return [*lines, *found.table(glyphs, room).lines(width), *said]

    return Drawing((repr(found), glyphs.plain, facts.state), draw)


def _facts(view: RunView, found: Finished, glyphs: Glyphs, standing: int) -> list[Lines | Text]:
    """Return what is to be known of a run that passed; of one that failed, why and what to do."""
    if not found.passed and view.alarms:
        gravest_alarm = max(view.alarms, key=lambda alarm: SEVERITIES.index(alarm.severity))
        return _advice(view, found, gravest_alarm, glyphs)
    sure = max(found.stations, key=lambda each: gravest(each.sure_mm))
    bound = f"below {sure.sure_mm:.3f} mm", f" at {sure.short}"
    floor = f"   floor: {found.floor_mm:.3f} mm" if math.isfinite(found.floor_mm) else ""
    return [
        _whole((" true mean, 95 % sure: ", "$label"), *bound, (floor, "$label")),
        *found.orientation,
        _written(view, found, glyphs),
        _drift(view, glyphs, standing),
        Content.assemble((" next: ", "$label"), NEXT),
    ]


def _whole(*phrases: Text) -> Lines:
    """Return as many phrases as fit, each whole."""
    texts = [Content.assemble(*phrases[:n]) for n in range(len(phrases), 0, -1)]
    return Grid([[Fitting((*texts, texts[-1].truncate(1)))]], Col(grows=True))


def _advice(view: RunView, found: Finished, alarm: Alarm, glyphs: Glyphs) -> list[Lines | Text]:
    """Return why the run failed, with the stations concerned, and the steps, each whole."""
    where = f"{alarm.where}: " if alarm.where else ""
    words = in_words(f"{where}{alarm.found}", view.log)
    if entry_of(alarm.code, "").verdict == VALIDATION.rstrip("."):
        words = found.reason_words or words
    why = Content(harmless(f"{alarm.code} {words}")).stylize("bold $fault", 0, len(alarm.code))
    rows: list[list[Cell]] = [["", (glyphs.warned, "bold $fault"), why]]
    rows += [["", (str(n), "bold"), step] for n, step in enumerate(alarm.do[:3], start=1)]
    return [Grid(rows, Col(), Col(), Col(grows=True, wraps=True))]


def _written(view: RunView, found: Finished, glyphs: Glyphs) -> Lines | Text:
    celsius = view.log.temperatures_c()
    unit = f"{glyphs.degree}C"
    air = f"; air was {min(celsius):.1f} to {max(celsius):.1f} {unit}" if celsius else ""
    if not view.log.calibrates:
        none = " no calibration file was to be written"
        return _whole((none, "$label"), (air, "$label"))
    if view.calibration_lost:
        text = f" {glyphs.warned} calibration.json is not written: space writes it"
        return Content.styled(text, "$ask")
    names = " ".join(each.name for each in found.stations)
    head = Content.assemble((" written: ", "$label"), "calibration.json")
    return _whole(head, (f" for {names}", "$label"), (air, "$label"))


def _drift(view: RunView, glyphs: Glyphs, standing: int) -> Lines:
    """Return how many alarms stand, or are over, and how far the floor nests moved."""
    proofs = [e.fact.off_mm for e in view.log.events if isinstance(e.fact, TrackerProven)]
    moved = max((max(each) for each in proofs if each), default=None)
    over = sum(alarm.cause == "over" for alarm in view.alarms)
    count = max(len(view.alarms), standing) - over
    text = f"{count} alarm{'s' if count > 1 else ''}: e" if count else "no alarms"
    text += f"; {over} that {'are' if over > 1 else 'is'} over: e" if over else ""
    drift = "" if moved is None else f"; floor nests stood within {moved:.3f} mm"
    tone, shape = ("$ask", glyphs.warned) if count else ("$passed", glyphs.fresh)
    head = Content.assemble((f" {shape}", tone), (f" {text}", "$label"))
    return _whole(head, (drift, "$label"))
