"""The cells of a plant: the newest calibration of each, how long it is still valid, what to doubt.

Records to doubt have a serial number or a name that several have, or clocks that disagree.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from operator import attrgetter

import msgspec
from sqlalchemy import CTE, ColumnElement, Connection, Text, and_, cast, func, or_, select

from hilcell.calibration.validity import CLOCK_ERROR, MAX_AGE_DAYS
from hilcell.decoding import decoded
from hilcell.journal.calibration_status import statuses
from hilcell.journal.index import RunRow, in_order
from hilcell.plant.tables import RUN, Found, grouped
from hilcell.sanitize import clean

CELL = (RUN.c.cell, RUN.c.serial, RUN.c.machine)
Name = tuple[str, str, str]  # a cell: its name, its serial number, and which simulated machine


class CellState(msgspec.Struct, frozen=True, kw_only=True):
    """One cell: its last run, and its current calibration; "" and None where it has none.

    ``condition`` is *valid*, *too old*, how the newest calibration stands otherwise, or *no
    calibration that holds*.
    """

    cell: str
    serial: str
    machine: str
    last_run: str
    last_state: str
    last_ended: datetime
    condition: str
    calibration: str = ""
    calibrated: datetime | None = None
    valid_until: datetime | None = None
    days_left: float | None = None


def newest() -> ColumnElement[bool]:
    """Return the condition that a run's row is its newest revision."""
    later = RUN.alias("later")
    return ~(
        select(later.c.digest)
        .where(later.c.run_key == RUN.c.run_key, later.c.revision > RUN.c.revision)
        .exists()
    )


def chosen(cell: str, robot: str) -> list[ColumnElement[bool]]:
    """Return the conditions that a run is of a cell and of a robot; "" for any."""
    wanted = ((RUN.c.cell, cell), (RUN.c.robot, robot))
    return [column == name for column, name in wanted if name]


def cells(
    connection: Connection, now: datetime, max_age_days: float = MAX_AGE_DAYS
) -> list[CellState]:
    """Return the state of all cells, in the order of their names."""
    every = _every()
    own = RUN.alias("own")
    last = (
        select(own.c.digest)
        .where(own.c.cell_key == every.c.key)
        .order_by(own.c.ended.desc(), own.c.revision.desc())
        .limit(1)
        .correlate(every)
        .scalar_subquery()
    )
    asked = select(*CELL, RUN.c.name, RUN.c.state, RUN.c.ended)
    since = _since(connection)
    states = [
        _state(row, since[row.cell, row.serial, row.machine], now, max_age_days)
        for row in connection.execute(asked.join_from(every, RUN, RUN.c.digest == last))
    ]
    return sorted(states, key=attrgetter("cell", "serial", "machine"))


def _every() -> CTE:
    """Return the keys of all cells, each found by one step in the index: runs are many more."""
    first = select(RUN.c.cell_key).order_by(RUN.c.cell_key).limit(1).scalar_subquery()
    keys = select(first.label("key")).cte("every", recursive=True)
    following = (
        select(RUN.c.cell_key)
        .where(RUN.c.cell_key > keys.c.key)
        .order_by(RUN.c.cell_key)
        .limit(1)
        .correlate(keys)
        .scalar_subquery()
    )
    return keys.union_all(select(following).where(keys.c.key.is_not(None)))


def _since(connection: Connection) -> defaultdict[Name, list[RunRow]]:
    """Return each cell's runs since its newest proven calibration, which superseded all before."""
    every = _every()
    proven = (
        select(RUN.c.ended)
        .where(RUN.c.cell_key == every.c.key, RUN.c.proven, newest())
        .order_by(RUN.c.ended.desc())
        .limit(1)
        .correlate(every)
        .scalar_subquery()
    )
    begun = connection.execute(select(every.c.key, proven.label("ended"))).all()
    known = [and_(RUN.c.cell_key == key, RUN.c.ended >= ended) for key, ended in begun if ended]
    found: defaultdict[Name, list[RunRow]] = defaultdict(list)
    batch = 200  # cells of one question
    for start in range(0, len(known), batch):
        own = or_(*known[start : start + batch])
        asked = select(*CELL, cast(RUN.c.row, Text).label("row")).where(own, newest())
        for row in connection.execute(asked):
            found[row.cell, row.serial, row.machine].append(decoded(row.row, RunRow))
    return found


def _state(last: Found, since: list[RunRow], now: datetime, max_age_days: float) -> CellState:
    known = statuses(since)
    ended_here = [known[row.name] for row in in_order(since) if row.name in known]
    state = CellState(
        cell=last.cell, serial=last.serial, machine=last.machine,
        last_run=last.name, last_state=last.state, last_ended=last.ended,
        condition=ended_here[-1].text if ended_here else "no calibration that holds",
    )  # fmt: skip
    current = next((each for each, status in known.items() if status.current == each), "")
    if not current:
        return state
    made = next(datetime.fromisoformat(row.ended) for row in since if row.name == current)
    latest = datetime(9000, 1, 1, tzinfo=UTC)  # a time after which is a date, too
    until = min(made, latest) + timedelta(days=max_age_days)
    condition = "valid" if now <= until else "too old"
    if made > now + CLOCK_ERROR:
        condition = "made in the future: check the clock of the cell's computer"
    return msgspec.structs.replace(
        state,
        condition=condition,
        calibration=current,
        calibrated=made,
        valid_until=until,
        days_left=round((until - now) / timedelta(days=1), 1),
    )


def doubts(connection: Connection, cells: Collection[str] | None = None) -> list[str]:
    """Return what is wrong with the records: serial numbers and clocks, one sentence each.

    ``cells`` are the names of those whose records to check; None for all.
    """
    of = _Doubts(connection)
    kinds = (of.serials, of.robots, of.namesakes, of.at_once, of.ahead, of.set_back)
    found = (doubt for kind in kinds for doubt in kind())
    return [words for names, words in found if cells is None or not {*cells}.isdisjoint(names)]


Doubt = tuple[list[str], str]  # about the records of these cells, in a sentence


@dataclass(frozen=True, eq=False)
class _Doubts:
    connection: Connection

    def serials(self) -> Iterator[Doubt]:
        asked = select(RUN.c.serial, RUN.c.cell).where(RUN.c.serial != "").distinct()
        by_serial = grouped(self.connection, asked.order_by(RUN.c.serial, RUN.c.cell), "serial")
        for (serial,), rows in by_serial.items():
            names = [row.cell for row in rows]
            cells = ", ".join(map(clean, names))
            if len(names) > 1:
                own = "give each its own in its cell file"
                yield names, f"serial number {clean(serial)} is that of cells {cells}: {own}"

    def robots(self) -> Iterator[Doubt]:
        """Yield robots that worked in several cells in turns: one that was moved left the first."""
        place = (RUN.c.robot, RUN.c.cell, RUN.c.serial)
        first = func.min(RUN.c.begun)
        asked = select(*place, first.label("first"), func.max(RUN.c.ended).label("last"))
        asked = asked.where(RUN.c.robot != "").group_by(*place)
        asked = asked.order_by(RUN.c.robot, first, RUN.c.cell)
        for (robot,), spans in grouped(self.connection, asked, "robot").items():
            if any(later.first < earlier.last for earlier, later in pairwise(spans)):
                names = sorted({span.cell for span in spans})
                words = (
                    f"robot {clean(robot)} worked in {len(spans)} cells in turns "
                    f"({', '.join(map(clean, names))}): two robots have one serial number, or it "
                    "was moved to and fro; its drift is judged in each cell for itself"
                )
                yield names, words

    def namesakes(self) -> Iterator[Doubt]:
        """Yield cells of which several runs have one name."""
        columns = (RUN.c.cell, RUN.c.serial, RUN.c.name)
        asked = select(*columns).group_by(*columns).order_by(*columns)
        asked = asked.having(func.count(RUN.c.run_key.distinct()) > 1)
        for (cell, serial), rows in grouped(self.connection, asked, "cell", "serial").items():
            words = (
                f"cell {clean(cell)}, serial number {clean(serial)}: several runs have one name "
                f"({len(rows)} names, the first {clean(rows[0].name)}): two folders or computers "
                "ship as one cell; give each cell a name and a serial number of its own, or each "
                "run its own name (`hilcell run --name`)"
            )
            yield [cell], words

    def at_once(self) -> Iterator[Doubt]:
        """Yield real cells of which two runs were at work at once: two computers are one cell.

        A run that was opened again lasts from its begin to its last end, so that is no sign.
        """
        before = func.lag(RUN.c.ended).over(partition_by=CELL, order_by=RUN.c.begun)
        other = RUN.alias("other")
        first = select(func.min(other.c.revision)).where(other.c.run_key == RUN.c.run_key)
        of_each = select(*CELL, RUN.c.begun, before.label("before")).where(
            RUN.c.machine == "", RUN.c.revision == first.correlate(RUN).scalar_subquery()
        )
        each = of_each.subquery("each")
        place = (each.c.cell, each.c.serial)
        asked = select(*place, func.count().label("times")).where(each.c.begun < each.c.before)
        for row in self.connection.execute(asked.group_by(*place)):
            words = (
                f"cell {clean(row.cell)}, serial number {clean(row.serial)}: {row.times} runs "
                "began while another was at work: two computers ship as one cell, or their clocks "
                "disagree"
            )
            yield [row.cell], words

    def ahead(self) -> Iterator[Doubt]:
        """Yield cells whose runs ended later than the server's clock said when they arrived."""
        asked = select(RUN.c.cell, RUN.c.ended, RUN.c.shipped, RUN.c.name)
        asked = asked.where(RUN.c.ended > RUN.c.shipped).order_by(RUN.c.ended)
        ahead = {
            row.cell: row
            for row in self.connection.execute(asked)
            if row.ended > row.shipped + CLOCK_ERROR
        }
        for row in ahead.values():
            hours = (row.ended - row.shipped).total_seconds() / 3600.0
            words = (
                f"cell {clean(row.cell)}: run {clean(row.name)} ended {hours:.1f} h after it "
                "arrived here: set the clock of its computer, or the server's"
            )
            yield [row.cell], words

    def set_back(self) -> Iterator[Doubt]:
        """Yield cells of which runs ended before they began."""
        asked = select(RUN.c.cell, func.max(RUN.c.name).label("name"), func.count().label("times"))
        asked = asked.where(RUN.c.ended < RUN.c.begun).group_by(RUN.c.cell)
        for row in self.connection.execute(asked):
            words = (
                f"cell {clean(row.cell)}: {row.times} runs ended before they began, one of them "
                f"{clean(row.name)}: the clock of its computer was set back meanwhile"
            )
            yield [row.cell], words
