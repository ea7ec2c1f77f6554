"""Cells' folders, and the two stores of a plant."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest

from hilcell.plant.database import Database
from tests.conftest import shared_folder
from tests.hilcell.plant.server import BLANK, MISSING, Server, server, shared_server
from tests.hilcell.plant.year import Model
from tests.whole.golden import GoldenRuns

NOW = datetime(2026, 11, 1, 12, 0, tzinfo=UTC)


@pytest.fixture(scope="session")
def model(golden: GoldenRuns) -> Model:
    """Return the run that journals are made of."""
    return Model(golden["small"].folder)


@pytest.fixture(scope="session")
def blank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an office's database that holds nothing yet."""
    file = tmp_path_factory.mktemp("office") / "plant.db"
    with closing(Database(f"sqlite:///{file}")) as database:
        database.make()
    return file


@pytest.fixture
def office(blank: Path, tmp_path: Path) -> Iterator[Database]:
    """Return an office's database, a file."""
    shutil.copy(blank, tmp_path / "plant.db")
    with closing(Database(f"sqlite:///{tmp_path}/plant.db")) as database:
        yield database


@pytest.fixture(scope="session")
def _server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Server, Path]]:
    if MISSING:
        pytest.skip(MISSING)
    with shared_server(shared_folder(tmp_path_factory) / "plant") as found:
        yield found


@pytest.fixture(scope="session")
def postgresql(_server: tuple[Server, Path]) -> Server:
    """Return the server of all tests, or skip where PostgreSQL is not installed."""
    return _server[0]


@pytest.fixture(scope="module")
def mortal(_server: tuple[Server, Path]) -> Iterator[Server]:
    """Return a server that a test may kill and start again."""
    with server(made=_server[1]) as found:
        yield found


@pytest.fixture
def plant(postgresql: Server) -> Iterator[Database]:
    """Return a database of its own on the server, its tables made."""
    with closing(Database(postgresql.make(like=BLANK))) as database:
        yield database
