"""Targets at the tip of a tool: the same flange as for the reflector, seen from elsewhere."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.file import compensate_targets
from hilcell.calibration.influence import Bounds
from hilcell.calibration.tool_point import AT_REFLECTOR, tip_named, tip_of_program, tool_tips
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.compensation.programs import StatedTool
from hilcell.geometry.frames import inverse, poses_from_zyx, zyx_from_pose
from hilcell.journal.runs import CALIBRATION
from hilcell.programs.corrected import UsableCalibration
from hilcell.run.order import Release
from tests.hilcell.calibration.calibrations import T_W_B, calibration
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.commands.test_prepare import INSIDE, holes, made, prepare
from tests.hilcell.commands.workplace import read_corrected
from tests.hilcell.lists import write_targets
from tests.whole.bench import command

DRILL = """
[[tool]]
name = "drill"
number = 2
x_mm = 0.0
y_mm = 0.0
z_mm = 310.0
measured = "pin nest at the tip, on a CMM"
u_mm = 0.02
drill_mm = 60.0
"""
OTHER = DRILL.replace('"drill"', '"long"').replace("number = 2", "number = 3")


def cell_with(folder: Path, *tools: str) -> Path:
    path = folder / "cell.toml"
    text = Path("hilcell/cells/paper.toml").read_text("utf-8")
    path.write_text(text.replace("\n[[station]]", "".join(tools) + "\n[[station]]", 1))
    return path


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    return load_cell(str(cell_with(tmp_path, DRILL)))


def test_a_target_of_the_tip_is_one_of_the_reflector(cell: Cell) -> None:
    tip = tip_named(cell, "drill")
    np.testing.assert_allclose(tip.lever_mm, [-98.0, 0.0, 183.0])
    seen = T_W_B @ poses_from_zyx(np.array([[1850.0, 20.0, 950.0, 0.5, 75.0, 1.0]]))
    target = zyx_from_pose(seen @ tip.T_T_D)
    one = compensate_targets(calibration(), "S1100", zyx_from_pose(seen), ["H"])
    other = compensate_targets(calibration(), "S1100", target, ["H"], tip)
    np.testing.assert_allclose(other - target, one - zyx_from_pose(seen), atol=1e-9)
    assert np.abs(other - target)[:, :3].max() > 0.3


def test_a_list_is_at_the_tip_of_the_calibrated_cell(tmp_path: Path) -> None:
    """Without --cell it was corrected at the reflector: 0.2 mm beside, and no word of it."""
    path = cell_with(tmp_path, DRILL)
    known = load_cell(str(path))
    made_of = {"cell": msgspec.to_builtins(known), "digest": known.digest}
    provenance = msgspec.structs.replace(calibration(run="1-made").provenance, digest=known.digest)
    finished(tmp_path / "runs", "1-made", MADE, plan=made_of, provenance=provenance)
    source, out = tmp_path / "targets.csv", tmp_path / "out.csv"
    target = np.array([[0.0, 0.0, 1200.0, 0.0, 75.0, 0.0]])
    tip = tip_named(known, "")
    write_targets(source, ["H1"], zyx_from_pose(poses_from_zyx(target) @ tip.T_T_D))
    words: list[str | Path] = [
        "1-made",
        source,
        "-o",
        out,
        "--station",
        "S1100",
        "--runs",
        tmp_path / "runs",
    ]
    found = []
    choices: tuple[list[str | Path], ...] = ([], ["--cell", path], ["--tool", "reflector"])
    for more in choices:
        done = command("compensate", *words, *more)
        assert done.returncode == 0, done.stderr
        found.append(read_corrected(out)[1])
        assert ("tip of drill" in done.stderr) == ("--tool" not in more)
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[0] - found[2]).max() > 0.01
    (tmp_path / "runs" / "1-made" / CALIBRATION).rename(tmp_path / "lone.json")
    done = command("compensate", tmp_path / "lone.json", *words[1:-1], tmp_path)
    assert "at the reflector's centre: no tool is known without --cell CELL" in done.stderr


def test_bounds_hold_at_the_tip(cell: Cell) -> None:
    """Its place on the flange is in them."""
    tip, target = tip_named(cell, "drill"), np.array([[0.0, 0.0, 1200.0, 0.0, 75.0, 0.0]])
    at_tip = zyx_from_pose(poses_from_zyx(target) @ tip.T_T_D)
    used = UsableCalibration(calibration(), Path("c.json"), Release(runs=Path()), None, [], None)
    found = used.corrected("S1100", ["H1"], at_tip, tip, None).bounds
    known = used.corrected("S1100", ["H1"], target, AT_REFLECTOR, None).bounds
    assert isinstance(known, Bounds)
    assert isinstance(found, Bounds) or "no line" in found.reason


def test_which_tip_is_meant(tmp_path: Path, cell: Cell) -> None:
    assert tip_named(cell, "").name == "drill"
    assert tip_named(cell, "reflector").table is None
    assert tip_named(load_cell("paper"), "").table is None
    two = load_cell(str(cell_with(tmp_path, DRILL, OTHER)))
    for name in ("", "dril"):
        with pytest.raises(SettingsError, match="drill"):
            tip_named(two, name)
    with pytest.raises(SettingsError):
        tip_named(None, "drill")


@pytest.mark.parametrize(
    ("number", "frame", "name"),
    [
        (1, None, "reflector"),
        (2, None, "drill"),
        (3, None, None),
        (0, (0.0, 0.0, 0.0), None),
        (None, (0.0, 0.0, 310.0), "drill"),
        (None, (98.0, 0.0, 127.0), "reflector"),
        (None, (0.0, 0.0, 310.05), None),
        (None, (0.0, 0.0, float("nan")), None),
    ],
)
def test_a_program_s_tool_decides(
    cell: Cell, number: int | None, frame: tuple[float, ...] | None, name: str | None
) -> None:
    T = None
    if frame is not None:
        T = np.eye(4)
        T[:3, 3] = frame
    stated = StatedTool("x.src line 3", "its tool", number, T)
    if name is None:
        with pytest.raises(SettingsError, match="line 3"):
            tip_of_program(cell, "", stated, 1, "x.src")
        return
    assert tip_of_program(cell, "", stated, 1, "x.src").name == name
    other = "drill" if name == "reflector" else "reflector"
    with pytest.raises(SettingsError, match=other):
        tip_of_program(cell, other, stated, 1, "x.src")


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('name = "drill"', 'name = "reflector"', "tool[0].name"),
        ("drill_mm = 60.0", "drill_mm = 60.0\nstandoff_mm = 79.0", "standoff_mm"),
        ("drill_mm = 60.0", "drill_mm = 60.0\nstandoff_mm = 1000.5", "standoff_mm"),
        ("drill_mm = 60.0", "drill_mm = 981.0", "drill_mm"),
        ("drill_mm = 60.0", "drill_mm = 60.0\nb_deg = 180.0", "drill_mm"),  # into the flange
        ("drill_mm = 60.0", "drill_mm = 60.0\nb_deg = 90.0", "drill_mm"),  # the flange is beside
        ("drill_mm = 60.0", "drill_mm = 320.0", "drill_mm"),
        ("u_mm = 0.02", "u_mm = nan", "u_mm"),
        ("u_mm = 0.02\n", "", "u_mm"),
        ('measured = "pin nest at the tip, on a CMM"', 'measured = ""', "measured"),
    ],
)
def test_tools_that_are_refused(tmp_path: Path, old: str, new: str, key: str) -> None:
    with pytest.raises(SettingsError) as raised:
        load_cell(str(cell_with(tmp_path, DRILL.replace(old, new))))
    assert key in str(raised.value)


@pytest.mark.parametrize("second", [DRILL.replace("number = 2", "number = 3"),
                                    DRILL.replace('"drill"', '"other"')])  # fmt: skip
def test_names_and_numbers_of_tools_differ(tmp_path: Path, second: str) -> None:
    with pytest.raises(SettingsError, match="must differ"):
        load_cell(str(cell_with(tmp_path, DRILL, second)))


@pytest.mark.parametrize("number", ["", "number = 1"])
def test_no_krl_program_moves_another_tip_than_its_own(tmp_path: Path, number: str) -> None:
    """Without a number of its own the program would take the reflector's: 208 mm elsewhere."""
    made(tmp_path)
    path = cell_with(tmp_path, DRILL.replace("number = 2", number))
    done = prepare(tmp_path, at_tip_of(path, tmp_path), "--cell", path)
    assert done.returncode == 2
    assert "tool drill" in done.stderr
    assert "number" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_number_that_two_tools_have_names_none(tmp_path: Path) -> None:
    """A robot without ``options.tool`` has 1 for the reflector; only its programs know that."""
    cell = load_cell(str(cell_with(tmp_path, DRILL.replace("number = 2", "number = 1"))))
    stated = StatedTool("x.src line 3", "TOOL_DATA[1]", 1)
    with pytest.raises(SettingsError, match="reflector"):
        tip_of_program(cell, "", stated, 1, "x.src")


def test_tools_are_no_part_of_what_was_calibrated(cell: Cell) -> None:
    assert cell.digest == load_cell("paper").digest


def at_tip_of(path: Path, folder: Path) -> Path:
    """Write holes where the tip of a cell's tool stands when the reflector is inside."""
    (tip,) = tool_tips(load_cell(str(path)))[1:]
    seen = (T_W_B @ poses_from_zyx(np.array([[1850.0, 0.0, 950.0, 0.0, 75.0, 0.0]])))[0]
    shift = seen[:3, :3] @ tip.lever_mm
    return holes(folder, *[tuple(np.add(each, shift).tolist()) for each in INSIDE])


def test_list_and_program_of_a_drill(tmp_path: Path) -> None:
    """Holes are where its tip is to be: the list, the program's tool, and `compensate` agree."""
    made(tmp_path)
    path = cell_with(tmp_path, DRILL)
    loaded = load_cell(str(path))
    tip = tool_tips(loaded)[1]
    source = at_tip_of(path, tmp_path)
    done = prepare(tmp_path, source, "--cell", path, "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["tool"] == "drill"
    assert [each["standoff_mm"] for each in facts["stations"]] == [80.0]
    src = (tmp_path / "out" / "S1100.src").read_text("latin-1")
    assert "BAS (#TOOL,2 )" in src
    assert "no [[tool]]" not in src
    assert "tool drill" in src
    page = (tmp_path / "out" / "sheet.html").read_text("utf-8")
    assert "drill, number 2; in the flange: X 0.000 Y 0.000 Z 310.000" in page
    assert "comes on top of the bounds" in page
    names, commands, _ = read_corrected(tmp_path / "out" / "S1100.csv")
    (station,) = json.loads(
        command("plan", source, "--json", "--cell", path, "--calibration",
                tmp_path / "calibration.json").stdout
    )["stations"]  # fmt: skip
    nominal, again = tmp_path / "nominal.csv", tmp_path / "again.csv"
    write_targets(nominal, station["holes"], np.array(station["targets"]))
    words = ("--station", "S1100", "-o", again, "--cell", path, "--tool", "drill")
    file = tmp_path / "calibration.json"
    assert command("compensate", file, nominal, *words).returncode == 0
    assert read_corrected(again)[0] == names
    np.testing.assert_allclose(read_corrected(again)[1], commands, atol=1e-12)
    at_reflector = command("compensate", file, nominal, *words[:-1], "reflector")
    assert at_reflector.returncode in (0, 2)
    seen = poses_from_zyx(commands) @ inverse(tip.T_T_D)
    off_mm = np.linalg.norm(seen[:, :3, 3] - np.array(INSIDE)[[int(n[1:]) - 1 for n in names]],
                            axis=1)  # fmt: skip
    assert (off_mm < 2.0).all()


def test_a_refused_list_leaves_no_bounds(tmp_path: Path) -> None:
    file, source = made(tmp_path), tmp_path / "targets.csv"
    write_targets(source, ["H1"], np.array([[0.0, 0.0, 1200.0, 0.0, 75.0, 0.0]]))
    words = ("--station", "S1100", "--bounds", tmp_path / "bounds.csv", "-o")
    for out in ("out.json", "targets.csv", "none/out.csv"):
        assert command("compensate", file, source, *words, tmp_path / out).returncode in (2, 7)
        assert not (tmp_path / "bounds.csv").exists(), out
