"""A total station in place of the laser tracker: its driver and its simulated instrument."""

from __future__ import annotations

import contextlib
import html
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.leica import tracker_geocom as tracker_leica_geocom
from drivers.leica.tracker_geocom import LeicaGeocomTracker
from fakes.faults import Faults
from fakes.leica.geocom_device import GeocomDevice
from fakes.leica.geocom_server import GeocomServer
from fakes.time import PlantTime
from fakes.truth.plant import Plant
from hilcell.alarms import alarms_of
from hilcell.cell.file import Cell, load_cell
from hilcell.journal.runs import read_log
from hilcell.ports import NoReading
from tests.drivers.peers import wall_clock
from tests.whole.bench import SMALL, Simulation, command, end_of, sets, simulation

STATION = {
    "tracker.driver": "leica-geocom",
    "tracker.max_std_mm": "3.0",
    "tracker.samples": "4",
    "base_frame.points": "24",
    "tracker.options.temperature_c": "23.0",
    "tracker.options.pressure_mbar": "1009.0",
    "uncertainty.tracker_limit_mm": "0.3",
    "uncertainty.tracker_limit_um_m": "2.0",
    "layout.max_tool_std_mm": "1.0",
    "validation.mean_tolerance_mm": "2.0",
    "validation.max_tolerance_mm": "4.0",
}
CALIBRATION = SMALL | STATION | {"layout.nest_samples": "9"}


class Quick(LeicaGeocomTracker):
    REPLY_S = 0.5


@contextlib.contextmanager
def pair(cell: Cell, line: bool) -> Iterator[tuple[Quick, Plant, Faults]]:
    faults, clock = Faults(), PlantTime(math.inf)
    plant = Plant(cell, 1, clock, faults)
    server = GeocomServer(GeocomDevice(plant.tracker, faults), faults, clock, serial=line)
    options = Quick.Options(
        channel=str(server.address["channel"]),
        reflector="SMR 1.5in",
        max_std_mm=1.0,
        find_radius_mm=50.0,
        reading_s=0.1,
        temperature_c=23.0,
        pressure_mbar=1009.0,
    )
    tracker = Quick(options, wall_clock())
    with contextlib.closing(server), contextlib.closing(tracker):
        server.start()
        yield tracker, plant, faults


@pytest.mark.parametrize("line", [False, True])
def test_every_reflector_is_where_it_is(line: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker_leica_geocom, "DISTANCE_MS", 1500)
    with pair(load_cell("paper"), line) as (tracker, plant, faults):
        (identity,) = tracker.connect()
        assert identity.simulated
        for at_mm in plant.tracker.reflectors().values():
            near_mm = at_mm + [5.0, -10.0, 5.0]
            found = tracker.measure(near_mm, "SMR 1.5in", 3)
            np.testing.assert_allclose(found.xyz_mm, at_mm, atol=0.06)
        at_mm = plant.tracker.reflectors()["F1"]
        faults.set("tracker.late_result")
        with pytest.raises(NoReading) as error:
            tracker.measure(at_mm, "SMR 1.5in", 1)
        assert error.value.code == "HC-T13"
        other_mm = plant.tracker.reflectors()["F2"]
        for place_mm in (other_mm, at_mm):
            found = tracker.measure(place_mm, "SMR 1.5in", 1)
            np.testing.assert_allclose(found.xyz_mm, place_mm, atol=0.06)
        faults.set("tracker.split_packet", count=5)
        tracker.measure(at_mm, "SMR 1.5in", 5)
        tracker.close()
        tracker.connect()
        tracker.measure(at_mm, "SMR 1.5in", 1)


@pytest.fixture(scope="module")
def standing() -> Iterator[Simulation]:
    with simulation(values=STATION) as cell:
        yield cell


@pytest.mark.parametrize(
    ("fault", "value", "alarm"),
    [
        ("geocom_code", 1283, "HC-T50"),
        ("geocom_code", 1284, "HC-T51"),
        ("geocom_code", 1292, "HC-T52"),
        ("geocom_code", 776, "HC-T53"),
        ("geocom_code", 18, "HC-T55"),
        ("geocom_number", True, "HC-T02"),
        ("geocom_noise", True, "HC-T02"),
        ("no_distance", True, "HC-T52"),
        ("no_reflector", True, "HC-T11"),
        ("beam_break_after", True, "HC-T52"),
        ("bad_number", "nan", "HC-T14"),
        ("busy", True, "HC-T21"),
        ("eof", True, "HC-T02"),
    ],
)
def test_faults_end_a_run_by_their_alarm(
    standing: Simulation,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: str,
    value: object,
    alarm: str,
) -> None:
    monkeypatch.setattr(LeicaGeocomTracker, "REPLY_S", 0.5)
    standing.ask(do="fault", name=f"tracker.{fault}", value=value, count=0)
    values = STATION | {
        "simulation.address": standing.control,
        "plan.unattended_wait_s": "0",
    }
    words = ("--runs", str(tmp_path), "--name", "x", *sets(values))
    done = command("run", "world-frame", "--unattended", *words)
    standing.ask(do="clear")
    assert done.returncode == 3, done.stderr
    found = alarms_of(read_log(tmp_path / "x"), "x", live=False)[-1]
    assert found.code == alarm, found
    assert found.severity == "fault"
    assert len(found.do) >= 2


def test_an_unattended_run_waits_while_readings_are_not_accurate(
    standing: Simulation, tmp_path: Path
) -> None:
    """A person may level and adjust the instrument meanwhile; a good look lets the run go on."""
    standing.ask(do="fault", name="tracker.geocom_code", value=1284, count=6)
    values = STATION | {"simulation.address": standing.control}
    words = ("--runs", str(tmp_path), "--name", "x", *sets(values))
    done = command("run", "world-frame", "--unattended", *words)
    standing.ask(do="clear")
    assert done.returncode == 0, done.stderr
    life = [(each.body["to"], each.body.get("by")) for each in read_log(tmp_path / "x").life]
    assert [each for each in life if each[0] == "suspended" or each[1]] == [
        ("suspended", None),
        ("running", "look"),
    ]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The paper's machine with a total station: 0.6 mm along the beam, 1 arcsec across."""
    here = Path(__file__).parents[2] / "fakes" / "truth" / "machines" / "paper.toml"
    file = tmp_path_factory.mktemp("machine") / "station.toml"
    sizes = "[tracker]\nradial_um = 600.0\nacross_um_m = 4.85\n"
    file.write_text(here.read_text("utf-8").replace("[tracker]\n", sizes), "utf-8")
    return str(file)


@pytest.mark.nightly  # by day, with another robot: test_cells
def test_a_whole_calibration_with_the_uncertainty_of_a_total_station(
    machine: str, tmp_path: Path
) -> None:
    values = CALIBRATION | {"sweeps.enabled": "true", "simulation.machine": machine}
    words = ("--unattended", "--runs", tmp_path, "--name", "x", "--seed", "301")
    done = command("run", *words, *sets(values), "--json")
    assert done.returncode in (0, 1), done.stderr
    result = end_of(done)["result"]
    assert end_of(done)["state"] == "finished"
    assert result["suspicions"] == []
    before, chosen = (result["validation"]["S1100"][how]["mean"] for how in ("before", "chosen"))
    assert chosen < before
    log = read_log(tmp_path / "x")
    stds_mm = np.array([point.std_mm for point in log.points.values()])
    assert 0.3 < np.median(np.linalg.norm(stds_mm, axis=1)) < 1.0
    reason = "tracker driver 'leica-geocom' does not stream; the ripple"
    assert result["sweeps"]["left_out"].startswith(reason)
    page = tmp_path / "x.html"
    assert command("report", "x", "--runs", tmp_path, "-o", page).returncode == 0
    text = html.unescape(page.read_text("utf-8"))
    assert text.count(f"Axes not swept: {reason}") == 2  # beside the model's choice, in the course


def suspected(runs: Path, *words: str) -> list[dict[str, Any]]:
    """Return what a calibration with a total station suspects."""
    end = end_of(command("run", "--unattended", "--runs", runs, *words, "--json"))
    assert end["state"] == "finished", end
    found: list[dict[str, Any]] = end["result"]["suspicions"]
    return found


@pytest.mark.nightly
@pytest.mark.parametrize("seed", ["302", "303", "304", "306"])
def test_the_noise_of_a_total_station_is_no_suspicion(
    machine: str, tmp_path: Path, seed: str
) -> None:
    words = sets(CALIBRATION | {"simulation.machine": machine})
    assert suspected(tmp_path, "--seed", seed, *words) == []


@pytest.mark.nightly  # by day, with a laser tracker: test_disturbances
def test_a_mount_that_slipped_is_seen_by_a_total_station(machine: str, tmp_path: Path) -> None:
    values = CALIBRATION | {"touch.poses": "0"}  # the slip leads one near the sight to a nest
    with simulation(values=values | {"simulation.machine": machine}) as cell:
        assert cell.ask(do="fault", name="robot.mount_slip", value=5.0)["ok"]
        words = sets(values | {"simulation.address": cell.control})
        found = suspected(tmp_path, *words)
    assert found[0]["cause"] == "mount offset"
    assert found[0]["size"] == pytest.approx(5.0, rel=0.4)


def test_sweeps_alone_say_that_nothing_was_swept(tmp_path: Path) -> None:
    words = sets(STATION | {"base_frame.points": "6"})
    done = command("run", "axis-sweeps", "--unattended", "--runs", tmp_path, *words)
    assert "Axes not swept: tracker driver 'leica-geocom' does not stream" in done.stderr
