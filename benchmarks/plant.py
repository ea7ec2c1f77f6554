"""``python -m benchmarks.plant [RUNS ..]``: questions to a plant's records, and how fast they come.

Runs are made by the server at three sizes, five years of cells of 1000 runs each, every eighth a
calibration of 64 vertices; 100 points a run, in partitions by month: up to 2 x 10^7, which take
6 GB. PostgreSQL runs in a folder of its own, with its usual settings. The pace of shipping is
measured with whole journals of a small calibration, hash chains checked. In brackets stands the
processor's time, here and in the server's process; targets are judged by it, as other work on the
machine changes it less.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from sqlalchemy import Connection, select, text

from benchmarks.words import parser
from hilcell.journal.calibration_facts import CalibrationFacts
from hilcell.journal.index import RunRow
from hilcell.model.outcome import Outcome
from hilcell.plant.cells import cells
from hilcell.plant.database import Database
from hilcell.plant.equipment import robots
from hilcell.plant.shipper import ship
from hilcell.plant.tables import POINT, RUN
from tests.hilcell.plant.server import MISSING, server
from tests.hilcell.plant.year import Model, Run
from tests.whole.bench import SMALL, hilcell, sets

SIZES = (2_000, 20_000, 200_000)
RUNS_PER_CELL = 1000
CALIBRATION = 8  # every eighth run
VERTICES = 64
POINTS = 100
SHIPPED = 40
TARGETS_MS = {"cells": 100.0, "robot": 300.0}  # the points of one run have none
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
FROM (SELECT month, digest, begun FROM run ORDER BY month, digest) AS run,
    generate_series(1, :points) AS n
"""


def fill(connection: Connection, runs: int) -> None:
    places_mm = np.random.default_rng(1).uniform(0.0, 900.0, (VERTICES, 3)).tolist()
    common = RunRow(
        name="@name@", begun="@t@", ended="@t@", state="finished", exit=0, cell="c", serial="s"
    )
    made = CalibrationFacts(kind="made", validated=True, judged=True, outcome=Outcome.ACCEPTED)
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


class Taken(NamedTuple):
    """Milliseconds of one question: as they passed, and of processor here and in the server."""

    passed: float
    worked: float

    def __str__(self) -> str:
        return f"{self.passed:.0f} ms ({self.worked:.0f})"


def milliseconds(database: Database, ask: Callable[[Connection], object]) -> Taken:
    """Return the median times of a question, each in a transaction of its own."""
    taken = []
    for _ in range(12):
        with database.transaction() as connection:  # the pool has one
            pid = connection.execute(text("SELECT pg_backend_pid()")).scalar_one()
            began_s, began_cpu_s = time.perf_counter(), _worked_s(pid)
            ask(connection)
            taken.append((time.perf_counter() - began_s, _worked_s(pid) - began_cpu_s))
    passed, worked = zip(*taken[2:], strict=True)
    return Taken(statistics.median(passed) * 1e3, statistics.median(worked) * 1e3)


def _worked_s(pid: int) -> float:
    """Return the processor's seconds of this process and of another one."""
    other_ns = int(Path(f"/proc/{pid}/schedstat").read_text().split()[0])
    return time.process_time() + other_ns * 1e-9


def points_of_a_run(connection: Connection, name: str) -> None:
    """Read the points of a run, as an export does."""
    run = connection.execute(select(RUN.c.digest, RUN.c.month).where(RUN.c.name == name)).one()
    own = (POINT.c.month == run.month, POINT.c.digest == run.digest)
    assert len(connection.execute(select(POINT).where(*own)).all()) == POINTS


def answers(url: str, runs: int) -> None:
    """Print how long the questions take in a plant of so many runs, as a row of a table."""
    count = max(1, runs // RUNS_PER_CELL)
    with closing(Database(url)) as database:
        database.create()
        began_s = time.perf_counter()
        with database.transaction() as connection:
            fill(connection, runs)
        with database.transaction() as connection:
            connection.execute(text("ANALYZE"))
            size = "SELECT pg_database_size(current_database())"
            gigabytes = connection.execute(text(size)).scalar_one() / 1e9
        filled_s = time.perf_counter() - began_s
        now = datetime.now(UTC)
        times = {
            "cells": milliseconds(database, lambda each: cells(each, now)),
            "robot": milliseconds(database, lambda each: robots(each, f"R-{count // 2}")),
            "points": milliseconds(
                database, lambda each: points_of_a_run(each, f"run-{runs // 2}")
            ),
        }
    missed = [name for name, most_ms in TARGETS_MS.items() if times[name].worked > most_ms]
    print(
        f"| {runs} | {count} | {runs * POINTS:.0e} | {gigabytes:.1f} GB "
        f"| {times['cells']} | {times['robot']} | {times['points']} | {filled_s:.0f} s "
        f"| {'missed: ' + ', '.join(missed) if missed else 'reached'} |",
        flush=True,
    )


def shipping(url: str, folder: Path) -> None:
    """Print how many points arrive a second."""
    words = ("run", "--runs", str(folder / "model"), "--name", "small", *sets(SMALL))
    hilcell(*words).check_returncode()
    model = Model(folder / "model" / "small", whole=True)
    for n in range(SHIPPED):
        began = datetime.now(UTC) - timedelta(days=10 * n + 1)
        model.write(folder / "runs", Run(f"run-{n}", "north", "HC-1", began))
    with closing(Database(url)) as database:
        database.create()
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
    words = parser(__doc__)
    words.add_argument("sizes", type=int, nargs="*", default=SIZES, metavar="RUNS")
    sizes = words.parse_args().sizes
    if MISSING:
        sys.exit(MISSING)
    with server(settings=()) as found, tempfile.TemporaryDirectory() as folder:
        shipping(found.make("shipping"), Path(folder))
        print(f"load {os.getloadavg()[1]:.0f} on {os.cpu_count()} cores")
        print(
            f"| runs | cells | points | on disk | last state of all cells (<= "
            f"{TARGETS_MS['cells']:.0f}) | drift of one robot (<= {TARGETS_MS['robot']:.0f}) "
            "| points of one run | made in | targets |\n|---|---|---|---|---|---|---|---|---|"
        )
        for size in sizes:
            answers(found.make(f"plant_{size}"), size)


if __name__ == "__main__":
    main()
