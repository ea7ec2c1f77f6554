"""The tables of the plant's database, as of the newest migration.

``run`` has a row per revision of a run, the other tables refer to it by ``digest``. A trigger keeps
``run.newest`` in the transaction of the insert; the view ``current_run`` has the newest revisions.
``run`` is narrow, since most questions read it whole; long columns are in the other tables.
"""

from __future__ import annotations

from collections import defaultdict
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

Row = Any  # a row of an answer: its columns by their names
HEAD = "0001"  # of the schema; raised when a table, a record or a meaning changes


class Utc(sa.TypeDecorator[datetime]):
    """A time; in UTC for SQLite, which has no zones."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        return self.in_utc(value)

    def process_result_value(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        if value is None:
            return None
        return value.astimezone(UTC) if value.tzinfo else value.replace(tzinfo=UTC)

    @staticmethod
    def in_utc(value: datetime | None) -> datetime | None:
        return None if value is None else value.astimezone(UTC)


TABLES = sa.MetaData()


def _part(name: str, *columns: sa.Column[Any] | sa.Index) -> sa.Table:
    digest = sa.Column("digest", sa.Uuid, sa.ForeignKey("run.digest"), primary_key=True)
    return sa.Table(name, TABLES, digest, *columns)


def _number_column() -> sa.Column[int]:
    return sa.Column("n", sa.Integer, primary_key=True)


def _text_column(name: str) -> sa.Column[str]:
    return sa.Column(name, sa.Text, nullable=False)


RUN = sa.Table(
    "run",
    TABLES,
    sa.Column("digest", sa.Uuid, primary_key=True),
    sa.Column("run_key", sa.Uuid, nullable=False),
    sa.Column("revision", sa.Integer, nullable=False),
    sa.Column("head", sa.String(64), nullable=False),
    sa.Column("cell_key", sa.Uuid, nullable=False),
    _text_column("name"),
    _text_column("cell"),
    _text_column("serial"),
    sa.Column("simulated", sa.Boolean, nullable=False),
    _text_column("machine"),
    _text_column("procedure"),
    _text_column("state"),
    sa.Column("exit", sa.Integer, nullable=False),
    sa.Column("begun", Utc, nullable=False),
    sa.Column("ended", Utc, nullable=False),
    sa.Column("points", sa.Integer, nullable=False),
    sa.Column("proven", sa.Boolean, nullable=False),
    _text_column("robot"),
    _text_column("tracker"),
    _text_column("version"),
    sa.Column("shipped", Utc, nullable=False, server_default=sa.func.now()),
    sa.Column("newest", sa.Boolean, nullable=False, server_default=sa.true()),
    sa.UniqueConstraint("run_key", "revision", name="run_revision"),
    sa.Index("run_of_head", "head"),
)


def _partial_index(name: str, where: str, *columns: str) -> None:
    condition = sa.text(where)
    of = [RUN.c[each] for each in columns]
    sa.Index(name, *of, postgresql_where=condition, sqlite_where=condition)


_partial_index("run_of_cell", "newest", "cell_key", "ended")
_partial_index("run_proven", "newest AND proven", "cell_key", "ended")
_partial_index("run_of_robot", "newest", "robot", "ended")

OUTCOME = _part("outcome", sa.Column("row", sa.JSON, nullable=False))

FRAME = _part(
    "frame",
    sa.Column("key", sa.Text, primary_key=True),
    sa.Column("matrix", sa.JSON, nullable=False),
    sa.Column("covariance", sa.JSON),
)
VERDICT = _part(
    "verdict",
    sa.Column("key", sa.Text, primary_key=True),
    sa.Column("holds", sa.Boolean, nullable=False),
    sa.Column("mean_mm", sa.Double),
    sa.Column("mean_U_mm", sa.Double),
    sa.Column("mean_tolerance_mm", sa.Double),
    sa.Column("body", sa.JSON, nullable=False),
)
DEVICE = _part(
    "device",
    _number_column(),
    *map(_text_column, ("kind", "device", "maker", "model", "serial", "firmware")),
    sa.Column("simulated", sa.Boolean, nullable=False),
    sa.Index("device_serial", "kind", "serial"),
)
ALARM = _part(
    "alarm",
    _number_column(),
    sa.Column("t", Utc, nullable=False),
    *map(_text_column, ("code", "severity", "title", "place", "found")),
    sa.Index("alarm_code", "code", "t"),
)
LENGTH = _part(
    "length",
    _number_column(),
    _text_column("nests"),
    sa.Column("wanted_mm", sa.Double, nullable=False),
    sa.Column("found_mm", sa.Double, nullable=False),
    sa.Column("U_mm", sa.Double, nullable=False),
)
GRID = _part(
    "grid",
    sa.Column("places_mm", sa.JSON, nullable=False),
    sa.Column("errors_mm", sa.JSON, nullable=False),
    sa.Column("temperature_c", sa.Double),
)
STREAM = _part(
    "stream",
    sa.Column("key", sa.Text, primary_key=True),
    _text_column("file"),
    sa.Column("sha256", sa.String(64), nullable=False),
    sa.Column("samples", sa.Integer, nullable=False),
    sa.Column("joint_samples", sa.Integer, nullable=False),
)
DOCUMENT = _part(
    "document",
    sa.Column("name", sa.Text, primary_key=True),
    sa.Column("sha256", sa.String(64), nullable=False),
    _text_column("text"),
)
POINT = _part(
    "point",
    sa.Column("seq", sa.Integer, primary_key=True),
    sa.Column("t", Utc, nullable=False),
    *map(_text_column, ("key", "kind", "station", "frame", "reflector")),
    *(sa.Column(name, sa.Double, nullable=False) for name in ("x_mm", "y_mm", "z_mm")),
    *(sa.Column(name, sa.Double, nullable=False) for name in ("std_x_mm", "std_y_mm", "std_z_mm")),
    sa.Column("samples", sa.Integer, nullable=False),
    sa.Column("session", sa.Integer, nullable=False),
    sa.Column("set_up", sa.Integer, nullable=False),
    sa.Column("retaken", sa.Boolean, nullable=False),
    sa.Column("superseded", sa.Boolean, nullable=False),
    *(
        sa.Column(name, sa.Double)
        for name in (
            "temperature_c", "pressure_mbar", "humidity_percent", "strip_mm", "rail_mm",
            "nominal_x_mm", "nominal_y_mm", "nominal_z_mm",
        )
    ),
    sa.Column("commanded_deg", sa.JSON(none_as_null=True)),
    sa.Column("joints_deg", sa.JSON(none_as_null=True)),
)  # fmt: skip
PARTS = (OUTCOME, FRAME, VERDICT, DEVICE, ALARM, LENGTH, GRID, STREAM, DOCUMENT, POINT)


def grouped(
    connection: sa.Connection, query: sa.Executable, *names: str
) -> defaultdict[tuple[str, ...], list[Row]]:
    """Return the rows of an answer, in their order, by what they have in these columns."""
    found: defaultdict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in connection.execute(query):
        found[tuple(getattr(row, name) for name in names)].append(row)
    return found
