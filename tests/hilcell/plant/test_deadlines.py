"""A server, another cell or a lock that does not let go costs one command its time, and nothing."""

from __future__ import annotations

import sqlite3
from contextlib import ExitStack, closing
from datetime import timedelta
from pathlib import Path

import psycopg
import pytest
from sqlalchemy import event, text

from hilcell.commands.cli import main
from hilcell.plant import database as plants
from hilcell.plant import deadlines
from hilcell.plant.database import Database, PlantAway
from hilcell.plant.shipper import Shipped, ship
from tests.hilcell.plant.conftest import NOW
from tests.hilcell.plant.server import BLANK, Server
from tests.hilcell.plant.year import Model, Run

SHORT_S = 0.1


@pytest.fixture
def runs(model: Model, tmp_path: Path) -> Path:
    for days, name in enumerate("ab"):
        model.write(tmp_path / "runs", Run(name, "north", "HC-1", NOW - timedelta(days)))
    return tmp_path / "runs"


@pytest.fixture(scope="module")
def empty(mortal: Server) -> str:
    """Return the name of a database with its tables, on the server that these tests freeze."""
    with closing(Database(mortal.make(BLANK))) as database:
        database.make()
    return BLANK


def short(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    for name in names:
        monkeypatch.setattr(deadlines, name, SHORT_S)


@pytest.mark.parametrize(
    ("moment", "nth"),
    [("before_cursor_execute", 1), ("before_cursor_execute", 15), ("commit", 3)],
)
def test_a_server_that_freezes_in_mid_transaction_loses_and_doubles_nothing(
    moment: str, nth: int, empty: str, mortal: Server, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody knows whether a commit was done that had no answer: the next shipment asks."""
    short(monkeypatch, "ORDER_S", "SLACK_S")
    with closing(Database(mortal.make(like=empty))) as database, ExitStack() as stack:
        left = [nth]

        def freeze(*_: object) -> None:
            left[0] -= 1
            if left[0] == 0:
                stack.enter_context(mortal.frozen())

        event.listen(database.engine, moment, freeze)
        with pytest.raises(PlantAway, match=r"no answer for 0\.[2-9] s: the server stands still"):
            ship(runs, database)
        stack.close()
        monkeypatch.undo()
        done = ship(runs, database)
        assert done.runs + done.before == 2
        assert ship(runs, database) == Shipped(before=2)


def test_a_server_that_freezes_while_tables_are_made_is_not_waited_for_as_one_at_work(
    mortal: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An order of a migration may take hours; the server must answer others meanwhile."""
    short(monkeypatch, "ORDER_S", "SLACK_S")
    monkeypatch.setattr(deadlines, "ANSWER_S", 2)  # libpq's least
    with closing(Database(mortal.make())) as database, ExitStack() as stack:

        def freeze(*words: object) -> None:
            if "CREATE TABLE point" in str(words[2]).replace("\n", ""):
                stack.enter_context(mortal.frozen())

        event.listen(database.engine, "before_cursor_execute", freeze)
        with pytest.raises(PlantAway, match=r"no answer for \d\.\d s: the server stands still"):
            database.make()
        stack.close()
        event.remove(database.engine, "before_cursor_execute", freeze)
        assert database.make() == ""
        with database.transaction(migrating=True) as connection:
            connection.execute(text("SELECT pg_sleep(0.5)"))


def test_a_server_that_stands_still_takes_no_connection(
    mortal: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(deadlines.OPTIONS, "connect_timeout", 2)  # libpq's least
    with (
        closing(Database(mortal.url())) as database,
        mortal.frozen(),
        pytest.raises(PlantAway, match="connection timeout expired"),
    ):
        database.check()


def test_a_lock_that_is_not_let_go_is_one_line(
    plant: Database, runs: Path, postgresql: Server, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    short(monkeypatch, "LOCK_S")
    url = postgresql.url(str(plant.engine.url.database))
    with psycopg.connect(url) as other:
        other.execute("LOCK TABLE run")
        assert main(["plant", "ship", str(runs), "--to", url]) == 7
    (line,) = capsys.readouterr().err.splitlines()
    assert "canceling statement due to lock timeout; nothing is lost" in line
    assert ship(runs, plant).runs == 2


def test_an_order_that_takes_too_long_is_ended_by_the_server(
    plant: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    short(monkeypatch, "ORDER_S")
    with (
        pytest.raises(PlantAway, match="canceling statement due to statement timeout"),
        plant.transaction() as connection,
    ):
        connection.execute(text("SELECT pg_sleep(60)"))
    with plant.transaction(migrating=True) as connection:
        connection.execute(text("SELECT pg_sleep(0.2)"))


def test_a_cell_that_freezes_in_mid_transaction_keeps_no_other_from_shipping(
    plant: Database, runs: Path, postgresql: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(deadlines, "REST_S", SHORT_S)
    with closing(Database(postgresql.url(str(plant.engine.url.database)))) as other:

        def frozen() -> None:
            with other.transaction() as connection:
                connection.execute(text("LOCK TABLE run"))
                assert ship(runs, plant).runs == 2
                connection.execute(text("SELECT 1"))

        with pytest.raises(PlantAway, match="idle-in-transaction timeout"):
            frozen()


def test_an_office_s_file_that_another_writes_is_one_line(
    office: Database, runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(plants, "BUSY_S", SHORT_S)
    url = f"sqlite:///{tmp_path}/plant.db"
    with closing(sqlite3.connect(tmp_path / "plant.db")) as other:
        other.execute("BEGIN EXCLUSIVE")
        assert main(["plant", "ship", str(runs), "--to", url]) == 7
    (line,) = capsys.readouterr().err.splitlines()
    assert "database is locked; nothing is lost" in line
    assert ship(runs, office).runs == 2
