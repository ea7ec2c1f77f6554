"""Cells' folders, and the two stores of a plant."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, time, timedelta
from pathlib import Path

import pytest

from hilcell.plant.database import Database
from hilcell.plant.rights import CELL, ENGINEER
from tests.hilcell.plant.logins import Plant
from tests.hilcell.plant.server import BLANK, MISSING, Server, server
from tests.hilcell.plant.year import Model, Run
from tests.whole.bench import command
from tests.whole.golden import GoldenRuns

# Of whole days, so that processes of one day agree; a server holds what is of the future.
NOW = datetime.combine(datetime.now(UTC).date(), time(12), UTC) - timedelta(days=2)
DAY = timedelta(days=1)


def refused(*words: str | Path, code: int = 2) -> str:
    """Return the one line that a command of the plant says on stderr, and nothing on stdout."""
    done = command("plant", *words)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (code, "", 1), done.stderr
    return done.stderr


@pytest.fixture(scope="session")
def model(golden: GoldenRuns) -> Model:
    return Model(golden["small"].folder)


@pytest.fixture
def runs(model: Model, tmp_path: Path) -> Path:
    for name, days in (("a", 60), ("b", 20)):
        model.write(tmp_path / "runs", Run(name, "north", "HC-1", NOW - days * DAY))
    return tmp_path / "runs"


@pytest.fixture(scope="session")
def blank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("office") / "plant.db"
    with closing(Database(f"sqlite:///{file}")) as database:
        database.create()
    return file


@pytest.fixture
def office(blank: Path, tmp_path: Path) -> Iterator[Database]:
    shutil.copy(blank, tmp_path / "plant.db")
    with closing(Database(f"sqlite:///{tmp_path}/plant.db")) as database:
        yield database


@pytest.fixture(scope="session")
def _server() -> Iterator[Server]:
    if MISSING:
        pytest.skip(MISSING)
    with server() as found:
        with closing(Database(found.make(BLANK))) as database:
            database.create()
        yield found


@pytest.fixture
def postgresql(_server: Server) -> Server:
    """Return a server that a test may kill, or skip where PostgreSQL is not installed."""
    if not _server.runs:
        _server.start()
    return _server


@pytest.fixture
def plant(postgresql: Server) -> Iterator[Database]:
    """Return a database of its own on the server, its tables made."""
    with closing(Database(postgresql.make(like=BLANK))) as database:
        yield database


@pytest.fixture
def both(model: Model, postgresql: Server, plant: Database, tmp_path: Path) -> Plant:
    name = str(plant.engine.url.database)
    mark = secrets.token_hex(3)
    logins = {cell: f"{cell}_{mark}" for cell in ("north", "south", "reader")}
    own = Plant(postgresql, name, tmp_path, logins)
    with own.connect() as owner:
        for cell, login in logins.items():
            role = ENGINEER if cell == "reader" else CELL
            owner.execute(f"CREATE ROLE {login} LOGIN IN ROLE {role}".encode())
    for cell in ("north", "south"):
        for days in (40, 20):
            run = Run(f"{cell}-{days}", cell, f"HC-{cell}", NOW - days * DAY, f"R-{cell}")
            model.write(tmp_path / cell, run)
        done = command("plant", "ship", tmp_path / cell, "--to", own.url(cell))
        assert done.returncode == 0, done.stderr
    return own
