"""A finished run: a word on its ground, two lengths large beside their limits, and its table.

A validation has PASS or FAIL and its stations; the worst station decides. *95 % sure* bounds the
mean of a station, *95 % below* is a share of its targets: never one word for both. A pose test
shows its worst AP and RP large, a re-check what to do with the calibration, every other procedure
its own table, as ``hilcell show`` prints it. A narrow or low window has words and figures in one
row each. A run that ended before has no verdict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import ClassVar, Self, TypeVar

import msgspec
from textual.content import Content

from hilcell.alarms.catalogue import SEVERITIES, entry_of
from hilcell.calibration.decision_rule import tolerance_limits
from hilcell.calibration.iso9283 import Angles, PoseTest
from hilcell.calibration.recheck import KIND as RECHECK
from hilcell.calibration.recheck import CheckedPose, RecheckResult
from hilcell.cell.devices import load_entry
from hilcell.decoding import Json, typed
from hilcell.errors import HilcellError
from hilcell.journal.labels import point_id, procedure_label, with_labels
from hilcell.journal.log import Log
from hilcell.language import decimal, tr
from hilcell.model.events import TrackerVerified
from hilcell.model.outcome import Outcome
from hilcell.model.verdicts import (
    AD,
    AP,
    AP_ANGLES,
    ISO,
    RD,
    RP,
    RP_ANGLES,
    VALIDATION,
    Judged,
    Limits,
)
from hilcell.present.table import Column, Named, Table
from hilcell.run.last_word import last_word
from hilcell.sanitize import harmless
from hilcell.tui.layout import (
    BLANK,
    Bar,
    Cell,
    Col,
    Drawing,
    Fitting,
    Grid,
    Lines,
    Stack,
    Text,
    figure,
    has_shapes,
    labelled_rows,
    large,
    large_rows,
)
from hilcell.tui.run_view import RunView
from hilcell.tui.terminal import Glyphs
from hilcell.tui.text.plots import validated_places
from hilcell.tui.text.run import OUTCOME_STYLES, simulation_block


@dataclass(frozen=True, slots=True)
class Figure:
    """One large length (mm): its title, where it is the worst, and its limit, None for none."""

    BAR: ClassVar = 24  # columns
    TO_LIMIT: ClassVar = 19

    title: str
    value_mm: float
    at: str
    limit_mm: float | None = None
    U_mm: float = 0.0  # expanded uncertainty, where it counts against the limit

    @property
    def over(self) -> bool:
        return self.limit_mm is not None and not self.value_mm + self.U_mm <= self.limit_mm

    @property
    def place(self) -> str:
        """Return place and limit; a long name is shortened, the limit never."""
        limit = (
            tr("no limit")
            if self.limit_mm is None
            else tr("limit {limit_mm:.3f}", limit_mm=self.limit_mm)
        )
        return f" {Content(self.at).truncate(10, ellipsis=True).plain}, {limit}"

    def tone(self, glyphs: Glyphs) -> tuple[str, str]:
        """Return the style and the shape that say whether the limit is kept."""
        if self.limit_mm is None:
            return "$label", glyphs.stale
        return ("$fault", glyphs.warned) if self.over else ("$passed", glyphs.fresh)

    def large(self, glyphs: Glyphs) -> list[Cell]:
        """Return eight rows: the title, the digits, the place and the bar up to the limit."""
        tone, shape = self.tone(glyphs)
        digits = large(figure(self.value_mm), tone if self.over else "$foreground", glyphs)
        at = Content.assemble((shape, tone), (self.place, "$label"))
        bar = BLANK
        if self.limit_mm:
            mark = self.TO_LIMIT / self.BAR
            share, guard = (mark * length / self.limit_mm for length in (self.value_mm, self.U_mm))
            bar = Bar(share, tone, mark, guard).drawn(self.BAR)
        return [(self.title, "$label"), *digits, at, bar, BLANK]


@dataclass(frozen=True, slots=True)
class Head:
    """One or two large words, what one word states, the role of their colour, and two figures."""

    BLOCK: ClassVar = 24  # columns of the words' ground

    words: tuple[str, ...]
    stated: str
    role: str
    figures: tuple[Figure, ...]

    @property
    def style(self) -> str:
        if self.role == "label":
            return "bold $foreground on $badge"
        return f"bold $on-{self.role} on ${self.role}-fill"

    @staticmethod
    def is_small(width: int, rows: int) -> bool:
        return width < 78 or rows < 14

    def block(self, mark: Content, glyphs: Glyphs) -> list[Content]:
        """Return the words on their ground, over the mark of a simulation."""
        texts: list[str] = []
        for word in self.words:
            is_long = len(word) > (self.BLOCK + 1) // 4  # for large letters
            is_bold = glyphs.plain or is_long or not has_shapes(word)
            texts += ["", word, ""] if is_bold else large_rows(word)
        if len(self.words) == 1:
            texts = ["", *texts, "", self.stated]
        last = mark.pad_left((self.BLOCK - mark.cell_length) // 2).truncate(self.BLOCK, pad=True)
        words = (Content.styled(f"{text:^{self.BLOCK}}", self.style) for text in texts)
        return [*words, last.stylize_before(self.style.removeprefix("bold "))]

    def small(self, mark: Content, glyphs: Glyphs) -> Lines:
        stated = (self.stated,) if len(self.words) == 1 else ()
        text = "  ".join(["", " ".join(self.words), *stated, ""])
        rows: list[list[Cell]] = []
        for each in self.figures:
            tone, shape = each.tone(glyphs)
            value = (f"{figure(each.value_mm)} mm", f"bold {tone}" if each.over else "bold")
            title = (each.title.removesuffix(", mm"), "$label")
            places = each.place, each.place.partition(", ")[2]
            place = Fitting(tuple(Content.styled(text, "$label") for text in places))
            rows.append(["", (shape, tone), title, value, place])
        columns = Col(), Col(), Col(), Col(), Col(grows=True)
        words = Content("").join([Content.styled(text, self.style), mark])
        return Stack(words, Grid(rows, *columns))

    def lines(self, view: RunView, glyphs: Glyphs, width: int, rows: int) -> list[Content]:
        """Return the words and the figures, large where there is room; nothing without words."""
        if not self.words:
            return []
        mark = simulation_block() if view.simulated else BLANK
        if Head.is_small(width, rows):
            return self.small(mark, glyphs).lines(width)
        rows_of = (self.block(mark, glyphs), *(each.large(glyphs) for each in self.figures))
        return Grid(zip(*rows_of, strict=True), Col(self.BLOCK), Col(25), Col(), gap=2).lines(width)


def gravest(value_mm: float) -> float:
    """Return a length to order by: NaN and infinity are the worst."""
    return value_mm if math.isfinite(value_mm) else math.inf


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
        return Content(harmless(self.name)).truncate(20, ellipsis=True).plain

    @property
    def reason(self) -> str:
        """Return which limits it does not keep, or is not shown to."""
        over, unsure = [], []
        for name, each in zip(("mean", "single", "orientation"), self.judged.figures, strict=False):
            value = math.nan if each.value is None else each.value
            written, limit, U = (
                (
                    decimal(f"{value:.4f}°"),
                    decimal(f"{each.limit:g}°"),
                    decimal(f"{each.U or 0.0:.4f}°"),
                )
                if each.unit == "deg"
                else (figure(value), decimal(f"{each.limit:.3f}"), decimal(f"{each.U or 0.0:.3f}"))
            )
            if each.limit is not None and not value <= each.limit:
                over.append(
                    tr("{name} {written} over {limit}", name=name, written=written, limit=limit)
                )
            elif each.outcome is not Outcome.ACCEPTED:
                unsure.append(
                    tr(
                        "{name} {written}, U {U}: not shown below {limit}",
                        name=name,
                        written=written,
                        U=U,
                        limit=limit,
                    )
                )
        return ", ".join(over or unsure) or tr("too few targets to show it")

    def cells(self, limits: Limits, glyphs: Glyphs) -> list[Cell]:
        judged, outcome = self.judged, self.judged.outcome
        role, shape, *_ = OUTCOME_STYLES[outcome]
        word, tone = tr(outcome.short), f"${role}"
        if outcome is Outcome.REJECTED:
            word, tone = word.upper(), f"bold {tone}"
        mean_style = "bold" if judged.mean_mm <= limits.mean_mm else "bold $fault"
        max_style = "" if judged.max_mm <= limits.max_mm else "bold $fault"
        return [
            "",
            Content(harmless(self.name)).truncate(13, ellipsis=True),
            (str(self.targets), "$label"),
            (decimal(f"{self.before_mm:.3f}"), "$label"),
            (figure(judged.mean_mm), mean_style),
            figure(self.p95_mm),
            (figure(judged.max_mm), max_style),
            (f"{getattr(glyphs, shape)} {word}", tone),
        ]


@dataclass(frozen=True, slots=True)
class Finished:
    """A finished validation: its stations, its limits and the run's outcome."""

    outcome: Outcome
    stations: tuple[Station, ...]
    limits: Limits
    floor_mm: float

    @property
    def worst_mean(self) -> Station:
        return max(self.stations, key=lambda each: gravest(each.judged.mean_mm))

    @property
    def worst_single(self) -> Station:
        return max(self.stations, key=lambda each: gravest(each.judged.max_mm))

    @property
    def words(self) -> tuple[str, str]:
        undecided = self.outcome is Outcome.UNDECIDED
        meaning = tr("neither pass nor fail") if undecided else tr(self.outcome.text)
        return tr(self.outcome.short).upper(), meaning

    @property
    def reasons(self) -> str:
        """Return which stations do not keep which limit, the worst first.

        Of those that are only not shown to keep it the first says why: the table has their figures.
        """
        failed = [each for each in self.stations if each.judged.outcome is not Outcome.ACCEPTED]
        failed.sort(key=lambda each: -gravest(each.judged.mean_mm))
        undecided = [each.name for each in failed if each.judged.outcome is Outcome.UNDECIDED]
        whole = [each for each in failed if each.name not in undecided[1:]]
        words = [f"{each.name}: {each.reason}" for each in whole]
        return "; ".join(
            [
                *words,
                *([tr("also {others}", others=", ".join(undecided[1:]))] if undecided[1:] else []),
            ]
        )

    @property
    def head(self) -> Head:
        word, stated = self.words
        mean, single, limits = self.worst_mean, self.worst_single, self.limits
        figures = (
            Figure(tr("worst mean |e|, mm"), mean.judged.mean_mm, tr("at {name}", name=mean.name),
                   limits.mean_mm,
                   mean.judged.mean_U_mm),
            Figure(tr("worst single |e|, mm"), single.judged.max_mm,
                   tr("at {name}", name=single.name), limits.max_mm,
                   single.judged.max_U_mm),
        )  # fmt: skip
        return Head((word,), stated, OUTCOME_STYLES[self.outcome][0], figures)

    @property
    def orientation(self) -> list[Lines | Text]:
        """Return the largest error of orientation beside its limit, where one is stated."""
        turns = [(each, each.judged.orientation) for each in self.stations]
        known = [(each, turn) for each, turn in turns if turn is not None]
        if not known:
            return []
        worst, turn = max(known, key=lambda each: gravest(each[1].max_deg))
        words = tr(
            "{largest_deg:.4f}° at {station}, limit {limit_deg:g}°",
            largest_deg=turn.max_deg,
            station=worst.short,
            limit_deg=self.limits.max_deg,
        )
        return [Content.assemble((tr(" orientation, worst: "), "$label"), words)]

    def table(self, glyphs: Glyphs, room: int) -> Lines:
        order = sorted(self.stations, key=lambda each: -gravest(each.judged.mean_mm))
        kept = order[: room - 2]
        shown = [each for each in self.stations if each in kept]
        left = len(self.stations) - len(shown)
        titles = (
            tr("station"),
            tr("targets"),
            tr("mean as sent"),
            tr("mean"),
            tr("95 % below"),
            tr("max mm"),
            tr(" verdict"),
        )
        limits = (decimal(f"{self.limits.mean_mm:.3f}"), "-", decimal(f"{self.limits.max_mm:.3f}"))
        name = tr("limit ({left} more in the report)", left=left) if left else tr("limit")
        rows: list[list[Cell]] = [["", *((title, "$label") for title in titles)]]
        rows += [each.cells(self.limits, glyphs) for each in shown]
        rows.append(["", (name, "$label"), "", "", *((each, "$label") for each in limits), ""])
        numbers = [Col(width, right=True) for width in (7, 12, 8, 11, 8)]
        return Grid(rows, Col(), Col(13), *numbers, Col(9, grows=True), styles={0: "on $panel"})

    def lines(self, view: RunView, glyphs: Glyphs, standing: int = 0) -> Lines:
        """Return the block, the two worst figures, the stations, and what is to be known or done.

        ``standing`` alarms are latched, also those that the journal raises no more.
        """
        facts = Stack(*self._facts(view, glyphs, standing))

        def draw(width: int, height: int) -> list[Content]:
            rows = height or 40  # which hold everything
            lines, fact_lines = self.head.lines(view, glyphs, width, rows), facts.lines(width)
            if Head.is_small(width, rows):
                return [*lines, *fact_lines]
            fact_lines = fact_lines[: max(rows - len(lines) - len(self.stations) - 2, 2)]
            room = max(rows - len(lines) - len(fact_lines), 3)
            return [*lines, *self.table(glyphs, room).lines(width), *fact_lines]

        return Drawing(draw)

    def _facts(self, view: RunView, glyphs: Glyphs, standing: int) -> list[Lines | Text]:
        """Return what is to be known of a run that passed; of a failed one why, and what next."""
        if self.outcome is not Outcome.ACCEPTED and view.alarms:
            return self._advice(view, glyphs)
        sure = max(self.stations, key=lambda each: gravest(each.sure_mm))
        bound = (
            tr("below {sure_mm:.3f} mm", sure_mm=sure.sure_mm),
            tr(" at {station}", station=sure.short),
        )
        floor = (
            tr("   floor: {floor_mm:.3f} mm", floor_mm=self.floor_mm)
            if math.isfinite(self.floor_mm)
            else ""
        )
        return [
            _whole((tr(" true mean, 95 % confidence: "), "$label"), *bound, (floor, "$label")),
            *self.orientation,
            self._written(view, glyphs),
            _drift(view, glyphs, standing),
            _last_word(view),
        ]

    def _advice(self, view: RunView, glyphs: Glyphs) -> list[Lines | Text]:
        alarm = max(view.alarms, key=lambda alarm: SEVERITIES.index(alarm.severity))
        where = f"{alarm.where}: " if alarm.where else ""
        words = with_labels(f"{where}{alarm.found}", view.log)
        if entry_of(alarm.code, "").verdict == VALIDATION.rstrip("."):
            words = self.reasons or words
        why = Content(harmless(f"{alarm.code} {words}")).stylize("bold $fault", 0, len(alarm.code))
        rows: list[list[Cell]] = [["", (glyphs.warned, "bold $fault"), why]]
        rows += [["", (str(n), "bold"), step] for n, step in enumerate(alarm.do[:3], start=1)]
        return [Grid(rows, Col(), Col(), Col(grows=True, wraps=True))]

    def _written(self, view: RunView, glyphs: Glyphs) -> Lines | Text:
        celsius, air = view.log.temperatures_c(), ""
        if celsius:
            air = tr(
                "; air was {low:.1f} to {high:.1f} {degree}C",
                low=min(celsius),
                high=max(celsius),
                degree=glyphs.degree,
            )
        if not view.log.calibrates:
            return _whole((tr(" no calibration file was to be written"), "$label"), (air, "$label"))
        if view.calibration_lost:
            return (
                f" {glyphs.warned} {tr('calibration.json is not written: space writes it')}",
                "$ask",
            )
        names = " ".join(each.name for each in self.stations)
        head = Content.assemble((tr(" written: "), "$label"), "calibration.json")
        return _whole(head, (tr(" for {names}", names=names), "$label"), (air, "$label"))


def finished_verdict(view: RunView) -> Finished | None:
    """Return the verdict of a finished run with a validation; None for every other run.

    Stations that were also judged together are shown one by one.
    """
    if view.state not in ("done", "intolerant"):
        return None
    places = validated_places(view.log)
    order = [each.name for each in view.log.cell.station]
    names = [name for name in order if name in places] or list(places)
    stations = [
        Station(name, place.points, place.before.mean, place.chosen.p95, judged)
        for name in names
        for place in (places[name],)
        if (judged := view.log.verdict(Judged, f"{VALIDATION}{name}")) is not None
    ]
    if not stations:
        return None
    floors = [place.floor.mean for place in places.values() if place.floor is not None]
    outcome = Outcome.ACCEPTED
    if view.state != "done":
        undecided = view.log.outcome is Outcome.UNDECIDED
        outcome = Outcome.UNDECIDED if undecided else Outcome.REJECTED
    limits = tolerance_limits(view.log.cell)
    return Finished(outcome, tuple(stations), limits, max(floors, default=math.nan))


def _whole(*phrases: Text) -> Lines:
    """Return as many phrases as fit, each whole."""
    texts = [Content.assemble(*phrases[:n]) for n in range(len(phrases), 0, -1)]
    return Grid([[Fitting((*texts, texts[-1].truncate(1)))]], Col(grows=True))


def _last_word(view: RunView) -> Lines:
    """Return the sentence with which every run ends; the footer has the keys for what is next."""
    sentence: list[Cell] = ["", last_word(view.log, Path(view.run)).sentence]
    return Grid([sentence], Col(), Col(grows=True, wraps=True))


def _drift(view: RunView, glyphs: Glyphs, standing: int) -> Lines:
    offsets_mm = [e.fact.off_mm for e in view.log.events if isinstance(e.fact, TrackerVerified)]
    moved = max((max(each) for each in offsets_mm if each), default=None)
    over = sum(alarm.cause == "over" for alarm in view.alarms)
    count = max(len(view.alarms), standing) - over
    text = {0: tr("no alarms"), 1: tr("1 alarm: e")}.get(count, tr("{n} alarms: e", n=count))
    text += {0: "", 1: tr("; 1 that is over: e")}.get(over, tr("; {n} that are over: e", n=over))
    drift = "" if moved is None else tr("; floor nests within {moved:.3f} mm", moved=moved)
    tone, shape = ("$ask", glyphs.warned) if count else ("$passed", glyphs.fresh)
    head = Content.assemble((f" {shape}", tone), (f" {text}", "$label"))
    return _whole(head, (drift, "$label"))


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Result:
    """The findings of a run; the head has no words where nothing large is said."""

    head: Head
    text: str
    table: Table

    @classmethod
    def of_test(cls, test: PoseTest, *, passed: bool) -> Self:
        worst, limits, turned = test.worst, test.limits, test.orientation
        ap_mm, rp_mm = limits.get(AP.limit), limits.get(RP.limit)
        figures = (
            Figure(
                tr("worst AP_p, mm"),
                worst.ap_mm,
                tr("at {name}", name=worst.ap_pose),
                ap_mm,
                worst.ap_u95_mm,
            ),
            Figure(
                tr("worst RP_l, mm"),
                worst.rp_mm,
                tr("at {name}", name=worst.rp_pose),
                rp_mm,
                worst.rp_u95_mm,
            ),
        )
        rows: list[tuple[str, ...]] = [
            (
                name,
                *map(figure, (each.ap_mm, each.ap_u95_mm, each.rp_mm, each.rp_u95_mm)),
                *cls._worst_angles(turned.get(name)),
                tr("pass") if test.keeps(name) else tr("FAIL"),
            )
            for name, each in test.poses.items()
        ]
        heads = [(tr("pose"), ""), (AP.symbol, "mm"), ("U", "mm"), (RP.symbol, "mm"), ("U", "mm")]
        heads += [(AP_ANGLES.symbol, "°"), (RP_ANGLES.symbol, "°"), (tr("verdict"), "")]
        columns = [
            Column(name, itemgetter(n), unit, "s" if unit else "")
            for n, (name, unit) in enumerate(heads)
            if (n < 5 or turned or n == 7) and (n < 7 or limits)
        ]
        words = (("ISO",), tr("no limits stated"), "label")
        if limits:
            angles = (_limit(limits.get(of.limit)) for of in (AP_ANGLES, RP_ANGLES))
            rows.append((tr("limit"), _limit(ap_mm), "", _limit(rp_mm), "", *angles, ""))
            words = (tr("FAIL"),), tr("not within its limits"), "fault"
            if passed:
                words = (tr("PASS"),), tr("within its limits"), "passed"
        return cls(Head(*words, figures), cls._distance_words(test), Table(columns, rows))

    @classmethod
    def of_recheck(cls, result: RecheckResult, log: Log) -> Self:
        worst = sorted(result.poses, key=lambda each: -gravest(each.error_mm))
        columns: list[Column[CheckedPose]] = [
            Column("worst first", lambda each: point_id(each.pose, log).short),
            Column("predicted below", lambda each: figure(each.bound_mm), "mm", "s"),
            Column("now", lambda each: figure(each.error_mm), "mm", "s"),
            Column("less the base's motion", lambda each: figure(each.left_mm), "mm", "s"),
        ]
        limits_mm = result.mean_tolerance_mm, result.max_tolerance_mm
        at = point_id(worst[0].pose, log).short if worst else tr("its target")
        figures = (
            Figure(tr("mean |e| now, mm"), result.mean_mm, "all", limits_mm[0], result.mean_U_mm),
            Figure(tr("largest |e| now, mm"), result.max_mm, at, limits_mm[1], result.max_U_mm),
        )
        words = {
            "valid": ((tr("STILL"), tr("VALID")), tr("still valid"), "passed"),
            "update": ((tr("UPDATE"),), tr("base moved, updated"), "ask"),
            "redo": ((tr("REDO"),), tr("calibrate again"), "fault"),
        }
        head = Head(*words[result.verdict], figures)
        return cls(head, result.text, Table(columns, worst))

    def lines(self, view: RunView, glyphs: Glyphs) -> Lines:
        """Return the word and its figures, the sentence, and as many rows of the table as fit."""
        table = table_lines(self.table, view.log)

        def draw(width: int, height: int) -> list[Content]:
            rows = height or 40  # which hold most results whole
            lines = self.head.lines(view, glyphs, width, rows)
            if self.text:
                sentence: list[Cell] = ["", (harmless(self.text), "$label")]
                lines += Grid([sentence], Col(), Col(grows=True, wraps=True)).lines(width)
            lines += table.lines(width)
            if len(lines) > rows:
                more = Content.styled(tr(" o report: all of the table"), "$label")
                lines = [*lines[: max(rows - 1, 0)], more]
            else:
                lines += _last_word(view).lines(width)
            return [line.truncate(width) for line in lines]

        return Drawing(draw)

    @staticmethod
    def _distance_words(test: PoseTest) -> str:
        pair = test.distance
        stated = ((of.key.upper(), test.limits.get(of.limit)) for of in (AD, RD))
        limits = [f"{name} {limit_mm:.3f}" for name, limit_mm in stated if limit_mm is not None]
        limits_text = tr("; limits {limits} mm", limits=", ".join(limits)) if limits else ""
        return tr(
            "distance {start}-{to}: AD {ad_mm:+z.3f} mm (U {ad_u95_mm:.3f}), "
            "RD ±{rd_mm:.3f} mm (U {rd_u95_mm:.3f}){limits}",
            start=pair.start,
            to=pair.to,
            ad_mm=pair.ad_mm,
            ad_u95_mm=pair.ad_u95_mm,
            rd_mm=pair.rd_mm,
            rd_u95_mm=pair.rd_u95_mm,
            limits=limits_text,
        )

    @staticmethod
    def _worst_angles(angles: Angles | None) -> tuple[str, str]:
        """Return the largest AP and RP of a pose's angles, as far as they were measured."""
        parts = ({}, {}) if angles is None else (angles.ap_deg, angles.rp_deg)
        ap, rp = (decimal(f"{max(map(abs, each.values())):.4f}") if each else "-" for each in parts)
        return ap, rp


def result_of(view: RunView) -> Result | None:
    """Return the result of a run that has come to its end; None for every other, or for none."""
    if view.state not in ("done", "intolerant") or view.log.plan is None:
        return None
    result = None if view.log.end is None else view.log.result
    if not isinstance(result, dict):
        return None
    test = _converted(result.get(ISO), PoseTest)
    if test is not None and test.poses:
        return Result.of_test(test, passed=view.state == "done")
    checked = _converted(result.get(RECHECK), RecheckResult)
    if checked is not None:
        return Result.of_recheck(checked, view.log)
    table, text = procedure_table(view.log.plan.procedure, result)
    nothing = "" if table else tr("Finished. This procedure measures nothing that is judged.")
    return Result(Head((), "", "label", ()), text or nothing, table)


def _converted(value: object, kind: type[T]) -> T | None:
    """Return a part of a result; None of another procedure's, or of another version's."""
    try:
        return typed(value, kind)
    except msgspec.ValidationError:
        return None


def procedure_table(name: str, result: Json) -> tuple[Table, str]:
    """Return a procedure's own table and text of a result; none where it cannot read it."""
    if not result:
        return Table((), ()), ""
    try:
        procedure = load_entry("procedures", name)
        table: Table = procedure.table(result)
        table.texts()  # raises where a value is not of its column
        return table, procedure.words(result)
    except (HilcellError, LookupError, TypeError, ValueError, AttributeError):
        return Table((), ()), ""  # of another version, or of a procedure that is not installed here


def _limit(limit_mm: float | None) -> str:
    return "-" if limit_mm is None else decimal(f"{limit_mm:.3f}")


NAMES = {  # of the summary, by the name shown
    "last_word": "outcome", "operator": "operator", "job": "job", "points": "points",
    "state": "state",
    "verdict": "verdict", "calibration": "stage", "seed": "seed",
    "accepted": "accepted", "link_warning": "warning", "fault": "fault",
}  # fmt: skip


def report_lines(summary: Mapping[str, object], log: Log | None) -> Lines:
    procedure, standing = str(summary.get("procedure", "")), summary.get("standing")
    facts = [
        (tr("run"), str(summary.get("run", ""))),
        (tr("procedure"), procedure_label(procedure)),
        (tr("cell"), str(summary.get("cell", ""))),
        (tr("simulated"), tr("yes, no device moved") if summary.get("simulated") else tr("no")),
        *((shown, _words(summary[name])) for name, shown in NAMES.items() if summary.get(name)),
    ]
    if isinstance(standing, Mapping):
        facts.append((tr("calibration"), str(standing.get("text", ""))))
    parts: list[Lines | Text] = [labelled_rows((name, harmless(text)) for name, text in facts)]
    result = summary.get("result")
    if summary.get("state") == "finished" and isinstance(result, dict):
        table, text = procedure_table(procedure, result)
        parts += [BLANK, table_lines(table, log)] if table else []
        parts += [BLANK, harmless(text)] if text else []
    return Stack(*parts)


def _words(value: object) -> str:
    if isinstance(value, list):
        return "; ".join(map(_words, value))
    text = str(value)
    return text if " " in text else text.replace("_", " ")


GAP = 2
WIDEST = 30  # columns of a cell; a longer text wraps


def table_lines(table: Table, log: Log | None = None) -> Lines:
    """Return the table in as many blocks as it needs, each with its header.

    Names of the program, and keys of the points of ``log``, are in words.
    """
    shown = [table.headers, *table.texts("-")]
    for texts, values in zip(shown[1:], table.rows, strict=True):
        for at, value in enumerate(values):
            text = value.words if isinstance(value, Named) else texts[at]
            texts[at] = text if log is None else with_labels(text, log)
    shown = [[harmless(cell) for cell in row] for row in shown]
    columns = [list(column) for column in zip(*shown, strict=True)]

    def draw(width: int, height: int) -> list[Content]:
        widths = [max(map(len, column)) for column in columns]
        if sum(widths) + GAP * len(widths) > width:  # headers wrap before columns go on below
            widths = [max(map(len, [*head.split(), *cells])) for head, *cells in columns]
        widths = [max(min(each, WIDEST, width - 2), 1) for each in widths]
        blocks: list[list[int]] = [[0]] if widths else []  # columns; the first begins each block
        for n in range(1, len(widths)):
            used = sum(widths[m] + GAP for m in blocks[-1])
            if used + widths[n] > width - 1 and len(blocks[-1]) > 1:
                blocks.append([0])
            blocks[-1].append(n)
        lines: list[Content] = []
        for block in blocks:
            cols = (Col(most=widths[n], right=n > 0, wraps=True) for n in block)
            rows = [[row[n] for n in block] for row in shown]
            grid = Grid(rows, *cols, gap=GAP, styles={0: "$label on $panel"})
            lines += [line.pad_left(1) for line in grid.lines(width - 1)]
        return lines

    return Drawing(draw)
