"""Records to doubt: serial numbers and names that several have, clocks that disagree."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator
from itertools import groupby, pairwise
from typing import NamedTuple

from sqlalchemy import Connection, func, select

from hilcell.calibration.validity import CLOCK_ERROR
from hilcell.clean import clean
from hilcell.plant.cells import CELL
from hilcell.plant.tables import RUN


class Doubt(NamedTuple):
    """A doubt about the records of some cells, in a sentence."""

    cells: list[str]
    words: str


def doubts(connection: Connection, cells: Collection[str] | None = None) -> list[str]:
    """Return what is wrong with the records: serial numbers and clocks, one sentence each.

    ``cells`` are the names of those whose records are wanted; None for all.
    """
    kinds = (_shared_serials, _shared_robots, _namesakes, _at_once, _ahead, _set_back)
    found = (doubt for kind in kinds for doubt in kind(connection))
    return [doubt.words for doubt in found if cells is None or not {*cells}.isdisjoint(doubt.cells)]


def _shared_serials(connection: Connection) -> Iterator[Doubt]:
    asked = select(RUN.c.serial, RUN.c.cell).where(RUN.c.serial != "").distinct()
    found: defaultdict[str, list[str]] = defaultdict(list)
    for row in connection.execute(asked.order_by(RUN.c.serial, RUN.c.cell)):
        found[row.serial].append(row.cell)
    for serial, names in found.items():
        if len(names) > 1:
            yield Doubt(
                names,
                f"serial number {clean(serial)} is that of cells {', '.join(map(clean, names))}: "
                "give each its own in its cell file",
            )


def _shared_robots(connection: Connection) -> Iterator[Doubt]:
    """Yield robots that worked in several cells in turns: one that was moved has left the first."""
    asked = (
        select(
            RUN.c.robot, RUN.c.cell, RUN.c.serial,
            func.min(RUN.c.begun).label("first"), func.max(RUN.c.ended).label("last"),
        )
        .where(RUN.c.robot != "")
        .group_by(RUN.c.robot, RUN.c.cell, RUN.c.serial)
        .order_by(RUN.c.robot, func.min(RUN.c.begun), RUN.c.cell)
    )  # fmt: skip
    for robot, rows in groupby(connection.execute(asked), lambda row: row.robot):
        spans = list(rows)
        if any(later.first < earlier.last for earlier, later in pairwise(spans)):
            names = sorted({span.cell for span in spans})
            yield Doubt(
                names,
                f"robot {clean(robot)} worked in {len(spans)} cells in turns "
                f"({', '.join(map(clean, names))}): two robots have one serial number, or it was "
                "moved to and fro; its drift is judged in each cell for itself",
            )


def _namesakes(connection: Connection) -> Iterator[Doubt]:
    """Yield cells of which several runs have one name."""
    asked = (
        select(RUN.c.cell, RUN.c.serial, RUN.c.name)
        .group_by(RUN.c.cell, RUN.c.serial, RUN.c.name)
        .having(func.count(RUN.c.run_key.distinct()) > 1)
        .order_by(RUN.c.cell, RUN.c.serial, RUN.c.name)
    )
    for cell, rows in groupby(connection.execute(asked), lambda row: (row.cell, row.serial)):
        names = [row.name for row in rows]
        yield Doubt(
            [cell[0]],
            f"cell {clean(cell[0])}, serial number {clean(cell[1])}: several runs have one name "
            f"({len(names)} names, the first {clean(names[0])}): two folders or computers ship as "
            "one cell; give each cell a name and a serial number of its own, or each run its own "
            "name (`hilcell run --name`)",
        )


def _at_once(connection: Connection) -> Iterator[Doubt]:
    """Yield real cells of which two runs were at work at once: two computers have one cell's name.

    A run that was opened again lasts from its begin to its last end, so that is no sign.
    """
    before = func.lag(RUN.c.ended).over(partition_by=CELL, order_by=RUN.c.begun)
    other = RUN.alias("other")
    first = select(*CELL, RUN.c.begun, before.label("before")).where(
        RUN.c.machine == "",
        RUN.c.revision
        == select(func.min(other.c.revision))
        .where(other.c.run_key == RUN.c.run_key)
        .correlate(RUN)
        .scalar_subquery(),
    )
    each = first.subquery("each")
    asked = (
        select(each.c.cell, each.c.serial, func.count().label("times"))
        .where(each.c.begun < each.c.before)
        .group_by(each.c.cell, each.c.serial)
    )
    for row in connection.execute(asked):
        yield Doubt(
            [row.cell],
            f"cell {clean(row.cell)}, serial number {clean(row.serial)}: {row.times} runs began "
            "while another was at work: two computers ship as one cell, or their clocks disagree",
        )


def _ahead(connection: Connection) -> Iterator[Doubt]:
    """Yield cells whose runs ended later than the server's clock said when they arrived."""
    asked = select(RUN.c.cell, RUN.c.ended, RUN.c.shipped, RUN.c.name).where(
        RUN.c.ended > RUN.c.shipped
    )
    ahead = {
        row.cell: row
        for row in connection.execute(asked.order_by(RUN.c.ended))
        if row.ended > row.shipped + CLOCK_ERROR
    }
    for row in ahead.values():
        hours = (row.ended - row.shipped).total_seconds() / 3600.0
        yield Doubt(
            [row.cell],
            f"cell {clean(row.cell)}: run {clean(row.name)} ended {hours:.1f} h after it arrived "
            "here: set the clock of its computer, or the server's",
        )


def _set_back(connection: Connection) -> Iterator[Doubt]:
    """Yield cells of which runs ended before they began."""
    asked = select(RUN.c.cell, func.max(RUN.c.name).label("name"), func.count().label("times"))
    for row in connection.execute(asked.where(RUN.c.ended < RUN.c.begun).group_by(RUN.c.cell)):
        yield Doubt(
            [row.cell],
            f"cell {clean(row.cell)}: {row.times} runs ended before they began, one of them "
            f"{clean(row.name)}: the clock of its computer was set back meanwhile",
        )
