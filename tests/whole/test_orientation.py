"""Three reflectors on the flange: the tool's orientation is measured, corrected, and validated."""

from __future__ import annotations

import csv
import html
import io
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest
from msgspec.structs import replace

from fakes.faults import Faults
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from hilcell.calibration.file import read_calibration
from hilcell.calibration.frames import Frames, world_from_tracker
from hilcell.calibration.orientation import (
    last_orientation_errors,
    orientation_bounds_deg,
    seats_of,
)
from hilcell.geometry.frames import apply, from_zyx, inverse, matrix, orientations, to_rotvec
from hilcell.journal.log import commanded_rad
from hilcell.journal.runs import read_log
from hilcell.model.outcome import Outcome
from hilcell.model.verdicts import Judged, Verdict
from hilcell.programs.station_jobs import SHEET, TRUE_ANGLE
from procedures.validate import Validate
from tests.whole.bench import SEATS, SMALL, command, cut, end_of, events, judge, sets
from tests.whole.golden import GoldenRuns

if TYPE_CHECKING:
    from hilcell.run.cell_session import CellSession

HOLE = "name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\nH1,{:.3f},{:.3f},{:.3f},{:.6f},{:.6f},{:.6f}\n"
PROGRAM = "DEF drill()\nLIN {{X {:.3f},Y {:.3f},Z {:.3f},A {:.4f},B {:.4f},C {:.4f}}}\nEND\n"


def test_the_orientation_is_corrected_as_measured(golden: GoldenRuns) -> None:
    run = golden["seats"]
    assert run.end["exit"] == 0, run.done.stderr
    figures = run.result["validation"]["BASE"]
    before, after = (figures[how]["orientation"] for how in ("before", "chosen"))
    assert after["mean_deg"] < 0.5 * before["mean_deg"]
    assert after.keys() == {"mean_deg", "p95_deg", "max_deg"}
    assert figures["bounds"]["orientation"]["coverage"] >= 0.8  # 8 targets
    assert "orientation" not in figures["idw"]  # positions only
    points = run.result["points"]
    assert points["grid_seats"] == 2 * points["grid"]
    assert points["oriented_1_seats"] == 2 * points["oriented_1"] == 2 * points["grid"]
    assert "validate_idw_seats" not in points
    verdicts = {e["key"]: e for e in run.events if e["kind"] == "verdict"}
    assert verdicts["orientation"]["holds"]
    assert {each.kind for each in run.log.assets} == {"robot", "tracker"}  # there is no rail
    assert not [event for event in run.log.events if event.body["what"] == "station held"]


def test_a_limit_of_orientation_is_judged_like_those_of_position(
    golden: GoldenRuns, tmp_path: Path
) -> None:
    """The run's own targets, by the limit that they keep, and by one that U leaves nothing of."""
    run = golden["seats"]
    stated = run.log.verdict(Judged, "validation.BASE")
    assert stated is not None
    assert (stated.holds, stated.outcome) == (True, Outcome.ACCEPTED)
    assert stated.max_tolerance_deg == 0.1
    assert stated.max_U_deg is not None
    assert 0.002 < stated.max_U_deg < 0.03
    chosen = run.result["validation"]["BASE"]["chosen"]
    assert stated.max_deg == pytest.approx(chosen["orientation"]["max_deg"])
    assert read_calibration(run.folder / "calibration.json").verdicts is not None
    limited = Limited(run.folder, chosen["orientation"]["max_deg"])
    Validate()._judge(cast("CellSession", limited))
    judged = limited.verdicts["validation.BASE"]
    assert (judged.holds, judged.outcome) == (False, Outcome.UNDECIDED)
    report = tmp_path / "report.html"
    assert command("report", "seats", "--runs", run.runs, "-o", report).returncode == 0
    assert "on the floor, without a rail" in report.read_text("utf-8")


class Limited:
    """The session of a finished run whose cell limits the orientation otherwise."""

    def __init__(self, folder: Path, limit_deg: float) -> None:
        self.log = read_log(folder)
        table = replace(self.log.cell.validation, max_tolerance_deg=limit_deg)
        self.cell = replace(self.log.cell, validation=table)
        self.verdicts: dict[str, Verdict] = {}

    def judge(self, key: str, verdict: Verdict) -> None:
        self.verdicts[key] = verdict


def test_each_reading_is_a_point_of_the_journal(golden: GoldenRuns, tmp_path: Path) -> None:
    log = golden["seats"].log
    first, second, third = (log.select("grid", seat=seat) for seat in (None, 2, 3))
    assert len(first) == len(second) == len(third) == 27
    assert all(point.nominal_deg for point in first)
    apart_mm = [
        np.linalg.norm(np.array(a.xyz_mm) - b.xyz_mm) for a, b in zip(first, second, strict=True)
    ]
    assert np.ptp(apart_mm) < 0.1  # they ride on one flange
    out = tmp_path / "points.csv"
    done = command("export", "seats", "--runs", golden["seats"].runs, "--csv", "-o", out)
    assert done.returncode == 0, done.stderr
    rows = [*csv.DictReader(io.StringIO(out.read_text()))]
    (row,) = [row for row in rows if row["key"] == "grid/0-0-0"]
    assert float(row["orientation_error_deg"]) > 0.0
    (row,) = [row for row in rows if row["key"] == "grid/0-0-0/seat2"]
    assert (row["seat"], row["orientation_error_deg"]) == ("2", "")


def test_targets_are_turned_and_their_bounds_stated(golden: GoldenRuns, tmp_path: Path) -> None:
    folder = golden["seats"].copied_to(tmp_path / "runs")
    made = read_calibration(folder / "calibration.json")
    assert made.orients
    assert len(made.validity.orientations) == 1
    log = read_log(folder)
    point = log.select("validate", how="chosen")[0]
    nominal = [*(point.nominal_mm or ()), *(point.nominal_deg or ())]
    holes, out, bounds = (tmp_path / name for name in ("holes.csv", "out.csv", "bounds.csv"))
    holes.write_text(HOLE.format(*nominal))
    words = ("compensate", "seats", holes, "--station", "BASE", "-o", out, "--bounds", bounds)
    done = command(*words, "--runs", tmp_path / "runs")
    assert done.returncode == 0, done.stderr
    prepared = tmp_path / "prepared"
    of_cell = ["--cell", "fixed", *sets(SMALL | SEATS), "--runs", str(tmp_path / "runs")]
    done = command("prepare", holes, "--calibration", "seats", "-o", prepared, *of_cell)
    assert done.returncode == 0, done.stderr
    assert TRUE_ANGLE in html.unescape((prepared / SHEET).read_text("utf-8"))
    (corrected,) = csv.DictReader(io.StringIO(out.read_text()))
    turned_deg = np.array([float(corrected[f"{name}_deg"]) for name in "abc"]) - nominal[3:]
    assert 0.001 < np.abs(turned_deg).max() < 1.0
    (bound,) = csv.DictReader(io.StringIO(bounds.read_text()))
    assert 0.001 < float(bound["bound95_deg"]) < 0.1
    source, program = tmp_path / "drill.src", tmp_path / "program"
    source.write_text(PROGRAM.format(*nominal))
    of_program = ("compensate", "seats", source, "--station", "BASE", "-o", program)
    done = command(*of_program, "--runs", tmp_path / "runs")
    assert done.returncode == 0, done.stderr
    (line,) = [
        each for each in program.with_suffix(".src").read_text().splitlines() if "LIN" in each
    ]
    numbers = [float(each.split()[1]) for each in line[5:-1].split(",")]
    wanted = [
        float(corrected[name]) for name in ("x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg")
    ]
    assert numbers == pytest.approx(wanted, abs=1e-3)


def test_a_run_killed_between_two_reflectors_measures_the_third_only(
    golden: GoldenRuns, tmp_path: Path
) -> None:
    whole = golden["seats"]
    last = [e for e in whole.events if e["kind"] == "point" and "validate/" in e["key"]][-1]
    assert last["key"] == "validate/BASE/chosen/007/seat3"
    cut(whole.folder, tmp_path / "cut", last["seq"] - 1)
    done = command("resume", "cut", "--runs", tmp_path, "--json")
    assert end_of(done)["state"] == "finished", done.stderr
    points = [event["key"] for event in events(done.stdout) if event["kind"] == "point"]
    assert [key for key in points if key.startswith("validate/")] == [last["key"]]
    before = [event for event in whole.events if event["seq"] < last["seq"]]
    assert judge([*before, *events(done.stdout)]) == []


def test_the_tool_really_is_turned_less(golden: GoldenRuns) -> None:
    """By the simulator's truth, of which no engine knows: a constant turn about axis 6 is allowed,
    the controller's zero of it cannot be told from the reflectors' mounting.
    """
    log = golden["seats"].log
    cell, seed = log.cell, log.inputs.machine_seed
    assert seed is not None
    arm = CellTruth(cell, seed, CellTime(), Faults()).arm
    T_W_B = Frames(cell, log).base_in_world(cell.station_named("BASE"))
    left_deg = {}
    for how in ("before", "chosen"):
        points = log.select("validate", how=how)
        joints_rad = commanded_rad(points)
        landed = np.ones_like(joints_rad), np.zeros(6)  # from below, without repeatability
        actual = arm.ideal_base[:3, :3].T @ arm.pose(joints_rad, *landed)[:, :3, :3]
        nominal = T_W_B[:3, :3].T @ from_zyx(np.array([point.nominal_deg for point in points]))
        in_tool = np.degrees(to_rotvec(np.swapaxes(nominal, 1, 2) @ actual))
        in_tool[:, 2] -= in_tool[:, 2].mean()
        left_deg[how] = float(np.linalg.norm(in_tool, axis=1).mean())
    assert left_deg["chosen"] < 0.5 * left_deg["before"]
    assert left_deg["chosen"] < 0.02


def test_bounds_in_use_cover_the_true_turns_and_a_measured_one_has_the_noise_of_its_readings(
    golden: GoldenRuns,
) -> None:
    """By the simulator's truth, in the {W} that the nests span, for visits of the same targets."""
    folder = golden["seats"].folder
    log, made = read_log(folder), read_calibration(folder / "calibration.json")
    cell, seed, seats = log.cell, log.inputs.machine_seed, seats_of(log)
    assert seed is not None
    assert seats is not None
    truth, rng = CellTruth(cell, seed, CellTime(), Faults()), np.random.default_rng(53)
    places_mm = np.stack([np.zeros(3), *truth._seats.values()])
    floor = truth.places_in_world()
    nests_mm = np.array([floor[nest.name] for nest in cell.layout.floor])
    T_W_R = (
        world_from_tracker(cell, nests_mm) @ truth.base_in_world() @ inverse(truth.arm.ideal_base)
    )
    turned = last_orientation_errors(log, log.select("validate", how="chosen"), seats)
    nominal = from_zyx(np.array([point.nominal_deg for point in turned.points]))
    nominal_mm = np.array([point.nominal_mm for point in turned.points])
    joints_rad = commanded_rad(turned.points)
    bounds_deg = orientation_bounds_deg(made, "BASE", matrix(nominal, nominal_mm))
    assert bounds_deg is not None
    true_rad = []
    for _ in range(50):
        landed = truth.arm.joint_sigma_rad * rng.standard_normal(joints_rad.shape)
        tool = T_W_R @ truth.arm.pose(joints_rad, np.ones_like(joints_rad), landed)
        seen_mm = np.stack([apply(each, places_mm) for each in tool])
        true_rad.append(to_rotvec(orientations(seats, seen_mm) @ np.swapaxes(nominal, 1, 2)))
    true_deg = np.degrees(np.linalg.norm(true_rad, axis=-1))
    assert np.mean(true_deg <= bounds_deg) >= 0.95
    noise_deg = np.degrees(np.linalg.norm(turned.error_rad - np.mean(true_rad, axis=0), axis=1))
    assert np.sqrt(np.mean(noise_deg**2)) == pytest.approx(turned.noise_deg, rel=0.4)
