"""From an empty hall to corrected programs, where nobody knows places, signs and units."""

import json
import re
import shlex
import subprocess
from pathlib import Path

import pytest

from fakes.traps import TRAPS
from hilcell.cell.file import load_cell
from hilcell.commission.record import Commissioned
from hilcell.commission.sequence import STEPS
from tests.whole.bench import HILCELL, events, hilcell, sim_command
from tests.whole.halls import (
    FREE_PORTS,
    READY,
    answers,
    calibrated,
    commission,
    commissioned,
    hall_with,
    least_clearance_mm,
    unknown_hall,
)
from tests.whole.trapped import TRAPPED, Trapped, trapped

PAGE = (Path(__file__).parents[2] / "docs/commissioning.md").read_text("utf-8")
MOST_STEPS = 12
CLEAR_MM = 50.0
pytestmark = pytest.mark.process


def typed(words: str, folder: Path, answered: str = "") -> subprocess.CompletedProcess[str]:
    """Type a command of the page in a folder; raises `AssertionError` where it fails."""
    program, *more = shlex.split(words)
    assert program == "hilcell"
    done = subprocess.run(
        [*HILCELL, *more], input=answered, capture_output=True, text=True, timeout=280,
        check=False, cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, f"{words}: {done.stderr[-3000:]}"
    return done


@pytest.mark.wall  # 17 minutes of a hall over wires whose deadlines are real
def test_the_page_is_typed(tmp_path: Path) -> None:
    """Nothing but the ports differs from the page: several tests may run at once."""
    (hall,) = re.findall(r"^```\n(hilcell sim .*) &\n```$", PAGE, re.MULTILINE)
    steps = re.findall(r"^\| \d+ \| (.*?) \|", PAGE, re.MULTILINE)
    first, run, prepare = (
        found[1] for found in (re.match("`(hilcell .*?)`", step) for step in steps) if found
    )
    assert len(steps) <= MOST_STEPS
    with sim_command(*shlex.split(hall)[2:], "--ports", FREE_PORTS, cwd=tmp_path):
        sheet = tmp_path / "hall"
        assert f"`{(sheet / 'hall.txt').relative_to(tmp_path)}`" in steps[0]
        found = json.loads((sheet / "hall.json").read_text("utf-8"))
        done = typed(first, tmp_path, answers(found, Path("hall")))
        file = tmp_path / shlex.split(first)[2]
        assert f"{READY}{file.name}" in done.stderr
        assert {step.step for step in Commissioned.read(file).steps} == {s.name for s in STEPS}
        record = file.with_suffix(".commissioning.html").read_text("utf-8")
        assert "This cell is ready to calibrate." in record
        ran = typed(run, tmp_path)
        assert "IN TOLERANCE" in ran.stdout + ran.stderr
        result = events(typed("hilcell watch last --json", tmp_path).stdout)[-1]["result"]
        assert [axis["axis"] for axis in result["sweeps"]["axes"] if axis["used"]] == [1, 2, 3, 5]
        assert result["validation"]["S1"]["chosen"]["mean"] < 0.05
        typed(prepare, tmp_path)
        assert list((tmp_path / shlex.split(prepare)[-1]).glob("*.src"))


SEEDS = range(1, 21)
QUICK = (10, 14)  # with the page's hall they are three in `make test`


@pytest.mark.wall
@pytest.mark.parametrize("seed", QUICK)
def test_a_hall_is_commissioned(seed: int, tmp_path: Path) -> None:
    with unknown_hall(tmp_path / "hall", seed) as hall:
        assert commissioned(hall, tmp_path / "mycell.toml").problems == []


@pytest.mark.nightly
@pytest.mark.parametrize("seed", SEEDS)
def test_a_hall_is_commissioned_and_calibrated(seed: int, tmp_path: Path) -> None:
    with unknown_hall(tmp_path / "hall", seed) as hall:
        assert commissioned(hall, tmp_path / "mycell.toml").problems == []
        assert calibrated(tmp_path / "mycell.toml").problems == []
        assert least_clearance_mm(hall, tmp_path / "runs" / "first") > CLEAR_MM


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [24, 26])  # no hall with a coupled axis 3, which this robot lacks
def test_a_hall_with_a_robot_of_abb_is_commissioned_and_calibrated(
    seed: int, tmp_path: Path
) -> None:
    cell = hall_with("abb", tmp_path / "unknown.toml")
    with unknown_hall(tmp_path / "hall", seed, cell=cell) as hall:
        assert commissioned(hall, tmp_path / "mycell.toml").problems == []
        assert calibrated(tmp_path / "mycell.toml").problems == []


@pytest.mark.nightly
@pytest.mark.parametrize("row", TRAPPED, ids=lambda row: row.trap)
def test_a_trap_is_named_and_nothing_moves_unannounced(row: Trapped, tmp_path: Path) -> None:
    assert trapped(row, tmp_path)[1] == []


def test_every_trap_is_judged() -> None:
    assert {row.trap for row in TRAPPED} == {*TRAPS}


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
