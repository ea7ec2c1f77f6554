"""The plant's database: URL, schema, roles, and errors of one line.

Messages never contain a password, which the URL may have if ``~/.pgpass`` is not used.
"""

from __future__ import annotations

import logging
import re
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from urllib.parse import quote, unquote_to_bytes

import sqlalchemy as sa
from sqlalchemy import URL, ColumnElement, Connection, Engine, event, exc, select, text

from hilcell.decoding import Json
from hilcell.errors import HilcellError, StoreUnavailable
from hilcell.journal.index import NAME as INDEX
from hilcell.plant.rights import CELL, CELL_COLUMNS, ENGINEER, admit
from hilcell.plant.tables import HEAD, LOCK_S, RUN, TABLES, Joined, joined
from hilcell.sanitize import clean, counted

MIGRATIONS = Path(__file__).with_name("migrations")
POSTGRESQL = "postgresql"
HIDDEN = "***"
SHIPPED = "plant.sqlite"  # cache in the folder of runs: which journals were shipped
# A failed connection has no SQLSTATE: only the English message of the server, or a request for a
# password, tells why.
FATAL = "FATAL: "  # the server's reply to a connection
FAILED = " failed: "  # libpq's reason follows
# The server is not the one that the URL trusts, or has no TLS: repeating does not help.
UNTRUSTED = re.compile(r"certificate|SSL was required|private key file")
ALONE = "AccessExclusiveLock"
AGAINST_WRITERS = [
    "RowShareLock", "RowExclusiveLock", "ShareLock", "ShareRowExclusiveLock", "ExclusiveLock",
    ALONE,
]  # fmt: skip
ANY_MODE = [*AGAINST_WRITERS, "AccessShareLock", "ShareUpdateExclusiveLock"]
SECRET = re.compile("passw|pwd", re.IGNORECASE)  # in the names of the URL's options


class PlantError(HilcellError):
    """The database refuses the work: its address, its schema, a privilege."""

    code = "HC-J21"


class RightMissing(PlantError):
    """The user lacks a privilege: repeating does not help."""


class PlantUnavailable(StoreUnavailable):
    """The database cannot be reached, or the connection was lost; no run is lost."""

    code = "HC-J20"


class Locked(PlantUnavailable):
    """Another transaction has a lock: of one cell, or of a whole table."""


class Database:
    """A plant's database by its URL; connects lazily. Raises `PlantError`."""

    _SILENT_LOG = logging.NullHandler()

    def __init__(self, url: str) -> None:
        self._url = _parsed(url)
        hidden = {name: HIDDEN for name in self._url.query if SECRET.search(name)}
        plain = self._url.set(drivername=self._url.get_backend_name()).update_query_dict(hidden)
        shown = plain.render_as_string(hide_password=True)
        self.name = clean(shown.replace(quote(HIDDEN), HIDDEN))
        self.has_logins = self._url.get_backend_name() == POSTGRESQL  # SQLite is a file
        options: dict[str, float] = {} if self.has_logins else {"timeout": LOCK_S}
        # psycopg's warnings repeat the raised error; without a handler they reach stderr.
        logging.getLogger("psycopg").addHandler(self._SILENT_LOG)
        self.engine: Engine = sa.create_engine(self._url, connect_args=options, pool_pre_ping=False)
        if self.has_logins:
            event.listen(self.engine, "do_connect", self._connected)
        else:
            event.listen(self.engine, "connect", self._opened)

    @contextmanager
    def transaction(self, *, migrating: bool = False) -> Iterator[Connection]:
        """Yield a connection in a transaction. Raises `PlantUnavailable` and `PlantError`."""
        try:
            with self.engine.begin() as connection:
                if self.has_logins:
                    from hilcell.plant import deadlines  # loads psycopg

                    order_s = deadlines.MIGRATION_S if migrating else deadlines.ORDER_S
                    deadlines.limit(connection, order_s, as_text=migrating)
                yield connection
        except exc.SQLAlchemyError as error:
            raise self._error(error) from None  # SQLAlchemy's message has the values of all rows
        except UnicodeDecodeError as error:
            raise self._refusal(f"it has text that is not in UTF-8: {error.reason}") from None
        except (UnicodeEncodeError, OverflowError) as error:  # before it reaches the database
            raise self._refusal(f"a value does not fit its column: {error}") from None

    def check(self) -> None:
        """Raise `PlantError` where the schema is not this version's, or `PlantUnavailable`."""
        self._check_place()
        if not (self.has_logins or Path(self._url.database or "").is_file()):
            raise self._none()  # SQLite would create an empty file
        with self.transaction() as connection:
            self._check(connection)

    def create(self) -> str:
        """Create the schema, or upgrade it; return its former version, or "".

        Raises `PlantUnavailable` and `PlantError`.
        """
        from alembic import command
        from alembic.config import Config

        self._check_place()
        with self.transaction(migrating=True) as connection:
            # One process at a time; sqlite3 would also commit each table separately.
            alone = "SELECT pg_advisory_xact_lock(hashtext('hilcell.plant_init'))"
            connection.exec_driver_sql(alone if self.has_logins else "BEGIN IMMEDIATE")
            before = self._version(connection)
            if before is None:
                self._check_empty(connection)
            else:
                self._check(connection)
            config = Config()
            config.set_main_option("script_location", str(MIGRATIONS))
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
            if self.has_logins:
                admit(connection)
        return before or ""

    def check_right(self, right: ColumnElement[bool], missing: str) -> None:
        """Raise `RightMissing` for a login without a right; SQLite has no logins."""
        if self.has_logins:
            with self.transaction() as connection:
                if not connection.execute(select(right)).scalar_one():
                    raise RightMissing(f"plant database {self.name}: {missing}")

    def close(self) -> None:
        self.engine.dispose()

    def _check_place(self) -> None:
        if self.has_logins:
            return
        file = Path(self._url.database or "")
        if file.is_dir():
            raise self._refusal("expected a file such as plant.db, got a folder")
        if not file.parent.is_dir():
            folder = clean(str(file.parent))
            raise self._refusal(f"the folder {folder} does not exist")

    @staticmethod
    def _connected(dialect: object, record: object, words: list[str], options: Json) -> object:
        from hilcell.plant import deadlines  # loads psycopg

        return deadlines.connect(*words, **options)

    @staticmethod
    def _opened(connection: sqlite3.Connection, _: object) -> None:
        connection.execute("PRAGMA foreign_keys=ON")
        connection.create_aggregate(joined.__name__, 1, Joined)  # type: ignore[arg-type]

    @staticmethod
    def _version(connection: Connection) -> str | None:
        """Return the schema's version, or None."""
        if not sa.inspect(connection).has_table("alembic_version"):
            return None
        version = connection.execute(text("SELECT version_num FROM alembic_version")).scalar()
        return None if version is None else str(version)

    def _check(self, connection: Connection) -> None:
        version = self._version(connection)
        if version is None:
            raise self._none()
        schema = sa.inspect(connection)
        names = schema.get_columns(RUN.name) if schema.has_table(RUN.name) else []
        if not {*CELL_COLUMNS} <= {each["name"] for each in names}:
            raise self._foreign(f"its schema is {clean(version)}")
        if version != HEAD:
            raise self._refusal(
                f"expected schema {HEAD}, got {clean(version)}; use the version of hilcell that "
                "created it (update this one if it is older), or ship the runs again to an empty "
                "database"
            )

    def _check_empty(self, connection: Connection) -> None:
        """Refuse a database with other tables, such as a run's journal."""
        others = sorted({*sa.inspect(connection).get_table_names()} - {"alembic_version"})
        if others:
            raise self._foreign(
                f"it has {counted(len(others), 'table')}, the first is {clean(others[0])}"
            )

    def _refusal(self, why: str) -> PlantError:
        return PlantError(f"plant database {self.name}: {why}")

    def _foreign(self, sign: str) -> PlantError:
        return self._refusal(f"it belongs to another program ({sign}); use an empty database")

    def _none(self) -> PlantError:
        return self._refusal("it has no plant records; `hilcell plant init --to URL` creates it")

    def _error(self, error: exc.SQLAlchemyError) -> HilcellError:
        """Return an error of the database in one line, without values and without a password."""
        cause = error.orig if isinstance(error, exc.StatementError) and error.orig else error
        message = getattr(getattr(cause, "diag", None), "message_primary", None)  # no values
        whole = message or str(cause)
        for secret in self._secrets:
            whole = whole.replace(secret, HIDDEN)
        line = clean(" ".join(whole.split()))
        if self._login_refused(cause, whole):
            return self._refusal(
                f"login refused: {_reasons(whole) or line}; check the URL's user and database, and "
                "the password in ~/.pgpass; the database's owner admits users"
            )
        if getattr(cause, "pgconn", None) is not None and UNTRUSTED.search(whole):
            return self._refusal(
                f"connection refused: {_reasons(whole) or line}; check sslmode, sslrootcert and "
                "the host name in the URL, and the server's certificate"
            )
        if getattr(cause, "sqlstate", "") == "55P03":  # lock not available
            holders = self._holders(str(getattr(error, "statement", "")))
            return Locked(
                f"plant database {self.name}: {line} after {LOCK_S:g} s; {holders}; nothing is "
                "lost: repeat the command when the lock is free"
            )
        if getattr(cause, "sqlite_errorname", "").startswith("SQLITE_BUSY"):
            return PlantUnavailable(
                f"plant database {self.name}: {line} after {LOCK_S:g} s: another process uses this "
                "file; nothing is lost: repeat the command when that process has ended"
            )
        if self._unavailable(error, cause):
            remote, local = "the server and the network", "the folder, its permissions and the disk"
            return PlantUnavailable(
                f"plant database {self.name}: it cannot be used now: {line}; nothing is lost: "
                f"check {remote if self.has_logins else local}, then repeat the command"
            )
        damaged = {  # by SQLite's error name
            "SQLITE_NOTADB": "; use another file, or restore its backup",
            "SQLITE_CORRUPT": "; restore its backup, or create another with `hilcell plant init "
            "--to URL` and ship the runs again from each cell's journals",
        }
        kind = "_".join(getattr(cause, "sqlite_errorname", "").split("_")[:2])
        refused = self._refusal(f"refused: {line}{damaged.get(kind, '')}")
        if getattr(cause, "sqlstate", "") == "42501":  # insufficient privilege
            return RightMissing(
                f"{refused}; `ship` needs a login in the role {CELL}, `show` and `export` one in "
                f"{ENGINEER}, all else the database's owner, who admits a login: "
                f"GRANT {ENGINEER} TO NAME"
            )
        return refused

    def _holders(self, order: str) -> str:
        """Return who has a lock of the plant's tables for which ``order`` may have waited."""
        reads, kind, modes = order.lstrip().startswith("SELECT"), "relation", ANY_MODE
        if "pg_advisory_xact_lock" in order:
            kind = "advisory"
        elif reads and "FOR UPDATE" not in order:
            modes = [ALONE]
        elif reads or order.lstrip().startswith(("INSERT", "UPDATE", "DELETE")):  # also for rows
            modes = AGAINST_WRITERS
        # A copy of a database has the same numbers of tables. Of a dropped login, or of a process
        # of the server, there is no name. Others wait behind one that waits to be alone.
        locks = text(
            "SELECT DISTINCT COALESCE(usename, backend_type, 'a process of the server') AS login, "
            "pid FROM pg_locks JOIN pg_stat_activity USING (pid) "
            "WHERE locktype = :kind AND mode = ANY(:modes) AND (granted OR mode = :alone) "
            "AND pid <> pg_backend_pid() AND (relation IS NULL OR relation IN "
            "(SELECT to_regclass(name) FROM unnest(CAST(:names AS text[])) AS name)) AND "
            "database = (SELECT oid FROM pg_database WHERE datname = current_database()) "
            "ORDER BY login, pid"
        )
        values = {
            "kind": kind, "modes": modes, "alone": ALONE,
            "names": [*TABLES.tables, "alembic_version"],
        }  # fmt: skip
        with suppress(HilcellError), self.transaction() as connection:
            rows = connection.execute(locks, values).all()
            if rows:
                named = (f"{clean(row.login)} (process {row.pid})" for row in rows)
                return f"transactions that hold a lock are of {', '.join(named)}"
        return "who held the lock is not known: it is free by now, or of a prepared transaction"

    @staticmethod
    def _login_refused(cause: BaseException, whole: str) -> bool:
        """Whether the server refused this user: repeating does not help."""
        connecting = getattr(cause, "pgconn", None)
        if connecting is None or getattr(cause, "sqlstate", None) is not None:
            return False
        if FATAL not in whole:
            return bool(connecting.needs_password)  # and there was none
        unknown = re.compile(
            r"authentication failed|no pg_hba\.conf entry|pg_hba\.conf rejects|"
            r"not permitted to log in|(role|database) .* does not exist|"
            r"permission denied for database"
        )
        full = "too many connections"
        return bool(unknown.search(whole) or (connecting.used_password and full not in whole))

    @staticmethod
    def _unavailable(error: exc.SQLAlchemyError, cause: BaseException) -> bool:
        """Whether the database cannot be used at all, rather than by this statement."""
        if isinstance(error, exc.DBAPIError) and error.connection_invalidated:
            return True
        limits = "54"  # class of SQLSTATE, such as a key that is too long for an index
        limited = str(getattr(cause, "sqlstate", "")).startswith(limits)
        wrong = getattr(cause, "sqlite_errorname", "") == "SQLITE_ERROR"
        return isinstance(error, exc.OperationalError) and not (limited or wrong)

    @property
    def _secrets(self) -> list[str]:
        """The passwords of the URL, the longest first: one may contain another."""
        options = [each for name, each in self._url.query.items() if SECRET.search(name)]
        values = [each if isinstance(each, tuple) else (each,) for each in options]
        passwords = {str(each) for each in [self._url.password, *chain(*values)] if each}
        return sorted(passwords, key=len, reverse=True)


def _reasons(whole: str) -> str:
    """Return what libpq says of each try to connect; it repeats a try without TLS."""
    tries = [each.rpartition(FAILED) for each in whole.splitlines()]
    reasons = [clean(why.removeprefix(FATAL)) for _, failed, why in tries if failed]
    return "; ".join(dict.fromkeys(reasons))


def _parsed(url: str) -> URL:
    forms = "expected postgresql://USER@HOST/DATABASE or sqlite:///FILE"
    try:
        if b"\0" in unquote_to_bytes(url):  # libpq would truncate it
            raise exc.ArgumentError
        parsed = sa.make_url(url)
        backend = parsed.get_backend_name()
    except (exc.ArgumentError, ValueError):  # both may repeat the URL, and so a password
        raise PlantError(f"plant database: invalid URL; {forms}") from None
    drivers = {POSTGRESQL: "postgresql+psycopg", "sqlite": "sqlite"}
    if backend not in drivers:
        raise PlantError(f"plant database: unknown {clean(backend)}; {forms}")
    if "@" in (parsed.host or ""):  # the rest of a password
        raise PlantError("plant database: invalid URL: write an @ of a password as %40")
    options = set[str]()
    if backend == POSTGRESQL:  # the driver's own options, such as autocommit, would override ours
        from psycopg.pq import Conninfo

        options = {each.keyword.decode() for each in Conninfo.get_defaults()}
    elif parsed.database in (None, "", ":memory:"):
        raise PlantError(f"plant database: its URL has no file; {forms}")
    elif (name := Path(parsed.database or "").name) in (INDEX, SHIPPED):
        raise PlantError(
            f"plant database: {name} is a cache in a folder of runs, which may be deleted; use "
            "another name, such as plant.db"
        )
    for name in parsed.query:
        if name not in options:
            raise PlantError(
                f"plant database: unknown option {clean(name)} of its URL; expected one of libpq, "
                "such as ?sslmode=verify-full"
            )
    return parsed.set(drivername=drivers[backend])
