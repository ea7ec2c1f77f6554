"""Shipper and server are killed at many moments: nothing is lost, nothing is doubled."""

from __future__ import annotations

import logging
import multiprocessing
import random
from collections import Counter
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest
from sqlalchemy import Engine, event, func, select

from hilcell.commands.cli import main
from hilcell.journal.runs import read_records
from hilcell.plant.database import Database, PlantAway
from hilcell.plant.record import record_of
from hilcell.plant.rows import rows_of
from hilcell.plant.shipper import NAME, Shipped, ship
from hilcell.plant.tables import PARTS, POINT, RUN
from tests.hilcell.plant.conftest import NOW
from tests.hilcell.plant.server import BLANK, Server
from tests.hilcell.plant.shipping import MOMENTS, ship_and_die
from tests.hilcell.plant.year import Model, Run, extend
from tests.whole.bench import sweep

RUNS = 6
ORDERS = 12  # to the database, for one run
SLOWEST_S = 0.4
MOST = 5  # kills in a row: the next shipment is let be
PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["tests.hilcell.plant.shipping"])


@pytest.fixture
def runs(model: Model, tmp_path: Path) -> Path:
    """Return runs of a cell, one of them opened again after it was shipped."""
    for n in range(RUNS):
        began = NOW - timedelta(days=20 * (RUNS - n))
        model.write(tmp_path / "runs", Run(f"r{n}", "north", "HC-1", began))
    return tmp_path / "runs"


def open_again(runs: Path, number: int) -> None:
    event = {"what": "calibration revoked", "reason": f"bumped {number}", "operator": "Ann"}
    extend(runs / f"r{number}", [(NOW, "event", "", event)])


def check(database: Database, runs: Path, revisions: Counter[str]) -> None:
    """Check that each run's newest record stands there once with all its parts."""
    assert ship(runs, database) == Shipped(before=RUNS)
    with database.transaction() as connection:
        names = [row.name for row in connection.execute(select(RUN.c.name))]
        assert Counter(names) == revisions
        for folder in runs.glob("r*"):
            record = record_of(folder.name, read_records(folder))
            (run,) = rows_of(record)[RUN]
            counts = {
                table.name: connection.execute(
                    select(func.count()).select_from(table).where(table.c.digest == run["digest"])
                ).scalar_one()
                for table in PARTS
            }
            assert counts["point"] == len(record.points)
            assert counts["verdict"] == len(record.verdicts)
            assert counts["frame"] == len(record.frames)
            assert counts["device"] == len(record.devices)
        # Nothing of a shipment that was cut off is left.
        for table in PARTS:
            orphans = (
                select(func.count())
                .select_from(table)
                .where(table.c.digest.not_in(select(RUN.c.digest)))
            )
            assert connection.execute(orphans).scalar_one() == 0


@pytest.mark.parametrize(("seed", "kills"), [(1, 10), *sweep((2, 220))])
def test_a_shipper_that_is_killed(seed: int, kills: int, runs: Path, postgresql: Server) -> None:
    rng = random.Random(seed)
    killed = 0
    while killed < kills:
        url = postgresql.make(like=BLANK)
        with closing(Database(url)) as database:
            revisions = Counter({f"r{n}": 1 for n in range(RUNS)})
            killed += _until_shipped(rng, runs, url, MOST)
            ship(runs, database)
            again = rng.randrange(RUNS)
            open_again(runs, again)
            revisions[f"r{again}"] += 1
            killed += _until_shipped(rng, runs, url, MOST)
            ship(runs, database)
            check(database, runs, revisions)


def _until_shipped(rng: random.Random, runs: Path, url: str, most: int) -> int:
    """Ship in processes that are killed until one comes to its end; return how many."""
    killed = 0
    while killed < most:
        order, seconds = rng.randrange(1, RUNS * ORDERS), 60.0
        if rng.random() < 0.5:
            order, seconds = 0, rng.uniform(0.001, SLOWEST_S)
        process = PROCESSES.Process(target=ship_and_die, args=(str(runs), url, order, seconds))
        process.start()
        process.join()
        assert process.exitcode in (0, -9, -14)
        if process.exitcode == 0:
            return killed
        killed += 1
    return killed


@pytest.mark.parametrize(("seed", "kills"), [(1, 4), *sweep((2, 80))])
def test_a_server_that_is_killed_and_started_again(
    seed: int, kills: int, runs: Path, mortal: Server
) -> None:
    rng = random.Random(seed)
    killed = 0
    while killed < kills:
        url = mortal.make()
        with closing(Database(url)) as database:
            database.make()
            killed += _with_a_kill(rng.randrange(1, 3 * ORDERS), runs, database, mortal)
            killed += _with_a_kill(rng.randrange(1, 3 * ORDERS), runs, database, mortal)
            ship(runs, database)
            check(database, runs, Counter({f"r{n}": 1 for n in range(RUNS)}))


def _with_a_kill(order: int, runs: Path, database: Database, server: Server) -> int:
    """Ship, and kill the server before an order to it; return whether it came to that."""
    left = [order]

    def count(*_: object) -> None:
        left[0] -= 1
        if not left[0]:
            server.kill()

    for name in MOMENTS:
        event.listen(database.engine, name, count)
    try:
        ship(runs, database)
    except PlantAway:
        server.start()
        return 1
    finally:
        for name in MOMENTS:
            event.remove(database.engine, name, count)
    return 0


def test_a_shipper_that_is_killed_before_each_order_of_a_run(
    model: Model, tmp_path: Path, postgresql: Server
) -> None:
    """Also after the commit, before the shipper has noted it."""
    folder = model.write(tmp_path / "runs", Run("r0", "north", "HC-1", NOW))
    points = len(record_of("r0", read_records(folder)).points)
    url = postgresql.make(like=BLANK)
    with closing(Database(url)) as database:
        order, ended = 1, False
        while not ended:
            (tmp_path / "runs" / NAME).unlink(missing_ok=True)
            arguments = (str(tmp_path / "runs"), url, order, 60.0)
            process = PROCESSES.Process(target=ship_and_die, args=arguments)
            process.start()
            process.join()
            ended, order = process.exitcode == 0, order + 1
            with database.transaction() as connection:
                runs = connection.execute(select(func.count()).select_from(RUN)).scalar_one()
                found = connection.execute(select(func.count()).select_from(POINT)).scalar_one()
            assert (runs, found) in [(0, 0), (1, points)]
            if runs:  # a shipment that finds it there says so
                done = ship(tmp_path / "runs", database)
                assert (done.before, done.refused) == (1, {})
        assert order > ORDERS
        assert (runs, found) == (1, points)


@pytest.mark.parametrize("order", [12, 16])
def test_a_server_that_dies_meanwhile_is_one_line(
    order: int, runs: Path, mortal: Server, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(logging.root, "handlers", [])  # as in a process of its own
    url = mortal.make()
    with closing(Database(url)) as database:
        database.make()
    left = [order]

    def count(*_: object) -> None:
        left[0] -= 1
        if not left[0]:
            mortal.kill()

    event.listen(Engine, "before_cursor_execute", count)
    try:
        code = main(["plant", "ship", str(runs), "--to", url])
    finally:
        event.remove(Engine, "before_cursor_execute", count)
        mortal.start()
    assert code == 7
    (line,) = capsys.readouterr().err.splitlines()
    assert "it cannot be used now" in line
    assert main(["plant", "ship", str(runs), "--to", url]) == 0
