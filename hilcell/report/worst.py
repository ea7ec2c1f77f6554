"""The ten worst corrected targets, of re-measured ones both values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from hilcell.calibration.errors import errors_of, targets
from hilcell.journal.log import Log, Point
from hilcell.journal.ways_sent import Sent
from hilcell.ports import Array
from hilcell.present.table import Column, Table, Value
from hilcell.report.facts import Facts
from hilcell.report.target_budget import TargetBudget

MOST = 10
NO_BREAK = "\N{NO-BREAK SPACE}"


@dataclass(frozen=True, slots=True)
class Worst:
    """One target: its nominal place (3,), its error before and after (3,), all in {W}, mm.

    ``again_mm`` is the largest error of its other measurements, None where it was measured once.
    """

    rank: int
    name: str
    nominal_mm: Array
    before_mm: float | None
    error_mm: Array
    again_mm: float | None
    bound_mm: float | None

    @property
    def norm_mm(self) -> float:
        """Return the 3-D error."""
        return float(np.linalg.norm(self.error_mm))

    @property
    def share(self) -> float | None:
        """Return the error over its own 95 % bound."""
        return None if self.bound_mm is None else self.norm_mm / self.bound_mm


def _element(name: str, n: int) -> Callable[[Worst], Value]:
    return lambda row: float(getattr(row, name)[n])


WORST: tuple[Column[Worst], ...] = (
    Column("rank", lambda row: str(row.rank)),
    Column("target", attrgetter("name")),
    *(Column(axis, _element("nominal_mm", n), "mm", ".0f") for n, axis in enumerate("xyz")),
    Column("before", attrgetter("before_mm"), "mm", ".3f"),
    *(Column(f"e{axis}", _element("error_mm", n), "mm", "+.3f") for n, axis in enumerate("xyz")),
    Column("3-D", attrgetter("norm_mm"), "mm", ".3f"),
    Column("again", attrgetter("again_mm"), "mm", ".3f"),
    Column("95 % bound", attrgetter("bound_mm"), "mm", ".3f"),
    Column("after ÷ bound", attrgetter("share"), form=".2f"),
)


def worst(facts: Facts, budget: TargetBudget) -> Table:
    """Return the corrected targets with the largest errors."""
    log = facts.log
    if "world" not in log.frames:
        return Table((), ())
    found = [p for station in log.cell.station for p in targets(log, station.name, Sent.CHOSEN)]
    norms_mm = errors_of(log, found).norms_mm
    order = np.argsort(-norms_mm, kind="stable")[:MOST]
    before = {
        (p.station, p.id.number): p
        for station in log.cell.station
        for p in targets(log, station.name, Sent.BEFORE)
    }
    rows = [
        _row(log, rank, found[n], before.get((found[n].station, found[n].id.number)), budget)
        for rank, n in enumerate(order, start=1)
    ]
    note = (
        "Places and errors in {W}. After ÷ bound above 1: beyond the own bound, which 5 % of "
        "targets are expected to be. Where a target was measured again, the larger value counts."
    )
    if rows:
        key = found[order[0]].key
        note += f" Key of the first: {key}; hilcell export RUN --csv lists every key."
    title = "The ten worst targets" if len(rows) == MOST else "The worst targets"
    return Table(WORST, rows, title, note)


def _row(log: Log, rank: int, point: Point, before: Point | None, budget: TargetBudget) -> Worst:
    others = [p for p in (*log.repeated.get(point.key, ()), log.points[point.key])
              if p.xyz_mm != point.xyz_mm]  # fmt: skip
    found = errors_of(log, [point])
    return Worst(
        rank,
        f"{(point.id.number or 0) + 1} at {point.station}".replace(" ", NO_BREAK),
        found.nominal_mm[0],
        float(errors_of(log, [before]).norms_mm[0]) if before is not None else None,
        found.error_mm[0],
        float(errors_of(log, others).norms_mm.max()) if others else None,
        budget.points_mm.get(point.key),
    )
