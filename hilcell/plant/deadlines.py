"""Deadlines of a plant's server: no command waits for ever for a server that froze.

The server itself ends what takes too long, or waits for a lock. One that stands still says nothing,
and its system goes on acknowledging packets: only the silence, measured here, ends that wait. In a
migration, whose orders may take hours, a silent server is asked for a second connection: one that
answers is at work.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any

import psycopg
from psycopg.conninfo import make_conninfo
from psycopg.pq import PGconn, Ping
from psycopg.rows import TupleRow
from sqlalchemy import Connection, text

CONNECT_S = 10
LOCK_S = 30.0
ORDER_S = 120.0  # one order to the server
MIGRATION_S = 4 * 3600.0  # one order of a migration
REST_S = 600.0  # of this side within a transaction; then the server frees its locks
SLACK_S = 15.0  # the server's own word comes before the silence counts
ANSWER_S = 60  # that a server may take to answer a second connection

OPTIONS: dict[str, int | str] = {
    "client_encoding": "utf8",  # where the database has none, psycopg would hand over bytes
    "connect_timeout": CONNECT_S,
    "tcp_user_timeout": 30_000,  # ms: packets, and probes of a connection that is at rest
    "keepalives_idle": CONNECT_S,
    "keepalives_interval": CONNECT_S,
    "keepalives_count": 3,
}
Words = Generator[Any, Any, Any]  # psycopg's: it yields what it waits for, and gets what is ready


class Bounded(psycopg.Connection[TupleRow]):
    """A connection that ends where its server says nothing for too long."""

    order_s = ORDER_S

    def wait(self, gen: Words, *args: Any, **options: Any) -> Any:
        """Wait as psycopg does; a long silence closes the connection, and is an error."""
        try:
            heard = _heard(gen, ORDER_S + SLACK_S, self.order_s + SLACK_S, self._answers)
            return super().wait(heard, *args, **options)
        except Silent:
            self.pgconn.finish()  # a rollback would wait as long again
            raise

    def _answers(self) -> bool:
        """Whether the server answers a second connection; it need not let it in."""
        asked = make_conninfo(self.info.dsn, connect_timeout=ANSWER_S)
        return PGconn.ping(asked.encode()) in (Ping.OK, Ping.REJECT)


class Silent(psycopg.OperationalError):
    """The server said nothing for too long."""


def connect(*args: Any, **options: Any) -> Bounded:
    """Open a connection with these deadlines."""
    try:
        options |= OPTIONS
        return Bounded.connect(*args, **options)
    except UnicodeError as error:
        raise psycopg.ProgrammingError(f"a host of that name cannot be: {error}") from error
    except psycopg.OperationalError as error:
        words, bad = str(error), "connection is bad: "
        if words.startswith(bad) and "connection to server" not in words:  # no server was asked
            raise psycopg.ProgrammingError(words.removeprefix(bad)) from error
        raise


def limit(connection: Connection, order_s: float) -> None:
    """Give the transaction of a connection its deadlines, in the server and here."""
    own = connection.connection.driver_connection
    if not isinstance(own, Bounded):
        raise TypeError(f"expected a connection of `connect`, got {type(own).__name__}")
    own.order_s = order_s
    limits_s = {
        "statement_timeout": order_s,
        "lock_timeout": LOCK_S,
        "idle_in_transaction_session_timeout": REST_S,
    }
    sets = (f"set_config('{name}', '{at * 1000:.0f}', true)" for name, at in limits_s.items())
    connection.execute(text(f"SELECT {', '.join(sets)}"))


def _heard(gen: Words, quiet_s: float, most_s: float, answers: Callable[[], bool]) -> Words:
    """Pass psycopg's generator through; raise `Silent` where its socket is not ready for long.

    A server that is quiet must answer otherwise; after ``most_s`` even that is not enough.
    """
    heard_s = asked_s = time.monotonic()
    try:
        wanted = next(gen)
        while True:
            ready = yield wanted
            now_s = time.monotonic()
            if ready:
                heard_s = asked_s = now_s
            elif not now_s - asked_s < quiet_s:
                if not (now_s - heard_s < most_s and answers()):
                    silent_s = time.monotonic() - heard_s
                    raise Silent(f"no answer for {silent_s:.1f} s: the server stands still")
                asked_s = time.monotonic()
            wanted = gen.send(ready)
    except StopIteration as end:
        return end.value
