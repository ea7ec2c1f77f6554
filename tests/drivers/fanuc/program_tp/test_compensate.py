"""`compensate` and `prepare` as commands, in this process, with TP listings."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from drivers.fanuc.program_tp import load_program
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply, inverse, pose_from_zyx, poses_from_zyx, zyx_from_pose
from tests.drivers.fanuc.program_tp.samples import LISTING, listing, position
from tests.hilcell.calibration.calibrations import T_W_B, calibration
from tests.hilcell.commands import workplace
from tests.hilcell.commands.test_prepare import INSIDE, holes, made, prepare, refused
from tests.hilcell.compensation.models import level
from tests.hilcell.lists import write_targets

CELL = load_cell("paper")
L2 = "L P[2] 500mm/sec FINE"


class Workplace(workplace.Workplace):
    """A folder with a calibration and a listing, and the command over them."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "drill.ls", "out.ls")
        self.program()

    def program(self, text: str = LISTING) -> None:
        self.source.write_text(text, "latin-1")


@pytest.fixture
def desk(tmp_path: Path) -> Workplace:
    return Workplace(tmp_path)


def test_a_corrected_program_arrives_like_a_list_and_is_not_corrected_again(
    desk: Workplace,
) -> None:
    """Command + error at the command = target, to the rounding of three decimals."""
    done = desk.run()
    assert (done.returncode, done.stdout) == (0, "")
    assert "its base must be {W}" in done.stderr
    assert "CONFIG) were not checked" in done.stderr
    assert "names it DRILL" in done.stderr
    nominal, command = load_program(desk.source), load_program(desk.out)
    in_base = apply(inverse(T_W_B), command.values()[:, :3])
    arrived = in_base + calibration().error_model().predict(level(in_base)).error_mm
    assert np.abs(command.values()[:, :3] - nominal.values()[:, :3]).max() > 0.3
    np.testing.assert_allclose(arrived, apply(inverse(T_W_B), nominal.values()[:, :3]), atol=2e-3)
    np.testing.assert_array_equal(command.values()[:, 3:], nominal.values()[:, 3:])
    said = desk.refused(source=desk.out, out=desk.folder / "again.ls")
    assert "20261101-120000-calibrate-abcd" in said


def test_positions_in_frame_0_are_in_the_root(desk: Workplace) -> None:
    """They move as a list of the same targets in {W} does, and turns are checked in {B}."""
    stated = position(2, 1850.0, -50.0, 950.0, 0.0, 75.0, 0.0, uf=0)
    desk.program(listing([L2], stated))
    desk.calibrate(digest=CELL.digest)
    assert desk.compensate("--cell", "paper") == 0
    expected, command = load_program(desk.source).values(), load_program(desk.out).values()
    targets, out = desk.folder / "targets.csv", desk.folder / "out.csv"
    write_targets(targets, ["H0"], zyx_from_pose(T_W_B @ poses_from_zyx(expected)))
    assert desk.compensate(source=targets, out=out) == 0
    _, listed, _ = workplace.read_corrected(out)
    np.testing.assert_allclose(apply(T_W_B, command[:, :3]), listed[:, :3], atol=1.2e-3)


@pytest.mark.parametrize(
    ("old", "new", "token"),
    [
        (L2, "L P[2] 500mm/sec FINE Offset,PR[1]", "drill.ls line 5 (statement 1): L P[2]"),
        ("1200.000", "9000.000", "P[2] (drill.ls line 7)"),
        ("75.000", "85.000", "9.90 deg"),
        ("1,*,*,*,*", "1,1,*,*,*", "drill.ls line 3: DEFAULT_GROUP"),
    ],
)
def test_refused_and_nothing_written(desk: Workplace, old: str, new: str, token: str) -> None:
    desk.program(listing([L2], position(2)).replace(old, new))
    assert token in desk.refused()


def test_the_numbers_of_a_user_frame_are_printed_as_the_pendant_has_them(desk: Workplace) -> None:
    desk.program(listing([L2], position(2)))
    said = desk.run().stderr
    match = re.search(r"X (\S+) Y (\S+) Z (\S+) W (\S+) P (\S+) R (\S+)", said)
    assert match is not None, said
    x, y, z, w, p, r = map(float, match.groups())
    entered = pose_from_zyx(x, y, z, r, p, w)
    np.testing.assert_allclose(entered, inverse(T_W_B), atol=6e-4)
    assert "drill.ls: drill.ls" not in said


@pytest.mark.parametrize(("config", "code"), [("F U T", 0), ("N U T", 2), ("F D T", 2)])
def test_positions_in_another_posture_than_the_calibrated(
    desk: Workplace, config: str, code: int
) -> None:
    desk.calibrate(digest=CELL.digest)
    desk.program(listing([L2], position(2, config=f"{config}, 0, 0, 0")))
    done = desk.run("--cell", "paper")
    assert done.returncode == code, done.stderr
    named = f"P[2] (drill.ls line 7), CONFIG '{config}, 0, 0, 0': S "
    assert (named in done.stderr) == (code == 2)


@pytest.mark.parametrize(("ut", "code"), [(1, 0), (2, 2), (0, 2), ("F", 0)])
def test_a_tool_that_is_not_the_calibrated_one(desk: Workplace, ut: object, code: int) -> None:
    desk.calibrate(digest=CELL.digest)
    desk.program(listing([L2], position(2, ut=ut)))
    done = desk.run("--cell", "paper")
    assert done.returncode == code, done.stderr
    assert (f"drill.ls line 7: the tool is UT {ut}" in done.stderr) == (code == 2)


@pytest.mark.parametrize(("e1_mm", "code"), [(1100.0, 0), (300.0, 2)])
def test_a_program_that_drives_the_slide_to_another_station(
    desk: Workplace, e1_mm: float, code: int
) -> None:
    desk.calibrate(digest=load_cell("paper", {"rail.driver": "kuka-e1"}).digest)
    desk.program(listing([L2], position(2, more=f",\n\tE1= {e1_mm:9.3f}  mm")))
    done = desk.run("--cell", "paper", "--set", "rail.driver=kuka-e1")
    assert done.returncode == code, done.stderr
    assert ("moves the slide to 300 mm, expected 1100 mm" in done.stderr) == (code == 2)
    desk.calibrate(digest=CELL.digest)
    done = desk.run("--cell", "paper", out=desk.folder / "by-another-drive.ls")
    assert f"(drill.ls line 7): its external axis at {e1_mm:g} mm is left as it is" in done.stderr


def test_prepare_writes_the_form_that_the_cell_states(tmp_path: Path) -> None:
    made(tmp_path)
    source = holes(tmp_path, *INSIDE)
    done = prepare(tmp_path, source, "--set", "robot.program=fanuc-tp")
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "out" / "S1100.ls").read_text("ascii")
    assert text.startswith("/PROG  S1100\n")
    assert not list((tmp_path / "out").glob("*.src"))
    assert "S1100.ls" in (tmp_path / "out" / "summary.json").read_text()


def test_an_unknown_form_is_refused_with_those_installed(tmp_path: Path) -> None:
    made(tmp_path)
    said = refused(tmp_path, holes(tmp_path, *INSIDE), "--set", "robot.program=fanuc")
    assert "robot.program: unknown form 'fanuc'" not in said
    assert "unknown form 'fanuc'; installed: " in said
    assert "fanuc-tp, kuka-c3" in said
