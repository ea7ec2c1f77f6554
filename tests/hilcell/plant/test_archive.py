"""Points of old runs in files: the record of a cell is still whole, signed and proven."""

from __future__ import annotations

import json
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import func, select, text

from hilcell.plant.archive import archive
from hilcell.plant.database import Database
from hilcell.plant.shipper import ship
from hilcell.plant.tables import ARCHIVE, POINT, RUN
from tests.hilcell.commands.full_disk import files_limited_to
from tests.hilcell.plant.conftest import DAY, NOW, refused
from tests.hilcell.plant.logins import Plant
from tests.hilcell.plant.test_export import private, public
from tests.whole.bench import command

BOTH = ["office", pytest.param("plant", marks=pytest.mark.process)]
BEFORE = NOW - 40 * DAY  # run a ended before, run b after


def shipped(kind: str, runs: Path, request: pytest.FixtureRequest) -> Database:
    database: Database = request.getfixturevalue(kind)
    assert ship(runs, database).runs == 2
    return database


def points(database: Database) -> dict[str, int]:
    query = select(RUN.c.name, func.count(POINT.c.seq)).outerjoin(
        POINT, POINT.c.digest == RUN.c.digest
    )
    with database.transaction() as connection:
        rows = connection.execute(query.group_by(RUN.c.name)).all()
    return {row[0]: row[1] for row in rows}


def url(database: Database) -> str:
    return database.engine.url.render_as_string().replace("+psycopg", "")


@pytest.mark.parametrize("kind", BOTH)
def test_an_archived_run_is_exported_as_before(
    kind: str, runs: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    database = shipped(kind, runs, request)
    signer, folder = Ed25519PrivateKey.generate(), tmp_path / "old"
    public(tmp_path / "pub", signer)
    words = ("north", "--key", private(tmp_path / "key", signer), "--from", url(database))
    assert command("plant", "export", *words, "-o", tmp_path / "first").returncode == 0
    before = points(database)
    done = command(
        "plant", "archive", "--from", url(database), "--before", f"{BEFORE:%Y-%m-%d}",
        "-o", folder, "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert (said["runs"], said["points"], said["refused"]) == (1, before["a"], {})
    assert points(database) == before | {"a": 0}
    assert [each.suffix for each in folder.iterdir()] == [".parquet"]
    assert archive(database, BEFORE, folder).runs == 0
    assert ship(runs, database).before == 2
    assert points(database)["a"] == 0

    said_line = refused("export", *words, "-o", tmp_path / "second")
    assert "--archive" in said_line
    more = ("--archive", folder, "-o", tmp_path / "second")
    assert command("plant", "export", *words, *more).returncode == 0
    first, second = (
        {
            path.relative_to(place): path.read_bytes()
            for path in (place / "runs").rglob("*")
            if path.is_file()
        }
        for place in (tmp_path / "first", tmp_path / "second")
    )
    assert first == second
    verified = command("plant", "verify", tmp_path / "second", "--public-key", tmp_path / "pub")
    assert verified.returncode == 0

    (file,) = folder.iterdir()
    content = file.read_bytes()
    for spoilt in (content[:-9] + b"x" + content[-8:], b"", None):
        if spoilt is None:
            file.unlink()
        else:
            file.write_bytes(spoilt)
        line = refused("export", *words, "--archive", folder, "-o", tmp_path / "third")
        assert file.name in line
        assert "run a" in line
        assert not (tmp_path / "third").exists()


def test_a_run_that_was_changed_is_not_archived(
    runs: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    database = shipped("office", runs, request)
    with database.transaction() as connection:
        connection.execute(text("UPDATE point SET x_mm = x_mm + 1"))
    before = points(database)
    moved = archive(database, NOW, tmp_path / "old")
    assert moved.runs == 0
    assert set(moved.refused) == {"a", "b"}
    assert points(database) == before
    assert list((tmp_path / "old").iterdir()) == []
    done = command(
        "plant", "archive", "--from", url(database), "--before", f"{NOW + DAY:%Y-%m-%d}",
        "-o", tmp_path / "old",
    )  # fmt: skip
    assert done.returncode == 7


def test_a_full_disk_moves_nothing(
    runs: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    database = shipped("office", runs, request)
    before = points(database)
    folder = tmp_path / "old"
    with files_limited_to(4000):
        line = refused(
            "archive",
            "--from",
            url(database),
            "--before",
            f"{NOW + DAY:%Y-%m-%d}",
            "-o",
            folder,
            code=7,
        )
    assert str(folder) in line
    assert points(database) == before
    assert not list(folder.glob("*"))
    with database.transaction() as connection:
        assert connection.execute(select(ARCHIVE)).all() == []


def test_a_file_without_its_row_is_written_again(
    runs: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """As after a kill between both, or in a database that was set back."""
    database = shipped("office", runs, request)
    folder = tmp_path / "old"
    backup = (tmp_path / "plant.db").read_bytes()
    archive(database, NOW + timedelta(days=1), folder)
    files = {each: each.read_bytes() for each in folder.iterdir()}
    database.close()
    (tmp_path / "plant.db").write_bytes(backup)
    with closing(Database(url(database))) as again:
        assert archive(again, NOW + timedelta(days=1), folder).runs == 2
    assert {each: each.read_bytes() for each in folder.iterdir()} == files


@pytest.mark.process
@pytest.mark.parametrize("login", ["reader", "north"])
def test_a_login_that_may_not_archive_is_told_where_nothing_is_due(
    login: str, both: Plant, tmp_path: Path
) -> None:
    words = ("--before", f"{NOW - 900 * DAY:%Y-%m-%d}", "-o", tmp_path / "old")
    assert "owner" in refused("archive", "--from", both.url(login), *words)
    assert not (tmp_path / "old").exists()
    assert command("plant", "archive", "--from", both.url(), *words).returncode == 0
