"""The tables of the plant's database, as the newest migration leaves them.

Each run has one row per revision in ``run``, and its parts by ``digest``. On PostgreSQL ``point``
is partitioned by ``month``, that in which the run began.
"""

from __future__ import annotations

from collections import defaultdict
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    Connection,
    Date,
    DateTime,
    Dialect,
    Double,
    Executable,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
    UniqueConstraint,
    Uuid,
    func,
    text,
)

Found = Any  # a row of an answer: its columns by their names
HEAD = "0001"  # of the schema; raised when a table, a record or a meaning changes


class Utc(TypeDecorator[datetime]):
    """A moment; SQLite, which has no zones, keeps it in UTC."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Return what is stored."""
        return self.in_utc(value)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Return what was stored, with its zone."""
        if value is None:
            return None
        return value.astimezone(UTC) if value.tzinfo else value.replace(tzinfo=UTC)

    @staticmethod
    def in_utc(value: datetime | None) -> datetime | None:
        """Return a moment as it is kept."""
        return None if value is None else value.astimezone(UTC)


TABLES = MetaData()


def _part(name: str, *columns: Column[Any] | Index) -> Table:
    """Return a table of parts of runs."""
    digest = Column("digest", Uuid, ForeignKey("run.digest"), primary_key=True)
    return Table(name, TABLES, digest, *columns)


def _number() -> Column[int]:
    return Column("n", Integer, primary_key=True)


def _words(name: str) -> Column[str]:
    return Column(name, Text, nullable=False)


RUN = Table(
    "run",
    TABLES,
    Column("digest", Uuid, primary_key=True),
    Column("run_key", Uuid, nullable=False),
    Column("revision", Integer, nullable=False),
    Column("head", String(64), nullable=False),
    Column("month", Date, nullable=False),
    Column("cell_key", Uuid, nullable=False),
    _words("name"),
    _words("cell"),
    _words("serial"),
    Column("simulated", Boolean, nullable=False),
    _words("machine"),
    _words("procedure"),
    _words("state"),
    Column("exit", Integer, nullable=False),
    Column("begun", Utc, nullable=False),
    Column("ended", Utc, nullable=False),
    Column("points", Integer, nullable=False),
    Column("proven", Boolean, nullable=False),
    _words("robot"),
    _words("tracker"),
    _words("version"),
    Column("row", JSON, nullable=False),
    Column("shipped", Utc, nullable=False, server_default=func.now()),
    UniqueConstraint("run_key", "revision", name="run_revision"),
    Index("run_of_cell", "cell_key", "ended", "revision"),
)
Index(
    "run_proven",
    RUN.c.cell_key,
    RUN.c.ended,
    postgresql_where=text("proven"),
    sqlite_where=text("proven"),
)
Index("run_of_robot", RUN.c.robot, RUN.c.ended)
Index("run_of_head", RUN.c.head)

FRAME = _part(
    "frame",
    Column("key", Text, primary_key=True),
    Column("matrix", JSON, nullable=False),
    Column("covariance", JSON),
)
VERDICT = _part(
    "verdict",
    Column("key", Text, primary_key=True),
    Column("holds", Boolean, nullable=False),
    Column("mean_mm", Double),
    Column("mean_U_mm", Double),
    Column("mean_tolerance_mm", Double),
    Column("body", JSON, nullable=False),
)
DEVICE = _part(
    "device",
    _number(),
    *map(_words, ("kind", "device", "maker", "model", "serial", "firmware")),
    Column("simulated", Boolean, nullable=False),
    Index("device_serial", "kind", "serial"),
)
ALARM = _part(
    "alarm",
    _number(),
    Column("t", Utc, nullable=False),
    *map(_words, ("code", "severity", "title", "place", "found")),
    Index("alarm_code", "code", "t"),
)
LENGTH = _part(
    "length",
    _number(),
    _words("nests"),
    Column("wanted_mm", Double, nullable=False),
    Column("found_mm", Double, nullable=False),
    Column("U_mm", Double, nullable=False),
)
GRID = _part(
    "grid",
    Column("places_mm", JSON, nullable=False),
    Column("errors_mm", JSON, nullable=False),
    Column("temperature_c", Double),
)
STREAM = _part(
    "stream",
    Column("key", Text, primary_key=True),
    _words("file"),
    Column("sha256", String(64), nullable=False),
    Column("samples", Integer, nullable=False),
    Column("joint_samples", Integer, nullable=False),
)
DOCUMENT = _part(
    "document",
    Column("name", Text, primary_key=True),
    Column("sha256", String(64), nullable=False),
    _words("text"),
)
POINT = Table(
    "point",
    TABLES,
    Column("month", Date, primary_key=True),
    Column("digest", Uuid, primary_key=True),
    Column("seq", Integer, primary_key=True),
    Column("t", Utc, nullable=False),
    *map(_words, ("key", "kind", "station", "frame", "reflector")),
    *(Column(name, Double, nullable=False) for name in ("x_mm", "y_mm", "z_mm")),
    *(Column(name, Double, nullable=False) for name in ("std_x_mm", "std_y_mm", "std_z_mm")),
    Column("samples", Integer, nullable=False),
    Column("session", Integer, nullable=False),
    Column("set_up", Integer, nullable=False),
    Column("retaken", Boolean, nullable=False),
    Column("superseded", Boolean, nullable=False),
    *(
        Column(name, Double)
        for name in (
            "temperature_c", "pressure_mbar", "humidity_percent", "strip_mm", "rail_mm",
            "nominal_x_mm", "nominal_y_mm", "nominal_z_mm",
        )
    ),
    Column("commanded_deg", JSON(none_as_null=True)),
    Column("joints_deg", JSON(none_as_null=True)),
    postgresql_partition_by="RANGE (month)",
)  # fmt: skip
PARTS = (FRAME, VERDICT, DEVICE, ALARM, LENGTH, GRID, STREAM, DOCUMENT, POINT)


def grouped(
    connection: Connection, asked: Executable, *names: str
) -> defaultdict[tuple[str, ...], list[Found]]:
    """Return the rows of an answer, in their order, by what they have in these columns."""
    found: defaultdict[tuple[str, ...], list[Found]] = defaultdict(list)
    for row in connection.execute(asked):
        found[tuple(getattr(row, name) for name in names)].append(row)
    return found
