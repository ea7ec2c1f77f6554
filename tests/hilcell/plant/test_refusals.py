"""Each refusal is one line, nothing is half-written, and no password is anywhere."""

from __future__ import annotations

import importlib.util
import socket
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import event, text

from hilcell.journal.runs import JOURNAL
from hilcell.plant.database import Database, PlantUnavailable
from hilcell.plant.tables import HEAD
from tests.hilcell.plant.conftest import refused
from tests.whole.bench import command

SECRET = "s3cr-t%2Fp"  # as it stands in a URL
PLAIN = "s3cr-t/p"
ACTS = ["init", "ship", "show"]


def said(*words: str | Path, code: int = 2) -> str:
    """Return the one line that a command of the plant says on stderr, without the password."""
    line = refused(*words, code=code)
    assert SECRET not in line
    assert PLAIN not in line
    return line


def asked(act: str, runs: Path, url: str) -> list[str]:
    folder = [str(runs)] if act == "ship" else []
    return [act, *folder, "--from" if act == "show" else "--to", url]


def filed(tmp_path: Path, *orders: str, name: str = "plant.db") -> tuple[Path, str]:
    """Make a database of other orders than ours; return its file and its URL."""
    file = tmp_path / name
    with closing(sqlite3.connect(file)) as base, base:
        for order in orders:
            base.execute(order)
    return file, f"sqlite:///{file}"


def nowhere() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def test_a_server_that_is_away_costs_nothing(runs: Path, tmp_path: Path) -> None:
    url = f"postgresql://ann:{SECRET}@127.0.0.1:{nowhere()}/plant"
    for act in ACTS:
        line = said(*asked(act, runs, url), code=7)
        assert "postgresql://ann:***@127.0.0.1" in line
    kept = [path.read_bytes() for path in runs.rglob("*") if path.is_file()]
    assert not any(word.encode() in content for content in kept for word in (SECRET, PLAIN))
    office = f"sqlite:///{tmp_path}/plant.db"
    assert HEAD in said("init", "--to", office, code=0)
    assert HEAD in said("init", "--to", office, code=0), "it may be repeated"
    assert said("ship", runs, "--to", office, code=0).startswith("2 ")


@pytest.mark.parametrize(
    "url",
    [
        f"postgresql//ann:{SECRET}@host/plant",
        f"postgresql://ann:{SECRET}@host:port/plant",
        f"oracle://ann:{SECRET}@host/plant",
        f"postgresql://ann:{SECRET}%00@host/plant",
        f"postgresql://ann:{SECRET}\udcff@host/plant",
        "sqlite:///\udcff.db",
        "sqlite:///:memory:",
        "",
    ],
)
def test_a_wrong_url_is_refused_without_its_password(url: str, runs: Path) -> None:
    assert "sqlite:///FILE" in said("ship", runs, "--to", url)


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("postgresql://ann@host/plant?autocommit=1", "autocommit"),
        ("postgresql://ann@host/plant?sslmode=require&row_factory=x", "row_factory"),
        ("sqlite:///plant.db?isolation_level=IMMEDIATE", "isolation_level"),
    ],
)
def test_an_option_that_would_undo_the_transactions_is_refused(
    url: str, name: str, runs: Path
) -> None:
    assert name in said("ship", runs, "--to", url)


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("ship --to postgresql://ann:begin@endend@host/plant", "%40"),
        ("ship --to postgresql://ann@127.0.0.1:1/plant?Password=endend", "Password"),
        ("init postgresql://ann:begin@endend@host/plant", "postgresql://ann:***@host"),
        ("postgresql://ann:endend@host/plant", "postgresql://ann:***@host/plant"),
    ],
)
def test_a_password_at_a_wrong_place_is_not_shown(words: str, shown: str) -> None:
    done = command("plant", *words.split())
    assert done.returncode == 2
    assert shown in done.stderr
    assert "endend" not in done.stderr


@pytest.mark.parametrize("name", ["plant.sqlite", "index.sqlite"])
def test_a_database_has_no_name_of_a_file_that_may_be_deleted(name: str, runs: Path) -> None:
    assert name in said("init", "--to", f"sqlite:///{runs}/{name}")
    assert not (runs / name).exists()


@pytest.mark.parametrize(
    "place",
    [
        "ann@h..example/plant",
        "ann@127.0.0.1:70000/plant",
        "ann@127.0.0.1:1/plant?sslmode=verify",
        f"ann:{SECRET}@/plant?host=/{'h' * 200}",
    ],
)
def test_a_url_that_no_server_is_asked_with_is_refused(place: str) -> None:
    said("show", "--from", f"postgresql://{place}")


def test_an_office_s_tables_are_made_whole_or_not_at_all(tmp_path: Path) -> None:
    def full(*words: object) -> None:
        if "CREATE TABLE point" in str(words[2]).replace("\n", ""):
            raise sqlite3.OperationalError("database or disk is full")

    with closing(Database(f"sqlite:///{tmp_path}/plant.db")) as database:
        event.listen(database.engine, "before_cursor_execute", full)
        with pytest.raises(PlantUnavailable):
            database.create()
        with closing(sqlite3.connect(tmp_path / "plant.db")) as base:
            assert base.execute("SELECT name FROM sqlite_master").fetchall() == []
        event.remove(database.engine, "before_cursor_execute", full)
        database.create()
        database.check()


@pytest.mark.parametrize(
    "order",
    [
        "CREATE TABLE run (x int)",
        "CREATE TABLE frame AS SELECT 1 digest, 2 key, 3 matrix, 4 covariance",
        "CREATE TABLE customers (name TEXT)",
        "CREATE TABLE alembic_version AS SELECT 'ae1027a6acf' AS version_num",
        f"CREATE TABLE alembic_version AS SELECT '{HEAD}' AS version_num",
    ],
)
def test_a_database_of_another_program_is_left_alone(
    order: str, runs: Path, tmp_path: Path
) -> None:
    file, url = filed(tmp_path, order)
    before = file.read_bytes()
    for act in ACTS:
        said(*asked(act, runs, url))
    assert file.read_bytes() == before


def test_no_table_is_written_into_a_journal_or_a_text(runs: Path, tmp_path: Path) -> None:
    document = tmp_path / "text.db"
    document.write_text("no database, but long enough to be one" * 100)
    for file in (runs / "a" / JOURNAL, document):
        before = file.read_bytes()
        said("init", "--to", f"sqlite:///{file}")
        assert file.read_bytes() == before


@pytest.mark.parametrize("act", ACTS)
def test_a_newer_schema_asks_for_a_newer_hilcell(
    act: str, office: Database, runs: Path, tmp_path: Path
) -> None:
    _, url = filed(tmp_path, "UPDATE alembic_version SET version_num = '0999'")
    line = said(*asked(act, runs, url))
    assert "0999" in line
    assert HEAD in line


def test_a_folder_that_is_none_of_runs_is_refused(
    office: Database, runs: Path, tmp_path: Path
) -> None:
    to = ("--to", office.name)
    for folder in (runs / "a", tmp_path / "rusn"):
        assert str(folder) in said("ship", folder, *to)
    (tmp_path / "none").mkdir()
    assert str(tmp_path / "none") in command("plant", "ship", tmp_path / "none", *to).stderr
    (tmp_path / "file").touch()
    assert command("plant", "ship", tmp_path / "file", *to).returncode == 2
    assert command("runs", "--runs", tmp_path / "file").returncode == 2


@pytest.mark.parametrize("act", ACTS)
def test_a_place_at_which_no_file_can_be_is_refused(act: str, runs: Path) -> None:
    for place in (runs, runs / "no" / "plant.db"):
        said(*asked(act, runs, f"sqlite:///{place}"))
    if act != "init":
        said(*asked(act, runs, f"sqlite:///{runs}/no.db"))
        assert not (runs / "no.db").exists()


def test_a_damaged_database_is_no_server_that_is_away(office: Database, tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/plant.db"
    with office.transaction() as connection:
        connection.execute(text("DROP TABLE verdict"))
    assert "verdict" in said("show", "--from", url)
    file = tmp_path / "plant.db"
    file.write_bytes(file.read_bytes()[:5000])
    said("show", "--from", url)


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for name in ("shipper", "database"):
        monkeypatch.setitem(sys.modules, f"hilcell.plant.{name}", None)  # cannot be imported
    for words in (("init", "--to"), ("ship", "runs", "--to"), ("show", "--from")):
        line = said(*words, "sqlite:///x.db")
        assert line.startswith("hilcell: plant: not installed: sqlalchemy, alembic, psycopg; ")
        assert "'.[plant]'" in line


def test_the_environment_names_the_database(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HILCELL_PLANT", f"sqlite:///{tmp_path}/plant.db")
    for words in (("init",), ("ship", runs), ("show",)):
        assert command("plant", *words).returncode == 0
