"""From an empty hall to corrected programs, where nobody knows places, signs and units."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.cell.file import Cell, load_cell
from hilcell.commission.record import Commissioned
from hilcell.commission.sequence import STEPS
from tests.whole.bench import HILCELL, end_of, hilcell, sim_command

FREE_PORTS = "rail=0,robot=0,tracker=0,control=0"
MOST_QUESTIONS = 60
pytestmark = pytest.mark.process


def answers(hall: dict[str, Any], drawing: Path, teach: str = "none") -> str:
    """Return the lines that a person types, by the sheet of the hall."""
    lines = [
        "HC-7",
        hall["control"],
        hall["drivers"]["robot"],
        hall["drivers"]["rail"],
        hall["drivers"]["tracker"],
        hall["reflector"],
        f"{hall['room_mm']}",
        "35",
        f"{hall['speed_mm_s']}",
        f"{hall['acceleration_mm_s2']}",
        f"{drawing}",
        f"{len(hall['slide'])}",
        f"{drawing.parent / 'volumes.csv'}",
        teach,
        "",  # the arm's shape
        *["y"] * 30,
    ]
    return "\n".join(lines) + "\n"


def commission(cell: Path, typed: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*HILCELL, "commission", str(cell), "--runs", str(cell.parent / "runs"), *words],
        input=typed,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )


def holes(cell: Cell, path: Path) -> Path:
    """Write a drawing of holes: a row in the cube at the first station, in {W}."""
    grid, station = cell.grid.centre.matrix(), cell.reference
    T = cell.layout.nominal_base(station.strip_mm) @ grid
    rows = ["name,x_mm,y_mm,z_mm,nx,ny,nz"]
    for n, x_mm in enumerate((-100.0, 0.0, 100.0), start=1):
        at = T @ np.array([x_mm, 0.0, 0.0, 1.0])
        normal = -T[:3, 2]
        values = [*at[:3], *normal]
        rows.append(f"H{n}," + ",".join(f"{value:.4f}" for value in values))
    path.write_text("\n".join([*rows, ""]))
    return path


def test_an_unknown_hall_is_commissioned_calibrated_and_prepared(tmp_path: Path) -> None:
    file, sheet = tmp_path / "mycell.toml", tmp_path / "hall"
    words = ("--cell", "unknown", "--seed", "7", "--truth", "--ports", FREE_PORTS)
    with sim_command(*words, cwd=tmp_path) as simulation:
        hall, runs = json.loads((sheet / "hall.json").read_text()), ("--runs", tmp_path / "runs")
        done = commission(file, answers(hall, sheet / "nests.csv"))
        assert done.returncode == 0, done.stderr[-3000:]
        assert f"this cell is ready to calibrate: hilcell run --cell {file}" in done.stderr
        assert {step.step for step in Commissioned.read(file).steps} == {s.name for s in STEPS}
        for run in sorted((tmp_path / "runs").glob("*commission*")):
            checked = hilcell("show", run.name, "--check", *runs)
            assert checked.returncode == 0, checked.stdout
        page = file.with_suffix(".commissioning.html").read_text()
        assert "This cell is ready to calibrate." in page
        questions = int(done.stderr.rpartition(" questions")[0].rpartition("\n")[2])
        assert questions <= MOST_QUESTIONS

        cell, truth = load_cell(str(file)), simulation.ask(do="truth")
        base = cell.layout.nominal_base(cell.reference.strip_mm)
        found_mm = np.linalg.norm(
            np.array(truth["T_W_L"])[:3, 3] - cell.tracker.pose.matrix()[:3, 3]
        )
        assert found_mm < 2.0
        assert np.degrees(np.abs(np.array(truth["T_W_B"])[:3, :3] - base[:3, :3])).max() < 0.5

        ran = hilcell("run", "--cell", file, *runs, "--name", "first", "--json")
        assert ran.returncode == 0, ran.stderr[-3000:]
        result = end_of(ran)["result"]
        assert [axis["axis"] for axis in result["sweeps"]["axes"] if axis["used"]] == [1, 2, 3, 5]
        assert result["validation"]["S1"]["chosen"]["mean"] < 0.05
        checked = hilcell("show", "first", "--check", *runs)
        assert checked.returncode == 0, checked.stdout
        drawing = holes(cell, tmp_path / "holes.csv")
        prepared = hilcell(
            "prepare", drawing, "--cell", file, "--calibration", "first",
            "-o", tmp_path / "monday", *runs,
        )  # fmt: skip
        assert prepared.returncode == 0, prepared.stderr[-3000:]
        assert list((tmp_path / "monday").glob("*.src"))


# A trap in a hall, the step that names it, its words, and the drive's counts a mm then proved.
TRAPS = [
    ("drive-sign", 2, "rail", "opposite directions", -400.0),
    ("no-self-stop", 3, "self-stop", "DIFFERS", -500.0),
    ("scale-10", 3, "rail", "DIFFERS", -5000.0),
    ("coupled-axis-3", 3, "controller", "axis 3 turns with axis 2 (coupled, -1)", -500.0),
    ("tracker-upside-down", 3, "tracker", "upside down", -500.0),
    ("wrong-tool", 3, "base", "enter the measured place as the tool", -500.0),
]


@pytest.mark.nightly
@pytest.mark.parametrize(("trap", "seed", "step", "words", "counts_per_mm"), TRAPS)
def test_a_trap_is_named(
    trap: str, seed: int, step: str, words: str, counts_per_mm: float, tmp_path: Path
) -> None:
    """The strip counts up in the cell file; in hall 2 the drive counts up and the strip down."""
    file, sheet = tmp_path / "mycell.toml", tmp_path / "hall"
    hall_words = ("--cell", "unknown", "--seed", str(seed), "--speed", "max", "--trap", trap)
    with sim_command(*hall_words, "--sheet", str(sheet), "--ports", FREE_PORTS):
        hall = json.loads((sheet / "hall.json").read_text())
        done = commission(file, answers(hall, sheet / "nests.csv"))
    assert done.returncode == (1 if trap in ("wrong-tool", "no-self-stop") else 0), done.stderr[
        -2000:
    ]
    said = done.stderr.partition(f", {step}: ")[2].partition("\nstep ")[0]
    assert words in said
    proved = load_cell(str(file)).rail.options["counts_per_mm"]
    assert proved == pytest.approx(counts_per_mm, rel=5e-3)


@pytest.mark.nightly
def test_a_robot_on_the_floor_is_commissioned_and_calibrated(tmp_path: Path) -> None:
    file, drawing = tmp_path / "mycell.toml", tmp_path / "nests.csv"
    nests = load_cell("fixed").layout.fixed_nests
    rows = [f"{nest.name},{nest.x_mm},{nest.y_mm},{nest.z_mm}" for nest in nests]
    drawing.write_text("\n".join(["name,x_mm,y_mm,z_mm", *rows, ""]))
    words = ("--cell", "fixed", "--seed", "7", "--speed", "max")
    with sim_command(*words, "--ports", "robot=0,tracker=0,control=0") as simulation:
        typed = [
            "HC-7",
            simulation.control,
            "kuka-c3",
            "none",
            "leica-emscon",
            "",
            "",
            str(drawing),
            "none",
            "none",
        ]
        done = commission(file, "\n".join([*typed, *["y"] * 30, ""]))
        assert done.returncode == 0, done.stderr[-3000:]
        assert "step 8 of 8, proof" in done.stderr
        assert "slide" not in file.read_text()
        assert "the slide" not in done.stderr
        ran = hilcell("run", "--cell", file, "--runs", tmp_path / "runs")
        assert ran.returncode == 0, ran.stderr[-3000:]


def test_the_steps_are_listed_without_a_file(tmp_path: Path) -> None:
    done = hilcell("commission", tmp_path / "mycell.toml", "--list")
    assert done.returncode == 0
    assert done.stdout.count("open") == len(STEPS)


def test_a_built_in_cell_is_not_commissioned() -> None:
    done = hilcell("commission", "unknown")
    assert (done.returncode, "mycell.toml" in done.stderr) == (2, True)


def test_the_page_is_written_again(tmp_path: Path) -> None:
    place = tmp_path / "page.html"
    done = hilcell("commission", tmp_path / "mycell.toml", "--report", place)
    assert done.returncode == 0
    assert "NOT READY" in place.read_text()
    assert hilcell("commission", tmp_path / "c.toml", "--report", "page.csv").returncode == 2


@pytest.mark.parametrize("option", ["--from", "--only"])
def test_an_unknown_step_is_refused(option: str, tmp_path: Path) -> None:
    done = hilcell("commission", tmp_path / "mycell.toml", option, "rails")
    assert done.returncode == 2
    assert "unknown step 'rails'; known: devices" in done.stderr
