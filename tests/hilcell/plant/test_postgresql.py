"""What only a server has: roles, partitions, rights; and the schema on both stores."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime, timedelta
from itertools import cycle
from math import nextafter
from pathlib import Path
from typing import Any

import msgspec
import psycopg
import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Table, event, make_url, select

from hilcell.commands.cli import main
from hilcell.journal.runs import read_records
from hilcell.plant.database import CELL, ENGINEER, MIGRATIONS, Database
from hilcell.plant.record import GridErrors, LengthEntry, heads, record_of
from hilcell.plant.rows import digest_of
from hilcell.plant.shipper import NAME, ship
from hilcell.plant.store import write
from hilcell.plant.tables import HEAD, PARTS, POINT, RUN, TABLES
from tests.hilcell.plant.conftest import NOW
from tests.hilcell.plant.server import Server
from tests.hilcell.plant.test_export import private
from tests.hilcell.plant.year import Model, Run

DAY = timedelta(days=1)


@contextmanager
def asking(url: str) -> Iterator[psycopg.Connection[tuple[object, ...]]]:
    with psycopg.connect(url, autocommit=True) as connection:
        yield connection


def name_of(database: Database) -> str:
    return str(database.engine.url.database)


@pytest.fixture
def runs(model: Model, tmp_path: Path) -> Path:
    for name, days in (("a", 60), ("b", 20)):
        model.write(tmp_path / "runs", Run(name, "north", "HC-1", NOW - days * DAY))
    return tmp_path / "runs"


def test_the_tables_are_those_of_the_migrations(plant: Database, office: Database) -> None:
    for database in (plant, office):
        with database.transaction() as connection:
            context = MigrationContext.configure(connection, opts={"include_object": _ours})
            assert compare_metadata(context, TABLES) == []
    assert ScriptDirectory(str(MIGRATIONS)).get_heads() == [HEAD]


def _ours(thing: object, name: str, kind: str, reflected: bool, other: object) -> bool:
    return not (kind == "table" and name.startswith("point_"))


@pytest.mark.parametrize("encoding", ["SQL_ASCII", "LATIN1"])
def test_names_stay_whole_in_a_database_of_another_encoding(
    encoding: str, model: Model, tmp_path: Path, postgresql: Server
) -> None:
    name = f"in_{encoding}".lower()
    made = f"CREATE DATABASE {name} ENCODING '{encoding}' LOCALE 'C' TEMPLATE template0"
    with asking(postgresql.url()) as owner:
        owner.execute(made.encode())
    model.write(tmp_path, Run("a", "Köln", "HC-1", NOW))
    with closing(Database(postgresql.url(name))) as database:
        database.make()
        assert ship(tmp_path, database).runs == 1
        with database.transaction() as connection:
            assert connection.execute(select(RUN.c.cell)).scalar() == "Köln"


def test_the_digest_of_what_is_read_back_is_that_of_what_was_written(
    plant: Database, office: Database, model: Model, tmp_path: Path
) -> None:
    """To the last digit of each number, in both stores."""
    records = read_records(model.write(tmp_path, Run("a", "north", "HC-1", NOW)))
    record = record_of("a", records)
    numbers = (0.1 + 0.2, 5e-324, -0.0, 1.7976931348623157e308, 1e22, -123456789.123456789, 1 / 3)
    points = [
        msgspec.structs.replace(
            each,
            point=msgspec.structs.replace(
                each.point, xyz_mm=numbers[:3], std_mm=numbers[3:6], strip_mm=number,
                reflector="K\u00f6ln\u2028\U0001f916 '\\\"",
                joints_deg=numbers, nominal_mm=(0.0, number, -number),
            ),
        )
        for each, number in zip(record.points, cycle(numbers), strict=False)
    ]  # fmt: skip
    lengths = [LengthEntry("1-2", 1000, 1000.0, number) for number in numbers]
    grid = GridErrors([list(numbers[:3])], [list(numbers[3:6])], 20)
    record = msgspec.structs.replace(record, points=points, lengths=lengths, grid=grid)
    for database in (plant, office):
        with database.transaction() as connection:
            assert write(connection, record, heads(records))
        with database.transaction() as connection:
            found: dict[Table, list[dict[str, Any]]] = {
                table: [dict(row) for row in connection.execute(select(table)).mappings()]
                for table in (RUN, *PARTS)
            }
        (run,) = found[RUN]
        assert len(found[POINT]) == len(points) > len(numbers)
        assert digest_of(found) == run["digest"]
        found[POINT][0]["x_mm"] = nextafter(found[POINT][0]["x_mm"], 1)
        assert digest_of(found) != run["digest"]


def test_a_changed_value_on_a_server_is_not_signed(
    plant: Database, runs: Path, postgresql: Server, capsys: pytest.CaptureFixture[str]
) -> None:
    url = postgresql.url(name_of(plant))
    ship(runs, plant)
    exported = ["--key", str(private(runs / "key")), "--from", url, "-o"]
    assert main(["plant", "export", "north", *exported, str(runs / "before")]) == 0
    with asking(url) as owner:
        owner.execute("UPDATE verdict SET mean_mm = 0.001 WHERE key = 'validation.S300'")
    capsys.readouterr()
    assert main(["plant", "export", "north", *exported, str(runs / "after")]) == 2
    assert "2 runs are not as shipped: a, b: " in capsys.readouterr().err
    assert not (runs / "after").exists()


def test_two_that_make_the_tables_at_once_make_them_once(postgresql: Server) -> None:
    url = postgresql.make()
    own = f"FROM pg_stat_activity WHERE datname = '{make_url(url).database}'"
    asked = f"SELECT 1 {own} AND wait_event_type = 'Lock'".encode()
    others: list[subprocess.Popen[str]] = []

    def wait(*words: object) -> None:
        """Begin another, and go on when it waits for a lock."""
        if "CREATE TABLE point" in str(words[2]) and not others:
            others.append(
                subprocess.Popen(
                    [sys.executable, "-m", "hilcell", "plant", "init", "--to", url],
                    stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                )
            )  # fmt: skip
            with asking(postgresql.url()) as owner:
                while owner.execute(asked).fetchone() is None:
                    assert others[0].poll() is None

    with closing(Database(url)) as database:
        event.listen(database.engine, "before_cursor_execute", wait)
        assert database.make() == ""
    (other,) = others
    _, said = other.communicate()
    assert "is up to date, schema" in said
    assert other.returncode == 0


def test_points_lie_in_the_partition_of_the_month_in_which_the_run_began(
    plant: Database, runs: Path, model: Model, postgresql: Server
) -> None:
    model.write(runs, Run("far", "north", "HC-1", datetime(2199, 5, 1, tzinfo=UTC)))
    ship(runs, plant)
    with asking(postgresql.url(name_of(plant))) as connection:
        found = connection.execute(
            "SELECT tableoid::regclass::text, count(DISTINCT digest) FROM point GROUP BY 1"
        ).fetchall()
    assert sorted(found) == [("point_2026_09", 1), ("point_2026_10", 1), ("point_other", 1)]


def test_cells_may_insert_only_and_engineers_may_read_only(
    plant: Database, runs: Path, postgresql: Server, capsys: pytest.CaptureFixture[str]
) -> None:
    name = name_of(plant)
    users = {"cell_user": CELL, "engineer_user": ENGINEER}
    with asking(postgresql.url(name)) as owner:
        for user, role in users.items():
            owner.execute(f"CREATE ROLE {user} LOGIN IN ROLE {role}".encode())
    with closing(Database(postgresql.url(name, "cell_user"))) as cell:
        assert ship(runs, cell).runs == 2
        (runs / NAME).unlink()
        assert ship(runs, cell).before == 2
    asked = {
        "cell_user": [
            "SELECT * FROM point", "SELECT * FROM document",
            "SELECT name FROM run", "UPDATE run SET name = 'x'",
            "DELETE FROM run", "DELETE FROM point", "SELECT * FROM verdict", "DROP TABLE run",
            "DELETE FROM alembic_version", "TRUNCATE point", "SELECT * FROM point_2026_09",
        ],
        "engineer_user": [
            "INSERT INTO alarm SELECT * FROM alarm", "UPDATE run SET name = 'x'",
            "DELETE FROM run", "SELECT plant_month('2026-01-01')", "DROP TABLE point",
        ],
    }  # fmt: skip
    for user, orders in asked.items():
        with asking(postgresql.url(name, user)) as connection:
            for order in orders:
                with pytest.raises(psycopg.errors.InsufficientPrivilege):
                    connection.execute(order.encode())
    (runs / NAME).unlink()
    assert main(["plant", "ship", str(runs), "--to", postgresql.url(name, "engineer_user")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "permission denied" in line
    assert "a user ships in the role hilcell_cell" in line
    private(runs / "key")
    exported = ["-o", str(runs / "out"), "--key", str(runs / "key")]
    engineer_s = ["--from", postgresql.url(name, "engineer_user")]
    assert main(["plant", "export", "north", *exported, *engineer_s]) == 0
    with asking(postgresql.url(name, "engineer_user")) as engineer:
        assert engineer.execute("SELECT count(DISTINCT digest) FROM point").fetchone() == (2,)


def test_a_right_that_is_missing_is_one_line(
    plant: Database, runs: Path, postgresql: Server,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    name = name_of(plant)
    with asking(postgresql.url(name)) as owner:
        owner.execute("CREATE ROLE nobody_s LOGIN")
    assert main(["plant", "ship", str(runs), "--to", postgresql.url(name, "nobody_s")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "permission denied for table alembic_version; a user ships in the role hilcell_" in line
    assert main(["plant", "init", "--to", postgresql.url(name, "nobody_s")]) == 2
    said = capsys.readouterr().err
    assert "the owner of the database makes both by `hilcell plant init`" in said


def test_a_database_that_is_not_there_is_one_line(
    postgresql: Server, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plant", "ship", str(runs), "--to", postgresql.url("nowhere")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert 'login refused: database "nowhere" does not exist' in line
