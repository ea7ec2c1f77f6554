"""Points as text: the rows of the points table, and the page of one point."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace

from textual.content import Content

from hilcell.geometry.statistics import rms
from hilcell.journal.log import Log, Point
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.text.deviation import BAD_STATES, PointRow, expanded_of, row_of
from hilcell.tui.widgets import Column, Row

WIDE = 112
_NARROW_COLUMNS = (
    Column("point", 26),
    Column("dx mm", 7, right=True),
    Column("dy mm", 7, right=True),
    Column("dz mm", 7, right=True),
    Column("|e| mm", 7, right=True),
    Column("rms mm", 6, right=True),
    Column("state", 8),
)
_WIDE_COLUMNS = (
    Column("point", 26),
    Column("nominal x y z mm", 28, right=True),
    Column("measured x y z mm", 31, right=True),
    *_NARROW_COLUMNS[1:],
)
_TONES = {"out": "fault", "unsure": "ask", "noisy": "ask", "waits": "live", "again": "live"}


def columns_for(width: int, *, bad_only: bool = False, worst: bool = False) -> Sequence[Column]:
    """Return the columns that a table of this width shows; the first title names the filter."""
    columns = _WIDE_COLUMNS if width >= WIDE + 40 else _NARROW_COLUMNS
    which = " ".join(["bad only"] * bad_only + ["by |e|" if bad_only else "worst first"] * worst)
    return (replace(columns[0], title=f"point: {which}"), *columns[1:]) if which else columns


class PointRows:
    """Makes each row once: while points come, all but the newest stay as they were."""

    def __init__(self) -> None:
        self._found: dict[str, PointRow] = {}
        self._drawn: dict[str, tuple[PointRow, bool, int, Row]] = {}

    def rows(self, log: Log) -> Iterator[PointRow]:
        """Yield the rows of all points in the order in which they were first measured."""
        U_mm: float | None = None  # computed once, and only for new rows
        for key, point in log.points.items():
            row = self._found.get(key)
            if row is None or row.point is not point or row.deviation is None:
                U_mm = expanded_of(log) if U_mm is None else U_mm
                row = self._found[key] = row_of(log, point, U_mm)
            yield row

    def drawn(self, found: PointRow, waiting: Collection[str], width: int) -> Row:
        """Return the cells of one point."""
        key, waits = found.point.key, found.point.key in waiting
        known = self._drawn.get(key)
        if known is None or known[0] is not found or known[1:3] != (waits, width):
            known = self._drawn[key] = (found, waits, width, to_row(found, waiting, width))
        return known[3]


def filtered(
    points: Iterable[PointRow], wanted: str, *, bad_only: bool, worst: bool
) -> list[PointRow]:
    """Return the points that match all words, only bad ones and worst first where asked."""
    words = wanted.lower().split()
    rows = [
        row
        for row in points
        if (not bad_only or row.state in (*BAD_STATES, "again"))
        and all(
            word in f"{row.point.key} {row.point.station} {row.state}".lower() for word in words
        )
    ]
    if worst:
        rows.sort(key=_badness, reverse=True)
    return rows


def _badness(row: PointRow) -> tuple[bool, float]:
    """Sort raw errors after those with a tolerance: they are expected to be large."""
    norm_mm = row.norm_mm if row.norm_mm < math.inf else math.inf  # NaN is the worst of all
    return row.deviation is not None and row.deviation.limit_mm is not None, norm_mm


def to_row(found: PointRow, waiting: Collection[str], width: int) -> Row:
    """Return the cells of one point; ``waiting`` names those that are to be re-measured."""
    point, deviation = found.point, found.deviation
    state = "waits" if point.key in waiting else found.state
    errors: tuple[str, ...] = ("", "", "", "")
    if deviation is None:
        actual = point.xyz_mm
    else:
        errors = (*(f"{each:+.3f}" for each in deviation.error_mm), f"{deviation.norm_mm:.3f}")
        actual = deviation.actual_mm
    narrow = (*errors, f"{rms(point.std_mm):.3f}", state)
    if width < WIDE + 40:
        return Row(point.key, (point.key, *narrow), _TONES.get(state, ""))
    nominal = "" if point.nominal_mm is None else _triple(point.nominal_mm, 2)
    return Row(point.key, (point.key, nominal, _triple(actual, 3), *narrow), _TONES.get(state, ""))


def _triple(values: Sequence[float], digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)


def point_page(view: RunView, key: str) -> Content:
    """Return all that the journal holds of a point."""
    point = view.log.points.get(key)
    if point is None:
        return Content(f"{key}: the journal holds no such point")
    row = row_of(view.log, point)
    facts: list[tuple[str, str]] = [("point", key), ("state", row.state)]
    facts += [("group", point.group), ("station", point.station or "-")]
    if row.deviation is not None:
        found = row.deviation
        facts += [
            ("nominal, world {W}, mm", _numbers(point.nominal_mm or (), 3)),
            ("measured, world {W}, mm", _numbers(found.actual_mm, 3)),
            ("e = actual - nominal, mm", _numbers(found.error_mm, 4, sign="+")),
            ("|e|, mm", f"{found.norm_mm:.4f}"),
        ]
        if found.limit_mm is not None:
            facts.append(("limit, mm", f"{found.limit_mm:.3f}, U {found.U_mm:.3f} (k = 2)"))
    facts += _measured(point)
    return Content("\n").join(
        Content.assemble((f"{name:<28}", "$label"), text) for name, text in facts
    )


def _measured(point: Point) -> list[tuple[str, str]]:
    facts = [
        ("reading, tracker {L}, mm", _numbers(point.xyz_mm, 4)),
        ("standard deviation, mm", f"{_numbers(point.std_mm, 4)}   rms {rms(point.std_mm):.4f}"),
        ("samples", str(point.samples)),
        ("reflector", point.reflector),
        ("air", _air(point)),
        ("readings", _readings(point)),
        ("session", str(point.session)),
    ]
    if point.commanded_deg is not None:
        facts.append(("joints commanded, deg", _numbers(point.commanded_deg, 3)))
    if point.joints_deg is not None:
        facts.append(("joints read back, deg", _numbers(point.joints_deg, 3)))
    if point.rail_mm is not None and point.strip_mm is not None:
        facts.append(("rail / strip, mm", f"{point.rail_mm:.3f} / {point.strip_mm:.2f}"))
    return facts


def _readings(point: Point) -> str:
    if (times := point.readings) is None:
        return "times not recorded"
    known = {"tracker": times.tracker, "rail": times.rail, "robot": times.robot}
    ages = ", ".join(f"{name} {each.age_s:.2f}" for name, each in known.items() if each)
    settled_s = times.settled_s
    rest = "" if settled_s is None else f"; at rest for {settled_s:.2f} s when measured"
    return f"age at use in s: {ages}{rest}"


def _air(point: Point) -> str:
    if (air := point.air) is None:
        return "not measured"
    humidity = f"{air.humidity_percent:.0f} %"
    return f"{air.temperature_c:.2f} C  {air.pressure_mbar:.1f} mbar  {humidity}"


def _numbers(values: Sequence[float], digits: int, sign: str = "") -> str:
    return "  ".join(f"{value:{sign}.{digits}f}" for value in values)
