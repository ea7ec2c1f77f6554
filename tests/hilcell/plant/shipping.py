"""A shipper in a process of its own that dies at a moment that the test chose."""

from __future__ import annotations

import os
import signal
from contextlib import closing
from pathlib import Path

from sqlalchemy import event

from hilcell.plant.database import Database
from hilcell.plant.shipper import ship

MOMENTS = ("before_cursor_execute", "commit", "checkin")  # of a connection: the commit is done


def ship_and_die(runs: str, url: str, order: int, seconds: float) -> None:
    """Ship; die before the ``order``-th order to the database, or after so many seconds."""
    left = [order]

    def count(*_: object) -> None:
        left[0] -= 1
        if not left[0]:
            os.kill(os.getpid(), signal.SIGKILL)

    signal.setitimer(signal.ITIMER_REAL, seconds)  # SIGALRM ends the process at once
    with closing(Database(url)) as database:
        for name in MOMENTS:
            event.listen(database.engine, name, count)
        ship(Path(runs), database)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
