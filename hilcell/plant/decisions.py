"""Decisions of the owner of a plant's database: the login of a cell, and the runs held apart.

Each decision is a row of the table ``decision``, with its time and its login. A run that was
removed is in no answer, but stays in the database and in exports: evidence is not deleted, and its
cell does not ship it again.
"""

from __future__ import annotations

import getpass
from collections.abc import Iterable
from datetime import datetime
from uuid import UUID

import msgspec
from sqlalchemy import ColumnElement, Connection, and_, func, or_, select, union, update
from sqlalchemy.dialects import postgresql

from hilcell.errors import HilcellError
from hilcell.plant.database import POSTGRESQL, PlantError
from hilcell.plant.tables import CLAIM, DECISION, RUN, Row
from hilcell.sanitize import clean

DIGITS = 12  # of a digest, as in the folders of an export


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """A cell and the login that ships it."""

    cell: str
    serial: str
    login: str
    since: datetime


class HeldRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run that is held apart: not decided on, or removed."""

    run: str
    cell: str
    serial: str
    machine: str
    digest: str
    revision: int
    ended: datetime
    shipped: datetime
    shipped_by: str
    removed: bool


def claims(connection: Connection) -> list[Claim]:
    return _claims(connection.execute(select(CLAIM).order_by(CLAIM.c.cell, CLAIM.c.serial)))


def _claims(rows: Iterable[Row]) -> list[Claim]:
    return [
        Claim(cell=row.cell, serial=row.serial, login=row.login, since=row.since) for row in rows
    ]


def assign(connection: Connection, cell: str, serial: str | None, login: str) -> Claim:
    """Let a login ship a cell, and no other; raises `HilcellError` and `PlantError`.

    ``serial`` is needed where no cell, or several, have the name.
    """
    if connection.dialect.name != POSTGRESQL:
        raise PlantError(
            "plant: an SQLite file has no logins; use PostgreSQL where cells are not trusted"
        )
    exists = "SELECT 1 FROM pg_roles WHERE rolname = %s AND rolcanlogin"
    if not connection.exec_driver_sql(exists, (login,)).first():
        raise HilcellError(
            f"login {login[:80]!r} does not exist; the owner makes it first: "
            'CREATE ROLE "NAME" LOGIN IN ROLE hilcell_cell'
        )
    if serial is None:
        of = (select(table.c.serial).where(table.c.cell == cell) for table in (CLAIM, RUN))
        known = sorted(connection.execute(union(*of)).scalars())
        if len(known) != 1:
            most = 5
            more = f" and {len(known) - most} more" if len(known) > most else ""
            listed = ", ".join(map(clean, known[:most])) + more
            shipped = f"shipped so far: {listed}" if known else "no run of it was shipped yet"
            raise HilcellError(
                f"cell {clean(cell)}: expected --serial with its serial number; {shipped}"
            )
        (serial,) = known
    place = and_(CLAIM.c.cell == cell, CLAIM.c.serial == serial)
    before = connection.execute(select(CLAIM.c.login).where(place).with_for_update()).scalar()
    row = {"cell": cell, "serial": serial, "login": login}
    if before != login:
        insert = postgresql.insert(CLAIM).values(row)
        renewed = {"login": login, "since": func.now()}
        connection.execute(insert.on_conflict_do_update(constraint="claim_pkey", set_=renewed))
        _journal(connection, row | {"what": "assigned", "before": before})
    (claim,) = _claims(connection.execute(select(CLAIM).where(place)))
    return claim


def held(connection: Connection) -> list[HeldRun]:
    """Return the runs that are held apart, in the order of their arrival."""
    query = select(RUN).where(RUN.c.held).order_by(RUN.c.shipped, RUN.c.ended)
    return [_held(row) for row in connection.execute(query)]


def decide(connection: Connection, run: str, *, accepted: bool) -> HeldRun:
    """Accept a run that is held apart, or remove any run; raises `HilcellError`.

    ``run`` is a name, or at least 12 digits of a digest.
    """
    rows = connection.execute(select(RUN).where(or_(RUN.c.name == run, *_digest(run)))).all()
    whole = run.replace("-", "").lower()  # another's run may have these digits as its name
    rows = [row for row in rows if row.digest.hex == whole] or rows
    if accepted:
        rows = [row for row in rows if row.held]
    if len(rows) != 1:
        listed = "; ".join(
            f"{row.digest.hex[:DIGITS]} of cell {clean(row.cell)}, revision {row.revision}"
            for row in rows
        )
        what = f"is ambiguous: {listed}" if rows else "not found; `hilcell plant held` lists them"
        raise HilcellError(f"{'held ' if accepted else ''}run {clean(run)} {what}")
    (row,) = rows
    if row.accepted is not accepted:
        own = RUN.c.digest == row.digest
        connection.execute(update(RUN).where(own).values(accepted=accepted))
        what = "accepted" if accepted else "removed"
        place = {"cell": row.cell, "serial": row.serial}
        _journal(connection, place | {"what": what, "digest": row.digest})
    return _held(row)


def _digest(run: str) -> list[ColumnElement[bool]]:
    """Return the SQL condition that a digest begins like this, if it may."""
    digits, longest = run.replace("-", "").lower(), 32
    if not (DIGITS <= len(digits) <= longest and set(digits) <= set("0123456789abcdef")):
        return []
    first, last = (UUID(digits.ljust(longest, each)) for each in "0f")
    return [RUN.c.digest.between(first, last)]


def _held(row: Row) -> HeldRun:
    return HeldRun(
        run=row.name, cell=row.cell, serial=row.serial, machine=row.machine,
        digest=row.digest.hex, revision=row.revision, ended=row.ended, shipped=row.shipped,
        shipped_by=row.shipped_by, removed=row.accepted is False,
    )  # fmt: skip


def _journal(connection: Connection, values: Row) -> None:
    who = {} if connection.dialect.name == POSTGRESQL else {"by": getpass.getuser()}
    connection.execute(DECISION.insert().values(values | who))
