"""What only a server has: roles, rights, logins; and the schema on both stores."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from ipaddress import ip_address
from itertools import cycle
from math import nextafter
from pathlib import Path
from typing import Any

import psycopg
import pytest
from alembic import command as alembic
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID
from sqlalchemy import Table, event, make_url, select, text

from hilcell.journal.runs import read_records
from hilcell.plant.cells import cells
from hilcell.plant.database import MIGRATIONS, SHIPPED, Database
from hilcell.plant.record import heads, rows_digest, run_record
from hilcell.plant.rights import CELL, ENGINEER
from hilcell.plant.shipper import ship, write
from hilcell.plant.tables import GRID, HEAD, LENGTH, PARTS, POINT, RUN, TABLES
from tests.hilcell.plant.conftest import NOW, refused
from tests.hilcell.plant.server import FAST, MISSING, Server, server
from tests.hilcell.plant.test_export import private
from tests.hilcell.plant.test_refusals import nowhere
from tests.hilcell.plant.year import Model, Run, extend
from tests.whole.bench import command

Authority = tuple[x509.Name, ec.EllipticCurvePrivateKey]
BOTH = ["office", pytest.param("plant", marks=pytest.mark.process)]


@contextmanager
def asking(url: str) -> Iterator[psycopg.Connection[tuple[object, ...]]]:
    with psycopg.connect(url, autocommit=True) as connection:
        yield connection


def name_of(database: Database) -> str:
    return str(database.engine.url.database)


@pytest.mark.parametrize("kind", BOTH)
def test_a_store_keeps_each_number_to_its_last_digit(
    kind: str, model: Model, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Its tables are those of the migrations; what is read back has the digest of what was kept."""
    database: Database = request.getfixturevalue(kind)
    with database.transaction(migrating=True) as connection:
        context = MigrationContext.configure(connection)
        assert compare_metadata(context, TABLES) == []
        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS))
        config.attributes["connection"] = connection
        alembic.check(config)
        with pytest.raises(NotImplementedError, match="backup"):
            alembic.downgrade(config, "base")
    assert ScriptDirectory(str(MIGRATIONS)).get_heads() == [HEAD]
    records = read_records(model.write(tmp_path, Run("a", "north", "HC-1", NOW)))
    record = run_record("a", records)
    numbers = (0.1 + 0.2, 5e-324, -0.0, 1.7976931348623157e308, 1e22, -123456789.123456789, 1 / 3)
    names = ("x_mm", "y_mm", "z_mm", "std_x_mm", "std_y_mm", "std_z_mm")
    places = dict(zip(names, numbers[:6], strict=True))
    points = [
        {
            **each, **places,
            "strip_mm": number, "reflector": "K\u00f6ln\u2028\U0001f916 '\\\"",
            "joints_deg": numbers, "nominal_x_mm": 0.0, "nominal_y_mm": number,
            "nominal_z_mm": -number,
        }
        for each, number in zip(record.rows[POINT], cycle(numbers), strict=False)
    ]  # fmt: skip
    lengths = [
        {"n": n, "nests": "1-2", "wanted_mm": 1000, "found_mm": 1000.0, "U_mm": number}
        for n, number in enumerate((0.1 + 0.2, 5e-324, -0.0, 1 / 3, 123456.789123456789))
    ]
    grid = {
        "places_mm": [list(numbers[:3])], "errors_mm": [list(numbers[3:6])], "temperature_c": 20,
        "layout": record.run_key, "base_mm": [list(numbers[1:4])] * 3, "mean_mm": numbers[0],
    }  # fmt: skip
    rows = {**record.rows, POINT: points, LENGTH: lengths, GRID: [grid]}
    own = {"digest": rows_digest(rows)}
    rows = {table: [{**each, **own} for each in every] for table, every in rows.items()}
    record = record._replace(rows=rows)
    with database.transaction() as connection:
        assert write(connection, record, heads(records))
    with database.transaction() as connection:
        found: dict[Table, list[dict[str, Any]]] = {
            table: [dict(row) for row in connection.execute(select(table)).mappings()]
            for table in (RUN, *PARTS)
        }
    (run,) = found[RUN]
    assert len(found[POINT]) == len(points) > len(numbers)
    assert rows_digest(found) == run["digest"]
    found[POINT][0]["x_mm"] = nextafter(found[POINT][0]["x_mm"], 1)
    assert rows_digest(found) != run["digest"]


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_the_newest_revision_is_current_in_whatever_order_they_arrive(
    kind: str, order: tuple[int, ...], model: Model, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    database: Database = request.getfixturevalue(kind)
    folder = model.write(tmp_path / "runs", Run("a", "north", "HC-1", NOW))
    records = [read_records(folder)]
    for n in range(2):
        extend(folder, [(NOW, "event", "", {"what": "note", "text": str(n)})])
        records.append(read_records(folder))
    for n, arrived in enumerate(order):
        with database.transaction() as connection:
            write(connection, run_record("a", records[arrived]), heads(records[arrived]))
            newest = connection.execute(text("SELECT revision FROM current_run")).scalars().all()
        assert newest == [max(records[each][-1].seq for each in order[: n + 1])]


@pytest.mark.process
def test_of_runs_that_end_at_once_both_stores_show_the_same(
    office: Database, plant: Database, model: Model, tmp_path: Path
) -> None:
    names = [f"tie-{n}" for n in range(9)]
    for n, name in enumerate(names):
        means_mm = {"S300": 0.01 * n}  # one journal is shipped once
        model.write(tmp_path / "runs", Run(name, "north", "HC-1", NOW, means_mm=means_mm))
    last: list[str] = []
    for database in (office, plant):
        for name in names:
            records = read_records(tmp_path / "runs" / name)
            with database.transaction() as connection:
                write(connection, run_record(name, records), heads(records))
        with database.transaction() as connection:
            last += [each.last_run for each in cells(connection, NOW)]
    assert last[0] == last[1]


@pytest.mark.process
def test_of_two_revisions_that_arrive_at_once_the_newest_is_current(
    plant: Database, model: Model, tmp_path: Path, postgresql: Server
) -> None:
    """The second waits for the first, and sees it."""
    folder = model.write(tmp_path / "runs", Run("a", "north", "HC-1", NOW))
    first = read_records(folder)
    extend(folder, [(NOW, "event", "", {"what": "note", "text": "later"})])
    second = read_records(folder)
    waiting = (
        "SELECT 1 FROM pg_stat_activity WHERE wait_event_type = 'Lock' AND datname = "
        f"'{name_of(plant)}'"
    ).encode()

    def write_first() -> None:
        url = postgresql.url(name_of(plant))
        with closing(Database(url)) as other, other.transaction() as connection:
            write(connection, run_record("a", first), heads(first))

    late = threading.Thread(target=write_first)
    with plant.transaction() as connection:
        write(connection, run_record("a", second), heads(second))
        late.start()
        with asking(postgresql.url()) as owner:
            while owner.execute(waiting).fetchone() is None:
                assert late.is_alive()
    late.join()
    with asking(postgresql.url(name_of(plant))) as asked:
        assert asked.execute("SELECT revision FROM current_run").fetchall() == [(len(second),)]


@pytest.mark.process
def test_tables_are_made_once_in_any_encoding(runs: Path, model: Model, postgresql: Server) -> None:
    _two_that_make_the_tables_at_once_make_them_once(postgresql)
    for encoding in ("SQL_ASCII", "LATIN1"):
        name = f"in_{encoding}".lower()
        made = f"CREATE DATABASE {name} ENCODING '{encoding}' LOCALE 'C' TEMPLATE template0"
        with asking(postgresql.url()) as owner:
            owner.execute(made.encode())
        model.write(runs / name, Run("a", "Köln", "HC-1", NOW))
        with closing(Database(postgresql.url(name))) as database:
            database.create()
            assert ship(runs / name, database).runs == 1
            with database.transaction() as connection:
                assert connection.execute(select(RUN.c.cell)).scalar() == "Köln"
    url = postgresql.make()
    with closing(Database(url)) as database, database.transaction() as connection:
        connection.execute(text("CREATE TABLE orders (n integer)"))
    assert "orders" in refused("init", "--to", url)


def _two_that_make_the_tables_at_once_make_them_once(postgresql: Server) -> None:
    url = postgresql.make()
    own = f"FROM pg_stat_activity WHERE datname = '{make_url(url).database}'"
    asked = f"SELECT 1 {own} AND wait_event_type = 'Lock'".encode()
    made: list[str] = []

    def make() -> None:
        with closing(Database(url)) as other:
            made.append(other.create())

    second = threading.Thread(target=make)

    def wait(*words: object) -> None:
        """Begin another, and go on when it waits for a lock."""
        if "CREATE TABLE point" in str(words[2]) and second.ident is None:
            second.start()
            with asking(postgresql.url()) as owner:
                while owner.execute(asked).fetchone() is None:
                    assert second.is_alive()

    with closing(Database(url)) as database:
        event.listen(database.engine, "before_cursor_execute", wait)
        assert database.create() == ""
    second.join()
    assert made == [HEAD]


@pytest.mark.process
def test_cells_may_insert_only_and_engineers_may_read_only(
    plant: Database, runs: Path, postgresql: Server
) -> None:
    name = name_of(plant)
    users = {"cell_user": f"IN ROLE {CELL}", "engineer_user": f"IN ROLE {ENGINEER}", "nobody_s": ""}
    with asking(postgresql.url(name)) as owner:
        for user, role in users.items():
            owner.execute(f"CREATE ROLE {user} LOGIN {role}".encode())
    with closing(Database(postgresql.url(name, "cell_user"))) as cell:
        assert ship(runs, cell).runs == 2
        (runs / SHIPPED).unlink()
        assert ship(runs, cell).before == 2
    asked = {
        "cell_user": [
            "SELECT * FROM point", "SELECT * FROM document",
            "SELECT name FROM run", "UPDATE run SET name = 'x'",
            "DELETE FROM run", "DELETE FROM point", "SELECT * FROM verdict", "DROP TABLE run",
            "DELETE FROM alembic_version", "TRUNCATE point",
        ],
        "engineer_user": [
            "INSERT INTO alarm SELECT * FROM alarm", "UPDATE run SET name = 'x'",
            "DELETE FROM run", "DROP TABLE point",
        ],
    }  # fmt: skip
    for user, orders in asked.items():
        with asking(postgresql.url(name, user)) as connection:
            for order in orders:
                with pytest.raises(psycopg.errors.InsufficientPrivilege):
                    connection.execute(order.encode())
    (runs / SHIPPED).unlink()
    for user in ("engineer_user", "nobody_s"):
        said = refused("ship", runs, "--to", postgresql.url(name, user))
        assert CELL in said
    refused("init", "--to", postgresql.url(name, "nobody_s"))
    assert "nowhere" in refused("ship", runs, "--to", postgresql.url("nowhere"))
    key = ("--key", private(runs / "key"), "--from", postgresql.url(name, "engineer_user"))
    assert command("plant", "export", "north", *key, "-o", runs / "out").returncode == 0
    with asking(postgresql.url(name)) as owner:
        owner.execute("UPDATE verdict SET mean_mm = 0.001 WHERE key = 'validation.S300'")
    assert "a, b" in refused("export", "north", *key, "-o", runs / "after")
    assert not (runs / "after").exists()


@pytest.mark.process
def test_a_login_is_refused_and_its_password_is_nowhere(
    runs: Path, postgresql: Server, tmp_path: Path
) -> None:
    """Only an answer that stays the same refuses a login."""
    wrong, database = "wr0ng-s3cr-t", "shut"
    host = make_url(postgresql.make(database)).query["host"]
    with asking(postgresql.url()) as owner:
        for order in (
            "CREATE ROLE ann LOGIN PASSWORD 'right'",
            "CREATE ROLE asked LOGIN PASSWORD 'right' CONNECTION LIMIT 0",
            "CREATE ROLE eve LOGIN",
            "REVOKE CONNECT ON DATABASE shut FROM public",
            "GRANT CONNECT ON DATABASE shut TO asked",
        ):
            owner.execute(order.encode())
    for user in ("ann", "asked"):
        postgresql.ask_password(user)
    for place in (f"ann:{wrong}@/shut?host={host}", f"ann@/shut?password={wrong}&host={host}"):
        url = f"postgresql://{place}"
        for words in (("ship", runs, "--to", url), ("show", "--from", url, "--json")):
            line = refused(*words)
            assert "***" in line
            assert wrong not in line
    kept = [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert not any(wrong.encode() in content for content in kept)
    assert wrong not in postgresql.log()
    for user, code in (("asked", 2), ("asked:right", 7), ("nobody", 2), ("eve", 2)):
        url = f"postgresql://{user}@/shut?host={host}"
        assert command("plant", "show", "--from", url).returncode == code


def certified(place: Path, name: str, by: Authority | None = None) -> Authority:
    """Write a certificate of a name and its key; return both."""
    key = ec.generate_private_key(ec.SECP256R1())
    own = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    issuer, signer = by or (own, key)
    address = x509.IPAddress(ip_address("127.0.0.1"))
    certificate = (
        x509.CertificateBuilder()
        .subject_name(own)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime(2000, 1, 1, tzinfo=UTC))
        .not_valid_after(datetime(2199, 1, 1, tzinfo=UTC))
        .add_extension(x509.BasicConstraints(ca=by is None, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([address]), critical=False)
        .sign(signer, hashes.SHA256())
    )
    (place / f"{name}.crt").write_bytes(certificate.public_bytes(Encoding.PEM))
    form = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (place / f"{name}.key").write_bytes(key.private_bytes(*form))
    (place / f"{name}.key").chmod(0o600)
    return own, key


@pytest.mark.process
def test_a_server_that_the_url_does_not_trust_is_refused(tmp_path: Path) -> None:
    """Another authority, a file that is none, a server without TLS: repeating does not help."""
    if MISSING:
        pytest.skip(MISSING)
    port = nowhere()
    with server((*FAST, "listen_addresses=127.0.0.1", f"port={port}")) as own:
        url = f"postgresql://owner@127.0.0.1:{port}/postgres"

        def answered(mode: str) -> int:
            authority = f"&sslrootcert={tmp_path}/{mode}" if mode.endswith(".crt") else ""
            ask = f"{url}?sslmode={'verify-full' if authority else mode}{authority}"
            done = command("plant", "init", "--to", ask)
            assert done.stderr.count("\n") == 1
            return done.returncode

        ours, _ = certified(tmp_path, "ours"), certified(tmp_path, "theirs")
        certified(tmp_path, "server", ours)
        assert answered("require") == 2
        for name in ("server.crt", "server.key"):
            content = (tmp_path / name).read_bytes()
            own.write(name, content)
        with asking(url) as owner:
            owner.execute("ALTER SYSTEM SET ssl = on")
            owner.execute("SELECT pg_reload_conf()")
            while owner.execute("SHOW ssl").fetchone() != ("on",):
                pass
            owner.execute("CREATE ROLE ann LOGIN PASSWORD 'right'")
        own.ask_password("ann")
        for user in ("ann", "nobody"):
            wrong = f"postgresql://{user}:wrong@127.0.0.1:{port}/postgres"
            said = refused("show", "--from", wrong)
            (why,) = re.findall(r"login refused: (.*?); check", said)
            assert why.endswith(f'"{user}"' if user == "ann" else "does not exist")
        missing = refused("init", "--to", f"{url}?sslmode=verify-full&sslrootcert={tmp_path}/none")
        assert f'root certificate file "{tmp_path}/none" does not exist; check' in missing
        codes = {mode: answered(mode) for mode in ("theirs.crt", "none.crt", "ours.crt")}
        assert codes == {"theirs.crt": 2, "none.crt": 2, "ours.crt": 0}
