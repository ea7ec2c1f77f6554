"""A robot on the floor with one reflector: the six steps of the page, typed."""

import json
import re
import shlex
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.fit.urdf_file import read_robot
from hilcell.geometry.kinematics import forward
from tests.whole.bench import HILCELL, hilcell, sim_command

PAGE = (Path(__file__).parents[2] / "docs/quickstart.md").read_text("utf-8")
STEPS = re.findall(r"^\| \d \| (.*?) \|", PAGE, re.MULTILINE)
pytestmark = pytest.mark.process


def typed(words: str, folder: Path, answers: str = "") -> subprocess.CompletedProcess[str]:
    """Type a command of the page in a folder."""
    program, *more = shlex.split(words)
    assert program == "hilcell"
    return subprocess.run(
        [*HILCELL, *more], input=answers, capture_output=True, text=True, timeout=280,
        check=False, cwd=folder,
    )  # fmt: skip


def test_the_page_is_typed(tmp_path: Path) -> None:
    """Nothing but the ports differs from the page: several tests may run at once."""
    (shop,) = re.findall(r"^```\n(hilcell sim .*) &\n```$", PAGE, re.MULTILINE)
    assert len(STEPS) == 6
    files, quickstart, prepare = (
        found[1] for found in (re.match("`(hilcell .*?)`", step) for step in STEPS) if found
    )
    with sim_command(*shlex.split(shop)[2:], "--ports", "robot=0,tracker=0,control=0") as shop_cell:
        assert typed(files, tmp_path).returncode == 0
        answers = ["HC-7", shop_cell.control, "kuka-c3", "leica-emscon", "foo", "", "floor", ""]
        yes = ["y"] * 60
        done = typed(quickstart, tmp_path, "\n".join([*answers, *yes, ""]))
    assert done.returncode == 0, done.stderr[-3000:]
    assert "IN TOLERANCE" in done.stderr
    assert re.search(r"expected one of .*SMR 1\.5in.*, got 'foo'", done.stderr)
    assert not re.findall(r"\b(rail|slide|None)\b|\{'", done.stderr)
    file = tmp_path / shlex.split(quickstart)[2]
    cell = load_cell(str(file))
    assert {each.name for each in cell.keep_out} == {"floor", "tracker"}
    assert [nest.name for nest in cell.layout.floor] == ["N1", "N2", "N3"]
    assert "<html" in file.with_suffix(".report.html").read_text("utf-8")

    centre = cell.layout.base.matrix() @ cell.grid.centre.matrix()
    at = [*centre[:3, 3], *centre[:3, 2]]
    holes = ",".join(f"{value:.4f}" for value in [*at[:3], *(-np.array(at[3:]))])
    (tmp_path / "holes.csv").write_text(f"name,x_mm,y_mm,z_mm,nx,ny,nz\nA1,{holes}\n")
    prepared = typed(prepare, tmp_path)
    assert prepared.returncode == 0, prepared.stderr[-3000:]
    assert list((tmp_path / shlex.split(prepare)[-1]).glob("*.src"))

    ended = json.loads(typed("hilcell show last --json", tmp_path).stdout)["result"]
    assert ended["validation"][cell.grid.station]["chosen"]["mean"] < 0.04
    assert [axis["axis"] for axis in ended["sweeps"]["axes"] if axis["used"]]

    joints_rad = np.radians([cell.robot.safe_deg, cell.robot.home_deg])
    nominal = forward(replace(cell.robot.arm(), tool=np.eye(4)), joints_rad)
    identified = read_robot(file.with_suffix(".urdf")).poses(joints_rad)
    off_mm = np.linalg.norm((identified - nominal)[:, :3, 3], axis=1)
    assert 0.05 < off_mm.max() < 10.0
    urdf = file.with_suffix(".urdf").read_text("utf-8")
    (seen,) = re.findall(r"Reflector SMR in the tip link, in m: (.*) -->", urdf)
    seen_mm = 1000.0 * np.array(seen.split(), dtype=float)
    assert np.linalg.norm(seen_mm - cell.robot.smr_mm) < 3.0  # the grid alone leaves it open


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('[rail]\ndriver = "canopen"\n', "it has a rail"),
        ('name = "mine"\n', "its reflectors are mounted"),
    ],
)
def test_a_cell_of_another_kind_is_not_changed(text: str, what: str, tmp_path: Path) -> None:
    file = tmp_path / "mycell.toml"
    file.write_text(text)
    done = hilcell("quickstart", file)
    assert done.returncode == 2
    assert f"{what}: use `hilcell commission {file}`" in done.stderr
    assert file.read_text() == text


def test_a_built_in_cell_is_refused() -> None:
    done = hilcell("quickstart", "fixed")
    assert (done.returncode, "mycell.toml" in done.stderr) == (2, True)


def test_input_that_ends_within_a_run_stops_it(tmp_path: Path) -> None:
    words = ("--cell", "fixed", "--set", "layout.reflectors=by_hand", "--speed", "max")
    with sim_command(*words, "--ports", "robot=0,tracker=0,control=0") as shop_cell:
        answers = ["HC-7", shop_cell.control, "kuka-c3", "leica-emscon", "", "floor", ""]
        done = typed(
            "hilcell quickstart mycell.toml", tmp_path, "\n".join([*answers, *"yyyyy", ""])
        )
    assert done.returncode in (2, 4)
    assert "the input has ended" in done.stderr


def test_ctrl_c_ends_it_at_a_question_after_a_run_too(tmp_path: Path) -> None:
    """The question is whether the robot may move: nothing may move after it."""
    words = ("--cell", "fixed", "--set", "layout.reflectors=by_hand", "--speed", "max")
    with (
        sim_command(*words, "--ports", "robot=0,tracker=0,control=0") as shop_cell,
        subprocess.Popen(
            [*HILCELL, "quickstart", "mycell.toml"], stdin=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        ) as asking,
    ):  # fmt: skip
        assert asking.stdin is not None
        assert asking.stderr is not None
        answers = ["HC-7", shop_cell.control, "kuka-c3", "leica-emscon", "", "floor", ""]
        for more in ([*answers, ""], ["y", ""]):
            asking.stdin.write("\n".join(more))
            asking.stdin.flush()
            while "another answer moves nothing" not in (line := asking.stderr.readline()):
                assert line, "it has ended"
        asking.send_signal(signal.SIGINT)
        assert asking.wait() == 4
        assert "interrupted" in asking.stderr.read()


def test_input_that_ends_is_told_how_to_go_on(tmp_path: Path) -> None:
    done = typed("hilcell quickstart mycell.toml", tmp_path, "HC-7\n")
    assert done.returncode == 2
    assert "the same command goes on with the first unproved step" in done.stderr
