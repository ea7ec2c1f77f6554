"""Rows that are not of a run, which any cell's login may send: refused, or named and left out."""

from __future__ import annotations

import json
import secrets
import struct
from collections.abc import Iterator
from typing import Any

import psycopg
import pytest
import sqlalchemy as sa
from psycopg.rows import DictRow

from hilcell.plant.record import first_128_bits
from hilcell.plant.tables import GRID, LENGTH, OUTCOME, PARTS, POINT, RUN, VERDICT, Utc, Vectors
from tests.hilcell.plant.conftest import DAY, NOW
from tests.hilcell.plant.logins import Plant, rows_of, send, sent
from tests.hilcell.plant.test_export import private
from tests.whole.bench import command

pytestmark = pytest.mark.process
Rows = dict[str, list[dict[str, Any]]]
DEEP = 5000
JSONS = (
    "null", "3", '"x"', "[]", "{}", "[[1e999]]", "[" * DEEP + "]" * DEEP, "[[1],[2,3]]",
    "[[1,0,0,0],[0,1,0,0],[0,0,1,1e300],[0,0,0,1]]", '{"name": 3}', "nonsense",
)  # fmt: skip


def nonsense(column: sa.Column[Any]) -> Iterator[object]:
    yield None
    match column.type:
        case Vectors():
            yield from (b"", b"\xff" * 24, b"odd", struct.pack("<3d", 1e300, 0.0, 0.0))
        case sa.JSON():
            yield from JSONS
        case sa.Double():
            yield from (float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 0.0, -1.0)
        case sa.Integer():
            yield from (-1, 0, 2**31 - 1, 2**40)
        case Utc():
            yield from ("infinity", "-infinity", "0044-03-15 BC", "2199-12-31", "1980-01-01")
        case sa.Uuid():
            yield from (first_128_bits(b""), "x")
        case sa.Boolean():
            yield from (True, False)
        case _:
            yield from ("", "\x1b[31m\u202e", "x" * 40_000, "\n" * 100, "0" * 64, "\udc80")


def spoilt_rows(row: dict[str, Any]) -> Iterator[str]:
    """Yield the JSON of a run's row with each field spoilt."""
    for name in row:
        spoilt: tuple[object, ...] = (
            None, "x", 3, -1e300, [], {}, True, "2199-01-01T00:00:00+00:00",
        )  # fmt: skip
        for value in spoilt:
            yield json.dumps(row | {name: value})
    for name in row["facts"]:
        others: tuple[object, ...] = (None, "south-20", 3, [], True)
        for value in others:
            yield json.dumps(row | {"facts": row["facts"] | {name: value}})


def tried(
    asked: psycopg.Connection[DictRow], rows: Rows, table: str, spoilt: dict[str, Any]
) -> bool:
    """Send a run of which one row is spoilt; return whether it was taken."""
    fresh = {"digest": first_128_bits(secrets.token_bytes(8))}
    run_key = {"run_key": first_128_bits(secrets.token_bytes(8))}
    try:
        with asked.transaction():
            for each in (RUN, *PARTS):
                if each is POINT and table != POINT.name:
                    continue
                for n, row in enumerate(rows.get(each.name, [])[:3]):
                    values = row | fresh | (run_key if each is RUN else {})
                    sent(
                        asked, each.name, values | (spoilt if (n, each.name) == (0, table) else {})
                    )
    except (psycopg.Error, UnicodeEncodeError):
        return False
    return True


def test_no_value_of_any_column_ends_the_answers_of_others(both: Plant) -> None:
    rows = rows_of(both, "south", "south-20")
    digest = rows["run"][0]["digest"]
    rows[LENGTH.name] = [
        {"digest": digest, "n": 0, "nests": "1-2", "wanted_mm": 1e3, "found_mm": 1e3, "U_mm": 0.1}
    ]
    taken = refused = 0
    with both.connect("south") as asked:
        for table in (RUN, *PARTS):
            for column in table.c:
                for value in nonsense(column):
                    took = tried(asked, rows, table.name, {column.name: value})
                    taken, refused = taken + took, refused + (not took)
        for text in spoilt_rows(rows[OUTCOME.name][0]["row"]):
            taken += tried(asked, rows, OUTCOME.name, {"row": text})
    assert min(taken, refused) > 100
    shown = both.shown()
    states = {each["cell"]: each for each in shown["cells"]}
    assert states["north"]["condition"] == "valid"
    assert states["north"]["calibration"] == "north-20"
    north = both.shown("--cell", "north")
    assert north["doubts"] == []
    assert [each["calibrations"] for each in north["robots"]] == [2]
    left_out = [each for each in shown["doubts"] if "south" in each and "cannot be read" in each]
    assert left_out
    assert command("plant", "show", "--from", both.url("reader")).returncode == 0
    key = ("--key", private(both.folder / "key"), "--from", both.url("reader"))
    words = ("plant", "export", "north", *key, "-o", both.folder / "out")
    assert command(*words).returncode == 0
    done = command("plant", "export", "south", *key, "-o", both.folder / "spoilt")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    before = ("--before", f"{NOW + DAY:%Y-%m-%d}", "-o", both.folder / "old")
    done = command("plant", "archive", *before, "--json", "--from", both.url())
    assert done.returncode == 7
    assert not {"north-40", "north-20"} & json.loads(done.stdout)["refused"].keys()


@pytest.mark.parametrize(
    ("table", "spoilt", "why"),
    [
        (OUTCOME, {"row": "{}"}, "name"),
        (GRID, {"errors_mm": struct.pack("<81d", *[float("nan")] * 81)}, "errors"),
    ],
)
def test_a_run_that_cannot_be_read_is_named_and_left_out(
    table: sa.Table, spoilt: dict[str, Any], why: str, both: Plant
) -> None:
    """A later calibration of the same cell; the one before it stays the current one."""
    rows = rows_of(both, "south", "south-20")
    rows["run"][0] |= {"name": "bad", "ended": NOW, "begun": NOW}
    rows[OUTCOME.name][0]["row"] |= {
        "name": "bad", "ended": NOW.isoformat(), "begun": NOW.isoformat(),
    }  # fmt: skip
    with both.connect("south") as asked:
        assert tried(asked, rows, table.name, spoilt)
    shown = both.shown()
    doubts = [each for each in shown["doubts"] if "bad" in each]
    assert len(doubts) == 1
    assert why in doubts[0]
    assert {each["cell"]: each["calibrations"] for each in shown["robots"]}["north"] == 2
    if table is GRID:
        assert {each["cell"]: each["calibrations"] for each in shown["robots"]}["south"] == 2
        with both.connect() as asked:
            of_south = "digest IN (SELECT digest FROM run WHERE cell = 'south')"
            asked.execute(f"UPDATE grid SET errors_mm = %s WHERE {of_south}", [*spoilt.values()])
        (robot,) = {each["robot"] for each in shown["robots"] if each["cell"] == "south"}
        words = ("plant", "show", "--from", both.url("reader"), "--robot", robot)
        assert "in these records; 3 runs cannot be read" in command(*words).stderr
    else:
        assert both.calibration("south") == "south-20"


def test_the_row_of_a_run_may_not_contradict_its_columns(both: Plant) -> None:
    """Its end by the columns is checked against the server's clock, its row names the newest."""
    rows = rows_of(both, "south", "south-20")
    rows["run"][0] |= {"name": "bad", "run_key": first_128_bits(b"bad")}
    far = (NOW + 4000 * DAY).isoformat()
    rows[OUTCOME.name][0]["row"] |= {"name": "bad", "ended": far}
    send(both, "south", rows)
    assert both.calibration("south") == "south-20"
    assert any("bad" in each and "ended" in each for each in both.shown()["doubts"])


def test_numbers_that_are_none_are_refused(both: Plant) -> None:
    rows = rows_of(both, "south", "south-20")
    with both.connect("south") as asked:
        for table, column, values in (
            (POINT, "x_mm", (float("nan"), float("inf"))),
            (VERDICT, "mean_mm", (float("nan"), 1e300)),
            (RUN, "exit", (8, -1)),
            (RUN, "ended", ("infinity", "2200-01-01")),
        ):
            for value in values:
                assert not tried(asked, rows, table.name, {column: value})
