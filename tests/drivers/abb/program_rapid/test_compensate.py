"""`compensate` as a command, in this process, on RAPID modules; and the program of a station."""

from pathlib import Path

import numpy as np
import pytest

from drivers.abb.program_rapid.files import load_program, read_program
from drivers.abb.program_rapid.program import to_quaternions, write_station
from hilcell.calibration.tool_point import tool_tips
from hilcell.cell.file import load_cell
from hilcell.compensation.targets import CorrectedBefore, Stamp, refuse_corrected
from hilcell.geometry.frames import apply, inverse, pose_from_zyx, poses_from_zyx
from hilcell.geometry.inverse import inverse_kinematics
from hilcell.geometry.kinematics import forward
from hilcell.programs.drilling import Drilling, WorkPiece, station_program
from tests.drivers.abb.program_rapid.samples import MODULE, NONE, TURN
from tests.hilcell.calibration.calibrations import T_W_B, calibration
from tests.hilcell.commands import workplace
from tests.hilcell.commands.test_prepare import INSIDE, holes, made, prepare
from tests.hilcell.compensation.models import level
from tests.hilcell.lists import write_targets

CELL = load_cell("paper")
STAMP = Stamp("a-run", "2026-11-22T14:00:00Z", "S1100")


def world(up_mm: float = 0.0) -> str:
    """A work object at {W} as calibrated, or above it."""
    T = inverse(T_W_B)
    place = ",".join(f"{each:.4f}" for each in T[:3, 3] + [0.0, 0.0, up_mm])
    turn = ",".join(f"{each:.9f}" for each in to_quaternions(T[None, :3, :3])[0])
    return f'PERS wobjdata w:=[FALSE,TRUE,"",[[{place}],[{turn}]],[[0,0,0],[1,0,0,0]]];'


class Workplace(workplace.Workplace):
    """A folder with a calibration and a module, and the command over them."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "drill.mod", "out.mod")
        self.program()

    def program(self, text: str = MODULE) -> None:
        text = text.replace("\\WObj:=wobj0", "").replace("tDrill;", "tDrill\\WObj:=wOther;")
        self.source.write_text(text.replace("inpos50, tDrill ", "inpos50, tDrill\\WObj:=wOther"))

    def target(self, values: str, turn: str = TURN, cf: str = "0,0,0,1", motion: str = "") -> None:
        """A module of one target, at numbers in {W}."""
        self.source.write_text(
            f"MODULE m\n{world()}\nPROC main()\n{motion or 'MoveJ'} "
            f"[[{values}],{turn},[{cf}],{NONE}],v1,fine,tOther\\WObj:=w;\nENDPROC\nENDMODULE\n"
        )


@pytest.fixture
def desk(tmp_path: Path) -> Workplace:
    return Workplace(tmp_path)


def test_a_corrected_program_arrives_like_a_list_and_is_not_corrected_again(
    desk: Workplace,
) -> None:
    """Command + error at the command = target, to the rounding of three decimals."""
    done = desk.run("--stroke-tolerance", "1")
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    for part in ("pSpare", "jHome", "wOther", "strokes keep", "confdata"):
        assert part in done.stderr
    nominal, command = load_program(desk.source), load_program(desk.out)
    in_base = apply(inverse(T_W_B), command.values()[:, :3])
    arrived = in_base + calibration().error_model().predict(level(in_base)).error_mm
    expected = apply(inverse(T_W_B), nominal.values()[:, :3])
    assert np.abs(command.values()[:, :3] - nominal.values()[:, :3]).max() > 0.3
    np.testing.assert_allclose(arrived, expected, atol=2e-3)
    np.testing.assert_array_equal(command.values()[:, 3:], nominal.values()[:, 3:])
    targets, out = desk.folder / "targets.csv", desk.folder / "out.csv"
    write_targets(targets, [f"H{n}" for n in range(4)], nominal.values())
    assert desk.compensate(source=targets, out=out) == 0
    _, listed, _ = workplace.read_corrected(out)
    np.testing.assert_allclose(command.values()[:, :3], listed[:, :3], atol=6e-4)
    said = desk.refused(source=desk.out, out=desk.folder / "again.mod")
    assert "out.mod was corrected before (hilcell: corrected by" in said
    assert desk.run("--stroke-tolerance", "1", out=desk.folder / "lib.sys").returncode == 0
    assert load_program(desk.folder / "lib.mod").names


@pytest.mark.parametrize(
    ("old", "new", "token"),
    [
        ("moveL\n      P10,", "MoveC p10, ", "drill.mod line 23: MoveC: a circle"),
        ("100.123456,1000.5", "100.123456,9000.5", "p10 (drill.mod line 9)"),
        ("[[0,0,1200]", "[[0,0,1E30]", "1 target "),
        ("Offs(p, 0, 0, 10)", "Offs(p, 0, 0, 90)", "strokes lead away from their point"),
    ],
)
def test_refused_and_nothing_written(desk: Workplace, old: str, new: str, token: str) -> None:
    assert old in MODULE
    desk.program(MODULE.replace(old, new))
    assert token in desk.refused("--stroke-tolerance", "1")


@pytest.mark.parametrize(("name", "code"), [("tDrill", 0), ("tLong", 2)])
def test_a_tool_that_is_not_the_calibrated_one(desk: Workplace, name: str, code: int) -> None:
    """Refused with the cell; a tool of another module is noted."""
    x, y, z = CELL.robot.smr_mm
    tools = f"PERS tooldata tDrill:=[TRUE,[[{x},{y},{z}],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
    tools += tools.replace("tDrill", "tLong").replace(f",{z}]", f",{z + 1}]")
    desk.target("0,0,1200", cf="0,-1,0,1")
    text = desk.source.read_text()
    desk.calibrate(digest=CELL.digest)
    assert "tOther" in desk.run("--cell", "paper").stderr
    desk.source.write_text(text.replace("PROC main", f"{tools}PROC main").replace("tOther", name))
    done = desk.run("--cell", "paper")
    assert done.returncode == code, done.stderr
    assert ("the tool is tLong" in done.stderr) == (code == 2)


def test_a_work_object_that_is_not_the_world_frame(desk: Workplace) -> None:
    desk.target("0,0,1200")
    assert desk.run().returncode == 0
    desk.source.write_text(desk.source.read_text().replace(world(), world(0.1)))
    said = desk.refused(out=desk.folder / "again.mod")
    assert "drill.mod line 2: the base set there is not the world frame" in said
    place = world().partition('"",')[2].partition("]")[0]
    assert f"set {place}],[" in said, "as RAPID states it"


def test_an_external_axis_that_is_not_the_slide_of_the_cell_is_not_checked(
    desk: Workplace,
) -> None:
    desk.target("0,0,1200", cf="0,-1,0,1")
    desk.source.write_text(desk.source.read_text().replace("[9E+09", "[300"))
    desk.calibrate(digest=CELL.digest)
    done = desk.run("--cell", "paper")
    assert done.returncode == 0, done.stderr
    assert "by eax_a: its external axis at 300 mm is left as it is and not checked" in done.stderr


def near_zero() -> tuple[str, int]:
    """A place that the correction takes from -0.2 to about 0.3 mm beside A1, and its cf4."""
    x, y, z = place = apply(T_W_B, np.array([[1850.0, -0.2, 950.0]]))[0]
    pose = inverse(T_W_B) @ pose_from_zyx(x, y, z, 0.0, 75.0, 0.0)
    joints_rad = inverse_kinematics(CELL.robot.arm(), pose, CELL.robot.status)
    return ",".join(f"{each:.4f}" for each in place), int(np.floor(joints_rad[3] / (np.pi / 2)))


@pytest.mark.parametrize(
    ("cf1", "motion", "code"),
    [
        ("0", "MoveJ", 2),
        ("4", "MoveJ", 2),  # a revolution on, the same quarter
        ("0", "MoveL", 2),
        ("-1", "MoveL", 0),  # as the corrected target has it
        ("1", "MoveJ", 0),  # not that of the nominal target either
        ("0", "ConfJ\\Off; MoveJ", 0),
        ("0", "ConfL\\Off; MoveL", 0),
        ("0", "ConfJ\\Off; MoveL", 2),
    ],
)
def test_quarter_turns_that_the_correction_changes(
    desk: Workplace, cf1: str, motion: str, code: int
) -> None:
    """Without the cell they are not checked, and a note says so."""
    place, cf4 = near_zero()
    desk.calibrate(digest=CELL.digest)
    desk.target(place, cf=f"{cf1},{cf4 if code == 2 else 0},0,1", motion=motion)
    done = desk.run("--cell", "paper")
    assert done.returncode == code, done.stderr
    assert ("target (drill.mod line 4): axis 1 goes from" in done.stderr) == (code == 2)
    assert f"stated cf1 {cf1}" in done.stderr or code == 0
    assert ("(drill.mod line 4) cf1 1, axis 1 at" in done.stderr) == (cf1 == "1"), "it is noted"
    unchecked = desk.run(out=desk.folder / "unchecked.mod")
    assert unchecked.returncode == 0
    assert ("axis configurations (confdata)" in unchecked.stderr) == (
        "Off" not in motion or code == 2
    )


def test_places_beside_a_target_keep_its_quarter_turn_too(desk: Workplace) -> None:
    place, _ = near_zero()
    x, y, z = map(float, place.split(","))
    desk.calibrate(digest=CELL.digest)
    desk.target(f"{x},{y + 5:.4f},{z}", cf="-1,-1,0,1")
    text = desk.source.read_text()
    begin, end = text.index("[[", text.index("MoveJ")), text.index(",v1")
    off = f"{text[:begin]}Offs({text[begin:end]},0,-5,0){text[end:]}"
    assert desk.run("--cell", "paper").returncode == 0
    desk.source.write_text(off)
    done = desk.run("--cell", "paper", "--stroke-tolerance", "1", out=desk.folder / "off.mod")
    assert done.returncode == 0, (
        "the target's own quarter is that of A1 < 0, unlike that of the place"
    )
    desk.source.write_text(off.replace("[-1,-1,0,1]", "[0,-1,0,1]"))
    said = desk.refused("--cell", "paper", "--stroke-tolerance", "1", out=desk.folder / "x.mod")
    assert "Offs(" in said
    assert "axis 1 goes from 0." in said


@pytest.mark.parametrize(("cfx", "code"), [(1, 0), (0, 2), (3, 2), (5, 2)])
def test_points_in_another_posture_than_the_calibrated_are_refused(
    desk: Workplace, cfx: int, code: int
) -> None:
    desk.calibrate(digest=CELL.digest)
    desk.target("0,0,1200", cf=f"0,-1,0,{cfx}")
    done = desk.run("--cell", "paper")
    assert done.returncode == code, done.stderr
    assert ("another posture than the calibrated one, S 6" in done.stderr) == (code == 2)


def test_the_program_of_a_station_moves_to_its_commands() -> None:
    targets = np.array([[0.0, 0.0, 1200.0, 0.0, 75.0, 0.0], [0.0, 50.0, 1250.0, 5.0, 75.0, 5.0]])
    names = ["Träger °1", "H2\n  MoveJ p10"]
    tip = tool_tips(CELL)[0]
    drilling = Drilling(CELL, T_W_B, tip, 100.0)
    outward = -poses_from_zyx(targets)[:, :3, 2]
    part = WorkPiece(targets[:, :3], outward)
    program = station_program(drilling, "S1100", names, targets, part, ["SIMULATED"])
    ((name, content),) = write_station(program, STAMP).items()
    text = content.decode("ascii")
    assert name == "S1100.mod"
    lines = text.split("\r\n")
    assert lines[:3] == ["MODULE S1100", f"  ! {STAMP.text}", "  ! SIMULATED"]
    assert "    ! 1 of 2: Trager deg1" in [f"  {each.strip()}".rjust(len(each)) for each in lines]
    read = read_program(name, text)
    assert read.base is not None
    np.testing.assert_allclose(
        pose_from_zyx(*read.base.values), inverse(T_W_B), atol=1e-4, rtol=0.0
    )
    assert read.tool is not None
    assert tip.is_stated(read.tool)
    assert sum("jSafe" in each for each in lines) == 3
    first = next(n for n, each in enumerate(lines) if "Move" in each)
    assert lines.index("    IF tHilcell.tload.mass <= 0.001 THEN") < first
    assert lines.index("      EXIT;") < first
    assert "[0.001,[0,0,0.001],[1,0,0,0],0,0,0]]" in text, "no load is made up"
    assert lines.index("    Stop;") < next(n for n, each in enumerate(lines) if "MoveJ" in each)
    values = {each.name: row for each, row in zip(read.targets, read.values(), strict=True)}
    command = [values["XP1"], values["XP2"]]
    np.testing.assert_allclose(
        poses_from_zyx(np.array(command)), poses_from_zyx(targets), atol=1e-4
    )
    off = np.array([values["XS1"], values["XS2"]])
    np.testing.assert_allclose(off[:, :3] - targets[:, :3], 100.0 * outward, atol=1e-3)
    moves = [each.strip() for each in lines if each.startswith("    Move")]
    order = [each.split(",")[0] for each in moves if "XV" not in each]
    hole = ["MoveJ XA{}", "MoveJ XS{}", "MoveL XP{}", "MoveL XS{}"]
    safe = ["MoveAbsJ jSafe\\NoEOffs"]
    assert order == safe + [each.format(n) for n in (1, 2) for each in hole] + safe
    assert all(",fine," in each for each in moves)
    arm = tip.arm(CELL.robot.arm())
    for target, row in zip(read.targets, read.values(), strict=True):
        pose = inverse(T_W_B) @ pose_from_zyx(*row)
        joints_rad = inverse_kinematics(arm, pose, target.status(arm))
        quarters = np.floor(np.degrees(joints_rad[[0, 3, 5]]) / 90.0)
        assert tuple(quarters % 4) == tuple(each % 4 for each in target.quarters), target.name
        np.testing.assert_allclose(forward(arm, joints_rad), pose, atol=1e-6)
        assert target.status(arm) == CELL.robot.status
    with pytest.raises(CorrectedBefore):
        refuse_corrected(name, read.remarks)


def test_an_axis_on_a_quarter_turn_switches_the_control_off() -> None:
    """Rounding decides on which side of it a controller finds the axis."""
    target = np.array([[*apply(T_W_B, np.array([[1850.0, 0.0, 950.0]]))[0], 0.0, 75.0, 0.0]])
    drilling = Drilling(CELL, T_W_B, tool_tips(CELL)[0], 100.0)
    part = WorkPiece(target[:, :3], -poses_from_zyx(target)[:, :3, 2])
    program = station_program(drilling, "S1100", ["H"], target, part, [])
    (content,) = write_station(program, STAMP).values()
    sure = abs(np.degrees(program.command.joints_rad[0, 0])) >= 0.01
    assert (b"ConfL\\Off" in content, b"ConfL\\On" in content) == (not sure, sure)
    assert not sure


def test_prepare_writes_the_form_that_the_cell_states(tmp_path: Path) -> None:
    """Its holes are the listed commands, but for the lost motion of the straight path."""
    made(tmp_path)
    done = prepare(tmp_path, holes(tmp_path, *INSIDE), "--set", "robot.program=abb-egm")
    assert done.returncode == 0, done.stderr
    read = load_program(tmp_path / "out" / "S1100.mod")
    _, listed, _ = workplace.read_corrected(tmp_path / "out" / "S1100.csv")
    rows = {each.name: row for each, row in zip(read.targets, read.values(), strict=True)}
    written = np.array([rows[f"XP{n}"] for n in (1, 2, 3)])
    np.testing.assert_allclose(written[:, :3], listed[:, :3], atol=0.1)
    np.testing.assert_allclose(written[:, 3:], listed[:, 3:], atol=1e-5)
    assert "S1100.mod" in (tmp_path / "out" / "summary.json").read_text()
