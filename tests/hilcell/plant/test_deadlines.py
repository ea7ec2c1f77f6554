"""A server, another cell or a lock that does not let go costs one command its time, and nothing.

A deadline is shortened only where what it ends can never come.
"""

from __future__ import annotations

import json
import re
import sqlite3
from contextlib import ExitStack, closing
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import psycopg
import pytest
from psycopg.pq import PGconn
from sqlalchemy import event, text

from hilcell.plant import database as plants
from hilcell.plant import deadlines, shipper
from hilcell.plant.database import Database, Locked, PlantUnavailable
from hilcell.plant.rights import CELL
from hilcell.plant.shipper import Shipped, ship
from hilcell.plant.tables import HEAD, TABLES
from tests.hilcell.plant.conftest import NOW, refused
from tests.hilcell.plant.logins import Plant
from tests.hilcell.plant.server import BLANK, Server
from tests.hilcell.plant.year import Model, Run
from tests.whole.bench import command, sweep

SHORT_S = 0.1
LEAST_S = 2  # that libpq waits for a server
STILL = "the server is frozen"


class Freezer:
    """Freezes a server before the nth moment of a kind, or before an order; then it is awaited."""

    def __init__(
        self, server: Server, database: Database, moment: str, nth: int, order: str = ""
    ) -> None:
        self._server, self._left, self._order = server, nth, order
        self._stack = ExitStack()
        event.listen(database.engine, moment, self._count)
        self._stack.callback(event.remove, database.engine, moment, self._count)

    def _count(self, *words: object) -> None:
        self._left -= not self._order or self._order in str(words[2]).replace("\n", "")
        if self._left == 0:
            self._left = -1
            patch = self._stack.enter_context(pytest.MonkeyPatch.context())
            for name, limit_s in (
                ("ORDER_S", SHORT_S),
                ("SLACK_S", SHORT_S),
                ("ANSWER_S", LEAST_S),
            ):
                patch.setattr(deadlines, name, limit_s)
            self._stack.enter_context(self._server.frozen())

    def thaw(self) -> None:
        self._stack.close()


class Unheard(deadlines.Bounded):
    """A connection whose server says nothing on any socket."""

    def __init__(self) -> None:
        self.pgconn = PGconn()

    def _answers(self) -> bool:
        return False


def test_a_server_is_silent_once_its_own_word_is_overdue(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look at the clock finds it one second on."""

    def never_ready(self: object, gen: deadlines.Waiting) -> None:
        next(gen)
        while True:
            gen.send(0)

    def asked() -> deadlines.Waiting:
        while True:
            yield 0

    monkeypatch.setattr(psycopg.Connection, "wait", never_ready)
    monkeypatch.setattr(deadlines, "time", SimpleNamespace(monotonic=count().__next__))
    with pytest.raises(deadlines.Silent, match=STILL) as silent:
        Unheard().wait(asked())
    (silent_s,) = map(float, re.findall(r"no answer for ([\d.]+) s", str(silent.value)))
    overdue_s = deadlines.ORDER_S + deadlines.SLACK_S
    assert overdue_s <= silent_s <= overdue_s + 2.0


@pytest.mark.process
@pytest.mark.parametrize(("moment", "nth"), [("commit", 3), *sweep(("before_cursor_execute", 15))])
def test_a_server_that_freezes_loses_and_doubles_nothing(
    postgresql: Server, runs: Path, moment: str, nth: int
) -> None:
    """Nobody knows whether a commit was done that had no answer: the next shipment asks."""
    with closing(Database(postgresql.make(like=BLANK))) as database:
        freezer = Freezer(postgresql, database, moment, nth)
        with pytest.raises(PlantUnavailable, match=STILL) as away:
            ship(runs, database)
        (silent_s,) = map(float, re.findall(r"no answer for ([\d.]+) s", str(away.value)))
        assert silent_s >= 2 * SHORT_S
        freezer.thaw()
        done = ship(runs, database)
        assert done.runs + done.before == 2
        assert ship(runs, database) == Shipped(before=2)


@pytest.mark.nightly
@pytest.mark.wall
def test_a_server_that_freezes_in_a_migration_is_named(
    postgresql: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An order of a migration may take hours; the server must answer others meanwhile."""
    with closing(Database(postgresql.make())) as database:
        freezer = Freezer(postgresql, database, "before_cursor_execute", 1, "CREATE TABLE point")
        with pytest.raises(PlantUnavailable, match=STILL):
            database.create()
        freezer.thaw()
        assert database.create() == ""
        with monkeypatch.context() as patch, database.transaction(migrating=True) as connection:
            for name in ("ORDER_S", "SLACK_S"):
                patch.setattr(deadlines, name, SHORT_S)
            connection.execute(text("SELECT pg_sleep(0.5)"))
    monkeypatch.setitem(deadlines.OPTIONS, "connect_timeout", LEAST_S)
    with (
        closing(Database(postgresql.url())) as database,
        postgresql.frozen(),
        pytest.raises(PlantUnavailable),
    ):
        database.check()


@pytest.mark.process
def test_locks_long_orders_and_frozen_cells_are_ended_by_the_server(
    plant: Database, runs: Path, postgresql: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = postgresql.url(str(plant.engine.url.database))
    with monkeypatch.context() as patch, psycopg.connect(url) as other:
        patch.setattr(deadlines, "LOCK_S", SHORT_S)
        other.execute("LOCK TABLE run")
        said = refused("ship", runs, "--to", url, code=7)
        assert "lock timeout" in said
        assert f"owner (process {other.info.backend_pid})" in said
    with monkeypatch.context() as patch:
        patch.setattr(deadlines, "ORDER_S", SHORT_S)
        with (
            pytest.raises(PlantUnavailable, match="statement timeout"),
            plant.transaction() as connection,
        ):
            connection.execute(text("SELECT pg_sleep(60)"))
        with plant.transaction(migrating=True) as connection:
            connection.execute(text("SELECT pg_sleep(0.2)"))

    def frozen(other: Database) -> None:
        monkeypatch.setattr(deadlines, "REST_S", SHORT_S)
        with other.transaction() as connection:
            monkeypatch.undo()
            connection.execute(text("LOCK TABLE run"))
            assert ship(runs, plant).runs == 2  # waits until the server has freed the lock
            connection.execute(text("SELECT 1"))

    with (
        closing(Database(url)) as cell,
        pytest.raises(PlantUnavailable, match="idle-in-transaction"),
    ):
        frozen(cell)


def blocked(order: str, database: Database, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return what is said of an order that waits for a lock."""
    with monkeypatch.context() as patch:
        patch.setattr(deadlines, "LOCK_S", SHORT_S)
        with pytest.raises(Locked) as said, database.transaction() as connection:
            connection.execute(text(order))
    return str(said.value)


@pytest.mark.process
def test_a_lock_is_of_those_who_have_it(
    plant: Database, postgresql: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader blocks whom it can; a session of a copy, whose tables have the same numbers, none;
    a login that was dropped meanwhile has no name.
    """
    url, like = postgresql.url(str(plant.engine.url.database)), postgresql.make(like=BLANK)
    insert, alter = "INSERT INTO point SELECT * FROM point", "ALTER TABLE point ADD x integer"
    with (
        psycopg.connect(url) as reader, psycopg.connect(url) as owner, psycopg.connect(like) as far
    ):  # fmt: skip
        named = {each: f"(process {each.info.backend_pid})" for each in (reader, owner, far)}

        def who(order: str) -> set[psycopg.Connection]:
            said = blocked(order, plant, monkeypatch)
            assert bool("not known" in said) is not any(each in said for each in named.values())
            return {each for each, name in named.items() if name in said}

        far.execute("LOCK TABLE point, run, claim")
        reader.execute("SELECT * FROM point")
        assert who(alter) == {reader}
        owner.execute("LOCK TABLE point IN SHARE MODE")
        assert who(insert) == {owner}
        owner.rollback()
        reader.rollback()
        owner.execute("SELECT pg_advisory_xact_lock(7)")
        assert who("SELECT pg_advisory_xact_lock(7)") == {owner}
    with psycopg.connect(url, autocommit=True) as owner:
        owner.execute("CREATE ROLE gone SUPERUSER LOGIN")
        owner.execute(f"CREATE ROLE waits LOGIN IN ROLE {CELL}".encode())
        other = url.replace("owner@", "gone@")
        with (
            psycopg.connect(other) as gone,
            closing(Database(url.replace("owner", "waits"))) as waits,
        ):
            gone.execute("SELECT 1")
            gone.execute("LOCK TABLE claim")
            owner.execute("DROP ROLE gone")
            name = f"(process {gone.info.backend_pid})"
            assert f"client backend {name}" in blocked("SELECT * FROM claim", plant, monkeypatch)
            said = blocked("SELECT * FROM claim", waits, monkeypatch)
            assert f"a process of the server {name}" in said
        owner.execute("DROP ROLE waits")


@pytest.mark.process
def test_what_exists_is_made_again_without_a_lock(
    plant: Database, postgresql: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside one that reads and one that writes; what is missing is made."""
    url = postgresql.url(str(plant.engine.url.database))
    rules = "SELECT polrelid::regclass::text, polname, relrowsecurity FROM pg_policy JOIN pg_class "
    rules += "ON pg_class.oid = polrelid ORDER BY 1, 2"
    with psycopg.connect(url, autocommit=True) as owner:
        before = owner.execute(rules.encode()).fetchall()
        assert len(before) > len(TABLES.tables)
        owner.execute(f"DROP POLICY {CELL}_inserts ON point".encode())
        owner.execute("ALTER TABLE claim DISABLE ROW LEVEL SECURITY")
        assert plant.create() == HEAD
        assert owner.execute(rules.encode()).fetchall() == before
    monkeypatch.setattr(deadlines, "LOCK_S", SHORT_S)
    with psycopg.connect(url) as other:
        for table in TABLES.tables:
            other.execute(f"SELECT FROM {table}".encode())
        other.execute("LOCK TABLE point, run, claim IN ROW EXCLUSIVE MODE")
        assert plant.create() == HEAD


@pytest.mark.process
def test_a_cell_that_another_holds_keeps_no_other_waiting(
    both: Plant, model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, cell in (("x1", "east"), ("x2", "east"), ("y", "south")):
        model.write(tmp_path / "year", Run(name, cell, f"HC-{cell}", NOW))
    with both.connect("north") as holder, holder.transaction():
        holder.execute("INSERT INTO claim (cell, serial) VALUES ('east', 'HC-east')")
        monkeypatch.setattr(deadlines, "LOCK_S", SHORT_S)
        done = command("plant", "ship", tmp_path / "year", "--to", both.url("south"), "--json")
        assert done.returncode == 7
        said = json.loads(done.stdout)
        assert (said["shipped"], set(said["refused"])) == (1, {"x1", "x2"})
        assert both.logins["north"] in said["refused"]["x1"]
        assert "x1" in said["refused"]["x2"]


def test_an_error_of_the_database_blames_no_journal(
    office: Database, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failed(*_: object) -> None:
        raise TypeError("a fault of the database's own")

    monkeypatch.setattr(shipper, "write", failed)
    with pytest.raises(TypeError, match="own"):
        ship(runs, office)


def test_a_value_that_no_column_takes_keeps_no_other_run(office: Database, runs: Path) -> None:
    (runs / "a").rename(runs / "a\udcff")
    done = ship(runs, office)
    assert (done.runs, list(done.refused)) == (1, ["a\udcff"])


def test_an_office_s_file_that_another_writes_is_one_line(
    office: Database, runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plants, "LOCK_S", SHORT_S)
    url = f"sqlite:///{tmp_path}/plant.db"
    with closing(sqlite3.connect(tmp_path / "plant.db")) as other:
        other.execute("BEGIN EXCLUSIVE")
        said = refused("ship", runs, "--to", url, code=7)
        assert "locked" in said
        assert "another process" in said
        assert "disk" not in said
    monkeypatch.undo()
    assert ship(runs, office).runs == 2
