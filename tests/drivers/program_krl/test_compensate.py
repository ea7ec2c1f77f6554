"""`compensate` as a command, in this process, on KRL programs."""

from pathlib import Path

import numpy as np
import pytest

from drivers.kuka.program_krl.files import load_program
from hilcell.cell.file import load_cell
from hilcell.compensation.targets import write_targets
from hilcell.geometry.frames import apply, inverse
from tests.drivers.program_krl.samples import DAT, SRC
from tests.hilcell.calibration.calibrations import T_W_B, calibration
from tests.hilcell.commands import workplace
from tests.hilcell.compensation.models import level


class Workplace(workplace.Workplace):
    """A folder with a calibration and a KRL program, and the command over them."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "drill.src", "out.src")
        self.program()

    def program(self, src: str = SRC, dat: str = DAT) -> None:
        self.source.write_text(src, "latin-1")
        self.source.with_suffix(".dat").write_text(dat, "latin-1")


BEFORE = ["calibration.json", "drill.dat", "drill.src"]


@pytest.fixture
def desk(tmp_path: Path) -> Workplace:
    return Workplace(tmp_path)


def test_a_corrected_program_arrives(desk: Workplace, capsys: pytest.CaptureFixture[str]) -> None:
    """Command + error at the command = target, to the rounding of three decimals."""
    assert desk.compensate() == 0
    nominal, command = load_program(desk.source), load_program(desk.out)
    in_base = apply(inverse(T_W_B), command.values()[:, :3])
    arrived = in_base + calibration().error_model().predict(level(in_base)).error_mm
    wanted = apply(inverse(T_W_B), nominal.values()[:, :3])
    assert np.abs(command.values()[:, :3] - nominal.values()[:, :3]).max() > 0.3
    np.testing.assert_allclose(arrived, wanted, atol=2e-3)
    np.testing.assert_array_equal(command.values()[:, 3:], nominal.values()[:, 3:])
    said = capsys.readouterr()
    assert said.out == ""
    assert "5 targets corrected for S1100 into" in said.err
    assert "drill.src: not used by a motion, left: XP3" in said.err
    assert "its targets were taken in {W}, its base must be {W}" in said.err
    assert "SIMULATED" not in said.err


def test_program_and_list_agree(desk: Workplace, tmp_path: Path) -> None:
    program = load_program(desk.source)
    targets, out = tmp_path / "targets.csv", tmp_path / "out.csv"
    write_targets(targets, [f"H{n}" for n in range(5)], program.values())
    assert desk.compensate() == 0
    assert desk.compensate(source=targets, out=out) == 0
    _, listed, _ = workplace.read_corrected(out)
    np.testing.assert_allclose(load_program(desk.out).values()[:, :3], listed[:, :3], atol=6e-4)


def test_what_was_corrected_is_not_corrected_again(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    again = desk.folder / "again.src"
    assert desk.compensate() == 0
    before = desk.files
    assert desk.compensate(source=desk.out, out=again) == 2
    assert "corrected by 20261101-120000-calibrate-abcd for S1100 on" in capsys.readouterr().err
    assert desk.files == before


@pytest.mark.parametrize(
    ("src", "dat", "part"),
    [
        (SRC.replace("lin xp2", "LIN_REL {Z 1}"), DAT, "drill.src line 32: LIN_REL"),
        (SRC, DAT.replace("Z +1000.5", "Z 9000"), "XP1 (drill.dat line 8) by "),
        (
            SRC,
            DAT.replace(
                "HOLE[2]={X 0.0,Y 50.0,Z 1200.0,A 0.0,B 75.0",
                "HOLE[2]={X 0.0,Y 50.0,Z 1200.0,A 0.0,B 85.0",
            ),
            "HOLE[2] (drill.dat line 16) by 9.90 deg",
        ),
        (SRC, DAT.replace("Z +1000.5", "Z 1E308"), "1 targets are not in the cell"),
    ],
)
def test_refused_and_nothing_written(
    desk: Workplace,
    capsys: pytest.CaptureFixture[str],
    src: str,
    dat: str,
    part: str,
) -> None:
    desk.program(src, dat)
    assert desk.compensate() == 2
    assert part in capsys.readouterr().err
    assert desk.files == BEFORE
    desk.out.write_text("old")
    assert desk.compensate() == 2
    assert desk.out.read_text() == "old"
    assert desk.files == sorted([*BEFORE, "out.src"])


@pytest.mark.parametrize("out", ["drill.src", "drill"])
def test_the_nominal_program_is_not_replaced(desk: Workplace, out: str) -> None:
    before = desk.source.read_bytes()
    assert desk.compensate(out=desk.folder / out) == 2
    assert desk.source.read_bytes() == before


@pytest.mark.parametrize("where", [".", "/", "n" * 300, "nowhere/out", "file/out"])
def test_places_that_cannot_be_written_are_reported_in_one_line(
    desk: Workplace, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    (desk.folder / "file").write_text("")
    before = desk.files
    assert desk.compensate(out=desk.folder / where) == 2
    err = capsys.readouterr().err.splitlines()
    assert len([line for line in err if "not checked" not in line]) == 1
    assert ("is a folder" in err[-1]) == (where in "./")
    assert desk.files == before


def test_the_calibration_is_not_written_over_by_a_link(desk: Workplace) -> None:
    file = desk.folder / "calibration.json"
    before = file.read_bytes()
    (desk.folder / "link.src").symlink_to(file)
    assert desk.compensate(out=desk.folder / "link.src") == 2
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("tool", "code"),
    [
        ("$TOOL=TOOL_DATA[2]", 2),
        ("BAS (#TOOL,3 )", 2),
        ("FDAT_ACT=FP1", 2),
        ("BAS (#TOOL,1 )", 0),
        ("$TOOL=DRILL", 0),
    ],
)
def test_a_tool_that_is_not_the_calibrated_one(
    desk: Workplace, capsys: pytest.CaptureFixture[str], tool: str, code: int
) -> None:
    """Refused with the cell; without it a note names the tool."""
    dat = "DECL FDAT FP1={TOOL_NO 4,BASE_NO 2,IPO_FRAME #BASE}\n" + DAT
    point = "LIN {X 0.0,Y 0.0,Z 1200.0,A 0.0,B 75.0,C 0.0}"
    desk.program(f"DEF drill( )\n{tool}\n{point}\nEND\n", dat.replace("FP1={TOOL_NO 1", "FP0={"))
    desk.calibrate(digest=load_cell("paper").digest)
    assert desk.compensate("--cell", "paper") == code
    said = capsys.readouterr().err
    assert ("wanted TOOL_DATA[1], which the calibration holds for" in said) == (code == 2)
    assert desk.compensate(out=desk.folder / "noted.src") == 0
    assert "its tool is " in capsys.readouterr().err


def test_a_module_that_has_another_name_than_its_file(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    desk.program("DEF drill( )\nLIN {X 0.0,Y 0.0,Z 1200.0,A 0.0,B 75.0,C 0.0}\nEND\n", "")
    (desk.folder / "new").mkdir()
    assert desk.compensate(out=desk.folder / "other.src") == 0
    said = capsys.readouterr().err
    assert "other.src: DEF names the module drill (line 1), and a KUKA wants module and" in said
    assert desk.compensate(out=desk.folder / "new" / "Drill.src") == 0
    assert "names the module" not in capsys.readouterr().err


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
    desk: Workplace, capsys: pytest.CaptureFixture[str], motion: str, posture: str, code: int
) -> None:
    desk.calibrate(digest=load_cell("paper").digest)
    desk.program(f"{motion} XP1", near_zero(posture))
    assert desk.compensate("--cell", "paper") == code
    err = capsys.readouterr().err
    assert ("XP1 (drill.dat line 1): A1 goes from 0.00" in err) == (code == 2)
    assert desk.out.exists() == (code == 0)


def test_turns_that_were_not_checked_are_reported(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    desk.program("PTP XP1", near_zero(",S 6,T 19"))
    assert desk.compensate() == 0
    assert "turns (T) were not checked; --cell CELL does" in capsys.readouterr().err
