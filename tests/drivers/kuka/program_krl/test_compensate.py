"""`compensate` as a command, in this process, on KRL programs."""

import numpy as np
import pytest

from drivers.kuka.program_krl.files import load_program
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply, inverse
from tests.drivers.kuka.program_krl.samples import DAT, SRC, Workplace
from tests.hilcell.calibration.calibrations import T_W_B, calibration
from tests.hilcell.commands.workplace import read_corrected
from tests.hilcell.compensation.models import level
from tests.hilcell.lists import write_targets


def test_a_corrected_program_arrives_like_a_list_and_is_not_corrected_again(
    workplace: Workplace,
) -> None:
    """Command + error at the command = target, to the rounding of three decimals."""
    done = workplace.run()
    assert (done.returncode, done.stdout) == (0, "")
    assert "XP3" in done.stderr, "it is not used by a motion"
    nominal, command = load_program(workplace.source), load_program(workplace.out)
    in_base = apply(inverse(T_W_B), command.values()[:, :3])
    arrived = in_base + calibration().error_model().predict(level(in_base)).error_mm
    expected = apply(inverse(T_W_B), nominal.values()[:, :3])
    assert np.abs(command.values()[:, :3] - nominal.values()[:, :3]).max() > 0.3
    np.testing.assert_allclose(arrived, expected, atol=2e-3)
    np.testing.assert_array_equal(command.values()[:, 3:], nominal.values()[:, 3:])
    targets, out = workplace.folder / "targets.csv", workplace.folder / "out.csv"
    write_targets(targets, [f"H{n}" for n in range(5)], nominal.values())
    assert workplace.compensate(source=targets, out=out) == 0
    _, listed, _ = read_corrected(out)
    np.testing.assert_allclose(command.values()[:, :3], listed[:, :3], atol=6e-4)
    said = workplace.refused(source=workplace.out, out=workplace.folder / "again.src")
    assert (
        "out.src was corrected before (hilcell: corrected by 20261101-120000-calibrate-abcd" in said
    )


@pytest.mark.parametrize(
    ("src", "dat", "token"),
    [
        (SRC.replace("lin xp2", "LIN_REL {Z 1}"), DAT, "drill.src line 32"),
        (SRC, DAT.replace("Z +1000.5", "Z 9000"), "XP1 (drill.dat line 8)"),
        (SRC, DAT.replace("50.0,Z 1200.0,A 0.0,B 75.0", "50.0,Z 1200.0,A 0.0,B 85.0"), "9.90 deg"),
        (SRC, DAT.replace("Z +1000.5", "Z 1E308"), "1 target "),
    ],
)
def test_refused_and_nothing_written(workplace: Workplace, src: str, dat: str, token: str) -> None:
    workplace.program(src, dat)
    assert token in workplace.refused()
    workplace.out.write_text("old")
    assert token in workplace.refused()


@pytest.mark.parametrize("out", ["drill.src", "drill", "link.src"])
def test_neither_program_nor_calibration_is_replaced(workplace: Workplace, out: str) -> None:
    (workplace.folder / "link.src").symlink_to(workplace.folder / "calibration.json")
    workplace.refused(out=workplace.folder / out)


@pytest.mark.parametrize(
    ("tool", "code"),
    [
        ("$TOOL=TOOL_DATA[2]", 2),
        ("BAS (#TOOL,3 )", 2),
        ("FDAT_ACT=FP1", 2),
        ("BAS (#TOOL,1 )", 0),
        ("$TOOL={X 98.0,Y 0.0,Z 127.0,A 0.0,B 0.0,C 0.0}", 0),
        ("$TOOL={X 98.0,Y 0.0,Z 227.0,A 0.0,B 0.0,C 0.0}", 2),
    ],
)
def test_a_tool_that_is_not_the_calibrated_one(workplace: Workplace, tool: str, code: int) -> None:
    """Refused with the cell; without it a note names the tool."""
    form = "DECL FDAT FP1={TOOL_NO 4,BASE_NO 2,IPO_FRAME #BASE}\n"
    dat = form + DAT.replace("FP1={TOOL_NO 1", "FP0={")
    point = "LIN {X 0.0,Y 0.0,Z 1200.0,A 0.0,B 75.0,C 0.0}"
    workplace.program(f"DEF drill( )\n{tool}\n{point}\nEND\n", dat)
    workplace.calibrate(digest=load_cell("paper").digest)
    assert workplace.compensate("--cell", "paper") == code
    noted = workplace.run(out=workplace.folder / "noted.src")
    assert noted.returncode == 0
    assert "its tool" in noted.stderr


def test_a_module_that_has_another_name_than_its_file(workplace: Workplace) -> None:
    workplace.program("DEF drill( )\nLIN {X 0.0,Y 0.0,Z 1200.0,A 0.0,B 75.0,C 0.0}\nEND\n", "")
    (workplace.folder / "new").mkdir()
    for out, noted in (("other.src", True), ("new/Drill.src", False)):
        done = workplace.run(out=workplace.folder / out)
        assert done.returncode == 0
        assert ("DEF" in done.stderr) is noted


def near_zero(posture: str) -> str:
    """Return a data list whose point the correction takes from -0.2 to about 0.3 mm beside A1."""
    x, y, z = apply(T_W_B, np.array([[1850.0, -0.2, 950.0]]))[0]
    return f"DECL E6POS XP1={{X {x:.4f},Y {y:.4f},Z {z:.4f},A 0,B 75,C 0{posture}}}"


@pytest.mark.parametrize(
    ("motion", "posture", "code"),
    [
        ("PTP", ",S 6,T 19", 2),
        ("PTP", ",S 'B110',T 'B10011'", 2),
        ("LIN", ",S 6,T 19", 0),
        ("PTP", ",S 6", 0),
    ],
)
def test_turns_that_the_correction_changes(
    workplace: Workplace, motion: str, posture: str, code: int
) -> None:
    """Without the cell they are not checked, and a note says so."""
    workplace.calibrate(digest=load_cell("paper").digest)
    workplace.program(f"{motion} XP1", near_zero(posture))
    done = workplace.run("--cell", "paper")
    assert done.returncode == code
    assert ("XP1 (drill.dat line 1): A1" in done.stderr) == (code == 2)
    assert workplace.out.exists() == (code == 0)
    unchecked = workplace.run(out=workplace.folder / "unchecked.src")
    assert unchecked.returncode == 0
    assert ("turns (T)" in unchecked.stderr) == (code == 2)


@pytest.mark.parametrize(("status", "code"), [(6, 0), (22, 0), (2, 2), (7, 2)])
def test_points_in_another_posture_than_the_calibrated_are_refused(
    workplace: Workplace, status: int, code: int
) -> None:
    """Errors are those of joints: by another elbow or wrist the robot errs by millimetres more.

    Bit 4 says that the robot has absolute accuracy, which is no posture.
    """
    workplace.calibrate(digest=load_cell("paper").digest)
    workplace.program("PTP XP1", f"DECL E6POS XP1={{X 0.0,Y 0.0,Z 1200.0,A 0,B 75,C 0,S {status}}}")
    done = workplace.run("--cell", "paper")
    assert done.returncode == code, done.stderr
    assert ("another posture than the calibrated one, S 6" in done.stderr) == (code == 2)
    unchecked = workplace.run(out=workplace.folder / "unchecked.src")
    assert "postures (S) were not checked" in unchecked.stderr


@pytest.mark.parametrize(("e1_mm", "code"), [(1100.0, 0), (1101.5, 0), (300.0, 2)])
def test_a_program_that_drives_the_slide_to_another_station_is_refused(
    workplace: Workplace, e1_mm: float, code: int
) -> None:
    rides = ("--set", "rail.driver=kuka-e1")
    cell = load_cell("paper", {"rail.driver": "kuka-e1"})
    workplace.calibrate(digest=cell.digest)
    workplace.program("LIN XP1", f"DECL E6POS XP1={{X 0,Y 0,Z 1200,A 0,B 75,C 0,E1 {e1_mm}}}")
    done = workplace.run("--cell", "paper", *rides)
    assert done.returncode == code, done.stderr
    assert ("moves the slide to 300 mm, expected 1100 mm" in done.stderr) == (code == 2)
    assert "is not checked" not in done.stderr


def test_an_external_axis_that_is_not_the_slide_of_the_cell_is_not_checked(
    workplace: Workplace,
) -> None:
    workplace.calibrate(digest=load_cell("paper").digest)
    workplace.program("LIN XP1", "DECL E6POS XP1={X 0,Y 0,Z 1200,A 0,B 75,C 0,E1 300}")
    where = "XP1 (drill.dat line 1): its external axis at 300 mm is left as it is and not checked"
    driven = f"{where}: this cell's slide is not moved by the robot's controller"
    assert driven in workplace.run("--cell", "paper").stderr
    assert (
        f"{where}: --cell CELL is not given" in workplace.run(out=workplace.folder / "2.src").stderr
    )
    workplace.program("LIN XP1", "DECL E6POS XP1={X 0,Y 0,Z 1200,A 0,B 75,C 0}")
    done = workplace.run("--cell", "paper", out=workplace.folder / "3.src")
    assert done.returncode == 0
    assert "external axis" not in done.stderr
