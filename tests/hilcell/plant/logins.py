"""A plant whose cells have logins, and rows that a login sends without `hilcell`."""

from __future__ import annotations

import json
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psycopg
from psycopg.rows import DictRow, dict_row
from psycopg.types.json import Json

from hilcell.journal.runs import read_records
from hilcell.plant.record import first_128_bits, run_record
from hilcell.plant.tables import PARTS, RUN
from tests.hilcell.plant.server import Server
from tests.whole.bench import command


@dataclass
class Plant:
    """A plant in which north and south were shipped, each by a login of its own."""

    server: Server
    name: str
    folder: Path
    logins: dict[str, str]

    def url(self, cell: str = "") -> str:
        return self.server.url(self.name, self.logins[cell] if cell else "owner")

    def connect(self, cell: str = "") -> psycopg.Connection[DictRow]:
        connect = psycopg.Connection[DictRow].connect
        return connect(self.url(cell), autocommit=True, row_factory=dict_row)

    def shown(self, *words: str) -> dict[str, Any]:
        done = command("plant", "show", "--from", self.url("reader"), "--json", *words)
        assert done.returncode == 0, done.stderr
        shown: dict[str, Any] = json.loads(done.stdout)
        return shown

    def calibration(self, cell: str) -> str:
        (state,) = (each for each in self.shown()["cells"] if each["cell"] == cell)
        return str(state["calibration"])

    def ask(self, sql: str, *values: object) -> list[DictRow]:
        with self.connect() as owner:
            return owner.execute(sql.encode(), values).fetchall()


def sent(asked: psycopg.Connection[DictRow], table: str, row: dict[str, Any]) -> None:
    names = ", ".join(f'"{name}"' for name in row)
    values = [
        Json(each) if isinstance(each, (dict, list, tuple)) or name == "covariance" else each
        for name, each in row.items()
    ]
    places = ", ".join(["%s"] * len(row))
    asked.execute(f"INSERT INTO {table} ({names}) VALUES ({places})".encode(), values)


def rows_of(own: Plant, cell: str, run: str) -> dict[str, list[dict[str, Any]]]:
    """Return the rows that a run's cell would send, by table."""
    record = run_record(run, read_records(own.folder / cell / run))
    rows = {table.name: [dict(each) for each in every] for table, every in record.rows.items()}
    for grid in rows["grid"]:
        vectors = ("places_mm", "errors_mm", "base_mm")
        grid |= {name: np.array(grid[name], "<f8").tobytes() for name in vectors}
    return rows


def send(own: Plant, login: str, rows: dict[str, list[dict[str, Any]]]) -> None:
    digest = first_128_bits(secrets.token_bytes(8))
    with own.connect(login) as asked, asked.transaction():
        for table in (RUN, *PARTS):
            for row in rows.get(table.name, []):
                sent(asked, table.name, row | {"digest": digest})
