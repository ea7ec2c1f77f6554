"""The tables of the plant's database, as of the newest migration.

``run`` has a row per revision of a run, the other tables refer to it by ``digest``. A trigger keeps
``run.newest`` in the transaction of the insert; the view ``current_run`` has the newest revisions.
``run`` is narrow, since most questions read it whole; long columns are in the other tables.
"""

from __future__ import annotations

import math
import struct
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from typing import Any, get_args

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import FunctionElement

from hilcell.alarms.catalogue import Severity
from hilcell.model.calibration import CLOCK_ERROR
from hilcell.model.records import OVER

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


class Vectors(sa.TypeDecorator[list[list[float]]]):
    """Vectors (N, 3), row by row in 8 bytes each, little-endian: a tenth of the time of JSON."""

    impl = sa.LargeBinary
    cache_ok = True

    def process_bind_param(
        self, value: list[list[float]] | None, dialect: sa.Dialect
    ) -> bytes | None:
        flat = [] if value is None else [each for vector in value for each in vector]
        return None if value is None else struct.pack(f"<{len(flat)}d", *flat)

    def process_result_value(
        self, value: bytes | None, dialect: sa.Dialect
    ) -> list[list[float]] | None:
        if value is None:
            return None
        return [[*vector] for vector in struct.iter_unpack("<3d", value)]


TABLES = sa.MetaData()
LONGEST = 30_000  # bytes of a text
LONGEST_NAME = 1000  # which tables show
LONGEST_JSON = 4 * 2**20
LONGEST_OUTCOME = 2**18  # those of all cells are read at once
MOST_VERTICES = 4096
LONGEST_DOCUMENT = 64 * 2**20
FARTHEST_MM = 1e6  # of what is averaged: sums of more would overflow
FARTHEST_URAD = 1e6


class _Either(sa.ColumnElement[Any]):
    """SQL that differs between the two databases."""

    inherit_cache = False

    def __init__(self, postgresql: str, sqlite: str) -> None:
        self.sql = {"postgresql": postgresql, "sqlite": sqlite}


@compiles(_Either)
def _compiled(either: _Either, compiler: SQLCompiler, **_: object) -> str:
    return either.sql[compiler.dialect.name]


class joined(FunctionElement[bytes]):  # noqa: N801 - as SQLAlchemy's functions
    """The values of a group's rows as bytes, one after another, in one order for all columns: a
    number or a time (s since 1970) as 8 bytes, big-endian, NULL as NaN; a UUID as 16.

    It takes a fraction of the time of so many rows.
    """

    type = sa.LargeBinary()
    inherit_cache = True


@compiles(joined)
def _joined(of: joined, compiler: SQLCompiler, **options: object) -> str:
    (column,) = of.clauses
    is_time = isinstance(column.type, Utc)
    values = sa.cast(sa.extract("epoch", column), sa.Double) if is_time else column
    sql = compiler.process(values, **options)
    if compiler.dialect.name == "sqlite":
        return f"joined({sql})"
    if isinstance(column.type, sa.Uuid):
        sql = f"uuid_send({sql})"
    elif is_time or isinstance(column.type, sa.Double):
        sql = f"float8send(COALESCE({sql}, 'NaN'))"
    return f"string_agg({sql}, '')"


class Joined:
    """The same for SQLite, which has UUIDs as hexadecimal digits."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def step(self, value: float | str | bytes | None) -> None:
        match value:
            case bytes():
                self._parts.append(value)
            case str():
                self._parts.append(bytes.fromhex(value))
            case _:
                self._parts.append(struct.pack(">d", math.nan if value is None else value))

    def finalize(self) -> bytes:
        return b"".join(self._parts)


LOGIN = _Either("session_user", "''")  # of the connection: no SET ROLE changes it
CLOCK = _Either("clock_timestamp()", "CURRENT_TIMESTAMP")  # now() may be hours old in a transaction
TRANSACTION = _Either("pg_current_xact_id()::text::bigint", "0")
# A run of the future is held apart until the plant's owner accepts it, as is one that he removed.
_AHEAD_S = CLOCK_ERROR.total_seconds()
HELD = _Either(
    f"COALESCE(NOT accepted, ended - shipped > '{CLOCK_ERROR!s:0>8}'::interval)",
    f"COALESCE(NOT accepted, (julianday(ended) - julianday(shipped)) * 86400 > {_AHEAD_S})",
)
_CELL_KEY = (  # `hilcell.plant.record.cell_key`: no cell writes under another's
    "cell_key = encode(substr(sha256(convert_to(json_build_array(cell, serial, machine)::text, "
    "'UTF8')), 1, 16), 'hex')::uuid"
)


def _check(name: str, sql: str | _Either) -> sa.CheckConstraint:
    return sa.CheckConstraint(sql, name=name)


def _one_of(name: str, column: str, values: Iterable[str]) -> sa.CheckConstraint:
    return _check(name, f"{column} IN ({', '.join(map(repr, values))})")


def _table(name: str, comment: str, *items: sa.Column[Any] | sa.Index | sa.Constraint) -> sa.Table:
    """Return a table whose values are checked by the types of their columns."""
    table = sa.Table(name, TABLES, *items, comment=comment)
    for column in table.columns:
        for n, check in enumerate(_checks(column)):
            table.append_constraint(_check(f"{name}_{column.name}_{n}", check))
    return table


def _checks(column: sa.Column[Any]) -> Iterator[str | _Either]:
    """Yield what each value of a column obeys; NaN fails."""
    name = f'"{column.name}"'
    most = column.info.get("most")
    match column.type:
        case sa.Text() | sa.String():
            most = most or LONGEST
            # A database in SQL_ASCII would take what is not in UTF-8.
            octets = f"octet_length(convert_to({name}, 'UTF8'))"
            yield _Either(f"{octets} <= {most}", f"length(CAST({name} AS BLOB)) <= {most}")
            if most == LONGEST_NAME:
                controls = "'*[' || char(1) || '-' || char(31) || char(127) || ']*'"
                yield _Either(f"{name} !~ '[\\x01-\\x1f\\x7f]'", f"{name} NOT GLOB {controls}")
        case sa.JSON():
            kinds = ", ".join(map(repr, column.info["kinds"]))
            yield _Either(f"json_typeof({name}) IN ({kinds})", f"json_type({name}) IN ({kinds})")
            yield _Either(
                f"octet_length(convert_to({name}::text, 'UTF8')) <= {most or LONGEST_JSON}",
                f"length(CAST({name} AS BLOB)) <= {most or LONGEST_JSON}",
            )
        case Vectors():
            yield f"length({name}) % 24 = 0 AND length({name}) <= {24 * MOST_VERTICES}"
        case sa.Double():
            most = most or sys.float_info.max
            yield f"{name} BETWEEN {-most!r} AND {most!r}"
        case sa.Integer():
            yield f"{name} >= 0"
        case Utc():
            yield f"{name} >= '1980-01-01 00:00:00+00' AND {name} < '2200-01-01 00:00:00+00'"


def _part(name: str, comment: str, *items: sa.Column[Any] | sa.Index | sa.Constraint) -> sa.Table:
    digest = sa.Column(
        "digest", sa.Uuid, sa.ForeignKey("run.digest"), primary_key=True,
        comment="the revision of the run",
    )  # fmt: skip
    return _table(name, comment, digest, *items)


def _number() -> sa.Column[int]:
    return sa.Column("n", sa.Integer, primary_key=True, comment="number in the run, from 0")


def _key(name: str, comment: str) -> sa.Column[str]:
    return sa.Column(name, sa.Text, primary_key=True, comment=comment)


def _text(name: str, comment: str) -> sa.Column[str]:
    return sa.Column(name, sa.Text, nullable=False, comment=comment)


def _name(name: str, comment: str) -> sa.Column[str]:
    return sa.Column(name, sa.Text, nullable=False, comment=comment, info={"most": LONGEST_NAME})


def _bool(name: str, comment: str) -> sa.Column[bool]:
    return sa.Column(name, sa.Boolean, nullable=False, comment=comment)


def _count(name: str, comment: str) -> sa.Column[int]:
    return sa.Column(name, sa.Integer, nullable=False, comment=comment)


def _time(name: str, comment: str) -> sa.Column[datetime]:
    return sa.Column(name, Utc, nullable=False, comment=comment)


def _figure(name: str, comment: str, most: float | None = None) -> sa.Column[float]:
    return sa.Column(name, sa.Double, nullable=False, comment=comment, info={"most": most})


def _perhaps(name: str, comment: str, most: float | None = None) -> sa.Column[float | None]:
    return sa.Column(name, sa.Double, comment=comment, info={"most": most})


def _json(name: str, comment: str, *kinds: str, most: int = LONGEST_JSON) -> sa.Column[Any]:
    info = {"kinds": kinds, "most": most}
    return sa.Column(name, sa.JSON, nullable=False, comment=comment, info=info)


def _vectors(name: str, comment: str) -> sa.Column[list[list[float]]]:
    return sa.Column(name, Vectors, nullable=False, comment=comment)


def _sha256(comment: str) -> sa.Column[str]:
    return sa.Column("sha256", sa.String(64), nullable=False, comment=comment)


RUN = _table(
    "run",
    "a revision of a run; times in UTC",
    sa.Column("digest", sa.Uuid, primary_key=True, comment="first 128 bits of the SHA-256 of all "
        "rows of the revision, without what the server adds"),
    sa.Column("run_key", sa.Uuid, nullable=False, comment="of all revisions of the run"),
    _count("revision", "number of the journal's last record"),
    sa.Column("head", sa.String(64), nullable=False, comment="SHA-256 at the end of the journal's "
        "chain"),
    sa.Column("cell_key", sa.Uuid, nullable=False, comment="of cell, serial and machine"),
    _name("name", "name of the run"),
    _name("cell", "name of the cell"),
    _name("serial", "serial number of the cell"),
    _bool("simulated", "whether the cell is simulated"),
    _name("machine", "which simulated machine; empty for a real cell"),
    _text("procedure", "such as calibrate"),
    _text("state", "finished, aborted or faulted"),
    _count("exit", "exit code of the run"),
    _time("begun", "first begin, by the clock of the cell's PC"),
    _time("first_ended", "first end, by the clock of the cell's PC"),
    _time("ended", "last end, by the clock of the cell's PC"),
    _count("points", "points that count"),
    _bool("proven", "whether it made a calibration that supersedes those before"),
    _name("robot", "serial number of the robot"),
    _name("tracker", "serial number of the tracker"),
    sa.Column("devices", sa.Uuid, nullable=False, comment="first 128 bits of the SHA-256 of its "
        "rows in device"),
    _text("version", "version of hilcell"),
    sa.Column("shipped", Utc, nullable=False, server_default=CLOCK, comment="arrival, by "
        "the server's clock"),
    sa.Column("shipped_by", sa.Text, nullable=False, server_default=LOGIN, comment="login that "
        "shipped it"),
    sa.Column("inserted_in", sa.BigInteger, nullable=False, server_default=TRANSACTION,
        comment="the server's transaction in which it arrived, with all its parts"),
    sa.Column("accepted", sa.Boolean, comment="the owner's decision: accepted (true), removed "
        "(false), or none (null)"),
    sa.Column("held", sa.Boolean, sa.Computed(HELD, persisted=True), comment="whether it is in no "
        f"answer: removed, or ended more than {CLOCK_ERROR} h after its arrival and not accepted"),
    sa.Column("newest", sa.Boolean, nullable=False, server_default=sa.true(), comment="whether it "
        "is the newest revision that is not held"),
    sa.UniqueConstraint("cell_key", "run_key", "revision", name="run_revision"),
    sa.Index("run_of_head", "cell_key", "head"),
    _one_of("run_state", "state", OVER),
    _check("run_exit", "exit <= 7"),
    _check("run_machine", "simulated = (machine <> '')"),
    _check("run_cell_key", _CELL_KEY).ddl_if(dialect="postgresql"),
)  # fmt: skip


# By triggers: a revision that is held is not the newest, and nothing follows from another cell's.
KEPT = """
    UPDATE run SET newest = NOT newest
    WHERE cell_key = NEW.cell_key AND run_key = NEW.run_key AND newest <> COALESCE(
        NOT held AND revision = (
            SELECT max(revision) FROM run AS every
            WHERE every.cell_key = NEW.cell_key AND every.run_key = NEW.run_key AND NOT every.held
        ), false);
"""
SERVER_COLUMNS = (
    "shipped",
    "shipped_by",
    "inserted_in",
    "accepted",
    "held",
    "newest",
)  # of `run`: no cell's


def _partial_index(name: str, table: sa.Table, where: str, *columns: str) -> None:
    condition = sa.text(where)
    of = [table.c[each] for each in columns]
    sa.Index(name, *of, postgresql_where=condition, sqlite_where=condition)


_partial_index("run_of_cell", RUN, "newest", "cell_key", "ended")
_partial_index("run_proven", RUN, "newest AND proven", "cell_key", "ended")
_partial_index("run_of_robot", RUN, "newest", "robot", "ended")
_partial_index("run_held", RUN, "held", "cell_key", "ended")
sa.Index("run_shipped", RUN.c.cell_key, RUN.c.shipped)
_partial_index("run_of_name", RUN, "newest", "cell", "serial", "name")
_partial_index("run_of_use", RUN, "newest", "cell_key", "devices", "begun", "ended")
_partial_index("run_real", RUN, "newest AND machine = ''", "cell_key", "begun", "first_ended")
_partial_index("run_set_back", RUN, "ended < begun", "ended")

OUTCOME = _part(
    "outcome",
    "the run's row in the index of runs",
    _json("row", "`hilcell.journal.index.RunRow`", "object", most=LONGEST_OUTCOME),
)
FRAME = _part(
    "frame",
    "a frame of the run",
    _key("key", "such as world, base, station.S300"),
    _json("matrix", "4 x 4, row by row; lengths in mm", "array"),
    _json("covariance", "of translation (mm) and rotation vector (rad), 6 x 6, or null",
        "array", "null"),
)  # fmt: skip
VERDICT = _part(
    "verdict",
    "a verdict of the run",
    _key("key", "such as validation.S300"),
    _bool("holds", "whether it holds"),
    _perhaps("mean_mm", "mean error, mm", FARTHEST_MM),
    _perhaps("mean_U_mm", "its expanded uncertainty (k = 2), mm", FARTHEST_MM),
    _perhaps("mean_tolerance_mm", "its tolerance, mm", FARTHEST_MM),
    _json("body", "the record in the journal", "object"),
)
_partial_index(
    "verdict_mean", VERDICT, "mean_mm IS NOT NULL",
    "digest", "key", "mean_mm", "mean_tolerance_mm",
)  # fmt: skip
DEVICE = _part(
    "device",
    "a device as it named itself",
    _number(),
    _text("kind", "robot, tracker, drive or strip"),
    _text("device", "port by which it was reached"),
    _text("maker", "maker"),
    _text("model", "model"),
    _text("serial", "serial number"),
    _text("firmware", "version of its firmware"),
    _bool("simulated", "whether it said that it is simulated"),
    sa.Index("device_serial", "kind", "serial"),
)
ALARM = _part(
    "alarm",
    "an alarm of the run's last session",
    _number(),
    _time("t", "when, UTC"),
    _text("code", "code of its entry in the catalogue"),
    _text("severity", ", ".join(get_args(Severity))),
    _text("title", "title"),
    _text("place", "device or part"),
    _text("found", "what was observed"),
    _one_of("alarm_severity", "severity", get_args(Severity)),
    sa.Index("alarm_code", "code", "t"),
)
LENGTH = _part(
    "length",
    "a certified length as measured",
    _number(),
    _text("nests", "its two nests"),
    _figure("wanted_mm", "certified, at the temperature of the air, mm", FARTHEST_MM),
    _figure("found_mm", "measured, mm", FARTHEST_MM),
    _figure("U_mm", "expanded uncertainty of the difference (k = 2), mm", FARTHEST_MM),
    _check("length_wanted", "wanted_mm >= 1"),
    _check("length_U", '"U_mm" >= 0'),
)
ADJUSTMENT = _part(
    "adjustment",
    "errors of the tracker's axes by both faces, with expanded uncertainties (k = 2)",
    _figure("collimation_urad", "of the line of sight", FARTHEST_URAD),
    _figure("collimation_U_urad", "its U", FARTHEST_URAD),
    _perhaps("transit_urad", "of the transit axis, NULL where not separable", FARTHEST_URAD),
    _perhaps("transit_U_urad", "its U", FARTHEST_URAD),
    _figure("index_urad", "of the vertical circle", FARTHEST_URAD),
    _figure("index_U_urad", "its U", FARTHEST_URAD),
)
GRID = _part(
    "grid",
    "errors of the robot at the vertices of a whole grid",
    sa.Column("layout", sa.Uuid, nullable=False, comment="first 128 bits of the SHA-256 of its "
        "vertices: grids of one layout are compared"),
    _vectors("places_mm", "vertices, (N, 3) in {B}, mm, 8 bytes each, little-endian"),
    _vectors("errors_mm", "errors, (N, 3) in {B}, mm, 8 bytes each, little-endian"),
    _vectors("base_mm", "{B} in {W} as three points: its origin, and 1 m from it along x and y"),
    _figure("mean_mm", "mean length of the errors, mm", FARTHEST_MM),
    _perhaps("temperature_c", "mean of the air, deg C", 1e4),
    _check("grid_errors", "length(errors_mm) = length(places_mm) AND length(errors_mm) > 0"),
    _check("grid_base", "length(base_mm) = 72"),
)  # fmt: skip
STREAM = _part(
    "stream",
    "a stream of readings, which stays in the run's folder",
    _key("key", "such as sweep/A1/up"),
    _text("file", "file in the run's folder"),
    _sha256("SHA-256 of the file"),
    _count("samples", "readings of the tracker"),
    _count("joint_samples", "readings of the robot"),
)
DOCUMENT = _part(
    "document",
    "a file of the run",
    _key("name", "name of the file"),
    _sha256("SHA-256 of its text in UTF-8"),
    sa.Column("text", sa.Text, nullable=False, comment="its content",
        info={"most": LONGEST_DOCUMENT}),
)  # fmt: skip
POINT = _part(
    "point",
    "a point as measured",
    sa.Column("seq", sa.Integer, primary_key=True, comment="number of its record in the journal"),
    _time("t", "when, UTC"),
    _text("key", "what was measured"),
    _text("kind", "such as grid, world, validate"),
    _text("station", "name of the station, or empty"),
    _text("frame", "frame of the coordinates: of the tracker's first set-up"),
    _text("reflector", "name of the reflector"),
    *(_figure(f"{axis}_mm", f"{axis} of the mean, mm") for axis in "xyz"),
    *(_figure(f"std_{axis}_mm", f"standard deviation of one reading in {axis}, mm")
        for axis in "xyz"),
    _count("samples", "readings"),
    _count("session", "session of the run in which it was measured"),
    _count("set_up", "set-up of the tracker at which it was measured"),
    _bool("retaken", "whether it was measured again"),
    _bool("superseded", "whether a later record replaced it: it does not count"),
    _perhaps("temperature_c", "air at the tracker, deg C"),
    _perhaps("pressure_mbar", "air at the tracker, mbar"),
    _perhaps("humidity_percent", "air at the tracker, percent"),
    _perhaps("strip_mm", "position by the strip, mm"),
    _perhaps("rail_mm", "position by the drive, mm"),
    *(_perhaps(f"nominal_{axis}_mm", f"{axis} of the nominal target in {{W}}, mm")
        for axis in "xyz"),
    *(sa.Column(name, sa.JSON(none_as_null=True), comment=comment, info={"kinds": ("array",)})
        for name, comment in (
            ("commanded_deg", "commanded joints, deg"), ("joints_deg", "joints as read, deg"),
        )),
)  # fmt: skip
ARCHIVE = _part(
    "archive",
    "a file that holds the points of a run, which are no longer in point",
    _text("file", "name of the file, in the folder of the archive"),
    _sha256("SHA-256 of the file"),
    sa.Column("at", Utc, nullable=False, server_default=sa.func.now(), comment="when they were "
        "moved, by the server's clock"),
)  # fmt: skip
CLAIM = _table(
    "claim",
    "the login that ships a cell: the first that did, or the one that the owner assigned",
    _key("cell", "name of the cell"),
    _key("serial", "serial number of the cell"),
    sa.Column("login", sa.Text, nullable=False, server_default=LOGIN, comment="login"),
    sa.Column("since", Utc, nullable=False, server_default=CLOCK, comment="since when, by "
        "the server's clock"),
)  # fmt: skip
DECISION = _table(
    "decision",
    "a decision of the database's owner; rows are only added",
    sa.Column("n", sa.Integer, primary_key=True, comment="number of the decision"),
    sa.Column("at", Utc, nullable=False, server_default=sa.func.now(), comment="when, by the "
        "server's clock"),
    sa.Column("by", sa.Text, nullable=False, server_default=LOGIN, comment="login that decided"),
    _text("what", "assigned (a cell), accepted or removed (a run)"),
    _text("cell", "name of the cell"),
    _text("serial", "serial number of the cell"),
    sa.Column("digest", sa.Uuid, sa.ForeignKey("run.digest"), comment="the run, if it is of one"),
    sa.Column("login", sa.Text, comment="login that the cell was assigned to"),
    sa.Column("before", sa.Text, comment="login that had the cell before"),
    _one_of("decision_what", "what", ("assigned", "accepted", "removed")),
)  # fmt: skip
BATCH = 500  # keys of one query
LOCK_S = 10.0  # wait for another transaction, or another process that writes an SQLite file
TRACKER = "tracker"  # of the kinds of `device`
PARTS = (
    OUTCOME, FRAME, VERDICT, DEVICE, ALARM, LENGTH, ADJUSTMENT, GRID, STREAM, DOCUMENT, POINT,
)  # fmt: skip


def grouped(
    connection: sa.Connection, query: sa.Executable, *names: str
) -> defaultdict[tuple[str, ...], list[Row]]:
    """Return the rows of an answer, in their order, by what they have in these columns."""
    found: defaultdict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in connection.execute(query):
        found[tuple(getattr(row, name) for name in names)].append(row)
    return found
