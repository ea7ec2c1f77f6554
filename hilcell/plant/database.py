"""The plant's database: its URL, its schema and roles, and its errors in one line each.

No message holds a password: it may stand in the URL, where libpq's own file (``~/.pgpass``) is
not used.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote, unquote_to_bytes

import sqlalchemy as sa
from sqlalchemy import URL, Connection, Engine, event, exc, text

from hilcell.decoding import Json
from hilcell.errors import HilcellError, StoreAway
from hilcell.journal.index import NAME as INDEX
from hilcell.plant.tables import HEAD, PARTS, RUN
from hilcell.sanitize import clean

MIGRATIONS = Path(__file__).with_name("migrations")
POSTGRESQL = "postgresql"
BUSY_S = 30.0  # that another may write an office's file
HIDDEN = "***"
SEEN = "plant.sqlite"  # beside the journals, of those that were shipped
CELL, ENGINEER = "hilcell_cell", "hilcell_engineer"  # the roles
# A connection that fails has no SQLSTATE: the words of an English server say why, or a password
# that was asked for.
FATAL = "FATAL: "  # the server's answer to a connection
SECRET = re.compile("passw|pwd", re.IGNORECASE)  # in the names of the URL's own options
KNOWN = ("run_key", "revision", "head")  # columns of `run` that cells may read


class PlantError(HilcellError):
    """The database refuses the work: its address, its schema, a right."""

    code = "HC-J21"


class RightMissing(PlantError):
    """The user may not do this: no repetition helps."""


class PlantAway(StoreAway):
    """The database cannot be reached, or went away; journals keep the runs that it lacks."""

    code = "HC-J20"


class Database:
    """A plant's database by its URL; opens nothing yet. Raises `PlantError`."""

    _UNHEARD = logging.NullHandler()

    def __init__(self, url: str) -> None:
        self._url = _parsed(url)
        hidden = {name: HIDDEN for name in self._url.query if SECRET.search(name)}
        plain = self._url.set(drivername=self._url.get_backend_name()).update_query_dict(hidden)
        shown = plain.render_as_string(hide_password=True)
        self.name = clean(shown.replace(quote(HIDDEN), HIDDEN))
        self._remote = self._url.get_backend_name() == POSTGRESQL
        options: dict[str, float] = {} if self._remote else {"timeout": BUSY_S}
        # Its warnings repeat the error that is raised; without a handler they reach stderr.
        logging.getLogger("psycopg").addHandler(self._UNHEARD)
        self.engine: Engine = sa.create_engine(self._url, connect_args=options, pool_pre_ping=False)
        if self._remote:
            event.listen(self.engine, "do_connect", self._connected)
        else:
            event.listen(self.engine, "connect", self._check_keys)

    @contextmanager
    def transaction(self, *, migrating: bool = False) -> Iterator[Connection]:
        """Yield a connection whose work is kept whole, or not at all.

        Raises `PlantAway` and `PlantError`.
        """
        try:
            with self.engine.begin() as connection:
                if self._remote:
                    from hilcell.plant import deadlines  # loads psycopg

                    order_s = deadlines.MIGRATION_S if migrating else deadlines.ORDER_S
                    deadlines.limit(connection, order_s)
                yield connection
        except exc.SQLAlchemyError as error:
            raise self._error(error) from None  # SQLAlchemy's own says the values of all rows

    def check(self) -> None:
        """Raise `PlantError` where the schema is not this version's, or `PlantAway`."""
        self._check_place()
        if not (self._remote or Path(self._url.database or "").is_file()):
            raise self._none()  # SQLite would make an empty one
        with self.transaction() as connection:
            self._check(connection)

    def create(self) -> str:
        """Make the schema where there is none; return which it was before, or "".

        Raises `PlantAway` and `PlantError`.
        """
        from alembic import command
        from alembic.config import Config

        self._check_place()
        with self.transaction(migrating=True) as connection:
            # One at a time; sqlite3 would also keep each table by itself.
            alone = "SELECT pg_advisory_xact_lock(hashtext('hilcell.plant_init'))"
            connection.exec_driver_sql(alone if self._remote else "BEGIN IMMEDIATE")
            before = self._version(connection)
            if before is None:
                self._check_empty(connection)
            else:
                self._check(connection)
            config = Config()
            config.set_main_option("script_location", str(MIGRATIONS))
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
            if self._remote:
                self._grant(connection)
        return before or ""

    def close(self) -> None:
        self.engine.dispose()

    def _check_place(self) -> None:
        """Refuse a place at which no file can be: no repetition helps."""
        if self._remote:
            return
        file = Path(self._url.database or "")
        if file.is_dir():
            raise self._refusal("it is a folder; name a file, as plant.db in it")
        if not file.parent.is_dir():
            folder = clean(str(file.parent))
            raise self._refusal(f"the folder {folder} is not there; make it, or name another file")

    @staticmethod
    def _connected(dialect: object, record: object, words: list[str], options: Json) -> object:
        """Open a connection as SQLAlchemy asks for it, with the deadlines of a server."""
        from hilcell.plant import deadlines  # loads psycopg

        return deadlines.connect(*words, **options)

    @staticmethod
    def _check_keys(connection: object, _: object) -> None:
        connection.execute("PRAGMA foreign_keys=ON")  # type: ignore[attr-defined] # sqlite3's own

    @staticmethod
    def _version(connection: Connection) -> str | None:
        """Return the schema's version; None where there is none."""
        if not sa.inspect(connection).has_table("alembic_version"):
            return None
        found = connection.execute(text("SELECT version_num FROM alembic_version")).scalar()
        return None if found is None else str(found)

    @staticmethod
    def _grant(connection: Connection) -> None:
        """Let cells insert and engineers read; the two roles are made where they are not there."""
        for role in (CELL, ENGINEER):
            there = text("SELECT 1 FROM pg_roles WHERE rolname = :role")
            if connection.execute(there, {"role": role}).scalar() is None:
                # The server's other databases share the roles: another `init` may make them now.
                make = f"""
                DO $$ BEGIN CREATE ROLE {role} NOLOGIN;
                EXCEPTION WHEN duplicate_object OR unique_violation THEN NULL;
                END $$
                """
                connection.execute(text(make))
        tables = ", ".join(table.name for table in (RUN, *PARTS))
        for order in (
            f"GRANT INSERT ON {tables} TO {CELL}",
            f"GRANT SELECT ({', '.join(KNOWN)}) ON {RUN.name} TO {CELL}",
            f"GRANT EXECUTE ON FUNCTION plant_month(date) TO {CELL}",
            f"GRANT SELECT ON {tables} TO {ENGINEER}",
            f"GRANT SELECT ON alembic_version TO {CELL}, {ENGINEER}",
        ):
            connection.execute(text(order))

    def _check(self, connection: Connection) -> None:
        found = self._version(connection)
        if found is None:
            raise self._none()
        schema = sa.inspect(connection)
        names = schema.get_columns(RUN.name) if schema.has_table(RUN.name) else []
        if not {*KNOWN} <= {each["name"] for each in names}:
            raise self._foreign(f"its schema is {clean(found)}")
        if found != HEAD:
            raise self._refusal(
                f"schema {clean(found)}, expected {HEAD}; use the hilcell that made it, or ship "
                "the runs again to an empty database"
            )

    def _check_empty(self, connection: Connection) -> None:
        """Refuse what holds other tables: a run's journal is such a file, too."""
        others = sorted({*sa.inspect(connection).get_table_names()} - {"alembic_version"})
        if others:
            raise self._foreign(f"it has {len(others)} tables, the first is {clean(others[0])}")

    def _refusal(self, why: str) -> PlantError:
        return PlantError(f"plant database {self.name}: {why}")

    def _foreign(self, sign: str) -> PlantError:
        return self._refusal(f"it belongs to another program ({sign}); name an empty database")

    def _none(self) -> PlantError:
        make = "`hilcell plant init --to URL` makes their tables"
        return self._refusal(f"it holds no plant records; {make}")

    def _error(self, error: exc.SQLAlchemyError) -> HilcellError:
        """Return an error of the database in one line, without values and without a password."""
        cause = error.orig if isinstance(error, exc.StatementError) and error.orig else error
        said = getattr(getattr(cause, "diag", None), "message_primary", None)  # no values
        words = clean(" ".join((said or str(cause)).split()))
        for secret in self._secrets:
            words = words.replace(secret, HIDDEN)
        if self._login_refused(cause, words):
            return self._refusal(
                f"login refused: {words.rpartition(FATAL)[2].strip()}; check the URL's user and "
                "database, and the password in ~/.pgpass; the owner lets users in"
            )
        if self._away(error, cause):
            remote, local = "the server and the network", "the folder, its rights and the disk"
            return PlantAway(
                f"plant database {self.name}: it cannot be used now: {words}; nothing is lost: "
                f"check {remote if self._remote else local}, then repeat the command"
            )
        damaged = {  # by SQLite's own word for the error
            "SQLITE_NOTADB": "; name another file, or restore its backup",
            "SQLITE_CORRUPT": "; restore its backup, or make another by `hilcell plant init --to "
            "URL` and ship the runs again: each cell's journals keep them",
        }
        kind = "_".join(getattr(cause, "sqlite_errorname", "").split("_")[:2])
        refused = self._refusal(f"refused: {words}{damaged.get(kind, '')}")
        if getattr(cause, "sqlstate", "") == "42501":  # insufficient privilege
            return RightMissing(
                f"{refused}; a user ships in the role {CELL} and reads in the role {ENGINEER}; the "
                "owner of the database makes both by `hilcell plant init`"
            )
        return refused

    @staticmethod
    def _login_refused(cause: BaseException, words: str) -> bool:
        """Whether the server answered that this user does not come in: no repetition helps."""
        asked = getattr(cause, "pgconn", None)
        if asked is None or getattr(cause, "sqlstate", None) is not None:
            return False
        if FATAL not in words:
            return bool(asked.needs_password)  # and there was none
        unknown = re.compile(
            r"authentication failed|no pg_hba\.conf entry|pg_hba\.conf rejects|"
            r"not permitted to log in|(role|database) .* does not exist|"
            r"permission denied for database"
        )
        full = "too many connections"
        return bool(unknown.search(words) or (asked.used_password and full not in words))

    @staticmethod
    def _away(error: exc.SQLAlchemyError, cause: BaseException) -> bool:
        """Whether the database is not to be used at all, rather than by this order."""
        if isinstance(error, exc.DBAPIError) and error.connection_invalidated:
            return True
        limits = "54"  # class of SQLSTATE: a key that is too long for an index, and the like
        limited = str(getattr(cause, "sqlstate", "")).startswith(limits)
        wrong = getattr(cause, "sqlite_errorname", "") == "SQLITE_ERROR"
        return isinstance(error, exc.OperationalError) and not (limited or wrong)

    @property
    def _secrets(self) -> list[str]:
        """Return the passwords of the URL, the longest first: one may be a part of another."""
        url = self._url
        given = [url.password, *(word for name, word in url.query.items() if SECRET.search(name))]
        words = (each if isinstance(each, tuple) else (each,) for each in given)
        return sorted({str(word) for each in words for word in each if word}, key=len, reverse=True)


def _parsed(url: str) -> URL:
    forms = "expected postgresql://USER@HOST/DATABASE or sqlite:///FILE"
    try:
        if b"\0" in unquote_to_bytes(url):  # libpq would read no further
            raise exc.ArgumentError
        parsed = sa.make_url(url)
        backend = parsed.get_backend_name()
    except (exc.ArgumentError, ValueError):  # both may repeat the URL, and so a password
        raise PlantError(f"plant database: its URL cannot be read; {forms}") from None
    drivers = {POSTGRESQL: "postgresql+psycopg", "sqlite": "sqlite"}
    if backend not in drivers:
        raise PlantError(f"plant database: {clean(backend)} is not known; {forms}")
    if "@" in (parsed.host or ""):  # the rest of a password
        raise PlantError("plant database: its URL cannot be read: write an @ of a password as %40")
    if backend == "sqlite" and parsed.database in (None, "", ":memory:"):
        raise PlantError(f"plant database: its URL names no file; {forms}")
    if backend == "sqlite" and (name := Path(parsed.database or "").name) in (INDEX, SEEN):
        raise PlantError(
            f"plant database: {name} is a file of a folder of runs, which may be deleted at any "
            "time; name another, as plant.db"
        )
    known = _options(backend)
    for name in parsed.query:
        if name not in known:
            raise PlantError(
                f"plant database: unknown option {clean(name)} of its URL; expected one of "
                "PostgreSQL's own library, as ?sslmode=verify-full"
            )
    return parsed.set(drivername=drivers[backend])


def _options(backend: str) -> set[str]:
    """Return the options that a URL may have: the driver's own, as autocommit, would undo ours."""
    if backend != POSTGRESQL:
        return set()
    from psycopg.pq import Conninfo  # an optional package's

    return {each.keyword.decode() for each in Conninfo.get_defaults()}
