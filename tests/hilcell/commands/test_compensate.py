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

from hilcell.atomic_files import CSV, check_output
from hilcell.calibration.budget import DRILL
from hilcell.calibration.decision_rule import Guard, decide
from hilcell.calibration.file import write_calibration
from hilcell.calibration.influence import ASSUMED, Influence, UncertaintyBudget, motion
from hilcell.cell.file import load_cell
from hilcell.commands.cli import main
from hilcell.compensation.programs import suffixes
from hilcell.compensation.targets import COLUMN, HEADER, Stamp
from hilcell.geometry.frames import apply, inverse
from hilcell.programs.holes import NORMALS
from tests.hilcell.calibration.calibrations import LIMITS, T_W_B, calibration
from tests.hilcell.cell.packages import install
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.commands.workplace import Workplace, read_corrected
from tests.hilcell.compensation.models import level
from tests.hilcell.lists import write_targets
from tests.whole.bench import command

TARGETS = np.array([[0.0, 0, 1200, 0, 75, 0], [0.0, 50, 1250, 0, 75, 0]])
STAMP = r"hilcell: corrected by 20261101-\S+ for S1100 on 2026-\d\d-\d\dT\d\d:\d\d:\d\dZ"


@pytest.fixture
def desk(tmp_path: Path) -> Workplace:
    write_targets(tmp_path / "targets.csv", ["H1", "H2"], TARGETS)
    return Workplace(tmp_path, "targets.csv", "out.csv")


def arrived_mm(command: np.ndarray) -> np.ndarray:
    """Return where commands (N, 3) end, in {W}: each plus the error at the command."""
    in_base = apply(inverse(T_W_B), command)
    return apply(T_W_B, in_base + calibration().error_model().predict(level(in_base)).error_mm)


def combined_bounds(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def stamp_of(desk: Workplace) -> str:
    _, _, (stamp,) = read_corrected(desk.out)
    return stamp


def test_a_corrected_list_arrives(desk: Workplace) -> None:
    done = desk.run()
    assert (done.returncode, done.stdout) == (0, "")
    names, command, (stamp,) = read_corrected(desk.out)
    assert names == ["H1", "H2"]
    assert re.match(STAMP, stamp)
    assert np.abs(command[:, :3] - TARGETS[:, :3]).max() > 0.3
    np.testing.assert_allclose(arrived_mm(command[:, :3]), TARGETS[:, :3], atol=2e-3)


def test_a_list_in_metres_is_asked_for_its_unit(desk: Workplace) -> None:
    write_targets(desk.source, ["H1", "H2"], TARGETS * [1e-3, 1e-3, 1e-3, 1, 1, 1])
    said = desk.refused()
    assert "targets.csv: 2 of 2 targets outside the calibrated volume" in said
    assert "metres" in said
    write_targets(desk.source, ["H1", "H2"], TARGETS + [0, 5000, 0, 0, 0, 0])
    assert "metres" not in desk.refused()


def test_one_hole_under_two_names_is_named(desk: Workplace) -> None:
    assert "one hole" not in desk.run().stderr
    write_targets(desk.source, ["H1", "H2", "H9"], TARGETS[[0, 1, 0]])
    assert "warning: H9 and H1 are one hole: same place, same normal" in desk.run().stderr


def test_a_copy_away_from_its_runs_stands_unknown_in_all_that_is_said(desk: Workplace) -> None:
    said = json.loads(desk.run("--json").stdout)
    assert said["standing"] == "unknown"
    assert "unknown" in said["stamp"]
    assert said["stamp"] == stamp_of(desk)


def test_a_list_is_handed_on_to_a_program_that_reads_it(desk: Workplace) -> None:
    """In this process's own stdout, which here is a file that others write as well."""
    shared = desk.folder / "shared.txt"
    with shared.open("w") as file:
        file.write("before\n")
        file.flush()
        out = Path(f"/dev/fd/{file.fileno()}")
        assert desk.run(out=out).returncode == 0
        file.write("after\n")
    first, header, *rows, last = shared.read_text().splitlines()
    assert (first, last) == ("before", "after")
    assert header == ",".join([*HEADER, COLUMN])
    assert [row.partition(",")[0] for row in rows] == ["H1", "H2"]


def test_a_simulated_calibration_marks_its_list(desk: Workplace) -> None:
    desk.calibrate(simulated=True)
    assert "SIMULATED" in desk.run().stderr
    assert "; SIMULATION; " in stamp_of(desk)


def test_a_corrected_list_is_not_corrected_again(desk: Workplace) -> None:
    """Its column may be empty, or without its name as a spreadsheet leaves it."""
    assert desk.run().returncode == 0
    text = desk.out.read_text()
    header, *rows = text.splitlines()
    blank = [header, *(f"{row.rpartition(',')[0]}," for row in rows)]
    for spoilt in (text, "\n".join(blank), text.replace(",corrected_by", "", 1)):
        desk.out.write_text(spoilt)
        said = desk.refused(source=desk.out, out=desk.folder / "again.csv")
        assert re.search("corrected (before|by 20261101-120000-calibrate-abcd)", said)
    assert main(["plan", str(desk.out)]) == 2


def test_bounds_are_written_beside_the_targets(desk: Workplace) -> None:
    bounds = desk.folder / "bounds.csv"
    done = desk.run("--bounds", bounds)
    rows = combined_bounds(bounds)
    assert [row["name"] for row in rows] == ["H1", "H2"] == read_corrected(desk.out)[0]
    wide = [float(row["bound95_mm"]) for row in rows]
    assert f"{max(wide):.3f} mm" in done.stderr
    for row, bound in zip(rows, wide, strict=True):
        u = np.array([float(row[f"u_{axis}_mm"]) for axis in "xyz"])
        assert 1.9 * np.linalg.norm(u) > bound > 1.6 * np.linalg.norm(u)  # 1.61 of a sphere
    assert desk.run("--bounds", bounds, "--temperature", "22.5").returncode == 0
    narrow = [float(row["bound95_mm"]) for row in combined_bounds(bounds)]
    assert all(here < anywhere for here, anywhere in zip(narrow, wide, strict=True))


@pytest.mark.parametrize("name", ["out.csv", "targets.csv", "calibration.json"])
def test_bounds_replace_no_other_file(desk: Workplace, name: str) -> None:
    desk.refused("--bounds", desk.folder / name)


def test_bounds_that_cannot_be_known(desk: Workplace) -> None:
    """Targets are corrected without; asked for, bounds are refused before anything is written."""
    bare = msgspec.structs.replace(
        calibration(), uncertainty=UncertaintyBudget(missing="no visits")
    )
    write_calibration(bare, desk.folder / "calibration.json")
    desk.refused("--bounds", desk.folder / "bounds.csv")
    assert desk.run().returncode == 0


def test_bounds_hold_at_the_drill_of_the_cell(desk: Workplace) -> None:
    """1 mrad at 200 mm is 0.2 mm, whatever the calibration's own drill was."""
    made = calibration(digest=load_cell("paper").digest)
    stated = made.uncertainty
    assert stated is not None
    drill = Influence(
        DRILL, ASSUMED, "", "5.1.2", "tool", motion(0.0, 1e-6), (0.0, 0.0, -50.0), applies="in use"
    )
    stated = msgspec.structs.replace(stated, lines=[*stated.lines, drill])
    made = msgspec.structs.replace(made, uncertainty=stated)
    write_calibration(made, desk.folder / "calibration.json")
    bounds, found = desk.folder / "bounds.csv", []
    for offset in ("[0.0, 0.0, 0.0]", "[0.0, 0.0, 200.0]"):
        words = ("--cell", "paper", "--set", f"uncertainty.drill_offset_mm={offset}")
        assert desk.run(*words, "--bounds", bounds).returncode == 0
        row = combined_bounds(bounds)[0]
        found.append(sum(float(row[f"u_{axis}_mm"]) ** 2 for axis in "xyz"))
    assert found[1] - found[0] == pytest.approx(2 * (0.2**2 - 0.05**2), rel=0.01)


@pytest.mark.parametrize("days", ["-1", "nan", "soon", "36501"])
def test_an_age_is_a_number_of_days(desk: Workplace, days: str) -> None:
    assert "36500" in desk.refused("--max-age", days)


@pytest.mark.parametrize(
    ("words", "token"),
    [
        (("--temperature", "40"), "40.0 C"),
        (("--cell", "paper"), "cell"),
        (("--max-age", "0"), "0 days"),
        (("--station", "S7"), "'S7'"),
        (("--cell", "paper", "--set", "uncertainty.orientation_urad=5"), "uncertainty"),
        (("--set", "uncertainty.drill_offset_mm=[0,0,200]"), "--set"),
    ],
)
def test_refused_and_nothing_written(desk: Workplace, words: tuple[str, ...], token: str) -> None:
    assert token in desk.refused(*words)
    desk.out.write_text("old")
    desk.refused(*words)


def test_an_unproven_calibration_is_refused(desk: Workplace) -> None:
    desk.calibrate(sign_checked=False)
    desk.refused()


def test_the_right_cell_is_taken(desk: Workplace) -> None:
    desk.calibrate(digest=load_cell("paper", {"grid.pitch_mm": "450.0"}).digest)
    assert desk.run("--cell", "paper", "--set", "grid.pitch_mm=450.0").returncode == 0
    assert desk.run("--cell", "paper").returncode == 2


def test_inputs_are_not_replaced(desk: Workplace) -> None:
    for name in ("targets.csv", "calibration.json"):
        desk.refused(out=desk.folder / name)


@pytest.mark.parametrize("where", [".", "/", "n" * 300, "nowhere/out", "file/out"])
def test_places_that_cannot_be_written_are_reported_in_one_line(
    desk: Workplace, where: str
) -> None:
    (desk.folder / "file").write_text("")
    assert desk.refused(out=desk.folder / where).count("\n") == 1


def test_a_calibration_that_is_not_there() -> None:
    for name in ("nowhere.json", "n" * 300):
        words = ("compensate", name, "targets.csv", "--station", "S1100", "-o", "out")
        assert command(*words).returncode == 2


PLANT = '''
from dataclasses import dataclass

import numpy as np

from hilcell.cell.settings import SettingsError
from hilcell.compensation import programs
from hilcell.errors import HilcellError


@dataclass
class Program(programs.Program):
    """A pose a line: NAME X Y Z A B C."""

    file: str
    rows: list
    suffixes = (".poses",)
    notes = ("comments are left",)
    needs_arm = "wrists"
    remarks = ()

    @property
    def names(self):
        return [f"{row[0]} ({self.file} line {n})" for n, row in enumerate(self.rows, start=1)]

    def values(self):
        return np.array([row[1:] for row in self.rows], dtype=float)

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


def test_a_second_make_s_programs_need_its_own_files_only(plant: Workplace) -> None:
    assert plant.run().returncode == 0
    rows = [line.split() for line in (plant.folder / "out.POSES").read_text().splitlines()]
    command = np.array([row[1:] for row in rows], dtype=float)
    np.testing.assert_allclose(arrived_mm(command[:, :3]), TARGETS[:, :3], atol=2e-3)


def test_a_program_is_named_as_one_and_is_not_handed_on(plant: Workplace) -> None:
    assert "out.poses" in plant.refused(out=plant.folder / "out.csv")
    plant.refused(out=Path("/dev/stdout"))
    assert not Path("/dev/stdout.POSES").exists()


def test_a_program_of_no_known_format_is_named(desk: Workplace) -> None:
    source = desk.folder / "drill.JBI"
    source.write_text("/JOB\n")
    assert ".jbi" in desk.refused(source=source)


def test_a_second_make_refuses_in_its_own_words(plant: Workplace) -> None:
    plant.calibrate(digest=load_cell("paper").digest)
    assert plant.refused("--cell", "paper") == "hilcell: wrists of 2 poses turn over at -1850\n"
    plant.source.write_text("H1 0 0 9000 0 75 0\n")
    assert "H1 (drill.POSES line 1)" in plant.refused()
    plant.source.write_text("H1 0 0 1200\n")
    assert "a line is no pose" in plant.refused()


@pytest.mark.parametrize("entry", ["other_poses:load", "plant_poses:load"])
def test_of_two_formats_of_one_suffix_none_is_chosen(plant: Workplace, entry: str) -> None:
    """Unless both are the same."""
    install(plant.folder / "site", FORMAT.format(entry), "other_poses")
    invalidate_caches()
    if entry == "plant_poses:load":
        assert plant.run().returncode == 0
    else:
        assert entry in plant.refused()


@pytest.mark.parametrize("text", ["import nothing_like_it", "read = 1"])
def test_a_format_that_cannot_be_loaded_is_refused(plant: Workplace, text: str) -> None:
    (plant.folder / "site" / "plant_poses.py").write_text(text)
    assert "'poses'" in plant.refused()


def test_a_failed_validation_corrects_nothing_unasked(desk: Workplace) -> None:
    bad = decide(3.7, 5.0, LIMITS, Guard(0.04, 0.05))
    made = msgspec.structs.replace(calibration(), verdicts={"S1100": bad})
    write_calibration(made, desk.folder / "calibration.json")
    assert "S1100" in desk.refused()
    assert desk.run("--accept-out-of-tolerance").returncode == 0
    assert "; OUT OF TOLERANCE (accepted); " in stamp_of(desk)


def test_a_long_name_takes_no_warning_off_a_stamp() -> None:
    text = Stamp("r" * 100, "2026-11-22T21:27:51Z", "s" * 60, True, ("a, b", "REVOKED")).text
    assert text.endswith("; SIMULATION; a  b; REVOKED")


@pytest.mark.parametrize("name", ["out", "out.csv", "out.TXT", "out.v1", "o.2026-11-22"])
def test_names_of_lists_that_say_nothing_else_are_taken(tmp_path: Path, name: str) -> None:
    check_output(tmp_path / name, CSV, "a list")


def test_a_list_is_not_named_like_another_form(desk: Workplace) -> None:
    for suffix in suffixes():  # of installed formats
        assert "out.csv" in desk.refused(out=desk.folder / f"out{suffix}")
    assert "b.csv" in desk.refused("--bounds", desk.folder / "b.xlsx")
    holes = desk.folder / "holes.csv"
    holes.write_text(f"{','.join(NORMALS)}\nH1,0,0,1200,0,0,1\n")
    done = command("plan", holes, "-o", desk.folder / "plan.json")
    assert done.returncode == 2
    assert "plan.csv" in done.stderr


@pytest.mark.parametrize(
    ("words", "name", "right"),
    [
        ("report", "x.csv", "x.html"),
        ("report", "x.docx", "x.html"),
        ("export --csv", "x.dcc", "x.csv"),
        ("export --dcc", "x.svg", "x.xml"),
        ("export --xlsx", "x.xls", "x.xlsx"),
        ("export --json", "x.HTML", "x.json"),
        ("export --urdf", "x.json", "x.urdf"),
    ],
)
def test_reports_and_tables_are_not_named_like_another_form(
    tmp_path: Path, words: str, name: str, right: str
) -> None:
    finished(tmp_path / "runs", "1-made", MADE)
    what, *form = words.split()
    out = tmp_path / name
    done = command(what, "1-made", *form, "--runs", tmp_path / "runs", "-o", out)
    assert done.returncode == 2
    assert right in done.stderr
    assert not out.exists()
