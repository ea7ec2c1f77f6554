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
from hilcell.clean import harmless
from hilcell.journal.calibration_facts import run_judged
from hilcell.journal.words import in_words
from hilcell.model.events import TrackerProven
from hilcell.model.outcome import Outcome
from hilcell.model.verdicts import VALIDATION, Judged, Turn
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


class _Figures(msgspec.Struct):
    mean: float
    p95: float = math.nan
    max: float = math.nan


class _Floor(msgspec.Struct):
    mean: float


class _Place(msgspec.Struct):
    points: int
    before: _Figures
    chosen: _Figures
    floor: _Floor | None = None


@dataclass(frozen=True, slots=True)
class Station:
    """Errors (mm) of one station's targets, as they were judged.

    ``turn`` is the error of orientation where that was judged.
    """

    name: str
    targets: int
    before_mm: float
    mean_mm: float
    p95_mm: float
    max_mm: float
    mean_U_mm: float
    max_U_mm: float
    outcome: Outcome
    turn: Turn | None = None

    @property
    def sure_mm(self) -> float:
        """Return the length below which the true mean is, 95 % sure."""
        return self.mean_mm + self.mean_U_mm


@dataclass(frozen=True, slots=True)
class Verdict:
    """The errors of a finished validation, with their limits (mm), and the run's outcome."""

    passed: bool
    outcome: Outcome
    stations: tuple[Station, ...]
    mean_limit_mm: float
    max_limit_mm: float
    floor_mm: float
    max_limit_deg: float | None = None

    @property
    def undecided(self) -> bool:
        """Whether neither that the limits are kept is shown nor the contrary."""
        return self.outcome is Outcome.UNDECIDED

    @property
    def worst_mean(self) -> Station:
        """Return the station of the largest mean."""
        return max(self.stations, key=lambda each: gravest(each.mean_mm))

    @property
    def worst_single(self) -> Station:
        """Return the station of the largest single error."""
        return max(self.stations, key=lambda each: gravest(each.max_mm))

    def turn_is_kept(self, turn: Turn | None, *, sure: bool = False) -> bool:
        """Whether an error of orientation, with its U if ``sure``, keeps its limit, or was not
        judged.
        """
        if turn is None or self.max_limit_deg is None:
            return True
        return turn.max_deg + (turn.U_deg if sure else 0.0) <= self.max_limit_deg


def verdict_of(view: RunView) -> Verdict | None:
    """Return the verdict of a finished run with a validation; None for every other run.

    Stations that were also judged together are shown one by one.
    """
    if view.state not in ("done", "intolerant"):
        return None
    places = _places(view)
    order = [each.name for each in view.log.cell.station]
    names = [name for name in order if name in places] or list(places)
    found = {name: view.log.verdict(Judged, f"{VALIDATION}{name}") for name in names}
    judged = {name: each for name, each in found.items() if each is not None}
    if not judged:
        return None
    limits = view.log.cell.validation
    floors = [place.floor.mean for place in places.values() if place.floor is not None]
    return Verdict(
        passed=view.state == "done",
        outcome=run_judged(view.log) or Outcome.REJECTED,
        stations=tuple(_station(name, places[name], found) for name, found in judged.items()),
        mean_limit_mm=limits.mean_tolerance_mm,
        max_limit_mm=limits.max_tolerance_mm,
        floor_mm=max(floors, default=math.nan),
        max_limit_deg=limits.max_tolerance_deg,
    )


def _places(view: RunView) -> dict[str, _Place]:
    """Return the places of a finished validation; nothing of another procedure's result."""
    found = view.log.result.get("validation", {})
    try:
        return typed(found, dict[str, _Place])
    except msgspec.ValidationError:
        return {}


def _station(name: str, place: _Place, judged: Judged) -> Station:
    return Station(
        name, place.points, place.before.mean, judged.mean_mm, place.chosen.p95, judged.max_mm,
        judged.mean_U_mm, judged.max_U_mm, judged.outcome, judged.turn,
    )  # fmt: skip


# -- drawing ---------------------------------------------------------------------------------------


def verdict_lines(view: RunView, found: Verdict, glyphs: Glyphs, standing: int = 0) -> Lines:
    """Return the block, the two worst figures, the stations, and what is to be known or done.

    ``standing`` alarms are latched, also those that the journal raises no more.
    """
    facts = Stack(*_facts(view, found, glyphs, standing))

    def draw(width: int, height: int) -> list[Content]:
        rows = height or TALL
        lines, said = head_lines(view, _head(found), glyphs, width, rows), facts.lines(width)
        if is_small(width, rows):
            return [*lines, *said]
        said = said[: max(rows - len(lines) - len(found.stations) - 2, 2)]
        room = max(rows - len(lines) - len(said), 3)
        return [*lines, *_table(found, glyphs, room).lines(width), *said]

    return Drawing((repr(found), glyphs.plain, facts.state), draw)


def words_of(found: Verdict) -> tuple[str, str]:
    """Return the verdict in one word, and what it states."""
    outcome = Outcome.ACCEPTED if found.passed else found.outcome
    said = "neither pass nor fail" if outcome is Outcome.UNDECIDED else outcome.words
    return outcome.short.upper(), said


def _head(found: Verdict) -> Head:
    word, stated = words_of(found)
    mean, single = found.worst_mean, found.worst_single
    figures = (
        Figure("worst mean |e|, mm", mean.mean_mm, f"at {mean.name}", found.mean_limit_mm,
               mean.mean_U_mm),
        Figure("worst single |e|, mm", single.max_mm, f"at {single.name}", found.max_limit_mm,
               single.max_U_mm),
    )  # fmt: skip
    role = "passed" if found.passed else "ask" if found.undecided else "fault"
    return Head((word,), stated, role, figures)


def _table(found: Verdict, glyphs: Glyphs, room: int) -> Lines:
    """Return the stations in at most ``room`` rows with header and limit; the worst are first."""
    order = sorted(found.stations, key=lambda each: -gravest(each.mean_mm))
    kept = order[: room - 2]
    shown = [each for each in found.stations if each in kept]
    left = len(found.stations) - len(shown)
    titles = "station", "targets", "mean as sent", "mean", "95 % below", "max mm", " verdict"
    limits = (f"{found.mean_limit_mm:.3f}", "-", f"{found.max_limit_mm:.3f}")
    name = f"limit ({left} more in the report)" if left else "limit"
    rows: list[list[Cell]] = [["", *((title, "$label") for title in titles)]]
    rows += [_row(each, found, glyphs) for each in shown]
    rows.append(["", (name, "$label"), "", "", *((each, "$label") for each in limits), ""])
    numbers = [Col(width, right=True) for width in (7, 12, 8, 11, 8)]
    return Grid(rows, Col(), Col(13), *numbers, Col(9, grows=True), styles={0: "on $panel"})


def _row(each: Station, found: Verdict, glyphs: Glyphs) -> list[Cell]:
    shape, tone = SHOWN[each.outcome]
    word = each.outcome.short
    word = f"{getattr(glyphs, shape)} {word.upper() if each.outcome is Outcome.REJECTED else word}"
    mean_style = "bold" if each.mean_mm <= found.mean_limit_mm else "bold $fault"
    max_style = "" if each.max_mm <= found.max_limit_mm else "bold $fault"
    return [
        "",
        Content(harmless(each.name)).truncate(13, ellipsis=True),
        (str(each.targets), "$label"),
        (f"{each.before_mm:.3f}", "$label"),
        (figure(each.mean_mm), mean_style),
        figure(each.p95_mm),
        (figure(each.max_mm), max_style),
        (word, tone),
    ]


def _facts(view: RunView, found: Verdict, glyphs: Glyphs, standing: int) -> list[Lines | Text]:
    """Return what is to be known of a run that passed; of one that failed, why and what to do."""
    if not found.passed and view.alarms:
        gravest_alarm = max(view.alarms, key=lambda alarm: SEVERITIES.index(alarm.severity))
        return _advice(view, found, gravest_alarm, glyphs)
    sure = max(found.stations, key=lambda each: gravest(each.sure_mm))
    bound = f"below {sure.sure_mm:.3f} mm", f" at {_short(sure.name)}"
    floor = f"   floor: {found.floor_mm:.3f} mm" if math.isfinite(found.floor_mm) else ""
    return [
        _whole((" true mean, 95 % sure: ", "$label"), *bound, (floor, "$label")),
        *_orientation(found),
        _written(view, found, glyphs),
        _drift(view, glyphs, standing),
        Content.assemble((" next: ", "$label"), NEXT),
    ]


def _orientation(found: Verdict) -> list[Lines | Text]:
    """Return the largest error of orientation beside its limit, where one is stated."""
    turns = {each.name: each.turn for each in found.stations if each.turn is not None}
    if not turns:
        return []
    name, turn = max(turns.items(), key=lambda each: gravest(each[1].max_deg))
    words = f"{turn.max_deg:.4f}° at {_short(name)}, limit {found.max_limit_deg:g}°"
    return [Content.assemble((" orientation, worst: ", "$label"), words)]


def _short(name: str) -> str:
    """Return a station's name that leaves room for figures."""
    return Content(harmless(name)).truncate(MOST_OF_A_NAME, ellipsis=True).plain


def _whole(*phrases: Text) -> Lines:
    """Return as many phrases as fit, each whole."""
    texts = [Content.assemble(*phrases[:n]) for n in range(len(phrases), 0, -1)]
    return Grid([[Fitting((*texts, texts[-1].truncate(1)))]], Col(grows=True))


def _advice(view: RunView, found: Verdict, alarm: Alarm, glyphs: Glyphs) -> list[Lines | Text]:
    """Return why the run failed, with the stations concerned, and the steps, each whole."""
    where = f"{alarm.where}: " if alarm.where else ""
    words = in_words(f"{where}{alarm.found}", view.log)
    if entry_of(alarm.code, "").verdict == VALIDATION.rstrip("."):
        words = reason_words(found) or words
    why = Content(harmless(f"{alarm.code} {words}")).stylize("bold $fault", 0, len(alarm.code))
    rows: list[list[Cell]] = [["", (glyphs.warned, "bold $fault"), why]]
    rows += [["", (str(n), "bold"), step] for n, step in enumerate(alarm.do[:3], start=1)]
    return [Grid(rows, Col(), Col(), Col(grows=True, wraps=True))]


def reason_words(found: Verdict) -> str:
    """Return which stations do not keep which limit, the worst first.

    Of those that are only not shown to keep it the first says why: the table has their figures.
    """
    failed = [each for each in found.stations if each.outcome is not Outcome.ACCEPTED]
    failed.sort(key=lambda each: -gravest(each.mean_mm))
    open_ones = [each.name for each in failed if each.outcome is Outcome.UNDECIDED]
    whole = [each for each in failed if each.name not in open_ones[1:]]
    words = [f"{each.name}: {_reason(each, found)}" for each in whole]
    return "; ".join([*words, *([f"also {', '.join(open_ones[1:])}"] if open_ones[1:] else [])])


def _reason(each: Station, found: Verdict) -> str:
    limits_mm = found.mean_limit_mm, found.max_limit_mm
    judged = zip(("mean", "single"), (each.mean_mm, each.max_mm), limits_mm, strict=True)
    over = [
        f"{n} {figure(value)} over {limit:.3f}" for n, value, limit in judged if not value <= limit
    ]
    if not found.turn_is_kept(each.turn) and each.turn is not None:
        over.append(f"orientation {each.turn.max_deg:.4f}° over {found.max_limit_deg:g}°")
    if over:
        return ", ".join(over)
    if not found.turn_is_kept(each.turn, sure=True) and each.turn is not None:
        turned = f"orientation {each.turn.max_deg:.4f}°, U {each.turn.U_deg:.4f}°"
        return f"{turned}: not shown below {found.max_limit_deg:g}°"
    sides = zip(
        ("mean", "single"), (each.mean_mm, each.max_mm), (each.mean_U_mm, each.max_U_mm), limits_mm,
        strict=True,
    )  # fmt: skip
    unsure = [
        f"{n} {figure(value)}, U {U:.3f}: not shown below {limit:.3f}"
        for n, value, U, limit in sides if not value + U <= limit
    ]  # fmt: skip
    return ", ".join(unsure) or "too few targets to show it"


def _written(view: RunView, found: Verdict, glyphs: Glyphs) -> Lines | Text:
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
