"""`compensate` as a command, in this process: lists of targets, and programs of any format."""

import csv
import json
import re
import sys
from collections.abc import Iterator
from importlib import invalidate_caches
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.budget import DRILL
from hilcell.calibration.decision import Guard, judged
from hilcell.calibration.file import write_calibration
from hilcell.calibration.influence import ASSUMED, Influence, Uncertainty, motion
from hilcell.cell.file import load_cell
from hilcell.commands.cli import main
from hilcell.compensation.stamp import COLUMN, Stamp
from hilcell.compensation.targets import HEADER, write_targets
from hilcell.geometry.frames import apply, inverse
from tests.hilcell.calibration.calibrations import LIMITS, T_W_B, calibration
from tests.hilcell.cell.packages import install
from tests.hilcell.commands.workplace import Workplace, read_corrected
from tests.hilcell.compensation.models import level

TARGETS = np.array([[0.0, 0, 1200, 0, 75, 0], [0.0, 50, 1250, 0, 75, 0]])
STAMP = r"hilcell: corrected by 20261101-\S+ for S1100 on 2026-\d\d-\d\dT\d\d:\d\d:\d\dZ"
UNKNOWN = "standing unknown: not among this cell's finished runs"
BOUNDS = r"95 % bounds of the corrected targets: median 0\.\d{3} mm, largest 0\.\d{3} mm at H[12].*"


@pytest.fixture
def desk(tmp_path: Path) -> Workplace:
    write_targets(tmp_path / "targets.csv", ["H1", "H2"], TARGETS)
    return Workplace(tmp_path, "targets.csv", "out.csv")


def arrived_mm(command: np.ndarray) -> np.ndarray:
    """Return where commands (N, 3) end, in {W}: each plus the error at the command."""
    in_base = apply(inverse(T_W_B), command)
    return apply(T_W_B, in_base + calibration().error_model().predict(level(in_base)).error_mm)


def test_a_corrected_list_arrives(desk: Workplace, capsys: pytest.CaptureFixture[str]) -> None:
    assert desk.compensate() == 0
    names, command, (stamp,) = read_corrected(desk.out)
    assert names == ["H1", "H2"]
    assert re.fullmatch(f"{STAMP}; {UNKNOWN}", stamp)
    assert np.abs(command[:, :3] - TARGETS[:, :3]).max() > 0.3
    np.testing.assert_allclose(arrived_mm(command[:, :3]), TARGETS[:, :3], atol=2e-3)
    reported = capsys.readouterr()
    corrected, bounds, unknown = reported.err.splitlines()
    assert "whether its calibration is current is not known" in unknown
    assert (reported.out, corrected) == ("", f"2 targets corrected for S1100 into {desk.out}")
    assert re.fullmatch(BOUNDS, bounds)


def test_a_copy_away_from_its_runs_stands_unknown_in_all_that_is_said(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    assert desk.compensate("--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["standing"] == "unknown"
    assert said["stamp"].endswith(UNKNOWN)
    assert any("whether its calibration is current is not known" in note for note in said["notes"])


def test_a_list_is_handed_on_to_a_program_that_reads_it(desk: Workplace) -> None:
    """In this process's own stdout, which here is a file that others write as well."""
    shared = desk.folder / "shared.txt"
    with shared.open("w") as file:
        file.write("before\n")
        file.flush()
        out = Path(f"/dev/fd/{file.fileno()}")
        assert desk.compensate(out=out) == 0
        file.write("after\n")
    first, header, *rows, last = shared.read_text().splitlines()
    assert (first, last) == ("before", "after")
    assert header == ",".join([*HEADER, COLUMN])
    assert [row.partition(",")[0] for row in rows] == ["H1", "H2"]


def test_simulated_is_warned_of(desk: Workplace, capsys: pytest.CaptureFixture[str]) -> None:
    desk.calibrate(simulated=True)
    assert desk.compensate() == 0
    assert "SIMULATED: run 20261101" in capsys.readouterr().err
    _, _, (stamp,) = read_corrected(desk.out)
    assert re.fullmatch(f"{STAMP}; SIMULATION; {UNKNOWN}", stamp)


def test_what_was_corrected_is_not_corrected_again(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    assert desk.compensate() == 0
    again = desk.folder / "again.csv"
    for command in (
        lambda: desk.compensate(source=desk.out, out=again),
        lambda: main(["plan", str(desk.out)]),
    ):
        assert command() == 2
        assert "corrected by 20261101-120000-calibrate-abcd for S1100 on 2026-" in (
            capsys.readouterr().err
        )
    assert not again.exists()
    text = desk.out.read_text()
    header, *rows = text.splitlines()
    blank = [header, *(f"{row.rpartition(',')[0]}," for row in rows)]
    desk.out.write_text("\n".join(blank))
    assert desk.compensate(source=desk.out, out=again) == 2
    assert "was corrected before (it has a column corrected_by)" in capsys.readouterr().err
    desk.out.write_text(text.replace(",corrected_by", "", 1))  # as a spreadsheet would not
    assert desk.compensate(source=desk.out, out=again) == 2
    assert "was corrected before" in capsys.readouterr().err


def test_bounds_are_written_beside_the_targets(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    bounds = desk.folder / "bounds.csv"
    assert desk.compensate("--bounds", str(bounds)) == 0
    rows = list(csv.DictReader(bounds.read_text().splitlines()))
    assert [row["name"] for row in rows] == ["H1", "H2"]
    wide = [float(row["bound95_mm"]) for row in rows]
    assert f"largest {max(wide):.3f} mm" in capsys.readouterr().err
    for row, bound in zip(rows, wide, strict=True):
        u = np.array([float(row[f"u_{axis}_mm"]) for axis in "xyz"])
        assert 1.9 * np.linalg.norm(u) > bound > 1.6 * np.linalg.norm(u)  # 1.61 of a sphere
    names, _, _ = read_corrected(desk.out)
    assert names == ["H1", "H2"]
    assert desk.compensate("--bounds", str(bounds), "--temperature", "22.5") == 0
    narrow = [float(r["bound95_mm"]) for r in csv.DictReader(bounds.read_text().splitlines())]
    assert all(here < anywhere for here, anywhere in zip(narrow, wide, strict=True))


@pytest.mark.parametrize("name", ["out.csv", "targets.csv", "calibration.json"])
def test_bounds_replace_no_other_file(
    desk: Workplace, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    before = {file: (desk.folder / file).read_bytes() for file in desk.files}
    assert desk.compensate("--bounds", str(desk.folder / name)) == 2
    assert name in capsys.readouterr().err
    assert {file: (desk.folder / file).read_bytes() for file in desk.files} == before


def test_bounds_that_cannot_be_stated(desk: Workplace, capsys: pytest.CaptureFixture[str]) -> None:
    """Targets are corrected without; asked for, bounds are refused before anything is written."""
    bare = msgspec.structs.replace(calibration(), uncertainty=Uncertainty(missing="no visits"))
    write_calibration(bare, desk.folder / "calibration.json")
    bounds = desk.folder / "bounds.csv"
    assert desk.compensate("--bounds", str(bounds)) == 2
    assert desk.files == ["calibration.json", "targets.csv"]
    assert desk.compensate() == 0
    told = capsys.readouterr().err
    assert told.count("no 95 % bounds of corrected targets: no visits") == 2


def test_bounds_hold_at_the_drill_of_the_cell(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    """1 mrad at 200 mm is 0.2 mm, whatever the calibration's own drill was."""
    made = calibration(digest=load_cell("paper").digest)
    stated = made.uncertainty
    assert stated is not None
    drill = Influence(
        DRILL, ASSUMED, "", "5.1.2", "tool", motion(0.0, 1e-6), (0.0, 0.0, -50.0), counts="in use"
    )
    stated = msgspec.structs.replace(stated, lines=[*stated.lines, drill])
    made = msgspec.structs.replace(made, uncertainty=stated)
    write_calibration(made, desk.folder / "calibration.json")
    bounds, found = desk.folder / "bounds.csv", []
    for offset in ("[0.0, 0.0, 0.0]", "[0.0, 0.0, 200.0]"):
        words = ("--cell", "paper", "--set", f"uncertainty.drill_offset_mm={offset}")
        assert desk.compensate(*words, "--bounds", str(bounds)) == 0
        row = next(csv.DictReader(bounds.read_text().splitlines()))
        found.append(sum(float(row[f"u_{axis}_mm"]) ** 2 for axis in "xyz"))
    assert found[1] - found[0] == pytest.approx(2 * (0.2**2 - 0.05**2), rel=0.01)
    assert "they hold at the drill, (0 0 200) mm from the reflector" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--cell", "paper", "--set", "uncertainty.orientation_urad=5"), "states its own budget"),
        (("--set", "uncertainty.drill_offset_mm=[0,0,200]"), "none is given"),
    ],
)
def test_settings_without_effect_are_refused(
    desk: Workplace, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], says: str
) -> None:
    assert desk.compensate(*words) == 2
    assert says in capsys.readouterr().err
    assert desk.files == ["calibration.json", "targets.csv"]


@pytest.mark.parametrize("days", ["-1", "nan", "inf", "soon", "36501", "1e300"])
def test_an_age_is_a_number_of_days(
    desk: Workplace, capsys: pytest.CaptureFixture[str], days: str
) -> None:
    with pytest.raises(SystemExit, match="2"):
        desk.compensate("--max-age", days)
    assert "days of 0 .. 36500 are wanted" in capsys.readouterr().err


def test_a_program_of_no_known_format_is_named(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    source = desk.folder / "drill.MOD"
    source.write_text("MODULE drill\n")
    assert desk.compensate(source=source) == 2
    told = capsys.readouterr().err
    assert "header must be" in told
    assert "no format of programs is installed for .mod (installed: .script, .src)" in told
    table = desk.folder / "drill.csv"
    table.write_text("MODULE drill\n")
    assert desk.compensate(source=table) == 2
    assert "format" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("--temperature", "40"), "40.0 C is not within 2 K"),
        (("--cell", "paper"), "another cell"),
        (("--max-age", "0"), "days ago, wanted <= 0 days"),
        (("--station", "S7"), "station 'S7' is not calibrated"),
    ],
)
def test_refused_and_nothing_written(
    desk: Workplace, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], part: str
) -> None:
    assert desk.compensate(*words) == 2
    assert part in capsys.readouterr().err
    assert desk.files == ["calibration.json", "targets.csv"]
    desk.out.write_text("old")
    assert desk.compensate(*words) == 2
    assert desk.out.read_text() == "old"


def test_an_unproven_calibration_is_refused(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    desk.calibrate(sign_checked=False)
    assert desk.compensate() == 2
    assert "sign check did not hold" in capsys.readouterr().err
    assert desk.files == ["calibration.json", "targets.csv"]


def test_the_right_cell_is_taken(desk: Workplace) -> None:
    desk.calibrate(digest=load_cell("paper", {"grid.pitch_mm": "450.0"}).digest)
    assert desk.compensate("--cell", "paper", "--set", "grid.pitch_mm=450.0") == 0
    assert desk.compensate("--cell", "paper") == 2


def test_nominal_targets_are_not_replaced(desk: Workplace) -> None:
    before = desk.source.read_bytes()
    assert desk.compensate(out=desk.source) == 2
    assert desk.source.read_bytes() == before


@pytest.mark.parametrize("where", [".", "/", "n" * 300, "nowhere/out", "file/out"])
def test_places_that_cannot_be_written_are_reported_in_one_line(
    desk: Workplace, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    (desk.folder / "file").write_text("")
    before = desk.files
    assert desk.compensate(out=desk.folder / where) == 2
    (reported,) = capsys.readouterr().err.splitlines()
    assert ("is a folder" in reported) == (where in "./")
    assert desk.files == before


def test_the_calibration_is_not_written_over(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    file = desk.folder / "calibration.json"
    before = file.read_bytes()
    assert desk.compensate(out=file) == 2
    assert "is what is read" in capsys.readouterr().err
    assert file.read_bytes() == before


def test_a_calibration_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("nowhere.json", "n" * 300):
        assert main(["compensate", name, "targets.csv", "--station", "S1100", "-o", "out"]) == 2
        assert capsys.readouterr().err.startswith("hilcell: run 'n")


PLANT = '''
from dataclasses import dataclass

import numpy as np

from hilcell.cell.settings import SettingsError
from hilcell.errors import HilcellError


@dataclass
class Program:
    """A pose a line: NAME X Y Z A B C."""

    file: str
    rows: list
    suffixes = (".poses",)
    notes = ("comments are left",)
    needs_arm = "wrists"
    remarks = ()
    strokes = ()
    base = None

    @property
    def names(self):
        return [f"{row[0]} ({self.file} line {n})" for n, row in enumerate(self.rows, start=1)]

    def values(self):
        return np.array([row[1:] for row in self.rows], dtype=float)

    def check_options(self, options):
        pass

    def check_joints(self, arm, T_W_B, command):
        raise HilcellError(f"wrists of {len(command)} poses turn over at {T_W_B[0, 3]:g}")

    def with_positions(self, positions_mm, remark=""):
        lines = [
            " ".join([row[0], *(f"{each:.3f}" for each in position), *row[4:]])
            for row, position in zip(self.rows, positions_mm, strict=True)
        ]
        return {self.file: "\\n".join(lines).encode()}


def load(path):
    rows = [line.split() for line in path.read_text().splitlines()]
    if any(len(row) != 7 for row in rows):
        raise SettingsError(path.name, ["a line is no pose"])
    return Program(path.name, rows)
'''


FORMAT = "[hilcell.programs]\nposes = {}\n"


@pytest.fixture
def plant(desk: Workplace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Workplace]:
    """Yield the desk with a second make's program; its format is an installed package's."""
    site = tmp_path / "site"
    install(site, FORMAT.format("plant_poses:load"), plant_poses=PLANT)
    monkeypatch.syspath_prepend(site)
    desk.source, desk.out = tmp_path / "drill.POSES", tmp_path / "out.poses"
    desk.source.write_text("H1 0 0 1200 0 75 0\nH2 0 50 1250 0 75 0\n")
    yield desk
    sys.modules.pop("plant_poses", None)


def test_a_second_make_s_programs_need_its_own_files_only(
    plant: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    assert plant.compensate() == 0
    out = plant.folder / "out.POSES"
    rows = [line.split() for line in out.read_text().splitlines()]
    command = np.array([row[1:] for row in rows], dtype=float)
    np.testing.assert_allclose(arrived_mm(command[:, :3]), TARGETS[:, :3], atol=2e-3)
    *reported, bounds, _ = capsys.readouterr().err.splitlines()
    assert reported == [
        "drill.POSES: wrists were not checked; --cell CELL does",
        "drill.POSES: comments are left",
        "drill.POSES: its targets were taken in {W}, its base must be {W}",
        f"2 targets corrected for S1100 into {out}",
    ]
    assert re.fullmatch(BOUNDS, bounds)


def test_a_program_is_not_named_like_a_list(
    plant: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    assert plant.compensate(out=plant.folder / "out.csv") == 2
    assert (
        "is a .csv file by its name, and a program is written; name it out.poses"
        in capsys.readouterr().err
    )
    assert not any(name.startswith("out") for name in plant.files)


def test_a_program_is_not_handed_on(plant: Workplace, capsys: pytest.CaptureFixture[str]) -> None:
    assert plant.compensate(out=Path("/dev/stdout")) == 2
    assert "/dev/stdout is no file, and a program is one of several" in capsys.readouterr().err
    assert not Path("/dev/stdout.POSES").exists()


def test_a_second_make_refuses_in_its_own_words(
    plant: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    plant.calibrate(digest=load_cell("paper").digest)
    assert plant.compensate("--cell", "paper") == 2
    assert capsys.readouterr().err == "hilcell: wrists of 2 poses turn over at -1850\n"
    plant.source.write_text("H1 0 0 9000 0 75 0\n")
    assert plant.compensate() == 2
    assert "H1 (drill.POSES line 1)" in capsys.readouterr().err
    plant.source.write_text("H1 0 0 1200\n")
    assert plant.compensate() == 2
    assert "drill.POSES: 1 problem\n  a line is no pose" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("entry", "part"),
    [
        ("other_poses:load", "'poses' is installed as other_poses:load and plant_poses:load"),
        ("plant_poses:load", ""),
    ],
)
def test_of_two_formats_of_one_suffix_none_is_chosen(
    plant: Workplace, capsys: pytest.CaptureFixture[str], entry: str, part: str
) -> None:
    install(plant.folder / "site", FORMAT.format(entry), "other_poses")
    invalidate_caches()
    assert plant.compensate() == (2 if part else 0)
    assert part in capsys.readouterr().err
    assert (plant.folder / "out.POSES").exists() != bool(part)


@pytest.mark.parametrize("text", ["import nothing_like_it", "read = 1"])
def test_a_format_that_cannot_be_loaded_is_refused(
    plant: Workplace, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    (plant.folder / "site" / "plant_poses.py").write_text(text)
    assert plant.compensate() == 2
    assert "'poses' cannot be loaded: " in capsys.readouterr().err


def test_a_failed_validation_corrects_nothing_unasked(
    desk: Workplace, capsys: pytest.CaptureFixture[str]
) -> None:
    """The reproduction: 3.7 mm off, exit 0."""
    bad = judged(3.7, 5.0, LIMITS, Guard(0.04, 0.05))
    made = msgspec.structs.replace(calibration(), verdicts={"S1100": bad})
    write_calibration(made, desk.folder / "calibration.json")
    assert desk.compensate() == 2
    assert "validation at S1100: out of tolerance" in capsys.readouterr().err
    assert not desk.out.exists()
    assert desk.compensate("--accept-out-of-tolerance") == 0
    assert "accepted although validation at S1100" in capsys.readouterr().err
    _, _, (stamp,) = read_corrected(desk.out)
    assert re.fullmatch(rf"{STAMP}; OUT OF TOLERANCE \(accepted\); {UNKNOWN}", stamp)


def test_a_long_name_takes_no_warning_off_a_stamp() -> None:
    text = Stamp("r" * 100, "2026-11-22T21:27:51Z", "s" * 60, True, ("a, b", "REVOKED")).text
    assert text.endswith("; SIMULATION; a  b; REVOKED")
