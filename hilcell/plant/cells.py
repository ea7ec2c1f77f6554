"""The cells of a plant: their newest calibrations and its validity; inconsistent records.

Inconsistent are serial numbers or names that several cells or runs share, and clocks that disagree.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cached_property
from itertools import pairwise
from operator import attrgetter
from uuid import UUID

import msgspec
from sqlalchemy import (
    CTE,
    ColumnElement,
    Connection,
    Executable,
    Subquery,
    Text,
    and_,
    cast,
    func,
    select,
)

from hilcell.decoding import decoded
from hilcell.journal.calibration_status import statuses
from hilcell.journal.index import RunRow, in_order
from hilcell.model.calibration import CLOCK_ERROR, MAX_AGE_DAYS
from hilcell.plant.tables import BATCH, CLAIM, OUTCOME, RUN, Row, grouped
from hilcell.sanitize import clean, counted

CELL = (RUN.c.cell, RUN.c.serial, RUN.c.machine)
Name = tuple[str, str, str]  # a cell: its name, its serial number, and which simulated machine


class CellState(msgspec.Struct, frozen=True, kw_only=True):
    """One cell: its last run, and its current calibration; "" and None without one.

    ``condition`` is *valid*, *too old*, another status of the newest calibration, or *no
    calibration that holds*.
    """

    cell: str
    serial: str
    machine: str
    last_run: str
    last_state: str
    last_ended: datetime
    last_shipped: datetime
    condition: str
    calibration: str = ""
    calibrated: datetime | None = None
    valid_until: datetime | None = None
    days_left: float | None = None


def uses() -> Subquery:
    """Return the query of which devices were used in which cell: number of runs, first begin and
    last end, with the names and the digest of one of these runs.
    """
    keys = (RUN.c.cell_key, RUN.c.devices)
    times = (func.min(RUN.c.begun).label("begun"), func.max(RUN.c.ended).label("ended"))
    counted = select(*keys, func.count().label("runs"), *times).where(RUN.c.newest)
    each = counted.group_by(*keys).subquery("each")
    other = RUN.alias("other")
    one = select(other.c.digest).where(
        other.c.newest, other.c.cell_key == each.c.cell_key, other.c.devices == each.c.devices
    )
    names = (RUN.c.digest, *CELL, RUN.c.robot)
    return (
        select(*names, each.c.runs, each.c.begun, each.c.ended)
        .join_from(each, RUN, RUN.c.digest == one.limit(1).correlate(each).scalar_subquery())
        .subquery("uses")
    )


def selected(cell: str, robot: str) -> list[ColumnElement[bool]]:
    """Return the SQL conditions that a run is of a cell and of a robot; "" for any."""
    return [column == name for column, name in ((RUN.c.cell, cell), (RUN.c.robot, robot)) if name]


Doubt = tuple[list[str], str]  # names of cells, text


def cells(
    connection: Connection,
    now: datetime,
    max_age_days: float = MAX_AGE_DAYS,
    doubts: list[Doubt] | None = None,
) -> list[CellState]:
    """Return the state of all cells, sorted by name; add the runs left out to ``doubts``."""
    every = _cell_keys()
    own = RUN.alias("own")
    last = (
        select(own.c.digest)
        .where(own.c.cell_key == every.c.key, own.c.newest)
        .order_by(own.c.ended.desc(), own.c.digest)  # both stores order digests alike
        .limit(1)
        .correlate(every)
        .scalar_subquery()
    )
    other = RUN.alias("other")
    shipped = select(func.max(other.c.shipped)).where(other.c.cell_key == RUN.c.cell_key)
    query = select(
        *CELL, RUN.c.name, RUN.c.state, RUN.c.ended,
        shipped.correlate(RUN).scalar_subquery().label("last_shipped"),
    )  # fmt: skip
    lasts = connection.execute(query.join_from(every, RUN, RUN.c.digest == last)).all()
    known = {(row.cell, row.serial, row.machine) for row in lasts}
    held = query.where(RUN.c.held).order_by(RUN.c.ended, RUN.c.digest)
    only_held = {
        place: row
        for row in connection.execute(held)
        if (place := (row.cell, row.serial, row.machine)) not in known
    }
    since = _runs_since(connection, [] if doubts is None else doubts)
    states = [
        _state(row, since[row.cell, row.serial, row.machine], now, max_age_days)
        for row in (*lasts, *only_held.values())
    ]
    return sorted(states, key=attrgetter("cell", "serial", "machine"))


def _cell_keys() -> CTE:
    """Return the keys of all cells, each by one step in the index: there are far more runs."""
    keys_of = select(RUN.c.cell_key).where(RUN.c.newest).order_by(RUN.c.cell_key).limit(1)
    first = keys_of.scalar_subquery()
    keys = select(first.label("key")).cte("every", recursive=True)
    after = RUN.c.cell_key > keys.c.key
    following = keys_of.where(after).correlate(keys).scalar_subquery()
    return keys.union_all(select(following).where(keys.c.key.is_not(None)))


def _runs_since(connection: Connection, doubts: list[Doubt]) -> defaultdict[Name, list[RunRow]]:
    """Return each cell's runs since its newest valid calibration, which superseded all before."""
    every, earlier = _cell_keys(), RUN.alias("earlier")
    proven = (
        select(earlier.c.ended)
        .where(earlier.c.cell_key == every.c.key, earlier.c.newest, earlier.c.proven)
        .order_by(earlier.c.ended.desc())
        .limit(1)
        .correlate(every)
        .scalar_subquery()
    )
    # As a join, the table of outcomes would be read whole.
    row = select(cast(OUTCOME.c.row, Text)).where(OUTCOME.c.digest == RUN.c.digest)
    of_runs = select(*_STATED, RUN.c.machine, RUN.c.cell_key, row.scalar_subquery().label("row"))
    of_runs = of_runs.where(RUN.c.newest)
    since = and_(RUN.c.cell_key == every.c.key, RUN.c.ended >= proven)
    runs, spoilt = _run_rows(connection, of_runs.join_from(every, RUN, since), doubts)
    # The calibration from which to read on may be one that is left out.
    for start in range(0, len(spoilt), BATCH):
        whole = of_runs.where(RUN.c.cell_key.in_(spoilt[start : start + BATCH]))
        runs |= _run_rows(connection, whole, doubts)[0]
    return runs


def _run_rows(
    connection: Connection, query: Executable, doubts: list[Doubt]
) -> tuple[defaultdict[Name, list[RunRow]], list[UUID]]:
    """Return the runs of cells, and the keys of cells of which one was left out."""
    runs: defaultdict[Name, list[RunRow]] = defaultdict(list)
    spoilt: dict[UUID, None] = {}
    for row in connection.execute(query):
        before = len(doubts)
        with left_out(row, doubts):
            runs[row.cell, row.serial, row.machine].append(_run_row(row))
        if len(doubts) > before:
            spoilt[row.cell_key] = None
    return runs, list(spoilt)


_TIMES = ("begun", "ended")
_STATED = tuple(
    RUN.c[name] for name in ("name", "cell", "serial", "procedure", "state", "exit", *_TIMES)
)


def _run_row(row: Row) -> RunRow:
    """Return a run's row; raises `ValueError` where it is none, or contradicts the columns."""
    if row.row is None:
        raise ValueError("expected a row in the table outcome, got none")
    run = decoded(row.row, RunRow)
    for column in _STATED:
        stated, own = getattr(run, column.name), getattr(row, column.name)
        if column.name in _TIMES:
            stated = datetime.fromisoformat(stated)
        if stated != own:
            raise ValueError(f"expected {column.name} {own}, got {stated}")
    return run


UNREADABLE = (msgspec.MsgspecError, ValueError, TypeError, ArithmeticError, RecursionError)


@contextmanager
def left_out(run: Row, doubts: list[Doubt]) -> Iterator[None]:
    """Leave a run out whose rows cannot be read, and add it to ``doubts``."""
    try:
        yield
    except UNREADABLE as error:
        why = clean(" ".join(str(error).split()))[:200]
        named = f"cell {clean(run.cell)}: run {clean(run.name)}"
        doubts.append(([run.cell], f"{named} is left out, its record cannot be read: {why}"))


def _state(last: Row, since: list[RunRow], now: datetime, max_age_days: float) -> CellState:
    known = statuses(since)
    ended_here = [known[row.name] for row in in_order(row for row in since if row.name in known)]
    state = CellState(
        cell=last.cell, serial=last.serial, machine=last.machine,
        last_run=last.name, last_state=last.state, last_ended=last.ended,
        last_shipped=last.last_shipped,
        condition=ended_here[-1].text if ended_here else "no calibration that holds",
    )  # fmt: skip
    current = next((each for each, status in known.items() if status.current == each), "")
    if not current:
        return state
    made = next(datetime.fromisoformat(row.ended) for row in since if row.name == current)
    latest = datetime(9000, 1, 1, tzinfo=UTC)  # so that the sum is a valid date
    until = min(made, latest) + timedelta(days=max_age_days)
    condition = "valid" if now <= until else "too old"
    if made > now + CLOCK_ERROR:
        condition = "made in the future: check the clock of the cell's PC"
    return msgspec.structs.replace(
        state,
        condition=condition,
        calibration=current,
        calibrated=made,
        valid_until=until,
        days_left=round((until - now) / timedelta(days=1), 1),
    )


def inconsistencies(
    connection: Connection, cells: Collection[str], left_out: Iterable[Doubt] = ()
) -> list[str]:
    """Return inconsistencies of serial numbers, names and clocks in the records of ``cells``, and
    which runs were left out.
    """
    of = _Inconsistencies(connection)
    checks = (of.serials, of.robots, of.namesakes, of.logins, of.at_once, of.held, of.set_back)
    every = (*_by_cell(left_out), *(each for check in checks for each in check()))
    return list(dict.fromkeys(text for names, text in every if not {*cells}.isdisjoint(names)))


def _by_cell(left_out: Iterable[Doubt]) -> Iterator[Doubt]:
    """Yield one doubt for each cell with runs that were left out."""
    by_cell: defaultdict[str, dict[str, None]] = defaultdict(dict)
    for (cell,), text in left_out:
        by_cell[cell][text] = None  # a run may be left out of several answers
    for cell, texts in by_cell.items():
        first, *others = texts
        more = f"; {counted(len(others), 'more record')} of this cell too" if others else ""
        yield [cell], f"{first}{more}"


@dataclass(frozen=True, eq=False)
class _Inconsistencies:
    connection: Connection

    def serials(self) -> Iterator[Doubt]:
        cells_of: defaultdict[str, set[str]] = defaultdict(set)
        for use in self.used:
            cells_of[use.serial].add(use.cell)
        for serial, names in sorted(cells_of.items()):
            if serial and len(names) > 1:
                cells = ", ".join(map(clean, sorted(names)))
                own = "give each cell its own in its cell file"
                yield (
                    sorted(names),
                    f"cells {cells} have the same serial number {clean(serial)}: {own}",
                )

    def robots(self) -> Iterator[Doubt]:
        spans: defaultdict[str, dict[tuple[str, str], tuple[datetime, datetime]]]
        spans = defaultdict(dict)
        for use in self.used:
            place = (use.cell, use.serial)
            first, last = spans[use.robot].get(place, (use.begun, use.ended))
            spans[use.robot][place] = min(first, use.begun), max(last, use.ended)
        for robot, of_robot in sorted(spans.items()):
            times = sorted((*span, cell) for (cell, _), span in of_robot.items())
            if robot and any(later[0] < earlier[1] for earlier, later in pairwise(times)):
                names = sorted({cell for cell, _ in of_robot})
                text = (
                    f"robot {clean(robot)} worked alternately in {len(of_robot)} cells "
                    f"({', '.join(map(clean, names))}): two robots have one serial number, or it "
                    "was moved back and forth; its drift is evaluated in each cell separately"
                )
                yield names, text

    @cached_property
    def used(self) -> list[Row]:
        return list(self.connection.execute(select(uses())))

    def namesakes(self) -> Iterator[Doubt]:
        columns = (RUN.c.cell, RUN.c.serial, RUN.c.name)
        query = select(*columns).where(RUN.c.newest).group_by(*columns).order_by(*columns)
        query = query.having(func.count() > 1)
        for (cell, serial), rows in grouped(self.connection, query, "cell", "serial").items():
            text = (
                f"cell {clean(cell)}, serial number {clean(serial)}: several runs have one name "
                f"({len(rows)} names, the first {clean(rows[0].name)}): two folders or PCs ship as "
                "one cell; give each cell its own name and serial number, or each run its own "
                "name (`hilcell run --name`)"
            )
            yield [cell], text

    def logins(self) -> Iterator[Doubt]:
        """Yield names of cells that several logins ship."""
        ships = RUN.c.newest, RUN.c.cell == CLAIM.c.cell, RUN.c.serial == CLAIM.c.serial
        query = select(CLAIM).where(select(RUN.c.digest).where(*ships).exists())
        query = query.order_by(CLAIM.c.cell, CLAIM.c.serial)
        for (cell,), rows in grouped(self.connection, query, "cell").items():
            if len({row.login for row in rows}) > 1:
                most = 3
                of = ", ".join(f"{clean(row.login)} (serial number {clean(row.serial)})"
                               for row in rows[:most])  # fmt: skip
                of += f" and {len(rows) - most} more" if len(rows) > most else ""
                text = f"cell {clean(cell)} is shipped by several logins: {of}: give each cell its "
                yield [cell], f"{text}own name, or `hilcell plant assign` each to its login"

    def at_once(self) -> Iterator[Doubt]:
        """Yield real cells in which two runs overlap up to their first ends, for a re-opened run
        lasts from its begin to its last end.
        """
        before = func.lag(RUN.c.first_ended).over(partition_by=RUN.c.cell_key, order_by=RUN.c.begun)
        each = (
            select(RUN.c.cell_key, RUN.c.begun, before.label("before"))
            .where(RUN.c.machine == "", RUN.c.newest)
            .subquery("each")
        )
        overlaps = (
            select(each.c.cell_key, func.count().label("times"))
            .where(each.c.begun < each.c.before)
            .group_by(each.c.cell_key)
            .subquery("overlaps")
        )
        any_run = RUN.alias("any_run")
        of_cell = select(any_run.c.digest).where(
            any_run.c.newest, any_run.c.cell_key == overlaps.c.cell_key
        )
        query = select(RUN.c.cell, RUN.c.serial, overlaps.c.times).join_from(
            overlaps, RUN, RUN.c.digest == of_cell.limit(1).correlate(overlaps).scalar_subquery()
        )
        for row in self.connection.execute(query.order_by(RUN.c.cell, RUN.c.serial)):
            text = (
                f"cell {clean(row.cell)}, serial number {clean(row.serial)}: {row.times} runs "
                "began while another was running: two PCs ship as one cell, or their clocks "
                "disagree"
            )
            yield [row.cell], text

    def held(self) -> Iterator[Doubt]:
        """Yield cells with runs that are held apart and not decided on."""
        columns = (RUN.c.cell, RUN.c.ended, RUN.c.shipped, RUN.c.shipped_by, RUN.c.name)
        query = select(*columns).where(RUN.c.held, RUN.c.accepted.is_(None))
        held = grouped(self.connection, query.order_by(RUN.c.ended), "cell")
        for (cell,), rows in held.items():
            row = rows[-1]
            hours = (row.ended - row.shipped).total_seconds() / 3600.0
            login = f" (shipped by {clean(row.shipped_by)})" if row.shipped_by else ""
            text = (
                f"cell {clean(cell)}: {counted(len(rows), 'run')} of the future held apart, the "
                f"last is {clean(row.name)}{login}, which ended {hours:.1f} h after it arrived: "
                "set the clock of its PC, or the server's; `hilcell plant held` accepts or removes"
            )
            yield [cell], text

    def set_back(self) -> Iterator[Doubt]:
        """Yield cells whose runs ended before they began."""
        query = select(RUN.c.cell, func.max(RUN.c.name).label("name"), func.count().label("times"))
        query = query.where(RUN.c.ended < RUN.c.begun).group_by(RUN.c.cell)
        for row in self.connection.execute(query):
            text = (
                f"cell {clean(row.cell)}: {row.times} runs ended before they began, one of them "
                f"{clean(row.name)}: the clock of its PC was set back meanwhile"
            )
            yield [row.cell], text
