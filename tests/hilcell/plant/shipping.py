"""A shipper that dies at a moment that the test chose."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from sqlalchemy import Engine, event

from hilcell.plant.database import Database
from hilcell.plant.shipper import ship

MOMENTS = ("before_cursor_execute", "commit", "checkin")  # of a connection: the commit is done


class Killed(BaseException):
    """Nothing of the shipper runs any more."""


def _die() -> None:
    raise Killed


@contextmanager
def dying_before(
    order: int, engine: Engine | type[Engine], die: Callable[[], None] = _die
) -> Iterator[None]:
    """Call ``die`` before the ``order``-th order to the database, once."""
    left = [order]

    def count(*_: object) -> None:
        left[0] -= 1
        if not left[0]:
            die()

    for name in MOMENTS:
        event.listen(engine, name, count)
    try:
        yield
    finally:
        for name in MOMENTS:
            event.remove(engine, name, count)


def ship_and_die(runs: str, url: str, order: int, seconds: float) -> None:
    """Ship in a process of its own; end it before an order, or after so many seconds."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # it ends the process at once
    signal.setitimer(signal.ITIMER_REAL, seconds)
    with (
        closing(Database(url)) as database,
        dying_before(order, database.engine, lambda: os.kill(os.getpid(), signal.SIGKILL)),
    ):
        ship(Path(runs), database)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
