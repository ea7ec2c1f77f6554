"""Shipper and server are killed at many moments: nothing is lost, nothing is doubled."""

from __future__ import annotations

import logging
import multiprocessing
import os
import random
import signal
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import timedelta
from pathlib import Path

import pytest
from sqlalchemy import Engine, event, func, select

from hilcell.journal.runs import read_records
from hilcell.plant.database import SHIPPED, Database
from hilcell.plant.record import run_record
from hilcell.plant.shipper import Shipped, ship
from hilcell.plant.tables import PARTS, POINT, RUN
from tests.hilcell.plant.conftest import NOW
from tests.hilcell.plant.server import BLANK, Server
from tests.hilcell.plant.year import Model, Run, revoke
from tests.whole.bench import command, sweep

RUNS = 3
ORDERS = 12  # to the database, for one run
SLOWEST_S = 0.4
MOST = 5  # kills in a row: the next shipment is let be
PROCESSES = multiprocessing.get_context("fork")  # others leave processes of their own


@pytest.fixture
def runs(model: Model, tmp_path: Path) -> Path:
    for n in range(RUNS):
        began = NOW - timedelta(days=20 * (RUNS - n))
        model.write(tmp_path / "runs", Run(f"r{n}", "north", "HC-1", began))
    return tmp_path / "runs"


def check(database: Database, runs: Path, revisions: Counter[str]) -> None:
    """Check that each run's newest record stands there once with all its parts, and no orphans."""
    assert ship(runs, database) == Shipped(before=RUNS)
    with database.transaction() as connection:
        names = [row.name for row in connection.execute(select(RUN.c.name))]
        assert Counter(names) == revisions
        for folder in runs.glob("r*"):
            record = run_record(folder.name, read_records(folder))
            (run,) = record.rows[RUN]
            counts = {
                table.name: connection.execute(
                    select(func.count()).select_from(table).where(table.c.digest == run["digest"])
                ).scalar_one()
                for table in PARTS
            }
            assert counts == {table.name: len(record.rows[table]) for table in PARTS}
            assert counts["point"]
        for table in PARTS:
            asked = select(func.count()).select_from(table)
            orphans = asked.where(table.c.digest.not_in(select(RUN.c.digest)))
            assert connection.execute(orphans).scalar_one() == 0


@pytest.mark.process
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")  # this process has threads
@pytest.mark.parametrize(("seed", "kills"), [(1, 5), *sweep((2, 220))])
def test_a_shipper_that_is_killed(seed: int, kills: int, runs: Path, postgresql: Server) -> None:
    """One of the runs is opened again after it was shipped."""
    rng = random.Random(seed)
    killed = 0
    while killed < kills:
        url = postgresql.make(like=BLANK)
        with closing(Database(url)) as database:
            revisions = Counter({f"r{n}": 1 for n in range(RUNS)})
            killed += _until_shipped(rng, runs, url)
            ship(runs, database)
            again = rng.randrange(RUNS)
            revoke(runs / f"r{again}", NOW)
            revisions[f"r{again}"] += 1
            killed += _until_shipped(rng, runs, url)
            ship(runs, database)
            check(database, runs, revisions)


def _until_shipped(rng: random.Random, runs: Path, url: str) -> int:
    """Ship in processes that are killed until one comes to its end; return how many."""
    for killed in range(MOST):
        order, seconds = rng.randrange(1, RUNS * ORDERS), 0.0
        if rng.random() < 0.5:
            order, seconds = 0, rng.uniform(0.001, SLOWEST_S)
        process = PROCESSES.Process(target=ship_and_die, args=(str(runs), url, order, seconds))
        process.start()
        process.join()
        code = process.exitcode
        process.close()
        assert code in (0, -9, -14)
        if code == 0:
            return killed
    return MOST


def test_a_shipment_that_is_cut_off_before_each_order_of_a_run(
    model: Model, tmp_path: Path, blank: Path
) -> None:
    """Also after the commit, before the shipper has noted it."""
    runs = tmp_path / "runs"
    folder = model.write(runs, Run("r0", "north", "HC-1", NOW))
    points = len(run_record("r0", read_records(folder)).rows[POINT])
    order, ended = 0, False
    while not ended:
        order += 1
        (runs / SHIPPED).unlink(missing_ok=True)
        file = tmp_path / f"{order}.db"
        file.write_bytes(blank.read_bytes())
        with closing(Database(f"sqlite:///{file}")) as database, ended_with_it(database.engine):
            try:
                with dying_before(order, database.engine):
                    ship(runs, database)
                ended = True
            except Killed:
                pass
        with closing(Database(f"sqlite:///{file}")) as database:
            with database.transaction() as connection:
                kept = connection.execute(select(func.count()).select_from(RUN)).scalar_one()
                found = connection.execute(select(func.count()).select_from(POINT)).scalar_one()
            assert (kept, found) in [(0, 0), (1, points)]
            done = ship(runs, database)
            assert (done.runs, done.before) == (1 - kept, kept)
    assert order > ORDERS


@pytest.mark.process
def test_a_server_that_is_killed_and_started_again(
    runs: Path, postgresql: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each shipment that it cuts off is one line with exit code 7; one after a month ships all."""
    monkeypatch.setattr(logging.root, "handlers", [])  # as in a process of its own
    rng = random.Random(1)
    for order in (1, 12, 16, rng.randrange(1, 3 * ORDERS)):
        url = postgresql.make(like=BLANK)
        with dying_before(order, Engine, postgresql.kill):
            done = command("plant", "ship", runs, "--to", url)
        assert (done.returncode, done.stderr.count("\n")) == (7, 1), done.stderr
        assert command("plant", "ship", runs, "--to", url).returncode == 7, "it is still away"
        postgresql.start()
        with closing(Database(url)) as database:
            ship(runs, database)
            check(database, runs, Counter({f"r{n}": 1 for n in range(RUNS)}))
        (runs / SHIPPED).unlink()


MOMENTS = ("before_cursor_execute", "commit", "checkin")  # of a connection: the commit is done


class Killed(BaseException):
    """Nothing of the shipper runs any more."""


def _die() -> None:
    raise Killed


@contextmanager
def ended_with_it(engine: Engine) -> Iterator[None]:
    """Close every connection at the end, as that of a process closes them."""
    used: list[sqlite3.Connection] = []
    event.listen(engine, "checkout", lambda connection, *_: used.append(connection))
    yield
    for each in used:
        each.close()


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
