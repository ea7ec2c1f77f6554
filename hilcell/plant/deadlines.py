"""Deadlines of a plant's server: no command waits forever for a frozen server.

The server itself ends statements and waits for locks that take too long. A frozen server is silent
while its system acknowledges packets, so silence is measured here. In a migration, whose statements
may take hours, a silent server must accept a second connection.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from typing import Any

import psycopg
from psycopg.conninfo import make_conninfo
from psycopg.pq import Format, PGconn, Ping
from psycopg.rows import TupleRow
from sqlalchemy import Connection
from sqlalchemy import text as sql

from hilcell.plant.tables import LOCK_S

CONNECT_S = 10
ORDER_S = 120.0  # one statement
MIGRATION_S = 4 * 3600.0  # one statement of a migration
REST_S = 600.0  # idle time of this side within a transaction, before the server frees its locks
SORTED = "64MB"  # the grids of 200 robots in five years are 40 MB
SLACK_S = 15.0  # the server's own deadline expires first
ANSWER_S = 60  # a second connection

OPTIONS: dict[str, int | str] = {
    "client_encoding": "utf8",  # in a database without one, psycopg would return bytes
    "connect_timeout": CONNECT_S,
    "tcp_user_timeout": 30_000,  # ms: packets, and probes of an idle connection
    "keepalives_idle": CONNECT_S,
    "keepalives_interval": CONNECT_S,
    "keepalives_count": 3,
}
Waiting = Generator[Any, Any, Any]  # psycopg's: yields what it waits for, receives what is ready


class _Binary(psycopg.Cursor[TupleRow]):
    """Rows as the server has them: as text, grids and times take a third longer."""

    def __init__(self, connection: Bounded, **options: Any) -> None:
        super().__init__(connection, **options)
        self.format = Format.BINARY


class _BinaryParts(psycopg.ServerCursor[TupleRow]):
    """The same, some rows at a time."""

    def __init__(self, connection: Bounded, name: str, **options: Any) -> None:
        super().__init__(connection, name, **options)
        self.format = Format.BINARY


class Bounded(psycopg.Connection[TupleRow]):
    """A connection that ends when its server is silent for too long."""

    order_s = ORDER_S

    def wait(self, gen: Waiting, *args: Any, **options: Any) -> Any:
        """Wait as psycopg does, and close the connection after a long silence."""
        try:
            return super().wait(self._watched(gen), *args, **options)
        except Silent:
            self.pgconn.finish()  # a rollback would wait as long again
            raise

    def _watched(self, gen: Waiting) -> Waiting:
        """Pass psycopg's generator through; raise `Silent` after too long without an event, or
        earlier if the server does not answer otherwise.
        """
        quiet_s, most_s = ORDER_S + SLACK_S, self.order_s + SLACK_S
        ready_s = alive_s = time.monotonic()
        try:
            awaited = next(gen)
            while True:
                ready = yield awaited
                now_s = time.monotonic()
                if ready:
                    ready_s = alive_s = now_s
                elif not now_s - alive_s < quiet_s:
                    if not (now_s - ready_s < most_s and self._answers()):
                        silent_s = time.monotonic() - ready_s
                        raise Silent(f"no answer for {silent_s:.1f} s: the server is frozen")
                    alive_s = time.monotonic()
                awaited = gen.send(ready)
        except StopIteration as end:
            return end.value

    def _answers(self) -> bool:
        """Whether the server answers a second connection, also by a refusal."""
        second = make_conninfo(self.info.dsn, connect_timeout=ANSWER_S)
        return PGconn.ping(second.encode()) in (Ping.OK, Ping.REJECT)


class Silent(psycopg.OperationalError):
    """The server was silent for too long."""


def connect(*args: Any, **options: Any) -> Bounded:
    try:
        options |= OPTIONS
        return Bounded.connect(*args, **options)
    except UnicodeError as error:
        raise psycopg.ProgrammingError(f"invalid name of a host: {error}") from error
    except psycopg.OperationalError as error:
        text, bad = str(error), "connection is bad: "
        if text.startswith(bad) and "connection to server" not in text:  # no server was involved
            raise psycopg.ProgrammingError(text.removeprefix(bad)) from error
        raise


def limit(connection: Connection, order_s: float, *, as_text: bool) -> None:
    """Set the deadlines of a connection's transaction, in the server and here.

    ``as_text``: of rows, as a migration needs that reads the server's own tables.
    """
    own = connection.connection.driver_connection
    if not isinstance(own, Bounded):
        raise TypeError(f"expected a connection of `connect`, got {type(own).__name__}")
    own.order_s = order_s
    own.cursor_factory = psycopg.Cursor if as_text else _Binary
    own.server_cursor_factory = psycopg.ServerCursor if as_text else _BinaryParts
    limits_s = {
        "statement_timeout": order_s,
        "lock_timeout": LOCK_S,
        "idle_in_transaction_session_timeout": REST_S,
    }
    limits = {name: f"{at * 1000:.0f}" for name, at in limits_s.items()}  # ms
    limits |= {"work_mem": SORTED, "jit": "off"}  # to compile takes as long as to answer
    sets = (f"set_config('{name}', '{at}', true)" for name, at in limits.items())
    connection.execute(sql(f"SELECT {', '.join(sets)}"))
