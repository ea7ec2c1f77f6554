"""A year of three cells, shipped and asked by the command: a collision in one of them is named."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psycopg
import pytest
from psycopg.rows import dict_row
from sqlalchemy import text

from hilcell.commands.plant import INSTRUMENTS, STATIONS
from hilcell.journal.runs import read_records
from hilcell.plant.database import Database
from hilcell.plant.equipment import ARM, Instrument, StationTrend
from hilcell.plant.rights import ENGINEER
from hilcell.plant.shipper import ship
from hilcell.present.table import Table
from tests.conftest import shared_folder
from tests.hilcell.plant.conftest import DAY, NOW
from tests.hilcell.plant.server import BLANK, Server
from tests.hilcell.plant.year import (
    COLLISION,
    TURN_RAD,
    Model,
    Run,
    extend,
    noisy,
    turned,
    write_journal,
    year,
)
from tests.whole.bench import command
from tests.whole.golden import once

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def filed(model: Model, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the URL of an office's database to which the year was shipped, once for all workers.

    Nobody changes it.
    """
    shared = shared_folder(tmp_path_factory)

    def shipped() -> str:
        runs, url = shared / "year", f"sqlite:///{shared}/year.db"
        year(model, runs, datetime.now(UTC) - 20 * DAY)
        assert command("plant", "init", "--to", url).returncode == 0
        done = json.loads(command("plant", "ship", runs, "--to", url, "--json").stdout)
        assert (done["shipped"], done["refused"]) == (37, {})
        return url

    return once(shared / "year.url", shipped)


def asked(url: str, *words: str) -> dict[str, Any]:
    done = command("plant", "show", "--from", url, "--json", *words)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def asked_after(url: str, *folders: Path) -> dict[str, Any]:
    for folder in folders:
        assert command("plant", "ship", folder, "--to", url).returncode == 0
    return asked(url)


def test_a_year_of_three_cells(filed: str) -> None:
    found = asked(filed)
    _check_cells(found)
    _check_collision(found)
    (worse,) = found["stations"]
    assert (worse["cell"], worse["station"]) == ("south", "S300")
    assert worse["low_mm_per_year"] <= 0.12 <= worse["high_mm_per_year"]
    trackers = {each["serial"]: each for each in found["instruments"] if each["kind"] == "tracker"}
    assert {serial: each["disagrees_with"] for serial, each in trackers.items()} == {
        "T-0": [], "T-1": [], "T-2": ["T-0", "T-1"],
    }  # fmt: skip
    _check_axes(trackers["T-0"]["axes"])
    assert [(each["code"], each["cells"]) for each in found["alarms"]] == [
        (COLLISION["code"], ["middle"])
    ]
    assert found["doubts"] == []


def _check_axes(axes: list[dict[str, Any]]) -> None:
    assert [each["axis"] for each in axes] == ["collimation", "transit", "index"]
    assert [(each["checks"], each["urad"]) for each in axes] == [(12, 23.0), (12, -1.0), (12, 3.0)]
    collimation, transit, _ = axes
    assert collimation["urad_per_year"] == pytest.approx(24.0, abs=collimation["U_urad_per_year"])
    assert 0.0 < collimation["U_urad_per_year"] < 2.0
    assert transit["urad_per_year"] == pytest.approx(0.0, abs=1e-9)


def _check_cells(found: dict[str, Any]) -> None:
    assert [each["cell"] for each in found["cells"]] == ["middle", "north", "south"]
    for each in found["cells"]:
        assert each["condition"] == "valid"
        assert each["calibration"] == f"{each['cell']}-11"
        assert each["days_left"] == pytest.approx(160.0, abs=0.2)


def _check_collision(found: dict[str, Any]) -> None:
    changes = [(each["cell"], change) for each in found["robots"] for change in each["changes"]]
    ((cell, change),) = changes
    assert cell == "middle"
    assert (change["after"], change["before"], change["confirmed"]) == (
        "middle-05", "middle-06", True,
    )  # fmt: skip
    assert any("middle-hit" in words and COLLISION["code"] in words for words in change["said"])
    # The arm turned about z: a vertex at radius r moved by r times the angle.
    assert change["size_mm"] == pytest.approx(TURN_RAD * 1900.0, rel=0.1)
    assert not any(drift["drifts"] for each in found["robots"] for drift in each["drift"])


def test_a_collision_after_the_grid_was_measured_is_named(
    model: Model, office: Database, tmp_path: Path
) -> None:
    """The run that it ended is the last one before the step."""
    runs, last = tmp_path / "runs", datetime.now(UTC) - 20 * DAY
    hit = Run("hit", "middle", "HC-1", last - 81 * DAY, fault=COLLISION, late=True)
    others = [Run(f"m{at}", "middle", "HC-1", last - 20 * at * DAY) for at in range(8)]
    for at, run in enumerate([hit, *others]):
        moved = turned if run is not hit and run.began > hit.began else np.zeros_like
        model.write(runs, replace(run, moved=partial(noisy, at, moved)))
    found = asked_after(office.name, runs)
    (change,) = found["robots"][0]["changes"]
    assert (change["after"], change["before"]) == ("hit", "m4")
    (words,) = change["said"]
    assert COLLISION["code"] in words
    assert "(hit)" in words


def test_the_order_of_arrival_changes_no_answer(
    model: Model, office: Database, tmp_path: Path
) -> None:
    """A cell's PC without network ships its oldest runs last."""
    now = datetime.now(UTC)
    for at in range(9):
        moved = partial(noisy, at, turned if at > 4 else np.zeros_like)
        means_mm = {"S300": 0.1 + 0.01 * at}
        run = Run(f"r{at}", "north", "HC-1", now - (20 - at) * DAY, moved=moved, means_mm=means_mm)
        model.write(tmp_path / ("early" if at < 6 else "late"), run)
    found = asked_after(office.name, tmp_path / "late", tmp_path / "early")
    (robot,) = found["robots"]
    assert [(each["after"], each["before"]) for each in robot["changes"]] == [("r4", "r5")]
    assert datetime.fromisoformat(robot["first"]) < datetime.fromisoformat(robot["last"])
    (worse,) = found["stations"]
    assert worse["mm_per_year"] == pytest.approx(0.01 * 365.25, rel=0.01)


def test_minutes_tell_no_change_a_year(model: Model, office: Database, tmp_path: Path) -> None:
    now = datetime.now(UTC)
    for at in range(9):
        moved = partial(noisy, at, turned if at > 4 else np.zeros_like)
        run = Run(f"r{at}", "north", "HC-1", now - timedelta(minutes=90 - 10 * at), moved=moved,
                  means_mm={"S300": 0.1 + 0.01 * at}, axes_urad=(2.0, -1.0, 3.0))  # fmt: skip
        model.write(tmp_path / "runs", run)
    found = asked_after(office.name, tmp_path / "runs")
    (robot,) = found["robots"]
    assert [(each["after"], each["before"]) for each in robot["changes"]] == [("r4", "r5")]
    assert robot["drift"] == found["stations"] == []
    (axes,) = (each["axes"] for each in found["instruments"] if each["kind"] == "tracker")
    reasons = [robot["not_judged"][ARM], *(each["not_judged"] for each in axes)]
    assert len(reasons) == 4
    assert all("too short" in each for each in reasons)
    assert [each["urad_per_year"] for each in axes] == [None] * 3


def test_a_monitor_has_an_exit_code_and_a_file(filed: str, tmp_path: Path) -> None:
    """The calibrations are 20 days old."""
    file = tmp_path / "plant.prom"
    words = ("plant", "show", "--from", filed, "--check", "--metrics", file)
    for days, code, valid, left in ((180, 0, 1.0, 160.0), (10, 1, 0.0, -10.0)):
        assert command(*words, "--max-age", str(days)).returncode == code
        values: dict[str, list[float]] = {}
        for line in file.read_text().splitlines():
            name, _, value = line.partition("{")
            if not line.startswith("#"):
                assert 'cell="' in value
                values.setdefault(name, []).append(float(value.rpartition(" ")[2]))
        assert values["hilcell_plant_calibration_valid"] == [valid] * 3
        assert values["hilcell_plant_calibration_days_left"] == pytest.approx([left] * 3, abs=0.2)
        arrived = values["hilcell_plant_last_shipped_timestamp_seconds"]
        assert arrived == pytest.approx([datetime.now(UTC).timestamp()] * 3, abs=86400.0)
    assert command("plant", "show", "--from", filed, "--max-age", "10").returncode == 0
    assert [each.name for each in tmp_path.iterdir()] == [file.name]
    line = command("plant", "show", "--from", filed, "--metrics", tmp_path / "no" / "x").stderr
    assert str(tmp_path / "no") in line


def test_a_label_is_one_word_to_prometheus(model: Model, office: Database, tmp_path: Path) -> None:
    model.write(tmp_path / "runs", Run("a", "north", "HC-1", NOW - 9 * DAY))
    asked_after(office.name, tmp_path / "runs")
    names = ['n"o\\th', "no\u200bth", "no\u200cth", "no\\u200bth"]
    series = set()
    for name in names:
        with office.transaction() as connection:
            connection.execute(text("UPDATE run SET cell = :cell"), {"cell": name})
        asked(office.name, "--metrics", str(tmp_path / "plant.prom"))
        series.add((tmp_path / "plant.prom").read_text().splitlines()[2])
    assert len(series) == len(names)
    assert any('cell="n\\"o\\\\\\\\th"' in each for each in series)


def test_tables_name_the_collision_too(filed: str) -> None:
    out = command("plant", "show", "--from", filed).stdout
    for words in ("middle-06", f"{COLLISION['code']} ", "(middle-hit)", "T-0, T-1", "S300"):
        assert words in out


def test_a_hall_is_shown_by_what_asks_for_an_act(filed: str) -> None:
    """All cells, and of the rest what changed: --all, --cell and --json have all rows."""
    needed = command("plant", "show", "--from", filed).stdout
    whole = command("plant", "show", "--from", filed, "--all").stdout
    for words in ("middle-11", "north-11", "south-11", "T-0, T-1"):
        assert words in needed
    every = asked(filed)
    hidden = [
        sum(len(each["drift"]) for each in every["robots"]),
        sum(not each["disagrees_with"] for each in every["instruments"]),
    ]
    assert [int(each) for each in re.findall(r"not shown: .*: (\d+);", needed)] == hidden
    assert "R-0" not in needed
    assert "not shown" not in whole
    for out in (whole, command("plant", "show", "--from", filed, "--cell", "north").stdout):
        assert "R-0" in out


def test_cells_that_need_a_calibration_are_first(
    model: Model, office: Database, tmp_path: Path
) -> None:
    now = datetime.now(UTC)
    for cell, days in (("a", 20), ("b", 200), ("c", 175)):
        model.write(tmp_path / "runs", Run(f"run-{cell}", cell, f"HC-{cell}", now - days * DAY))
    asked_after(office.name, tmp_path / "runs")
    first, *lines = command("plant", "show", "--from", office.name).stdout.splitlines()
    assert [int(each) for each in re.findall(r"\d+", first)] == [3, 1, 1, 14]
    names = [found[1] for line in lines if (found := re.search(r"\brun-([abc]), finished", line))]
    assert names == ["b", "c", "a"]


def test_names_of_one_login_leave_room_for_those_of_others(
    model: Model, office: Database, tmp_path: Path
) -> None:
    for cell in ("north", "south"):
        fault = COLLISION if cell == "south" else None
        began = NOW - 9 * DAY
        model.write(
            tmp_path / "runs", Run(cell, cell, f"HC-{cell}", began, f"R-{cell}", fault=fault)
        )
    asked_after(office.name, tmp_path / "runs")
    count = 300
    with office.transaction() as connection:
        digest = connection.execute(
            text("SELECT digest FROM run WHERE cell = 'north'")
        ).scalar_one()
        rows = [
            {"digest": digest, "n": n, "t": "2026-01-01 00:00:00.000000", "code": f"HC-A{n}",
             "severity": "fault" if n == 99 else "notice"}
            for n in range(count, 0, -1)
        ]  # fmt: skip
        order = (
            "INSERT INTO alarm (digest, n, t, code, severity, title, place, found) VALUES "
            "(:digest, :n, :t, :code, :severity, 'x', 'x', 'x')"
        )
        connection.execute(text(order), rows)
    found = asked(office.name)
    assert COLLISION["code"] in {each["code"] for each in found["alarms"]}
    assert len(found["alarms"]) + found["left_out"]["alarms"] == count + 1
    assert found["left_out"]["alarms"] >= 100
    assert {each["code"] for each in found["alarms"] if each["severity"] == "fault"} == {
        COLLISION["code"],
        "HC-A99",
    }
    assert found["left_out"]["instruments"] == 0
    shown = command("plant", "show", "--from", office.name).stdout
    assert len(shown.splitlines()) < 60
    assert "HC-A99 " in shown
    assert "--robot SERIAL" in shown


def test_one_cell_or_one_robot_alone(filed: str) -> None:
    of_cell = asked(filed, "--cell", "north")
    assert {each["cell"] for each in of_cell["cells"]} == {"north"}
    assert {each["robot"] for each in of_cell["robots"]} == {"R-0"}
    assert of_cell["stations"] == of_cell["alarms"] == []
    of_robot = asked(filed, "--robot", "R-2")
    for table in ("cells", "robots", "stations"):
        assert {each["cell"] for each in of_robot[table]} == {"south"}
    devices = {each["serial"] for each in of_robot["instruments"]}
    assert {"R-2", "T-2"} <= devices
    assert not {"R-0", "T-0", "R-1", "T-1"} & devices
    assert of_robot["alarms"] == []
    assert len(asked(filed, "--robot", "R-1")["alarms"]) == 1
    for words in (("--cell", "nroth"), ("--robot", "R-9")):
        assert command("plant", "show", "--from", filed, *words).returncode == 2
    for days, condition in (("36500", "valid"), ("10", "too old")):
        found = asked(filed, "--max-age", days)["cells"]
        assert {each["condition"] for each in found} == {condition}


def test_doubtful_records_are_named(model: Model, office: Database, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    now = datetime.now(UTC)
    model.write(runs, Run("one", "north", "HC-1", NOW - 9 * DAY, real=True))
    model.write(runs, Run("two", "north", "HC-1", NOW - 9 * DAY + DAY / 86400, real=True))
    model.write(runs, Run("three", "south", "HC-1", NOW - 8 * DAY, real=True))
    model.write(runs, Run("late", "west", "HC-2", now + 3 * DAY))
    back = model.write(runs, Run("back", "east", "HC-3", NOW - 5 * DAY))
    rows = [
        (NOW - at * DAY, each.kind, each.key, each.body)
        for at, each in enumerate(read_records(back))
    ]
    shutil.rmtree(back)
    write_journal(back, rows)
    found = asked_after(office.name, runs)
    serial, at_once, ahead, set_back = found["doubts"]
    assert "back" in set_back
    assert "HC-1" in serial
    assert "north" in at_once
    assert "72.0 h" in ahead
    for cell, doubts in (("north", [serial, at_once]), ("south", [serial]), ("west", [ahead])):
        assert asked(office.name, "--cell", cell)["doubts"] == doubts
    west = next(each for each in found["cells"] if each["cell"] == "west")
    assert west["condition"] not in ("valid", "too old")


@pytest.mark.parametrize("real", [False, True])
def test_a_robot_in_two_cells_and_runs_of_one_name_are_doubted(
    real: bool, model: Model, office: Database, tmp_path: Path
) -> None:
    url, runs = office.name, tmp_path / "runs"
    for days, cell, robot in (
        (9, "north", "R-1"), (8, "south", "R-1"), (7, "north", "R-1"),
        (9, "east", "R-2"), (8, "east", "R-2"), (7, "west", "R-2"),
    ):  # fmt: skip
        began = NOW - days * DAY
        model.write(runs, Run(f"{cell}-{days}", cell, f"HC-{cell}", began, robot, real=real))
    other = Run("east-9", "east", "HC-east", NOW - 20 * DAY, "R-2", real=real)
    model.write(tmp_path / "more", other)
    asked_after(url, runs)
    extend(runs / "west-7", [(NOW, "event", "", {"what": "note", "text": "a further revision"})])
    robot, name = asked_after(url, tmp_path / "more", runs)["doubts"]
    assert "R-1" in robot
    assert "HC-east" in name
    assert asked(url, "--cell", "south")["doubts"] == [robot]
    assert asked(url, "--robot", "R-2")["doubts"] == [name]
    shown = command("plant", "show", "--from", url, "--cell", "west")
    assert shown.stdout.count("got 1") == 2  # too few for a drift


@pytest.mark.nightly
@pytest.mark.process
def test_a_year_of_calibrations_that_were_really_measured(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "benchmarks.plant_year", str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("the collision is named\n")


def test_a_plant_without_runs_is_shown(office: Database) -> None:
    assert command("plant", "show", "--from", office.name).returncode == 0


DASHBOARD = json.loads(
    (Path(__file__).parents[3] / "docs/examples/grafana-plant.json").read_text("utf-8")
)
PANELS = DASHBOARD["panels"]
MONTHS = 6
Rows = dict[str, list[dict[str, Any]]]


def as_grafana_sends(sql: str, cells: str) -> str:
    """Return a question with the variables filled in."""
    since = NOW - timedelta(days=400)
    sql = re.sub(
        r"\$__timeFilter\(([\w.]+)\)", rf"\1 BETWEEN '{since.isoformat()}' AND '{NOW}'", sql
    )
    return sql.replace("${cell:sqlstring}", cells)


def answered(server: Server, model: Model, runs: Path) -> Rows:
    """Return what each panel is answered, asked by an engineer."""
    year(model, runs, NOW - timedelta(days=1), MONTHS)
    url = server.make(like=BLANK)
    with closing(Database(url)) as database:
        ship(runs, database)
    with psycopg.connect(url, autocommit=True) as connection:
        asking = connection.cursor(row_factory=dict_row)
        (variable,) = DASHBOARD["templating"]["list"]
        cells = asking.execute(variable["query"]).fetchall()
        all_of_them = ",".join(f"'{each['cell']}'" for each in cells)
        asking.execute(f"SET ROLE {ENGINEER}".encode())
        return {
            panel["title"]: asking.execute(
                as_grafana_sends(target["rawSql"], all_of_them).encode()
            ).fetchall()
            for panel in PANELS
            for target in panel["targets"]
        }


@pytest.mark.process
def test_every_panel_has_its_answer_of_the_year(
    postgresql: Server, model: Model, tmp_path: Path
) -> None:
    rows = answered(postgresql, model, tmp_path)
    for panel in PANELS:
        found = rows[panel["title"]]
        assert found
        assert "$" not in as_grafana_sends(panel["targets"][0]["rawSql"], "'x'")
        if panel["type"] == "timeseries":
            assert list(found[0]) == ["time", "metric", "value"]
            assert [each["time"] for each in found] == sorted(each["time"] for each in found)
            assert all(isinstance(each["value"], float) for each in found)
    by_title = {title.partition(":")[0]: found for title, found in rows.items()}
    assert [(each["cell"], each["calibration"]) for each in by_title["Calibrations"]] == [
        (cell, f"{cell}-05") for cell in ("middle", "north", "south")
    ]
    ((code, times),) = {(each["code"], each["times"]) for each in rows["Alarms by kind"]}
    assert (code, times) == (COLLISION["code"], 1)
    worn = [each["value"] for each in by_title["Stations"] if each["metric"] == "south S300"]
    assert worn == sorted(worn)
    assert len(worn) == MONTHS
    south = [each["value"] for each in by_title["Trackers"] if each["metric"] == "T-2"]
    assert min(south) > 100.0
    axes = by_title["Trackers' axes"]
    assert {each["metric"] for each in axes if each["metric"].startswith("T-2")} == {
        f"T-2 {name}" for name in ("collimation", "transit", "index")
    }
    assert sum(each["runs"] for each in rows["Runs of a month by their end"]) == 3 * MONTHS + 1


def test_long_names_leave_room_for_the_row_s_own() -> None:
    odd = Instrument(
        kind="tracker", maker="Leica", model="AT401", serial="400200", firmware=[], cells=["a"],
        runs=1, first=NOW, last=NOW, disagrees_with=[f"4000{n:02}" for n in range(60)],
    )  # fmt: skip
    assert Table(INSTRUMENTS, [odd]).texts()[0][-1] == "400000, 400001, 400002 and 57 more"


@pytest.mark.parametrize(
    ("tolerance_mm", "years", "said"), [(0.3, None, "out"), (0.3, 2.0, "2.0"), (None, None, "")]
)
def test_a_station_out_of_tolerance_says_so(
    tolerance_mm: float | None, years: float | None, said: str
) -> None:
    station = StationTrend(
        cell="a", serial="", machine="", station="S300", calibrations=9, mean_mm=0.4,
        tolerance_mm=tolerance_mm, mm_per_year=0.1, low_mm_per_year=0.05, high_mm_per_year=0.2,
        out_in_years=years,
    )  # fmt: skip
    assert Table(STATIONS, [station]).texts()[0][-1] == said
