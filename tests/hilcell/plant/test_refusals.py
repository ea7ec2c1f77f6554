"""One clear message each, nothing half-written, and no password anywhere."""

from __future__ import annotations

import importlib.util
import socket
import sqlite3
from contextlib import closing
from pathlib import Path

import psycopg
import pytest
from alembic import command
from alembic.config import Config
from sqlalchemy import event, make_url, select, text

from hilcell.commands.cli import main
from hilcell.journal.runs import JOURNAL
from hilcell.plant.database import MIGRATIONS, Database, PlantAway
from hilcell.plant.tables import POINT
from tests.hilcell.plant.conftest import NOW
from tests.hilcell.plant.server import Server
from tests.hilcell.plant.year import Model, Run
from tests.whole.bench import hilcell

SECRET = "s3cr-t%2Fp"  # as it stands in a URL
PLAIN = "s3cr-t/p"


@pytest.fixture
def runs(model: Model, tmp_path: Path) -> Path:
    model.write(tmp_path / "runs", Run("a", "north", "HC-1", NOW))
    return tmp_path / "runs"


def said(words: list[str], code: int, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line that a command said on stderr."""
    assert main(words) == code
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    return str(line)


def nowhere() -> int:
    """Return a port at which nobody listens."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def test_a_server_that_is_away_is_one_line_and_costs_nothing(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"postgresql://ann:{SECRET}@127.0.0.1:{nowhere()}/plant"
    for words in (["init", "--to", url], ["ship", str(runs), "--to", url], ["show", "--from", url]):
        line = said(["plant", *words], 7, capsys)
        assert "cannot be used now" in line
        assert "refused" in line
        assert "nothing is lost" in line
        assert "check the server and the network" in line
        assert "plant database postgresql://ann:***@127.0.0.1" in line
        assert SECRET not in line
        assert PLAIN not in line
    kept = [path.read_bytes() for path in runs.rglob("*") if path.is_file()]
    assert not any(word.encode() in content for content in kept for word in (SECRET, PLAIN))
    office = f"sqlite:///{tmp_path}/plant.db"
    assert main(["plant", "init", "--to", office]) == 0
    assert main(["plant", "ship", str(runs), "--to", office]) == 0
    assert "1 runs shipped" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("act", "form"),
    [
        ("ship", "ann:{}@/{}?host={}"),
        ("show", "ann@/{1}?host={2}&password={0}"),
        ("ship", "ann@/{1}?password={0}&host={2}"),
    ],
)
def test_a_wrong_password_is_in_no_output_file_or_log(
    act: str, form: str, runs: Path, mortal: Server, tmp_path: Path
) -> None:
    """In a process of its own, whose every output is seen."""
    wrong = "wr0ng-s3cr-t"
    database = make_url(mortal.make())
    with psycopg.connect(mortal.url(), autocommit=True) as connection:
        connection.execute("DROP ROLE IF EXISTS ann")
        connection.execute("CREATE ROLE ann LOGIN PASSWORD 'right'")
    mortal.ask_password("ann")
    url = "postgresql://" + form.format(wrong, database.database, database.query["host"])
    words = [str(runs), "--to", url] if act == "ship" else ["--from", url, "--json"]
    done = hilcell("plant", act, *words)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert 'login refused: password authentication failed for user "ann"; check' in line
    assert "***" in line
    assert wrong not in line
    kept = [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert not any(wrong.encode() in content for content in kept)
    assert wrong not in mortal.log()


def test_only_an_answer_that_stays_the_same_refuses_a_login(
    mortal: Server, capsys: pytest.CaptureFixture[str]
) -> None:
    database = make_url(mortal.make("shut"))
    with psycopg.connect(mortal.url(), autocommit=True) as connection:
        connection.execute("CREATE ROLE asked LOGIN PASSWORD 'right' CONNECTION LIMIT 0")
        connection.execute("CREATE ROLE eve LOGIN")
        connection.execute("REVOKE CONNECT ON DATABASE shut FROM public")
        connection.execute("GRANT CONNECT ON DATABASE shut TO asked")
    mortal.ask_password("asked")
    for user, code, words in (
        ("asked", 2, "login refused: "),
        ("asked:right", 7, "too many connections"),
        ("nobody", 2, "login refused: role"),
        ("eve", 2, "login refused: permission denied for database"),
    ):
        url = f"postgresql://{user}@/shut?host={database.query['host']}"
        assert words in said(["plant", "show", "--from", url], code, capsys)


@pytest.mark.parametrize(
    ("url", "words"),
    [
        (f"postgresql//ann:{SECRET}@host/plant", "its URL cannot be read"),
        (f"postgresql://ann:{SECRET}@host:port/plant", "its URL cannot be read"),
        (f"oracle://ann:{SECRET}@host/plant", "oracle is not known"),
        (f"mysql://ann:{SECRET}@host/plant", "mysql is not known"),
        (f"postgresql://ann:{SECRET}%00@host/plant", "its URL cannot be read"),
        (f"postgresql://ann:{SECRET}\udcff@host/plant", "its URL cannot be read"),
        ("sqlite:///\udcff.db", "its URL cannot be read"),
        ("sqlite://", "its URL names no file"),
        ("sqlite:///:memory:", "its URL names no file"),
        ("", "no database is named"),
    ],
)
def test_a_wrong_url_is_one_line_without_its_password(
    url: str, words: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = said(["plant", "ship", str(runs), "--to", url], 2, capsys)
    assert words in line
    assert "postgresql://USER@HOST/DATABASE or sqlite:///FILE" in line
    assert SECRET not in line
    assert PLAIN not in line


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("postgresql://ann@host/plant?autocommit=1", "autocommit"),
        ("postgresql://ann@host/plant?sslmode=require&row_factory=x", "row_factory"),
        ("sqlite:///plant.db?isolation_level=IMMEDIATE", "isolation_level"),
        ("sqlite:///plant.db?timeout=x", "timeout"),
    ],
)
def test_an_option_that_would_undo_the_transactions_is_refused(
    url: str, name: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = said(["plant", "ship", str(runs), "--to", url], 2, capsys)
    assert f"its URL has the option {name}, wanted are those of" in line


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("ship --to postgresql://ann:begin@endend@host/plant", "write an @ of a password as %40"),
        (
            "ship --to postgresql://ann@127.0.0.1:1/plant?Password=endend",
            "its URL has the option Password",
        ),
        ("init postgresql://ann:begin@endend@host/plant", "arguments: postgresql://ann:***@host"),
        ("postgresql://ann:endend@host/plant", "postgresql://ann:***@host/plant"),
    ],
)
def test_a_password_at_a_wrong_place_is_not_shown(
    words: str, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = main(["plant", *words.split()])
    except SystemExit as end:
        code = int(str(end.code))
    err = capsys.readouterr().err
    assert code == 2
    assert shown in err
    assert "endend" not in err


@pytest.mark.parametrize("name", ["plant.sqlite", "index.sqlite"])
def test_a_database_has_no_name_of_what_may_be_deleted(
    name: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = said(["plant", "init", "--to", f"sqlite:///{runs}/{name}"], 2, capsys)
    assert f"{name} is a file of a folder of runs, which may be deleted at any time" in line


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("ann@h..example/plant", "a host of that name cannot be"),
        ("ann@" + 70 * "h" + "/plant", "a host of that name cannot be"),
        ("ann@127.0.0.1:70000/plant", 'invalid port number: "70000"'),
        ("ann@127.0.0.1:1/plant?sslmode=verify", 'invalid sslmode value: "verify"'),
        (f"ann:{SECRET}@/plant?host=/{'h' * 200}", "Unix-domain socket path"),
    ],
)
def test_a_url_that_no_server_is_asked_with_is_refused(
    place: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = said(["plant", "show", "--from", f"postgresql://{place}"], 2, capsys)
    assert f"refused: {words}" in line
    assert SECRET not in line


@pytest.mark.parametrize(
    ("old", "moment"),
    [(False, "CREATE TABLE point"), (True, "INDEX run_of_head"), (True, "UPDATE alembic")],
)
def test_an_office_s_tables_are_made_or_brought_up_whole_or_not_at_all(
    old: bool, moment: str, tmp_path: Path
) -> None:
    url = f"sqlite:///{tmp_path}/plant.db"
    if old:
        old_schema(url)

    def full(*words: object) -> None:
        if moment in str(words[2]).replace("\n", ""):
            raise sqlite3.OperationalError("database or disk is full")

    def kept() -> list[object]:
        with closing(sqlite3.connect(tmp_path / "plant.db")) as base:
            return base.execute("SELECT name, sql FROM sqlite_master ORDER BY name").fetchall()

    before = kept()
    with closing(Database(url)) as database:
        event.listen(database.engine, "before_cursor_execute", full)
        with pytest.raises(PlantAway, match="disk is full"):
            database.make()
        assert kept() == before
        event.remove(database.engine, "before_cursor_execute", full)
        database.make()
        database.check()


def test_tables_that_an_earlier_version_made_in_part_are_named_as_that(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(sqlite3.connect(tmp_path / "plant.db")) as base, base:
        base.execute("CREATE TABLE frame (digest TEXT, key TEXT, matrix TEXT, covariance TEXT)")
    line = said(["plant", "init", "--to", f"sqlite:///{tmp_path}/plant.db"], 2, capsys)
    assert "interrupted while it made the tables; delete this database" in line


@pytest.mark.parametrize(
    "order",
    [
        "CREATE TABLE run (x int)",
        "CREATE TABLE frame AS SELECT 1 digest, 2 key, 3 matrix, 4 covariance",
    ],
)
def test_tables_of_our_names_that_may_hold_something_are_not_to_be_deleted(
    order: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(sqlite3.connect(tmp_path / "plant.db")) as base, base:
        base.execute(order)
    line = said(["plant", "init", "--to", f"sqlite:///{tmp_path}/plant.db"], 2, capsys)
    assert "it belongs to another program (it has 1 tables" in line
    assert "delete" not in line


def test_a_folder_without_runs_is_stated(
    office: Database, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "none").mkdir()
    assert main(["plant", "ship", str(tmp_path / "none"), "--to", office.name]) == 0
    assert f"hilcell: no runs in {tmp_path}/none\n" in capsys.readouterr().err


@pytest.mark.parametrize("words", [("ship", ""), ("show", "--cell", ""), ("show", "--robot", "")])
def test_an_empty_name_is_refused(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["plant", *words])
    assert "a name is wanted, found ''" in capsys.readouterr().err


def test_the_folder_of_one_run_is_refused(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"sqlite:///{tmp_path}/plant.db"
    line = said(["plant", "ship", str(runs / "a"), "--to", url], 2, capsys)
    assert "is that of one run: name the folder that it lies in" in line


def test_a_folder_of_runs_that_is_not_there_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"sqlite:///{tmp_path}/plant.db"
    assert main(["plant", "init", "--to", url]) == 0
    capsys.readouterr()
    line = said(["plant", "ship", str(tmp_path / "rusn"), "--to", url], 2, capsys)
    assert "rusn is not there: name the folder of runs" in line


def test_a_file_that_is_not_there_is_not_made(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = said(["plant", "ship", str(runs), "--to", f"sqlite:///{tmp_path}/no.db"], 2, capsys)
    assert "it holds no plant records; `hilcell plant init --to URL` makes their tables" in line
    assert not (tmp_path / "no.db").exists()


@pytest.mark.parametrize("act", ["init", "ship", "show"])
def test_a_place_at_which_no_file_can_be_is_refused(
    act: str, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = "--from" if act == "show" else "--to"
    folder = [str(runs)] if act == "ship" else []
    line = said(["plant", act, *folder, where, f"sqlite:///{runs}"], 2, capsys)
    assert "it is a folder; name a file, as plant.db in it" in line
    line = said(["plant", act, *folder, where, f"sqlite:///{runs}/no/plant.db"], 2, capsys)
    assert f"the folder {runs}/no is not there; make it, or name another file" in line


def test_a_damaged_database_is_one_line_with_the_next_act(
    office: Database, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "plant.db"
    file.write_bytes(file.read_bytes()[:5000])
    line = said(["plant", "show", "--from", f"sqlite:///{file}"], 2, capsys)
    assert "disk image is malformed; restore its backup, or make another by" in line


def test_a_database_of_something_else_is_left_alone(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "other.db"
    with sqlite3.connect(file) as base:
        base.execute("CREATE TABLE customers (name TEXT)")
    base.close()
    before = file.read_bytes()
    line = said(["plant", "show", "--from", f"sqlite:///{file}"], 2, capsys)
    assert "it holds no plant records" in line
    line = said(["plant", "init", "--to", f"sqlite:///{file}"], 2, capsys)
    assert "another program (it has 1 tables, the first is customers)" in line
    file.with_name("text.db").write_text("no database, but long enough to be one" * 100)
    line = said(["plant", "show", "--from", f"sqlite:///{tmp_path}/text.db"], 2, capsys)
    assert "file is not a database; name another file, or restore its backup" in line
    assert file.read_bytes() == before


def test_init_writes_no_table_into_a_journal_or_beside_the_tables_of_others(
    runs: Path, postgresql: Server, capsys: pytest.CaptureFixture[str]
) -> None:
    url = postgresql.make()
    with closing(Database(url)) as database, database.transaction() as connection:
        connection.execute(text("CREATE TABLE orders (n integer)"))
    line = said(["plant", "init", "--to", url], 2, capsys)
    assert "it belongs to another program (it has 1 tables, the first is orders)" in line
    journal = runs / "a" / JOURNAL
    before = journal.read_bytes()
    line = said(["plant", "init", "--to", f"sqlite:///{journal}"], 2, capsys)
    assert "it belongs to another program" in line
    assert journal.read_bytes() == before


@pytest.mark.parametrize("more", ["", "CREATE TABLE run (id INTEGER, revision INTEGER)"])
@pytest.mark.parametrize("version", ["ae1027a6acf", "0001", "0004"])
@pytest.mark.parametrize("act", ["init", "ship", "show"])
def test_a_database_of_another_program_with_versions_of_its_own_is_left_alone(
    act: str, version: str, more: str, runs: Path, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    file = tmp_path / "other.db"
    with closing(sqlite3.connect(file)) as base, base:
        base.execute("CREATE TABLE alembic_version (version_num TEXT)")
        base.execute("INSERT INTO alembic_version VALUES (?)", [version])
        base.execute(more)
    before = file.read_bytes()
    where = ["--from" if act == "show" else "--to", f"sqlite:///{file}"]
    folder = [str(runs)] if act == "ship" else []
    line = said(["plant", act, *folder, *where], 2, capsys)
    assert f"it belongs to another program (its schema is {version})" in line
    assert file.read_bytes() == before


def test_a_table_that_is_missing_is_no_server_that_is_away(
    office: Database, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with office.transaction() as connection:
        connection.execute(text("DROP TABLE verdict"))
    line = said(["plant", "show", "--from", f"sqlite:///{tmp_path}/plant.db"], 2, capsys)
    assert "refused: no such table: verdict" in line


@pytest.mark.parametrize("act", ["init", "ship", "show"])
def test_a_newer_schema_asks_for_a_newer_hilcell(
    act: str, runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"sqlite:///{tmp_path}/plant.db"
    assert main(["plant", "init", "--to", url]) == 0
    capsys.readouterr()
    with sqlite3.connect(tmp_path / "plant.db") as base:
        base.execute("UPDATE alembic_version SET version_num = '0999'")
    base.close()
    where = ["--from", url] if act == "show" else ["--to", url]
    more = [str(runs)] if act == "ship" else []
    line = said(["plant", act, *more, *where], 2, capsys)
    assert "schema 0999, this hilcell knows 0004; update hilcell on this PC" in line


def old_schema(url: str) -> None:
    """Make the tables of the first version, with a point of a run."""
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    with closing(Database(url)) as database, database.transaction() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "0001")
        connection.execute(
            text(
                "INSERT INTO point (month, digest, seq, t, key, kind, station, frame, reflector, "
                "x_mm, y_mm, z_mm, std_x_mm, std_y_mm, std_z_mm, samples, session, set_up, retaken)"
                " VALUES ('2026-01-01', '00000000000000000000000000000001', 7, "
                "'2026-01-05 00:00:00', 'k', 'grid', '', '', '', 1, 2, 3, 0, 0, 0, 1, 1, 0, false)"
            )
        )


@pytest.mark.parametrize("kind", ["office", "postgresql"])
def test_an_older_schema_is_brought_up_and_keeps_its_records(
    kind: str, runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    url = f"sqlite:///{tmp_path}/plant.db"
    if kind == "postgresql":
        server: Server = request.getfixturevalue("postgresql")
        url = server.make()
    old_schema(url)
    for words in (["ship", str(runs), "--to", url], ["show", "--from", url]):
        line = said(["plant", *words], 2, capsys)
        assert "schema 0001, wanted 0004; `hilcell plant init --to URL` brings it up" in line
    assert "brought up from schema 0001, schema 0004" in said(
        ["plant", "init", "--to", url], 0, capsys
    )
    assert "1 runs shipped" in said(["plant", "ship", str(runs), "--to", url], 0, capsys)
    with closing(Database(url)) as database, database.transaction() as connection:
        asked = select(POINT.c.superseded, POINT.c.x_mm).where(POINT.c.key == "k")
        assert connection.execute(asked).all() == [(False, 1.0)]


def test_init_may_be_repeated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    url = f"sqlite:///{tmp_path}/plant.db"
    assert main(["plant", "init", "--to", url]) == 0
    assert "made, schema 0004" in capsys.readouterr().err
    assert main(["plant", "init", "--to", url]) == 0
    assert "is up to date, schema 0004" in capsys.readouterr().err


def test_missing_packages_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    line = said(["plant", "init", "--to", "sqlite:///x.db"], 2, capsys)
    assert "sqlalchemy, alembic, psycopg is not installed" in line
    assert "pip install 'hilcell[plant]'" in line


def test_the_environment_names_the_database(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HILCELL_PLANT", f"sqlite:///{tmp_path}/plant.db")
    assert main(["plant", "init"]) == 0
    assert main(["plant", "ship", str(runs)]) == 0
    assert main(["plant", "show"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("plant shp", "'shp' is no command; did you mean \"ship\"?"),
        ("plant", "the following arguments are required: COMMAND"),
        ("plant show --form x", '--form is no option; did you mean "--from"?'),
    ],
)
def test_wrong_words_are_answered_by_the_nearest(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(words.split())
    assert message in capsys.readouterr().err
