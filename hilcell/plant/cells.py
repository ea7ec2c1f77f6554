"""The cells of a plant: the newest calibration of each, and how long it is still valid."""

from __future__ import annotations

from collections import defaultdict
from datetime import UTC, datetime, timedelta

import msgspec
from sqlalchemy import CTE, ColumnElement, Connection, Text, and_, cast, or_, select

from hilcell.calibration.validity import CLOCK_ERROR, MAX_AGE_DAYS
from hilcell.journal.folder_order import in_order
from hilcell.journal.index import RunRow
from hilcell.journal.standing import standings
from hilcell.plant.tables import RUN
from hilcell.typed import decoded, typed

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
    found: dict[Name, CellState] = {}
    for row in connection.execute(asked.join_from(every, RUN, RUN.c.digest == last)):
        name = (row.cell, row.serial, row.machine)
        found[name] = _state(name, row.name, row.state, row.ended, since[name], now, max_age_days)
    return [found[name] for name in sorted(found)]


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


def _state(
    name: Name, run: str, state: str, ended: datetime, since: list[RunRow], now: datetime,
    max_age_days: float,
) -> CellState:  # fmt: skip
    known = standings(since)
    current = next((each for each, standing in known.items() if standing.current == each), "")
    common = dict(zip(("cell", "serial", "machine"), name, strict=True)) | {
        "last_run": run,
        "last_state": state,
        "last_ended": ended,
    }
    none = "no calibration that holds"
    if not current:
        ended_here = [row for row in in_order(since) if row.name in known]
        last = ended_here[-1] if ended_here else None
        condition = known[last.name].text if last is not None else none
        return typed(common | {"condition": condition}, CellState)
    made = next(datetime.fromisoformat(row.ended) for row in since if row.name == current)
    latest = datetime(9000, 1, 1, tzinfo=UTC)  # a time after which is a date, too
    until = min(made, latest) + timedelta(days=max_age_days)
    condition = "valid" if now <= until else "too old"
    if made > now + CLOCK_ERROR:
        condition = "made in the future: check the clock of the cell's computer"
    more = {
        "condition": condition,
        "calibration": current,
        "calibrated": made,
        "valid_until": until,
        "days_left": round((until - now) / timedelta(days=1), 1),
    }
    return typed(common | more, CellState)
