"""`compensate` as a command, in this process, on calibrations whose errors are known."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.calibration.file import write_calibration
from hilcell.cell.file import load_cell
from hilcell.commands.cli import main
from hilcell.compensation.interpolation import trilinear
from hilcell.compensation.programs import load_program
from hilcell.compensation.targets import read_targets, write_targets
from hilcell.geometry.frames import apply, inverse
from tests.hilcell.calibration.calibrations import T_W_B, calibration
from tests.hilcell.krl.samples import DAT, SRC


class Workplace:
    """A folder with a calibration and a program, and the command over them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.out = folder / "out.src"
        self.source = folder / "drill.src"
        self.calibrate()
        self.program()

    def calibrate(self, size_mm: float = 1.2, **provenance: Any) -> None:
        write_calibration(calibration(size_mm, **provenance), self.folder / "calibration.json")

    def program(self, src: str = SRC, dat: str = DAT) -> None:
        self.source.write_text(src, "latin-1")
        self.source.with_suffix(".dat").write_text(dat, "latin-1")

    def compensate(self, *words: str, source: Path | None = None, out: Path | None = None) -> int:
        return main(
            ["compensate", str(self.folder / "calibration.json"), str(source or self.source),
             "--station", "S1100", "-o", str(out or self.out), *words]
        )  # fmt: skip

    @property
    def files(self) -> list[str]:
        return sorted(path.name for path in self.folder.iterdir())


BEFORE = ["calibration.json", "drill.dat", "drill.src"]


@pytest.fixture
def desk(tmp_path: Path) -> Workplace:
    return Workplace(tmp_path)


def test_a_corrected_program_arrives(desk: Workplace, capsys: pytest.CaptureFixture[str]) -> None:
    """Command + error at the command = target, to the rounding of three decimals."""
    assert desk.compensate() == 0
    nominal, command = load_program(desk.source), load_program(desk.out)
    made = calibration()
    in_base = apply(inverse(T_W_B), command.values()[:, :3])
    arrived = in_base + trilinear(made.grid(), np.array(made.grid_errors_mm), in_base)
    wanted = apply(inverse(T_W_B), nominal.values()[:, :3])
    assert np.abs(command.values()[:, :3] - nominal.values()[:, :3]).max() > 0.3
    np.testing.assert_allclose(arrived, wanted, atol=2e-3)
    np.testing.assert_array_equal(command.values()[:, 3:], nominal.values()[:, 3:])
    told = capsys.readouterr()
    assert told.out == ""
    assert "5 targets corrected for S1100 into" in told.err
    assert "drill.src: not used by a motion, left: XP3" in told.err
    assert "its base must be {W}" in told.err
    assert "SIMULATED" not in told.err


def test_program_and_list_agree(desk: Workplace, tmp_path: Path) -> None:
    program = load_program(desk.source)
    targets, out = tmp_path / "targets.csv", tmp_path / "out.csv"
    write_targets(targets, [f"H{n}" for n in range(5)], program.values())
    assert desk.compensate() == 0
    assert desk.compensate(source=targets, out=out) == 0
    _, listed = read_targets(out)
    np.testing.assert_allclose(load_program(desk.out).values()[:, :3], listed[:, :3], atol=6e-4)


def test_zero_errors_change_nothing_twice(desk: Workplace) -> None:
    desk.calibrate(0.0)
    again = desk.folder / "again.src"
    assert desk.compensate() == 0
    assert desk.compensate(source=desk.out, out=again) == 0
    assert again.read_bytes() == desk.out.read_bytes()
    assert again.with_suffix(".dat").read_bytes() == desk.out.with_suffix(".dat").read_bytes()


def test_simulated_is_warned_of(desk: Workplace, capsys: pytest.CaptureFixture[str]) -> None:
    desk.calibrate(simulated=True)
    assert desk.compensate() == 0
    assert "SIMULATED: run 20261101" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("src", "dat", "words", "part"),
    [
        (SRC.replace("lin xp2", "LIN_REL {Z 1}"), DAT, (), "drill.src line 32: LIN_REL"),
        (SRC, DAT.replace("Z +1000.5", "Z 9000"), (), "XP1 (drill.dat line 8) by "),
        (
            SRC,
            DAT.replace(
                "HOLE[2]={X 0.0,Y 50.0,Z 1200.0,A 0.0,B 75.0",
                "HOLE[2]={X 0.0,Y 50.0,Z 1200.0,A 0.0,B 85.0",
            ),
            (),
            "HOLE[2] (drill.dat line 16) by 9.90 deg",
        ),
        (SRC, DAT.replace("Z +1000.5", "Z 1E308"), (), "1 targets are not in the cell"),
        (SRC, DAT, ("--temperature", "40"), "40.0 C is not within 2 K"),
        (SRC, DAT, ("--cell", "paper"), "another cell"),
        (SRC, DAT, ("--max-age", "-1"), "days ago, wanted <= -1 days"),
        (SRC, DAT, ("--station", "S7"), "station 'S7' is not calibrated"),
    ],
)
def test_refused_and_nothing_written(
    desk: Workplace,
    capsys: pytest.CaptureFixture[str],
    src: str,
    dat: str,
    words: tuple[str, ...],
    part: str,
) -> None:
    desk.program(src, dat)
    assert desk.compensate(*words) == 2
    assert part in capsys.readouterr().err
    assert desk.files == BEFORE
    desk.out.write_text("old")
    assert desk.compensate(*words) == 2
    assert desk.out.read_text() == "old"
    assert desk.files == sorted([*BEFORE, "out.src"])


def test_an_unproven_calibration_is_refused(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    desk.calibrate(sign_checked=False)
    assert desk.compensate() == 2
    assert "sign check did not hold" in capsys.readouterr().err
    file = desk.folder / "calibration.json"
    desk.calibrate()
    file.write_text(file.read_text().replace(',\n  "sign_checked": true', ""))
    assert "sign_checked" not in file.read_text()
    assert desk.compensate() == 2
    assert "was changed after it was written" in capsys.readouterr().err
    assert desk.files == BEFORE


def test_the_right_cell_is_taken(desk: Workplace) -> None:
    desk.calibrate(digest=load_cell("paper", {"grid.pitch_mm": "450.0"}).digest)
    assert desk.compensate("--cell", "paper", "--set", "grid.pitch_mm=450.0") == 0
    assert desk.compensate("--cell", "paper") == 2


@pytest.mark.parametrize("out", ["drill.src", "drill", "targets.csv"])
def test_nominal_targets_are_not_replaced(desk: Workplace, out: str) -> None:
    targets = desk.folder / "targets.csv"
    write_targets(targets, ["H1"], np.array([[0.0, 0, 1200, 0, 75, 0]]))
    source = targets if out.endswith("csv") else desk.source
    before = source.read_bytes()
    assert desk.compensate(source=source, out=desk.folder / out) == 2
    assert source.read_bytes() == before


@pytest.mark.parametrize("kind", ["program", "list"])
@pytest.mark.parametrize("where", [".", "/", "n" * 300, "nowhere/out", "file/out"])
def test_places_that_cannot_be_written_are_told_in_one_line(
    desk: Workplace, capsys: pytest.CaptureFixture[str], kind: str, where: str
) -> None:
    (desk.folder / "file").write_text("")
    targets = desk.folder / "targets.csv"
    write_targets(targets, ["H1"], np.array([[0.0, 0, 1200, 0, 75, 0]]))
    before = desk.files
    source = desk.source if kind == "program" else targets
    assert desk.compensate(source=source, out=desk.folder / where) == 2
    told = capsys.readouterr().err.splitlines()
    assert len([line for line in told if "not checked" not in line]) == 1
    assert ("is a folder" in told[-1]) == (where in "./")
    assert desk.files == before


def test_the_calibration_is_not_written_over(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    targets = desk.folder / "targets.csv"
    write_targets(targets, ["H1"], np.array([[0.0, 0, 1200, 0, 75, 0]]))
    file = desk.folder / "calibration.json"
    before = file.read_bytes()
    assert desk.compensate(source=targets, out=file) == 2
    assert "is what is read" in capsys.readouterr().err
    (desk.folder / "link.src").symlink_to(file)
    assert desk.compensate(out=desk.folder / "link.src") == 2
    assert file.read_bytes() == before


def test_a_calibration_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("nowhere.json", "n" * 300):
        assert main(["compensate", name, "targets.csv", "--station", "S1100", "-o", "out"]) == 2
        assert capsys.readouterr().err.startswith("hilcell: run 'n")


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
    told = capsys.readouterr().err
    assert ("XP1 (drill.dat line 1): A1 goes from 0.00" in told) == (code == 2)
    assert desk.out.exists() == (code == 0)


def test_turns_nobody_checked_are_told(desk: Workplace, capsys: pytest.CaptureFixture[str]) -> None:
    desk.program("PTP XP1", near_zero(",S 6,T 19"))
    assert desk.compensate() == 0
    assert "turns (T) were not checked; --cell CELL does" in capsys.readouterr().err
