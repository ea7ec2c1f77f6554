"""``python -m benchmarks.plant [RUNS ..]``: questions to a plant's records, and how fast they come.

Runs are made by the server at three sizes, five years of cells of 1000 runs each, every eighth a
calibration of 64 vertices; five points a run, as points are in none of the answers. PostgreSQL runs
in a folder of its own, with its usual settings. The pace of shipping is measured with whole
journals of a small calibration, hash chains checked.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import numpy as np
from sqlalchemy import Connection, text

from benchmarks.__main__ import HILCELL, command
from hilcell.journal.calibration_facts import CalibrationFacts
from hilcell.journal.index import RunRow
from hilcell.plant.cells import cells
from hilcell.plant.database import Database
from hilcell.plant.robots import robots
from hilcell.plant.shipper import ship
from tests.hilcell.plant.server import MISSING, server
from tests.hilcell.plant.year import Model, Run
from tests.whole.bench import SMALL, sets

SIZES = (2_000, 20_000, 200_000)
RUNS_PER_CELL = 1000
CALIBRATION = 8  # every eighth run
VERTICES = 64
POINTS = 5
SHIPPED = 40
TARGETS_MS = {"cells": 100.0, "robot": 300.0}
TARGET_POINTS_S = 2000.0

_RUNS = """
INSERT INTO run (digest, run_key, revision, head, month, cell_key, name, cell, serial,
    simulated, machine, procedure, state, exit, begun, ended, points, proven,
    robot, tracker, version, row)
SELECT gen_random_uuid(), gen_random_uuid(), 500, md5(n::text),
    date_trunc('month', t), md5(cell::text)::uuid, name, 'cell-' || cell, 'HC-' || cell,
    false, '', 'calibrate', 'finished', 0, t, t, :points, made, 'R-' || cell, 'T-' || cell, '0.1.0',
    replace(replace(CASE WHEN made THEN :made ELSE :other END, '@name@', name),
        '@t@', to_char(t, 'YYYY-MM-DD"T"HH24:MI:SS"Z"'))::json
FROM (
    SELECT n, n / :each AS cell, n % :every = 0 AS made, 'run-' || n AS name,
        date_trunc('second', now() - interval '5 years' * (1 - (n % :each + 0.5) / :each)) AS t
    FROM generate_series(0, :runs - 1) AS n
) AS made_up
"""
_GRIDS = """
INSERT INTO grid SELECT digest, :places,
    (SELECT json_agg(ARRAY[random(), random(), random()])
     FROM generate_series(1, :vertices) WHERE run.digest IS NOT NULL),
    20 + 4 * random() FROM run WHERE proven
"""
_BASES = """
INSERT INTO frame SELECT digest, 'base', format(
    '[[1,0,0,%s],[0,1,0,%s],[0,0,1,%s],[0,0,0,1]]', random(), random(), random())::json, NULL
FROM run WHERE proven
"""
_POINTS = """
INSERT INTO point (month, digest, seq, t, key, kind, station, frame, reflector, x_mm, y_mm, z_mm,
    std_x_mm, std_y_mm, std_z_mm, samples, session, set_up, retaken)
SELECT month, digest, n, begun, 'grid/' || n, 'grid', 'S1100', 'tracker', 'SMR 1.5in',
    random(), random(), random(), 0.01, 0.01, 0.01, 10, 1, 0, false
FROM run, generate_series(1, :points) AS n
"""


def fill(connection: Connection, runs: int) -> None:
    """Make the records of a plant."""
    places_mm = np.random.default_rng(1).uniform(0.0, 900.0, (VERTICES, 3)).tolist()
    common = RunRow(
        name="@name@", begun="@t@", ended="@t@", state="finished", exit=0, cell="c", serial="s"
    )
    made = CalibrationFacts(kind="made", validated=True, judged=True, verdict="in tolerance")
    rows = {
        "made": msgspec.json.encode(msgspec.structs.replace(common, facts=made)).decode(),
        "other": msgspec.json.encode(common).decode(),
    }
    months = "SELECT plant_month(d::date) FROM generate_series(date_trunc('month', now() - "
    connection.execute(text(f"{months}interval '5 years'), now(), interval '1 month') AS d"))
    values = {"points": POINTS, "each": RUNS_PER_CELL, "every": CALIBRATION, "runs": runs}
    connection.execute(text(_RUNS), values | rows)
    connection.execute(
        text(_GRIDS), {"places": msgspec.json.encode(places_mm).decode(), "vertices": VERTICES}
    )
    connection.execute(text(_BASES))
    connection.execute(text(_POINTS), {"points": POINTS})


def milliseconds(database: Database, ask: Callable[[Connection], object]) -> float:
    """Return the median time of a question, each in a transaction of its own."""
    taken = []
    for _ in range(8):
        began = time.perf_counter()
        with database.transaction() as connection:
            ask(connection)
        taken.append((time.perf_counter() - began) * 1e3)
    return statistics.median(taken[1:])


def answers(url: str, runs: int) -> None:
    """Print how long the two questions take in a plant of so many runs."""
    with closing(Database(url)) as database:
        database.make()
        began = time.perf_counter()
        with database.transaction() as connection:
            fill(connection, runs)
        with database.transaction() as connection:
            connection.execute(text("ANALYZE"))
        filled_s = time.perf_counter() - began
        now = datetime.now(UTC)
        count = max(1, runs // RUNS_PER_CELL)
        times = {
            "cells": milliseconds(database, lambda each: cells(each, now)),
            "robot": milliseconds(database, lambda each: robots(each, f"R-{count // 2}")),
        }
    words = ", ".join(
        f"{name} {ms:.0f} ms ({'reached' if ms <= TARGETS_MS[name] else 'MISSED'}"
        f" {TARGETS_MS[name]:.0f})"
        for name, ms in times.items()
    )
    plant = f"{runs:7} runs of {count:3} cells, {runs * POINTS} points"
    print(f"{plant}: {words}; made in {filled_s:.0f} s")


def shipping(url: str, folder: Path) -> None:
    """Print how many points arrive a second."""
    words = ("run", "--runs", str(folder / "model"), "--name", "small", *sets(SMALL))
    command(*HILCELL, *words)()
    model = Model(folder / "model" / "small", whole=True)
    for n in range(SHIPPED):
        began = datetime.now(UTC) - timedelta(days=10 * n + 1)
        model.write(folder / "runs", Run(f"run-{n}", "north", "HC-1", began))
    with closing(Database(url)) as database:
        database.make()
        began_s, cpu_s = time.perf_counter(), time.process_time()
        done = ship(folder / "runs", database)
        taken_s, cpu_s = time.perf_counter() - began_s, time.process_time() - cpu_s
        again_s = time.perf_counter()
        ship(folder / "runs", database)
        again_s = time.perf_counter() - again_s
    pace = done.points / taken_s
    verdict = "reached" if pace >= TARGET_POINTS_S else "MISSED"
    print(
        f"shipped {done.runs} runs, {done.points} points in {taken_s:.1f} s ({cpu_s:.1f} of a core "
        f"here): {pace:.0f} points/s, target {TARGET_POINTS_S:.0f}: {verdict}; "
        f"nothing to ship: {again_s * 1e3:.0f} ms"
    )


def main() -> None:
    if MISSING:
        sys.exit(MISSING)
    sizes = [int(word) for word in sys.argv[1:]] or list(SIZES)
    with server(settings=()) as found, tempfile.TemporaryDirectory() as folder:
        shipping(found.make("shipping"), Path(folder))
        for size in sizes:
            answers(found.make(f"plant_{size}"), size)


if __name__ == "__main__":
    main()
