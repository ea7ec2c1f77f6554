"""``python -m benchmarks.plant [--full] [RUNS ..]``: a plant's records, and how fast they answer.

``--full``: every question at three sizes, five years of cells of 1000 runs each. Every eighth run
is a calibration of 64 vertices with all that a real one ships: 11 frames, 13 verdicts, certified
lengths, a calibration file (of 10 kB, a real one has 200) and its grid. In every twentieth cell the
robot has a step, and a station grows worse. Every run has its row of `hilcell runs`, four devices
and, one of three, an alarm; every fiftieth was opened again. Points are few there.

Each question is asked several times by a process of its own. The medians are printed: the time that
passed; in brackets the processor's time here and in the server's process, by which targets are
judged, as other work on the machine changes it less; and the peak of memory. A command is a whole
process with its start; what the server worked for it is not in brackets.

Without ``--full``: the pace of shipping whole journals of a small calibration, hash chains checked,
and the points of one run among 2 x 10^7, which take 6 GB.

PostgreSQL runs in a folder of its own, with its usual settings.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
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
from hilcell.plant.cells import cells, inconsistencies
from hilcell.plant.database import Database
from hilcell.plant.equipment import alarms, instruments, robots, worse_stations
from hilcell.plant.shipper import ship
from hilcell.plant.tables import POINT, RUN
from tests.hilcell.plant.server import MISSING, server
from tests.hilcell.plant.year import Model, Run
from tests.whole.bench import HILCELL, SMALL, hilcell, sets

SIZES = (2_000, 20_000, 200_000)
POINTS_RUNS = 200_000  # of 100 points
RUNS_PER_CELL = 1000
VERTICES = 64
SHIPPED = 40
TIMES = 6  # the first warms up
TARGET_POINTS_S = 2000.0
MOST_MB = 200.0
DASHBOARD = Path(__file__).parents[1] / "docs/examples/grafana-plant.json"

_RUNS = """
INSERT INTO run (digest, run_key, revision, head, cell_key, name, cell, serial,
    simulated, machine, procedure, state, exit, begun, first_ended, ended, points, proven,
    robot, tracker, devices, version, shipped)
SELECT md5('digest' || n)::uuid, md5('key' || n)::uuid, 500, md5('head' || n) || md5('' || n),
    encode(substr(sha256(convert_to(
        json_build_array('cell-' || cell, 'HC-' || cell, '')::text, 'UTF8')), 1, 16), 'hex')::uuid,
    'run-' || n, 'cell-' || cell, 'HC-' || cell,
    false, '', 'calibrate', 'finished', 0, t, t + interval '1 hour', t + interval '1 hour',
    :points, n % 8 = 0, 'R-' || cell, 'T-' || cell % 40, md5('devices' || cell)::uuid,
    '0.1.0', t + interval '2 hours'
FROM (
    SELECT n, n / :each AS cell,
        date_trunc('second', now() - interval '5 years' * (1 - (n % :each + 0.5) / :each)) AS t
    FROM generate_series(0, :runs - 1) AS n
) AS made_up
"""
_AGAIN = """
INSERT INTO run (digest, run_key, revision, head, cell_key, name, cell, serial,
    simulated, machine, procedure, state, exit, begun, first_ended, ended, points, proven,
    robot, tracker, devices, version, shipped)
SELECT md5('again' || digest)::uuid, run_key, 510, md5('again' || head) || md5(head),
    cell_key, name, cell, serial, simulated, machine, procedure, state, exit, begun,
    first_ended, ended + interval '10 minutes', points, proven, robot, tracker, devices, version,
    shipped
FROM run WHERE substr(name, 5)::integer % 50 = 8
"""
_SUPERSEDED = """
UPDATE run SET newest = false
WHERE revision < (SELECT max(revision) FROM run AS every WHERE every.run_key = run.run_key
    AND every.cell_key = run.cell_key)
"""
_OUTCOMES = """
INSERT INTO outcome (digest, row) SELECT digest, replace(replace(replace(replace(replace(
    CASE WHEN proven THEN :made ELSE :other END, '@name@', name),
    '@ended@', to_char(ended AT TIME ZONE 'UTC', 'YYYY-MM-DD"T"HH24:MI:SS"Z"')),
    '@begun@', to_char(begun AT TIME ZONE 'UTC', 'YYYY-MM-DD"T"HH24:MI:SS"Z"')),
    '@cell@', cell), '@serial@', serial)::json FROM run
"""
_DEVICES = """
INSERT INTO device (digest, n, kind, device, maker, model, serial, firmware, simulated)
SELECT digest, n, kind, device, maker, model,
    CASE kind WHEN 'tracker' THEN tracker WHEN 'robot' THEN robot ELSE kind || cell END,
    firmware, false
FROM run, (VALUES (0, 'drive', 'Rail', 'Lenze', 'i950 servo drive of the rail', 'revision 1.4'),
    (1, 'strip', 'Rail', 'SIKO', 'MSA501 absolute magnetic strip', 'revision 0.1'),
    (2, 'robot', 'Robot', 'KUKA', '#KR210R2700_2 C4 FLR', 'hilcell.src 4'),
    (3, 'tracker', 'Tracker', 'Leica', 'Leica AT401, emScon 3.8.0', 'emScon 3.8.0')
) AS each (n, kind, device, maker, model, firmware)
"""
_ALARMS = """
INSERT INTO alarm (digest, n, t, code, severity, title, place, found)
SELECT digest, 0, begun, 'HC-B' || (20 + substr(name, 5)::integer % 17), 'warning',
    'an alarm of the robot, kind ' || substr(name, 5)::integer % 17, 'Robot: move',
    'something that was seen' FROM run WHERE substr(name, 5)::integer % 3 = 0
"""
_FRAMES = """
INSERT INTO frame (digest, key, matrix, covariance) SELECT digest, key, format(
    '[[1,0,0,%s],[0,1,0,%s],[0,0,1,%s],[0,0,0,1]]', random(), random(), random())::json, :covariance
FROM run, unnest(ARRAY['base', 'world', 'station.S1100', 'station.S300', 'station.S1900',
    'touch.S1100', 'touch.S300', 'touch.S1900', 'three_points.S1100', 'three_points.S300',
    'three_points.S1900']) AS key WHERE proven
"""
_VERDICTS = """
INSERT INTO verdict (digest, key, holds, mean_mm, "mean_U_mm", mean_tolerance_mm, body)
SELECT digest, key, true, CASE WHEN key LIKE 'validation.%' THEN .08 + .01 * random()
        + CASE WHEN key = 'validation.S300' AND substr(cell, 6)::integer % 20 = 3
        THEN .02 * extract(epoch FROM begun) / 157788000 ELSE 0 END END,
    .004, .3, :body
FROM run, unnest(ARRAY['validation.S300', 'validation.S1100', 'validation.S1900',
    'validation.others', 'known-length', 'two-face', 'reversal', 'revisits', 'fit', 'sign',
    'suspicions', 'two-face.closing', 'revisits.closing']) AS key WHERE proven
"""
_LENGTHS = """
INSERT INTO length (digest, n, nests, wanted_mm, found_mm, "U_mm")
SELECT digest, n, n || '-' || n + 1, 1000 + n, 1000 + n + .02 * (random() - .5), .01
FROM run, generate_series(0, 5) AS n WHERE proven
"""
_GRIDS = """
INSERT INTO grid (digest, layout, places_mm, errors_mm, base_mm, mean_mm, temperature_c)
SELECT digest, md5('places')::uuid, :places, (
    SELECT decode(string_agg(  -- little-endian numbers from 1 to 2, or from 2 to 4
        lpad(to_hex((random() * 281474976710655)::bigint), 12, '0') || left(n::text, 0)
        || CASE WHEN hit THEN '0' ELSE 'f' END || to_hex((random() * 15)::integer)
        || CASE WHEN hit THEN '40' ELSE '3f' END, ''), 'hex')
    FROM generate_series(1, 3 * :vertices) AS n
), (SELECT decode(string_agg(lpad(to_hex((random() * 281474976710655)::bigint), 12, '0')
        || left(n::text, 0) || 'f03f', ''), 'hex') FROM generate_series(1, 9) AS n
    WHERE hit IS NOT NULL), 2.6 + hit::integer, 20 + 4 * random()
FROM run, LATERAL (SELECT begun > now() - interval '2 years'
    AND substr(cell, 6)::integer % 20 = 3 AS hit) AS step WHERE proven
"""
_DOCUMENTS = """
INSERT INTO document (digest, name, sha256, text)
SELECT digest, 'calibration.json', md5(text) || md5(text), text FROM (
    SELECT digest, (SELECT string_agg(md5(digest::text || n), '') FROM generate_series(1, 312) AS n)
        AS text FROM run WHERE proven) AS every
"""
_POINTS = """
INSERT INTO point (digest, seq, t, key, kind, station, frame, reflector, x_mm, y_mm, z_mm,
    std_x_mm, std_y_mm, std_z_mm, samples, session, set_up, retaken, superseded)
SELECT digest, n, begun, 'grid/' || n, 'grid', 'S1100', 'tracker', 'SMR 1.5in',
    random(), random(), random(), 0.01, 0.01, 0.01, 10, 1, 0, false, false
FROM run, generate_series(1, :points) AS n
"""


def fill(connection: Connection, runs: int, points: int, *, full: bool) -> None:
    """Let the server make the rows of so many runs."""
    made = CalibrationFacts(kind="made", validated=True, judged=True, outcome=Outcome.ACCEPTED)
    other = RunRow(
        name="@name@", begun="@begun@", ended="@ended@", state="finished", exit=0, cell="@cell@",
        serial="@serial@", procedure="calibrate", points=points, moved=True,
    )  # fmt: skip

    def encoded(value: object) -> str:
        return msgspec.json.encode(value).decode()

    rng = np.random.default_rng(1)
    values = {
        "points": points, "each": RUNS_PER_CELL, "runs": runs, "vertices": VERTICES,
        "other": encoded(other), "made": encoded(msgspec.structs.replace(other, facts=made)),
        "places": rng.uniform(0.0, 900.0, (VERTICES, 3)).tobytes(),
        "covariance": encoded(rng.uniform(0.0, 1e-4, (6, 6)).tolist()),
        "body": encoded({"check": "tolerance", "limits_mm": rng.uniform(0.0, 1.0, 20).tolist()}),
    }  # fmt: skip
    parts = (
        _AGAIN,
        _SUPERSEDED,
        _OUTCOMES,
        _DEVICES,
        _ALARMS,
        _FRAMES,
        _VERDICTS,
        _LENGTHS,
        _GRIDS,
        _DOCUMENTS,
    )
    # By the trigger, each run of the transaction would hold a lock.
    connection.execute(text("ALTER TABLE run DISABLE TRIGGER USER"))
    for order in (_RUNS, *(parts if full else ()), _POINTS):
        connection.execute(text(order), values)
    connection.execute(text("ALTER TABLE run ENABLE TRIGGER USER"))


# -- questions ------------------------------------------------------------------------------------

Question = Callable[[Connection], object]


def points_of_a_run(connection: Connection) -> None:
    """Read the points of a run, as an export does."""
    run = connection.execute(select(RUN.c.digest).where(RUN.c.name == "run-16").limit(1)).one()
    assert connection.execute(select(POINT).where(POINT.c.digest == run.digest)).all()


CELLS = {f"cell-{n}" for n in range(200)}
QUESTIONS: dict[str, Question] = {
    "state of all cells": lambda each: cells(each, datetime.now(UTC)),
    "drift of all robots": robots,
    "drift of one robot": lambda each: robots(each, "R-1"),
    "doubts": lambda each: inconsistencies(each, CELLS),
    "stations": worse_stations,
    "instruments": instruments,
    "alarms": alarms,
    "points of a run": points_of_a_run,
}
COMMANDS = {"`plant show`": (), "`plant show --cell`": ("--cell", "cell-1")}
MOST_MS = {"state of all cells": 100.0, "points of a run": 25.0}
OTHERS_MS = 1000.0


class Taken(NamedTuple):
    """Milliseconds of a question, as they passed and of processor (here, and in the server's
    process), and the peak of its process in MB.
    """

    passed_ms: float
    worked_ms: float
    peak_mb: float

    def __str__(self) -> str:
        return f"{self.passed_ms:.0f} ms ({self.worked_ms:.0f}), {self.peak_mb:.0f} MB"


def _worked_s(pid: int) -> float:
    """Return the processor's seconds of this process and of another one."""
    other_ns = int(Path(f"/proc/{pid}/schedstat").read_text().split()[0])
    return time.process_time() + other_ns * 1e-9


def panels() -> dict[str, Question]:
    """Return the questions of the Grafana dashboard, for all cells and five years."""

    def asked(sql: str) -> Question:
        sql = re.sub(r"\$__timeFilter\(([\w.]+)\)", r"\1 > now() - interval '6 years'", sql)
        sql = sql.replace("${cell:sqlstring}", "SELECT DISTINCT cell FROM run")
        return lambda each: each.exec_driver_sql(sql.replace("%", "%%")).all()

    found: list[dict[str, object]] = json.loads(DASHBOARD.read_text("utf-8"))["panels"]
    return {
        f"Grafana: {panel['title']}": asked(str(panel["targets"][0]["rawSql"]))  # type: ignore[index]
        for panel in found
    }


def ask(url: str, name: str) -> Taken:
    """Ask one question several times, in a process of its own."""
    question = (QUESTIONS | panels())[name]
    taken = []
    with closing(Database(url)) as database:
        for _ in range(TIMES):
            with database.transaction() as connection:
                pid = connection.execute(text("SELECT pg_backend_pid()")).scalar_one()
                began_s, began_cpu_s = time.perf_counter(), _worked_s(pid)
                question(connection)
                taken.append((time.perf_counter() - began_s, _worked_s(pid) - began_cpu_s))
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return _median(taken, peak_mb)


def order(url: str, words: tuple[str, ...]) -> Taken:
    """Run `plant show` several times, with the start of its process; the server's is not counted
    as worked.
    """
    taken, peak_mb = [], 0.0
    for _ in range(TIMES):
        began_s = time.perf_counter()
        child = subprocess.Popen(
            [*HILCELL, "plant", "show", "--from", url, *words], stdout=subprocess.DEVNULL
        )
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        assert child.returncode == 0
        taken.append((time.perf_counter() - began_s, used.ru_utime + used.ru_stime))
        peak_mb = max(peak_mb, used.ru_maxrss / 1024.0)
    return _median(taken, peak_mb)


def _median(taken_s: list[tuple[float, float]], peak_mb: float) -> Taken:
    passed_s, worked_s = zip(*taken_s[1:], strict=True)
    return Taken(statistics.median(passed_s) * 1e3, statistics.median(worked_s) * 1e3, peak_mb)


def answers(url: str, runs: int) -> dict[str, Taken]:
    """Return what each question takes in a plant of so many runs."""
    with closing(Database(url)) as database:
        database.create()
        began_s = time.perf_counter()
        with database.transaction(migrating=True) as connection:
            fill(connection, runs, 8, full=True)
        with database.engine.connect().execution_options(
            isolation_level="AUTOCOMMIT"
        ) as connection:
            connection.execute(text("VACUUM ANALYZE"))
            size = "SELECT pg_database_size(current_database())"
            gigabytes = connection.execute(text(size)).scalar_one() / 1e9
    print(f"{runs} runs: {gigabytes:.2f} GB, {time.perf_counter() - began_s:.0f} s", flush=True)
    found = {}
    spawn = multiprocessing.get_context("spawn")
    for name in (*QUESTIONS, *panels()):
        with ProcessPoolExecutor(1, spawn) as alone:
            found[name] = alone.submit(ask, url, name).result()
        print(f"  {name}: {found[name]}", flush=True)
    return found | {name: order(url, words) for name, words in COMMANDS.items()}


def full(sizes: list[int], make: Callable[[str], str]) -> None:
    """Print the table of all questions at these sizes."""
    found = [answers(make(f"plant_{size}"), size) for size in sizes]
    print("| question |" + "".join(f" {size} runs |" for size in sizes) + " at most |")
    print("|---|" + "---|" * (len(sizes) + 1))
    for name in found[0]:
        most_ms = MOST_MS.get(name, OTHERS_MS)
        shown = "".join(f" {each[name]} |" for each in found)
        last = found[-1][name]
        held = last.worked_ms <= most_ms and last.peak_mb <= MOST_MB
        print(f"| {name} |{shown} {most_ms:.0f} ms{'' if held else ': MISSED'} |")


def points(url: str) -> None:
    """Print how long the points of one run take among all."""
    with closing(Database(url)) as database:
        database.create()
        with database.transaction(migrating=True) as connection:
            fill(connection, POINTS_RUNS, 100, full=False)
            size = "SELECT pg_total_relation_size('point')"
            gigabytes = connection.execute(text(size)).scalar_one() / 1e9
    taken = ask(url, "points of a run")
    print(f"the 100 points of a run among {POINTS_RUNS * 100:.0e} ({gigabytes:.1f} GB): {taken}")


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
    words.add_argument("--full", action="store_true")
    words.add_argument("sizes", type=int, nargs="*", default=SIZES, metavar="RUNS")
    given = words.parse_args()
    if MISSING:
        sys.exit(MISSING)
    with server(settings=()) as found, tempfile.TemporaryDirectory() as folder:
        print(f"load {os.getloadavg()[1]:.0f} on {os.cpu_count()} cores", flush=True)
        if given.full:
            full(list(given.sizes), found.make)
        else:
            shipping(found.make("shipping"), Path(folder))
            points(found.make("points"))


if __name__ == "__main__":
    main()
