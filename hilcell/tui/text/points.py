"""Points as text: their deviations, the rows of the points table, and the page of one point.

A deviation is e = actual - nominal in {W}, mm.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from hilcell.calibration.measurement_budget import measurement_budget
from hilcell.calibration.position_errors import counting, position_errors
from hilcell.geometry.statistics import rms
from hilcell.journal.log import Log
from hilcell.language import decimal, marked, tr
from hilcell.model.outcome import Outcome, outcome_of
from hilcell.model.point import Point, Sent
from hilcell.ports import HilcellError
from hilcell.tui.layout import Lines, Stack, figure, labelled_rows
from hilcell.tui.run_view import RunView
from hilcell.tui.widgets import Column


@dataclass(frozen=True, slots=True)
class Deviation:
    """One point's deviation; ``limit_mm`` is None where no tolerance applies.

    ``U_mm`` is the expanded uncertainty of |e|.
    """

    key: str
    error_mm: tuple[float, ...]  # x, y, z
    actual_mm: tuple[float, ...]
    limit_mm: float | None
    U_mm: float = 0.0

    @property
    def norm_mm(self) -> float:
        """Return |e|, the 3D error of eq 18."""
        return math.hypot(*self.error_mm)

    @property
    def outcome(self) -> Outcome:
        if self.limit_mm is None:
            return Outcome.ACCEPTED
        return outcome_of(self.norm_mm, self.limit_mm, self.U_mm)


def expanded_uncertainty_mm(log: Log) -> float:
    """Return U (mm) of a single error; NaN, which accepts nothing, where it cannot be stated."""
    with suppress(HilcellError):
        budget = measurement_budget(log)
        return math.nan if budget is None else budget.U_mm
    return math.nan


def is_judged(point: Point) -> bool:
    """Whether the error of a point is judged: of a target sent with the chosen correction."""
    return point.id.kind == "validate" and point.id.how == Sent.CHOSEN


def deviation_of(log: Log, point: Point) -> Deviation | None:
    """Return a point's deviation, as `point_deviations`, with U as the log has it now."""
    U_mm = expanded_uncertainty_mm(log) if is_judged(point) else 0.0
    return point_deviations(log, [point], U_mm)[0]


def point_deviations(log: Log, points: Sequence[Point], U_mm: float) -> list[Deviation | None]:
    """Return the deviation of each point, None without a nominal target or where {W} is not known.

    Of a target that was measured more than once, the measurement that counts: the larger error.
    ``U_mm`` is that of a single error.
    """
    deviations: list[Deviation | None] = [None] * len(points)
    known = [n for n, point in enumerate(points) if point.nominal_mm is not None]
    if not known or "world" not in log.frames:
        return deviations
    errors = position_errors(log, [counting(log, points[n]) for n in known])
    actual_mm = errors.nominal_mm + errors.error_mm
    limit_mm = log.cell.validation.max_tolerance_mm
    for n, error, actual in zip(known, errors.error_mm, actual_mm, strict=True):
        judged = (limit_mm, U_mm) if is_judged(points[n]) else (None, 0.0)
        deviations[n] = Deviation(points[n].key, (*error.tolist(),), (*actual.tolist(),), *judged)
    return deviations


def state_of(log: Log, point: Point, deviation: Deviation | None) -> str:
    """Return a point's state in one word: ok, out, undecided, noisy, again (re-measured)."""
    if not rms(point.std_mm) <= log.cell.tracker.max_std_mm:
        return "noisy"
    if deviation is not None and deviation.outcome in PointRow.STATES:
        return PointRow.STATES[deviation.outcome]
    return "again" if point.retaken else "ok"


@dataclass(frozen=True, slots=True)
class PointRow:
    """One row of the points table."""

    STATES: ClassVar[dict[Outcome, str]] = {Outcome.REJECTED: "out", Outcome.UNDECIDED: "undecided"}

    SAID: ClassVar = {  # by state: its word with its shape, and its tone
        "in": (marked("● in"), "passed"),
        "out": (marked("▲ OUT"), "*fault"),
        "undecided": (marked("▲undec."), "ask"),
        "noisy": (marked("▲ noisy"), "ask"),
        "waits": (marked("○ waits"), "live"),
        "again": (marked("○ again"), "live"),
        "ok": (marked("· ok"), "label"),
    }

    point: Point
    deviation: Deviation | None
    state: str

    @classmethod
    def of(cls, log: Log, point: Point, deviation: Deviation | None) -> Self:
        return cls(point, deviation, state_of(log, point, deviation))

    @property
    def key(self) -> str:
        return self.point.key

    @property
    def norm_mm(self) -> float:
        """Return |e|, or -1 where there is none, so that it sorts last."""
        return -1.0 if self.deviation is None else self.deviation.norm_mm

    def said(self) -> tuple[str, str]:
        judged = self.deviation is not None and self.deviation.limit_mm is not None
        word, tone = self.SAID["in" if self.state == "ok" and judged else self.state]
        return tr(word), tone

    def bar(self) -> tuple[str, str]:
        """Return |e| as a bar; its whole width is the limit, nothing where there is none."""
        known, tone = self.deviation, self.said()[1].removeprefix("*")
        if known is None or known.limit_mm is None:
            return "", tone
        share = known.norm_mm / known.limit_mm
        return "▄" * max(round(8 * share) if share <= 1.0 else 8, 1), tone


def row_of(log: Log, point: Point) -> PointRow:
    return PointRow.of(log, point, deviation_of(log, point))


def _known(tone: str, text: Callable[[Deviation], str]) -> Callable[[PointRow], tuple[str, str]]:
    """Return the cell of a figure that rows without a deviation do not have."""
    return lambda row: ("" if row.deviation is None else text(row.deviation), tone)


def _error(axis: int) -> Callable[[PointRow], tuple[str, str]]:
    return _known("", lambda e: decimal(f"{e.error_mm[axis]:+z.3f}").replace("-", "−"))


def _triple(values: Sequence[float] | None, digits: int, room: int) -> str:
    """Return three lengths in mm; decimals that have no room go, no number is cut."""
    texts = (
        " ".join(decimal(f"{value:.{n}f}") for value in values or ()) for n in range(digits, -1, -1)
    )
    return next((text for text in texts if len(text) <= room), tr("see its page"))


STATIONS_FROM, WIDE = 62, 119  # widths of the table: stations have a column; places, too
_COLUMNS: tuple[Column[PointRow], ...] = (  # after the name
    Column("station", 7, lambda row: (row.point.station, "label"), least=STATIONS_FROM),
    Column("nominal x y z mm", 22, lambda row: (_triple(row.point.nominal_mm, 1, 22), "label"),
           right=True, least=WIDE),
    Column("measured x y z mm", 26, _known("label", lambda e: _triple(e.actual_mm, 3, 26)),
           right=True, least=WIDE),
    Column("dx", 6, _error(0), right=True, least=54),
    Column("dy", 7, _error(1), right=True, least=54),
    Column("dz", 7, _error(2), right=True, least=54),
    Column("|e| mm", 6, _known("*", lambda e: figure(e.norm_mm)), right=True),
    Column("", 8, PointRow.bar, least=78, below=WIDE),
    Column("", 8, PointRow.bar, least=128),
    Column("rms", 6, lambda row: (decimal(f"{rms(row.point.std_mm):.3f}"), "label"), right=True,
           least=69),
    Column("", 0, lambda row: ""),
    Column("state", 7, PointRow.said),
)  # fmt: skip


def point_columns(*, bad_only: bool = False, worst: bool = False) -> Sequence[Column[PointRow]]:
    """Return the columns of the points; the first title names the filter.

    Where the station has no column of its own, it is beside the name.
    """
    title = (tr("bad by |e|") if worst else tr("bad points")) if bad_only else tr("worst first")
    title = title if bad_only or worst else tr("point")
    return (
        Column(title, 14, lambda row: row.point.id.short, least=STATIONS_FROM),
        Column(title, 8, lambda row: f"{row.point.id.short} {row.point.station}".rstrip(),
               grows=True, below=STATIONS_FROM),
        *_COLUMNS,
    )  # fmt: skip


class PointRows:
    """Makes each row once: while points come, all but the newest stay as they were.

    A row holds as long as the number of the record that made its point: the log gives a new object
    at each access. U of a single error reads every point and changes little: it is taken again when
    a tenth more points are there, and at the end, so that rows and verdict have the same.
    """

    def __init__(self) -> None:
        self._found: dict[str, tuple[int, PointRow]] = {}
        self._world: object = None  # the frame in which the deviations are
        self._U_mm, self._U_of = 0.0, (0, False)  # of how many points, and whether at the end

    def rows(self, log: Log) -> list[PointRow]:
        if log.frames.get("world") is not self._world:
            self._world = log.frames.get("world")
            self._found.clear()
            self._U_of = (0, False)
        new = (key for key in log.points if self._row(key, log.changed[key]) is None)
        points = [log.points[key] for key in new]
        if any(is_judged(point) for point in points) or self._U_of[0]:
            self._take_expanded(log)
        for point, each in zip(points, point_deviations(log, points, self._U_mm), strict=True):
            self._found[point.key] = log.changed[point.key], PointRow.of(log, point, each)
        return [self._found[key][1] for key in log.points]

    def _row(self, key: str, number: int) -> PointRow | None:
        known = self._found.get(key)
        return known[1] if known is not None and known[0] == number else None

    def _take_expanded(self, log: Log) -> None:
        """Take U as the log has it now, where that is due, and judge the known rows by it."""
        count, ended = len(log.points), log.end is not None
        if count < 1.1 * self._U_of[0] and ended == self._U_of[1]:
            return
        self._U_mm, self._U_of = expanded_uncertainty_mm(log), (count, ended)
        for key, (number, row) in self._found.items():
            known = row.deviation
            if known is not None and known.limit_mm is not None and known.U_mm != self._U_mm:
                judged = PointRow.of(log, row.point, replace(known, U_mm=self._U_mm))
                self._found[key] = number, judged

    def deviation(self, log: Log, point: Point) -> Deviation | None:
        row = self._row(point.key, log.changed.get(point.key, 0))
        return deviation_of(log, point) if row is None else row.deviation


def filtered(
    points: Iterable[PointRow], filter_text: str, *, bad_only: bool, worst: bool
) -> list[PointRow]:
    """Return the points that match all words, only bad ones and worst first where asked."""
    # Letters match anywhere, a number as a whole only.
    words = [
        re.compile(rf"(?<!\d){re.escape(word)}(?!\d)" if word[0].isdecimal() else re.escape(word))
        for word in filter_text.lower().split()
    ]

    def searched(row: PointRow) -> str:
        id, label = row.point.id, row.said()[0]
        return f"{id.short} {id.text()} {row.point.station} {row.state} {label}".lower()

    def badness(row: PointRow) -> tuple[bool, float]:  # raw errors are expected to be large
        norm_mm = row.norm_mm if row.norm_mm < math.inf else math.inf  # NaN is the worst of all
        return row.deviation is not None and row.deviation.limit_mm is not None, norm_mm

    rows = [
        row
        for row in points
        if (not bad_only or row.state in ("out", "undecided", "noisy", "again"))
        and all(word.search(searched(row)) for word in words)
    ]
    if worst:
        rows.sort(key=badness, reverse=True)
    return rows


def point_page(view: RunView, key: str) -> Lines:
    point = view.log.points.get(key)
    if point is None:
        return Stack(tr("{key}: the journal holds no such point", key=key))
    row = row_of(view.log, point)
    facts = [
        (tr("point"), point.id.text(point.station)),
        (tr("key"), key),
        (tr("state"), row.state),
        (tr("group"), point.group),
        (tr("station"), point.station or "-"),
    ]
    if (deviation := row.deviation) is not None:
        facts += [
            (tr("nominal, world {W}, mm"), _numbers(point.nominal_mm or (), 3)),
            (tr("measured, world {W}, mm"), _numbers(deviation.actual_mm, 3)),
            (tr("e = actual - nominal, mm"), _numbers(deviation.error_mm, 4, sign="+")),
            ("|e|, mm", decimal(f"{deviation.norm_mm:.4f}")),
        ]
        if deviation.limit_mm is not None:
            facts.append(
                (
                    tr("limit, mm"),
                    tr(
                        "{limit_mm:.3f}, U {U_mm:.3f} (k = 2)",
                        limit_mm=deviation.limit_mm,
                        U_mm=deviation.U_mm,
                    ),
                )
            )
        facts += _repeated(view.log, point)
        point = counting(view.log, point)
    facts += _measured(point, has_rail=view.has_rail)
    return labelled_rows(facts, 27)


def _repeated(log: Log, point: Point) -> list[tuple[str, str]]:
    """Return |e| of each measurement of a target that was measured again, and which counts."""
    measured = [*log.repeated.get(point.key, ()), point]
    if len(measured) == 1:
        return []
    counted = measured.index(counting(log, point))
    norms_mm = position_errors(log, measured).norms_mm.tolist()
    texts = [decimal(f"{norm_mm:.4f}") for norm_mm in norms_mm]
    texts[counted] += tr(" (the larger: counts)")
    return [(tr("|e| first, then again, mm"), ", ".join(texts))]


def _measured(point: Point, *, has_rail: bool) -> list[tuple[str, str]]:
    air = tr("not measured")
    if (weather := point.air) is not None:
        humidity = decimal(f"{weather.humidity_percent:.0f} %")
        air = f"{weather.temperature_c:.2f} C  {weather.pressure_mbar:.1f} mbar  {humidity}"
    facts = [
        (tr("reading, tracker {L}, mm"), _numbers(point.xyz_mm, 4)),
        (
            tr("standard deviation, mm"),
            f"{_numbers(point.std_mm, 4)}   rms {rms(point.std_mm):.4f}",
        ),
        (tr("samples"), str(point.samples)),
        (tr("reflector"), point.reflector),
        (tr("air"), air),
        (tr("readings"), _readings(point, has_rail=has_rail)),
        (tr("session"), str(point.session)),
    ]
    if point.commanded_deg is not None:
        facts.append((tr("joints commanded, deg"), _numbers(point.commanded_deg, 3)))
    if point.joints_deg is not None:
        facts.append((tr("joints read back, deg"), _numbers(point.joints_deg, 3)))
    if has_rail and point.rail_mm is not None and point.strip_mm is not None:
        facts.append(
            (tr("rail / strip, mm"), decimal(f"{point.rail_mm:.3f} / {point.strip_mm:.2f}"))
        )
    return facts


def _readings(point: Point, *, has_rail: bool) -> str:
    if (times := point.readings) is None:
        return tr("times not recorded")
    rail = times.rail if has_rail else None
    known = {"tracker": times.tracker, "rail": rail, "robot": times.robot}
    ages = ", ".join(f"{name} {each.age_s:.2f}" for name, each in known.items() if each)
    settled_s = times.settled_s
    rest = (
        ""
        if settled_s is None
        else tr("; at rest for {settled_s:.2f} s when measured", settled_s=settled_s)
    )
    return tr("age at use in s: {ages}{rest}", ages=ages, rest=rest)


def _numbers(values: Sequence[float], digits: int, sign: str = "") -> str:
    return "  ".join(decimal(f"{value:{sign}.{digits}f}") for value in values)
