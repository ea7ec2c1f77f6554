"""Every procedure runs alone by its name, as planned, and its journal keeps every invariant."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.geometry.kinematics import forward
from tests.whole.bench import SMALL, command, end_of, events, sets
from tests.whole.golden import GoldenRun, GoldenRuns

SHORT = SMALL | {
    "grid.pitch_mm": "900.0",
    "base_frame.points": "4",
    "survey.to_mm": "600.0",
    "survey.step_mm": "200.0",
    "survey.repeats": "4",
}
GOLDEN = {"calibrate": "small", "sign-check": "sign-check"}  # runs that other tests need, too
OTHERS = (
    *GOLDEN,
    "campaign",
    "commission-base",
    "commission-proof",
    "commission-rail",
    "commission-robot",
    "commission-self-stop",
    "commission-slide",
    "commission-tracker",
    "conformance",
    "iso9283",
    "paper",
    "recheck",
    "reflectors",
    "targets",
    "touch",
)  # have runs of their own
NAMES = sorted(entry.name for entry in entry_points(group="hilcell.procedures"))


@pytest.mark.parametrize("name", [name for name in NAMES if name not in OTHERS])
def test_alone_by_its_name(tmp_path: Path, name: str) -> None:
    done = command("run", name, "--json", "--unattended", "--runs", tmp_path, *sets(SHORT))
    end = end_of(done)
    assert end["state"] == "finished", done.stderr
    assert_shown(tmp_path, name)


def assert_shown(runs: Path, name: str) -> None:
    shown = command("show", "last", "--runs", runs)
    assert shown.returncode == 0, shown.stderr
    assert name in shown.stdout


@pytest.mark.parametrize("name", GOLDEN)
def test_with_a_fit_by_its_name(golden: GoldenRuns, name: str) -> None:
    run = golden[GOLDEN[name]]
    assert run.end["state"] == "finished", run.done.stderr
    assert_shown(run.runs, name)


def test_the_survey_is_fig_1(paper: GoldenRun) -> None:
    survey = paper.result["rail_survey"]
    forth = dict(map(tuple, survey["curve"]["forth"]))
    back = dict(map(tuple, survey["curve"]["back"]))
    step_mm = paper.log.cell.survey.step_mm
    assert sorted(forth) == sorted(back) == np.arange(0.0, 2000.0 + step_mm, step_mm).tolist()
    assert 0.0 < survey["backlash_mm"]["u"] < 0.02
    assert all(back[at] > forth[at] for at in list(forth)[1:-1])
    assert set(survey["angles_mrad"]) == {"roll", "pitch", "yaw"}


def test_longer_arcs_are_more_certain(paper: GoldenRun) -> None:
    """Fig 6: the uncertainty of an axis falls with the arc."""
    for axis in (1, 6):
        arcs = [each for each in paper.result["base"]["arcs"] if each["axis"] == axis]
        assert [each["arc_deg"] for each in arcs] == sorted(each["arc_deg"] for each in arcs)
        assert arcs[-1]["centre_u_mm"] < arcs[0]["centre_u_mm"]


def recorded_campaign(file: Path, cell: str = "replay") -> list[str]:
    """Write poses measured on the robot of a cell, and return them as lines."""
    lines = ["pose,target,j1_deg,j2_deg,j3_deg,j4_deg,j5_deg,j6_deg,x_mm,y_mm,z_mm"]
    arm = load_cell(cell).robot.arm()
    for pose in range(24):
        joints = [((pose * step) % 50) - 25.0 + 0.123456 for step in (7, 11, 13, 17, 19, 23)]
        flange = forward(arm, np.radians(joints))
        for number in range(2):
            on_flange = np.array([40.0 + 30 * number, -20.0 + 60 * number, 25.0, 1.0])
            xyz = [2000.0, 150.0, -300.0] + (flange @ on_flange)[:3] + 0.1 * np.sin(pose + number)
            values = ",".join(f"{value:.6f}" for value in (*joints, *xyz))
            lines.append(f"{pose},SMR{number + 1},{values}")
    file.write_text("\n".join(lines) + "\n")
    return lines


def replayed_campaign(file: Path) -> CompletedProcess[str]:
    words = {"campaign.poses": str(file), "simulation.data": str(file)}
    runs = file.parent / "runs"
    return command("run", "campaign", "--cell", "replay", "--json", "--runs", runs, *sets(words))


def test_a_campaign_comes_back_as_it_was_recorded(tmp_path: Path) -> None:
    """Joints over the C3 wire, positions over the tracker's: the fit is the file's own."""
    lines = recorded_campaign(tmp_path / "poses.csv")
    done = replayed_campaign(tmp_path / "poses.csv")
    end = end_of(done)
    assert end["state"] == "finished", done.stderr
    points = {e["key"]: e for e in events(done.stdout) if e["kind"] == "point"}
    assert len(points) == 48
    for line in lines[1:]:
        label, target, *given = line.split(",")
        point = points[f"campaign/{label}/{target}"]
        assert point["commanded_deg"] == pytest.approx([float(v) for v in given[:6]], abs=1e-9)
        assert point["xyz_mm"] == pytest.approx([float(v) for v in given[6:]], abs=1e-9)


@pytest.mark.parametrize("cell", ["paper", "six-r"])
def test_a_campaign_of_another_robot_is_refused_before_anything_moves(
    cell: str, tmp_path: Path
) -> None:
    file = tmp_path / "poses.csv"
    recorded_campaign(file, cell)
    done = replayed_campaign(file)
    assert done.returncode == 2, done.stderr
    assert f"campaign.poses {file}: expected rows measured on robot 'ABB IRB 120'" in done.stderr
    assert "check the robot file" in done.stderr
    assert "(hilcell explain HC-C22)" in done.stderr
    assert not (tmp_path / "runs").exists()


def test_every_step_measures_as_many_points_as_planned(paper: GoldenRun) -> None:
    assert paper.end["state"] == "finished", paper.done.stderr
    steps = next(event for event in paper.events if event["kind"] == "plan")["steps"]
    planned = {
        step["name"]: sum(s["measured"] for s in step["spans"]) if step["spans"] else step["points"]
        for step in steps
    }
    measured = dict.fromkeys(planned, 0)
    name = ""
    for event in paper.events:
        if event["kind"] == "event" and event["what"] == "step":
            name = event["name"]
        swept = event["kind"] == "event" and event["what"] == "stream"
        if swept or (event["kind"] == "point" and not event.get("retaken")):
            measured[name] += 1
    assert measured == planned
    assert sum(planned.values()) > sum(step["points"] for step in steps)  # control points
