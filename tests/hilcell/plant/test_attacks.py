"""What a cell's login tries: to write as another cell, to change time, to spoil answers of all.

The login has its password, so it sends any SQL; it need not be `hilcell` that sends it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import psycopg
import pytest

from hilcell.journal.runs import read_records
from hilcell.plant.database import Database
from hilcell.plant.record import first_128_bits, run_record
from hilcell.plant.rights import CELL
from hilcell.plant.shipper import ship
from hilcell.plant.tables import PARTS, RUN
from tests.hilcell.plant.conftest import DAY, NOW, refused
from tests.hilcell.plant.logins import Plant, rows_of, send, sent
from tests.hilcell.plant.test_export import private
from tests.hilcell.plant.year import Model, Run, revoke
from tests.whole.bench import command

pytestmark = pytest.mark.process
Change = Callable[[dict[str, Any]], None]


def newest_of_north(own: Plant) -> dict[str, list[dict[str, Any]]]:
    return rows_of(own, "north", "north-20")


def revision_9999(row: dict[str, Any]) -> None:
    row |= {"revision": 9999, "proven": False}


def under_own_names(row: dict[str, Any]) -> None:
    """The key of the run and of the cell are the other's, the names are the login's own."""
    row |= {"revision": 9999, "cell": "south", "serial": "HC-south"}


def simulated_otherwise(row: dict[str, Any]) -> None:
    row |= {"machine": "simulated 999", "simulated": True}


@pytest.mark.parametrize("change", [revision_9999, under_own_names, simulated_otherwise])
def test_a_login_inserts_no_run_of_another_s_cell(change: Change, both: Plant) -> None:
    rows = newest_of_north(both)
    change(rows["run"][0])
    with pytest.raises((psycopg.errors.InsufficientPrivilege, psycopg.errors.CheckViolation)):
        send(both, "south", rows)
    shown = both.shown()
    assert both.calibration("north") == "north-20"
    assert shown["doubts"] == []


def test_a_key_of_another_s_run_under_one_s_own_cell_hides_nothing(both: Plant) -> None:
    """Also the run that the other has not shipped yet reaches the plant."""
    (theirs,) = newest_of_north(both)["run"]
    revoke(both.folder / "north" / "north-20", NOW)
    revoked = read_records(both.folder / "north" / "north-20")
    (to_come,) = run_record("north-20", revoked).rows[RUN]
    for revision, head in ((9999, theirs["head"]), (to_come["revision"], to_come["head"])):
        rows = rows_of(both, "south", "south-20")
        rows["run"][0] |= {"run_key": theirs["run_key"], "revision": revision, "head": head}
        send(both, "south", rows)
    assert both.calibration("north") == "north-20"
    for user in ("north", ""):
        done = command("plant", "ship", both.folder / "north", "--to", both.url(user), "--json")
        assert json.loads(done.stdout)["behind"] == {}
        assert done.returncode == 0
    assert both.calibration("north") == "north-40"


def test_a_digest_of_another_s_run_under_one_s_own_cell_is_named(both: Plant) -> None:
    """As from an export, where the database was set back: nothing is lost in silence."""
    revoke(both.folder / "north" / "north-20", NOW)
    (to_come,) = run_record("north-20", read_records(both.folder / "north" / "north-20")).rows[RUN]
    rows = rows_of(both, "south", "south-20")
    with both.connect("south") as asked:
        sent(asked, "run", rows["run"][0] | {"revision": 9999, "digest": to_come["digest"]})
    done = command("plant", "ship", both.folder / "north", "--to", both.url("north"))
    assert done.returncode == 7
    assert "digest" in done.stderr


@pytest.mark.parametrize("part", [table.name for table in PARTS])
def test_parts_of_another_s_run_and_of_an_older_run_are_refused(part: str, both: Plant) -> None:
    """A cell may not change its own record either, once it was shipped."""
    for cell in ("north", "south"):
        rows = rows_of(both, cell, f"{cell}-20")
        row = next(iter(rows[part]), None) or {"digest": rows["run"][0]["digest"]}
        with both.connect("south") as asked, pytest.raises(psycopg.errors.InsufficientPrivilege):
            sent(asked, part, row | {"n": 999} if "n" in row else row)


@pytest.mark.parametrize("column", ["shipped", "shipped_by", "accepted", "held", "newest"])
def test_time_login_and_decisions_are_the_server_s(column: str, both: Plant) -> None:
    values = {"shipped": NOW + 9 * DAY, "shipped_by": both.logins["north"]}
    rows = rows_of(both, "south", "south-20")
    row = rows["run"][0] | {"revision": 9999, column: values.get(column, True)}
    refusals = (psycopg.errors.InsufficientPrivilege, psycopg.errors.GeneratedAlways)
    with both.connect("south") as asked, pytest.raises(refusals):
        sent(asked, "run", row)
    row.pop(column)
    with both.connect("south") as asked:
        asked.execute(f"SET ROLE {CELL}".encode())
        sent(asked, "run", row | {"digest": first_128_bits(b"1")})
    (kept,) = both.ask("SELECT shipped_by, shipped > %s AS late FROM run WHERE revision = 9999",
                       datetime(2020, 1, 1, tzinfo=UTC))  # fmt: skip
    assert kept == {"shipped_by": both.logins["south"], "late": True}


@pytest.mark.parametrize(
    "order",
    [
        "INSERT INTO claim (cell, serial, login) VALUES ('west', '', 'owner')",
        "UPDATE claim SET login = session_user",
        "DELETE FROM claim",
        "DELETE FROM run",
        "UPDATE run SET revision = 9999",
        "INSERT INTO decision (what, cell, serial) VALUES ('accepted', 'north', 'HC-north')",
        "SELECT * FROM decision",
        "SELECT * FROM current_run",
        "SELECT name FROM run",
        "ALTER TABLE run DISABLE ROW LEVEL SECURITY",
        "DROP POLICY hilcell_cell_inserts ON run",
        "ALTER TABLE run DISABLE TRIGGER run_newest",
        "SET SESSION AUTHORIZATION owner",
        "SET ROLE owner",
        "SELECT plant_newest()",
        "CREATE TABLE run_of_mine (n integer)",
        "CREATE TRIGGER mine AFTER INSERT ON run EXECUTE FUNCTION plant_newest()",
    ],
)
def test_a_login_has_no_other_right(order: str, both: Plant) -> None:
    with both.connect("south") as asked, pytest.raises(psycopg.Error) as error:
        asked.execute(order.encode())
    assert error.value.sqlstate in ("42501", "0A000")  # insufficient privilege; only by triggers


def test_a_login_reads_its_own_cells_alone(both: Plant) -> None:
    with both.connect("south") as asked:
        own = asked.execute("SELECT DISTINCT cell_key FROM run").fetchall()
        assert len(own) == 1
        claims = asked.execute("SELECT cell, login FROM claim").fetchall()
        assert claims == [{"cell": "south", "login": both.logins["south"]}]


def test_a_trigger_of_one_s_own_never_runs_as_the_owner(both: Plant) -> None:
    """A temporary table is looked up first where a function of the owner does not say otherwise."""
    with both.connect("south") as asked:
        asked.execute(
            """
            CREATE TEMP TABLE run AS
                SELECT 1 AS cell_key, 1 AS run_key, 1 AS revision, true AS newest, false AS held;
            CREATE FUNCTION pg_temp.mine() RETURNS trigger LANGUAGE plpgsql AS
                $$ BEGIN DELETE FROM public.run; RETURN NULL; END $$;
            CREATE TRIGGER mine BEFORE UPDATE ON pg_temp.run EXECUTE FUNCTION pg_temp.mine()
            """
        )
        rows = rows_of(both, "south", "south-20")
        sent(asked, "public.run", rows["run"][0] | {
            "digest": first_128_bits(b"2"), "revision": 9999,
        })  # fmt: skip
    assert both.ask("SELECT count(*) AS runs FROM run") == [{"runs": 5}]
    assert both.ask("SELECT count(*) AS n FROM current_run WHERE cell = 'south'") == [{"n": 2}]


# -- whose cell it is ------------------------------------------------------------------------------


def test_the_first_login_has_the_cell_until_the_owner_assigns_it(
    both: Plant, model: Model, tmp_path: Path
) -> None:
    model.write(tmp_path / "twin", Run("twin", "north", "HC-north", NOW - 5 * DAY))
    model.write(tmp_path / "twin", Run("own", "south", "HC-south", NOW - 4 * DAY))
    done = command("plant", "ship", tmp_path / "twin", "--to", both.url("south"), "--json")
    assert done.returncode == 7
    said = json.loads(done.stdout)
    assert (said["shipped"], list(said["refused"])) == (1, ["twin"])
    assert f"--login {both.logins['south']}" in said["refused"]["twin"]
    words = ("plant", "assign", "north", "--login", both.logins["south"])
    assert command(*words, "--to", both.url("south")).returncode == 2
    assert command(*words, "--to", both.url()).returncode == 0
    assert command("plant", "ship", tmp_path / "twin", "--to", both.url("south")).returncode == 0
    assert both.calibration("north") == "twin"
    (tmp_path / "north" / "plant.sqlite").unlink()
    assert command("plant", "ship", tmp_path / "north", "--to", both.url("north")).returncode == 7
    (journal,) = both.ask('SELECT what, "by", cell, login, before FROM decision')
    assert journal == {
        "what": "assigned", "by": "owner", "cell": "north",
        "login": both.logins["south"], "before": both.logins["north"],
    }  # fmt: skip
    listed = command("plant", "assign", "--to", both.url(), "--json")
    assert {each["login"] for each in json.loads(listed.stdout)["claims"]} == {both.logins["south"]}


def test_a_namesake_of_another_s_cell_is_named(both: Plant, model: Model, tmp_path: Path) -> None:
    """With a serial number of its own it is another cell, which takes no run of the first."""
    model.write(tmp_path / "twin", Run("twin", "north", "HC-other", NOW - 5 * DAY))
    assert command("plant", "ship", tmp_path / "twin", "--to", both.url("south")).returncode == 0
    shown = both.shown()
    known = {each["serial"]: each["calibration"] for each in shown["cells"]}
    assert (known["HC-north"], known["HC-other"]) == ("north-20", "twin")
    (doubt,) = shown["doubts"]
    assert both.logins["south"] in doubt
    refused("export", "north", "-o", tmp_path / "out", "--key", private(tmp_path / "key"),
            "--from", both.url("reader"))  # fmt: skip


def test_a_cell_is_assigned_ahead(both: Plant, model: Model, tmp_path: Path) -> None:
    to = ("--to", both.url())
    refused("assign", "west", "--login", both.logins["north"], *to)  # which serial number?
    refused("assign", "west", "--serial", "HC-west", "--login", "nobody_at_all", *to)
    words = ("assign", "west", "--serial", "HC-west", "--login", both.logins["north"], *to)
    assert command("plant", *words).returncode == 0
    model.write(tmp_path / "west", Run("w", "west", "HC-west", NOW - 5 * DAY))
    assert command("plant", "ship", tmp_path / "west", "--to", both.url("south")).returncode == 7
    assert command("plant", "ship", tmp_path / "west", "--to", both.url("north")).returncode == 0


def test_a_login_that_may_not_ship_is_told_although_all_is_shipped(both: Plant) -> None:
    """A timer with the wrong login must not succeed."""
    done = command("plant", "ship", both.folder / "north", "--to", both.url("reader"))
    assert done.returncode == 2
    assert CELL in done.stderr
    assert command("plant", "ship", both.folder / "north", "--to", both.url()).returncode == 0


def test_the_owner_ships_for_all_and_claims_nothing(
    both: Plant, model: Model, tmp_path: Path
) -> None:
    model.write(tmp_path / "more", Run("w", "west", "HC-west", NOW - 5 * DAY))
    model.write(tmp_path / "more", Run("n", "north", "HC-north", NOW - 5 * DAY))
    assert command("plant", "ship", tmp_path / "more", "--to", both.url()).returncode == 0
    assert len(both.ask("SELECT * FROM claim")) == 2


def test_an_office_s_file_has_no_logins(office: Database) -> None:
    assert "SQLite" in refused("assign", "x", "--login", "y", "--to", office.name)


# -- runs of the future ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["office", "plant"])
def test_a_run_of_the_future_waits_for_the_owner(
    kind: str, model: Model, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    database: Database = request.getfixturevalue(kind)
    url = database.engine.url.set(drivername=kind.replace("plant", "postgresql").replace(
        "office", "sqlite")).render_as_string(hide_password=False)  # fmt: skip
    runs = tmp_path / "runs"
    for name, began in (("now", NOW - DAY), ("then", datetime.now(UTC) + 400 * DAY)):
        model.write(runs, Run(name, "north", "HC-1", began))
    ship(runs, database)

    def asked(*words: str) -> dict[str, Any]:
        done = command("plant", *words, "--from", url, "--json")
        assert done.returncode == 0, done.stderr
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer

    def state() -> tuple[str, str, int]:
        shown = asked("show")
        (cell,) = shown["cells"]
        return cell["calibration"], cell["last_run"], len(shown["doubts"])

    assert state() == ("now", "now", 1)
    (doubt,) = asked("show")["doubts"]
    assert "then" in doubt
    (run,) = asked("held")["held"]
    assert (run["run"], run["removed"]) == ("then", False)
    assert refused("held", "--accept", "now", "--from", url)
    assert asked("held", "--accept", run["digest"][:12]) == {"held": []}
    calibration, last, _ = state()
    assert (calibration, last) == ("then", "then")
    (removed,) = asked("held", "--remove", "then")["held"]
    assert removed["removed"]
    assert state() == ("now", "now", 0)
    (runs / "plant.sqlite").unlink()
    assert ship(runs, database).before == 2
    assert state() == ("now", "now", 0)
    with database.transaction() as connection:
        decisions = connection.exec_driver_sql('SELECT what, "by", digest FROM decision').all()
    assert [each.what for each in decisions] == ["accepted", "removed"]
    assert all(each.by and each.digest for each in decisions)
    key = private(tmp_path / "key")
    export = ("export", "north", "-o", str(tmp_path / "out"), "--key", str(key))
    assert asked(*export)["runs"] == 2
    exported = json.loads((tmp_path / "out" / "decisions.json").read_text())
    assert [each["what"] for each in exported] == ["accepted", "removed"]


# -- what one login may cost the readers -----------------------------------------------------------


def test_a_transaction_that_stays_open_states_no_earlier_arrival(both: Plant) -> None:
    """And parts come in the transaction of their run, whatever its time."""
    rows = rows_of(both, "south", "south-20")
    with both.connect("south") as asked:
        asked.execute(b"BEGIN")
        began = asked.execute(b"SELECT now() AS at").fetchone()
        sent(asked, "run", rows["run"][0] | {"revision": 9999, "digest": first_128_bits(b"1")})
        asked.execute(b"COMMIT")
    (kept,) = both.ask("SELECT shipped FROM run WHERE revision = 9999")
    assert began is not None
    assert kept["shipped"] > began["at"]


def test_claims_without_runs_are_in_no_answer(both: Plant) -> None:
    with both.connect("south") as asked:
        asked.execute(
            b"INSERT INTO claim (cell, serial) SELECT 'north', 'z' || n "
            b"FROM generate_series(1, 2000) AS n"
        )
    assert both.shown()["doubts"] == []
    line = refused("assign", "north", "--login", both.logins["north"], "--to", both.url())
    assert "more" in line
    assert len(line) < 1000


@pytest.mark.parametrize("name", ["fake\nnorth", "x" * 1001, "a\x7fb"])
def test_a_name_that_would_spoil_tables_is_refused(name: str, both: Plant) -> None:
    row = rows_of(both, "south", "south-20")["run"][0] | {"revision": 9999}
    with both.connect("south") as asked:
        for column in ("name", "robot", "tracker"):
            with pytest.raises(psycopg.errors.CheckViolation):
                sent(asked, "run", row | {column: name})


def test_a_digest_names_its_run_although_another_has_it_as_a_name(both: Plant) -> None:
    (theirs,) = both.ask("SELECT digest FROM run WHERE name = 'north-40'")
    digest = theirs["digest"].hex
    row = rows_of(both, "south", "south-20")["run"][0]
    with both.connect("south") as asked:
        sent(asked, "run", row | {"revision": 9999, "digest": first_128_bits(b"1"), "name": digest})
    done = command("plant", "held", "--remove", digest, "--from", both.url(), "--json")
    assert [each["run"] for each in json.loads(done.stdout)["held"]] == ["north-40"]


def test_many_runs_of_one_transaction_take_one_lock(both: Plant) -> None:
    row = rows_of(both, "south", "south-20")["run"][0]
    with both.connect("south") as asked:
        asked.execute(b"BEGIN")
        for n in range(5):
            own = {"digest": first_128_bits(b"%d" % n), "run_key": first_128_bits(b"k%d" % n)}
            sent(asked, "run", row | own)
        held = asked.execute(
            b"SELECT count(*) AS count FROM pg_locks "
            b"WHERE locktype = 'advisory' AND pid = pg_backend_pid()"
        ).fetchone()
        asked.execute(b"ROLLBACK")
    assert held == {"count": 1}


def test_runs_that_cannot_be_read_are_one_line_a_cell(both: Plant) -> None:
    row = rows_of(both, "south", "south-20")["run"][0] | {"ended": NOW, "begun": NOW}
    with both.connect("south") as asked:
        for n in range(5):
            own = {"digest": first_128_bits(b"%d" % n), "run_key": first_128_bits(b"k%d" % n)}
            sent(asked, "run", row | own | {"name": f"bad-{n}"})
    (doubt,) = both.shown()["doubts"]
    assert "bad-0" in doubt
    assert "4 more records" in doubt
