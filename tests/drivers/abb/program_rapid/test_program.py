"""RAPID programs: targets, strokes, frames, and that nothing else changes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.abb.program_rapid.files import is_home, read_program
from drivers.abb.program_rapid.program import Target, cfx_of, from_quaternions, to_quaternions
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import from_zyx, poses_from_zyx
from hilcell.geometry.inverse import status_of
from hilcell.geometry.kinematics import link_transforms
from tests.drivers.abb.program_rapid.samples import (
    BODY,
    MODULE,
    NONE,
    TURN,
    module,
    moved,
    one,
    refusal,
)

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def test_targets_are_the_robtargets_that_motions_use() -> None:
    read = read_program("drill.mod", MODULE)
    assert read.names == [
        "p10 (drill.mod line 9)",
        "target (drill.mod line 29)",
        "pHole{1} (drill.mod line 10)",
        "pHole{2} (drill.mod line 10)",
    ]
    expected = np.array(
        [[-200, 100.123456, 1000.5], [100.5, -20, 1150.25], [0, 0, 1200], [0, 50, 1200]]
    )
    np.testing.assert_allclose(read.values()[:, :3], expected)
    np.testing.assert_allclose(read.values()[:, 3:], [[0, 75, 0]] * 4, atol=1e-6)
    assert [each.cfx for each in read.targets] == [1] * 4
    notes = "\n".join(read.notes)
    for part in ("CallGripper", "jHome", "p10", "pSpare"):
        assert part in notes
    assert "pHole" not in notes, "it is LOCAL"
    assert read.tool is not None
    assert read.tool.frame is not None
    assert (read.tool.text, read.tool.frame[:3, 3].tolist()) == ("tDrill", [98, 0, 127])
    assert read.base is not None
    assert read.base.values == (0.0,) * 6
    assert read.slide is None


def test_strokes_keep_the_correction_of_their_target() -> None:
    """Shifts of Offs are along the work object, those of RelTool along the tool."""
    strokes = read_program("drill.mod", MODULE).strokes
    c, s = np.cos(np.radians(75.0)), np.sin(np.radians(75.0))
    expected = [(n, shift) for shift in ((0, 0, 10), (8 * s, 0, 8 * c), (0, 0, 10)) for n in (2, 3)]
    assert [each.target for each in strokes] == [n for n, _ in expected]
    np.testing.assert_allclose(
        [each.shift_mm for each in strokes], [shift for _, shift in expected], atol=1e-7
    )
    assert "RelTool(p, 0, 0, depth) (drill.mod line 47) from pHole{1}" in strokes[2].where


def test_the_corrected_file_is_the_golden_one() -> None:
    """The numbers of four targets and a comment, by hand; a quaternion keeps its sign."""
    read = read_program("drill.mod", MODULE)
    poses = read.values() + [0.5, -0.25, 0.125, 0.0, 0.5, 0.0]
    head = "MODULE Drill_Wing(SYSMODULE, NOSTEPIN)\n"
    q1, q3 = f"{np.cos(np.radians(37.75)):.9f}", f"{np.sin(np.radians(37.75)):.9f}"
    golden = MODULE.replace(head, f"{head}  ! by hand\n")
    for old, new in (
        ("[[-200.0,100.123456,1000.5]", "[[-199.500,99.873456,1000.625]"),
        ("[[0,0,1200]", "[[0.500,-0.250,1200.125]"),
        ("[[0.0,+5E1,1200.]", "[[0.500,49.750,1200.125]"),
        ("[[100.5,-20,1150.25]", "[[101.000,-20.250,1150.375]"),
        (TURN, f"[{q1},0.00000000,{q3},0.00000000]"),
        ("[-0.793353340, 0 ,-0.608761429,0]", f"[-{q1}, 0.00000000 ,-{q3},0.00000000]"),
    ):
        assert old in golden
        golden = golden.replace(old, new)
    assert moved(read, poses, "by hand") == golden
    again = read_program("drill.mod", golden)
    assert " by hand" in again.remarks
    np.testing.assert_allclose(poses_from_zyx(again.values()), poses_from_zyx(poses), atol=1e-7)


@given(st.lists(st.floats(-3000.0, 3000.0), min_size=12, max_size=12))
def test_all_but_the_numbers_of_targets_is_unchanged(places_mm: list[float]) -> None:
    text = "\xef\xbb\xbf" + MODULE.replace("\n", "\r\n").replace("done", "gebohrt \xfc")
    read = read_program("drill.mod", text)
    positions = np.array(places_mm).reshape(4, 3)
    written = moved(read, positions)
    assert NUMBER.sub("#", written) == NUMBER.sub("#", text)
    pairs = zip(NUMBER.findall(text), NUMBER.findall(written), strict=True)
    assert sum(before != after for before, after in pairs) <= 12
    again = read_program("drill.mod", written).values()
    np.testing.assert_allclose(again[:, :3], positions, atol=5e-4 + 1e-9)
    assert moved(read, positions, "r").replace("  ! r\r\n", "") == written


@given(st.lists(st.floats(-180.0, 180.0), min_size=3, max_size=3))
def test_quaternions_are_those_of_the_rotation(angles_deg: list[float]) -> None:
    R = from_zyx(np.array([angles_deg]))
    q = to_quaternions(R)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(from_quaternions(q), R, atol=1e-9)
    np.testing.assert_allclose(from_quaternions(-3.0 * q), R, atol=1e-9)
    assert to_quaternions(np.eye(3)[None]).tolist() == [[1.0, 0.0, 0.0, 0.0]]


def test_a_quaternion_is_taken_to_its_last_digit() -> None:
    def target(turn: str) -> str:
        return f"MoveL [[1,2,3],[{turn}],[0,0,0,0],{NONE}],v1,fine,t;"

    for turn in ("0.707107,0,0.707107,0", "0.71,0,0,0.704", "1.0,0,0,4.371E-08", "0,0,1,0"):
        one(target(turn))
    for turn in ("0.707107,0,0.708107,0", "1,0,0,1", "0,0,0,0", "0.7,0,0.7,0.7", "0,0,2,0"):
        assert "it is no rotation" in refusal(target(turn))


def test_postures_are_those_of_the_arm() -> None:
    """Before or behind axis 1 and the lower arm by the places of the joints, not by signs."""
    paper = load_cell("paper").robot.arm()
    rng = np.random.default_rng(8)
    joints_rad = np.radians(rng.uniform(-1.0, 1.0, (200, 6)) * [170, 80, 150, 180, 110, 180])
    for arm in (paper, replace(paper, sign=paper.sign * [1, 1, -1, 1, 1, 1])):
        links = link_transforms(arm, joints_rad)
        frames = [links[:, 0]]
        for n in range(1, 4):
            frames.append(frames[-1] @ links[:, n])
        ahead = frames[0][:, :3, 0]  # in the plane of the arm
        shoulder, elbow, _, wrist = (frame[:, :3, 3] for frame in frames)
        lower = elbow - shoulder
        front = lower[:, 2:] * ahead - np.sum(lower * ahead, 1)[:, None] * [0.0, 0.0, 1.0]
        behind = 4 * (np.sum(wrist * ahead, 1) < 0) + 2 * (np.sum((wrist - elbow) * front, 1) < 0)
        cfx = behind + (joints_rad[:, 4] < 0)
        assert set(cfx) == set(range(8))
        for number, status in zip(cfx.tolist(), status_of(arm, joints_rad).tolist(), strict=True):
            assert Target("p", 1, [], (0, 0, 0), number, ()).status(arm) == status
            assert cfx_of(status, arm) == number


MOVE = "MoveL p1,v1,fine,t;\n"


@pytest.mark.parametrize(
    ("body", "line", "sentence"),
    [
        ("MoveC p1,p2,v1,fine,t;", 0, "a circle through an auxiliary point"),
        ("SearchL diHit,pX,p1,v1,t;", 0, "it ends where a signal comes"),
        ("MoveL p9,v1,fine,t;", 0, "p9 is not a robtarget with numbers in this module"),
        ("MoveL j1,v1,fine,t;", 0, "j1 is jointtarget, expected a robtarget"),
        ("MoveL *,v1,fine,t;", 0, "its target * is not in the text"),
        ("MoveL CRobT(),v1,fine,t;", 0, "computed at run time"),
        ("MoveL Offs(p1,0,0,nX),v1,fine,t;", 0, "its shift nX is computed at run time"),
        ("MoveL Offs(p1,0,0,1+1),v1,fine,t;", 0, "its shift 1+1 is computed at run time"),
        ("MoveL Offs(Offs(p1,0,0,1),0,0,1),v1,fine,t;", 0, "Offs of Offs: state one shift"),
        ("MoveL RelTool(p1,0,0,1\\Rz:=5),v1,fine,t;", 0, "RelTool\\RZ turns the tool"),
        ("MoveL p1\\ID:=10,v1,fine,t;", 0, "MoveL\\ID: several robots move together"),
        ("MoveL p1,v1,fine,t\\Corr;", 0, "the sensor's path is not that of the targets"),
        ("MoveL p1,v1,fine;", 0, "fewer than 4 arguments"),
        (f"{MOVE}p1.trans.z:=5;", 1, "p1 is changed at run time"),
        (f"{MOVE}p1:=CRobT();", 1, "p1 is changed at run time"),
        (f"{MOVE}pX:=Offs(p1,0,0,5);", 1, "p1 is used besides moving to it"),
        (f"{MOVE}SpotL p1,v1,spot1,gun1,t;", 1, "p1 is used besides moving to it"),
        (f"{MOVE}ArcLStart p2,v1,seam1,weld1,fine,t;", 1, "a motion of a process"),
        (f"{MOVE}PDispSet pose1;", 1, "it displaces all targets behind it"),
        (f"{MOVE}PDispOn p1,t;", 1, "it displaces all targets behind it"),
        (f"{MOVE}EOffsSet e1;", 1, "it displaces all targets behind it"),
        (f"{MOVE}ActUnit CNV1;", 1, "another unit moves the targets"),
        (f"{MOVE}WaitWObj w\\RelDist:=0;", 1, "another unit moves the targets"),
        (f"{MOVE}SyncMoveOn sync1,tasks;", 1, "several robots move together"),
        (f"{MOVE}EGMRunJoint id,EGM_STOP_HOLD;", 1, "the sensor's path"),
        (f"{MOVE}SoftAct 3,50;", 1, "a soft axis does not reach its target"),
        (f"{MOVE}MoveExtJ jX,v1,fine;", 1, "it moves external axes"),
        (f'{MOVE}SetDataVal "p1",x;', 1, "it changes data by a name that is a text"),
        (f"{MOVE}SingArea\\LockAxis4;", 1, "changes the orientation of targets"),
        (f"{MOVE}t.tframe.trans.z:=9;", 1, "t is changed at run time, and motions work in it"),
        (f"{MOVE}MyCalib t;", 1, "MyCalib may change t, and motions work in it"),
        (f"{MOVE}DrillAt [[1,2,3],[1,0,0,0]];", 1, "DrillAt is called with data in brackets"),
        (f"{MOVE}MoveL p2,v1,fine,t2;", 1, "its tool is t2, that of other motions t (line 2)"),
        (f"{MOVE}MoveL p2,v1,fine,t\\WObj:=w;", 1, "its work object is w, that of other motions"),
        (f'{MOVE}MoveLSync p2,v1,z1,t,"Rise";', 1, "its routine RISE moves, or is not in this"),
        (f"{MOVE}MoveAbsJ j1,v1,fine,t;\n{MOVE}", 1, "a joint target may be a hole"),
        (f"MoveAbsJ j1\\ID:=1,v1,fine,t;\n{MOVE}", 0, "several robots move together"),
        (f"MoveAbsJ [[0,0,0,0,0,0],[x,0]],v1,fine,t;\n{MOVE}", 0, "its extax is not 6 numbers"),
        (f'{MOVE}TPWrite "open;', 1, "a string does not end on its line"),
        ("MoveL h{3},v1,fine,t;", 0, "h{3} is no element of h"),
    ],
)  # fmt: skip
def test_refused_by_line(body: str, line: int, sentence: str) -> None:
    data = f"CONST robtarget h{{1}}:=[[[1,2,3],[1,0,0,0],[0,0,0,0],{NONE}]];\nVAR num nX:=1;\n"
    said = refusal(body, data)
    assert any(
        each.startswith(f"drill.mod line {BODY + 2 + line}: ") and sentence in each
        for each in said.splitlines()
    ), said


@pytest.mark.parametrize(
    ("frame", "sentence"),
    [
        ('[TRUE,TRUE,"",[[1,0,0],[1,0,0,0]],[[0,2,0],[1,0,0,0]]]', "the robot holds the part"),
        ('[FALSE,FALSE,"CNV1",[[1,0,0],[1,0,0,0]],[[0,2,0],[1,0,0,0]]]', "moves with another unit"),
        ('[FALSE,TRUE,"STN1",[[1,0,0],[1,0,0,0]],[[0,2,0],[1,0,0,0]]]', "moves with another unit"),
        ('[FALSE,TRUE,"",[[1,0,0],[1,0,0,1]],[[0,2,0],[1,0,0,0]]]', "it is no rotation"),
        ('[FALSE,TRUE,"",[[1,0,x],[1,0,0,0]],[[0,2,0],[1,0,0,0]]]', "its place is not 3 numbers"),
    ],
)
def test_work_objects_that_move(frame: str, sentence: str) -> None:
    data = f"PERS wobjdata wX:={frame};\n"
    assert sentence in refusal("MoveL p1,v1,fine,t\\WObj:=wX;", data)


def test_a_tool_that_stands_is_refused() -> None:
    data = "PERS tooldata tX:=[FALSE,[[9,0,1],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
    assert "the robot does not hold this tool" in refusal("MoveL p1,v1,fine,tX;", data)


def test_a_defect_of_a_work_object_is_said_once() -> None:
    """With the number of motions in it; other refusals are kept."""
    data = 'PERS wobjdata wX:=[FALSE,TRUE,"STN1",[[1,0,0],[1,0,0,0]],[[0,2,0],[1,0,0,0]]];\n'
    said = refusal("MoveL p1,v1,fine,t\\WObj:=wX;\nMoveC p1;\nMoveJ p2,v1,fine,t\\WObj:=wX;", data)
    first, second = said.splitlines()
    assert first.startswith(f"drill.mod line {BODY - 1}: wX: its frame moves with another unit")
    assert f"(2 motions, the first in line {BODY + 1})" in first
    assert second.startswith(f"drill.mod line {BODY + 2}: MoveC")


def test_a_module_that_is_cut_off_is_refused() -> None:
    cut = MODULE.partition("ENDMODULE")[0]
    with pytest.raises(SettingsError, match=r"line 54: .*ENDMODULE"):
        read_program("drill.mod", cut)


def test_elements_of_an_array_that_are_left_are_named() -> None:
    read = read_program("drill.mod", MODULE.replace("Strike pHole{i}", "Strike pHole{2}"))
    (note,) = (each for each in read.notes if "pHole" in each)
    assert "pHole{1}" in note
    assert "pHole{2}" not in note


def test_tool_and_work_object_of_another_module_are_named() -> None:
    read = one("MoveL p1,v1,fine,tOther\\WObj:=wOther;")
    assert (read.tool, read.base) == (None, None)
    assert sum("is in another module" in each for each in read.notes) == 2


def test_user_and_object_frame_are_the_base() -> None:
    base = one("MoveL p1,v1,fine,t\\WObj:=w;").base
    assert base is not None
    assert base.values[:3] == (1.0, 2.0, 0.0)
    assert base.where == "drill.mod line 3"


def test_parameters_of_own_routines_are_what_its_calls_pass() -> None:
    inner = "PROC At(robtarget p,PERS tooldata tt\\num up)\nMoveL Offs(p,0,0,up),v1,fine,tt;\n"
    outer = "PROC Hole(robtarget q,num n)\nAt q,t\\up:=-n;\nMoveL q,v1,fine,t;\nENDPROC\n"
    main = "PROC main()\nHole p1,1;\nHole p2,2;\nENDPROC\n"
    read = module(f"{main}{outer}{inner}ENDPROC\n")
    assert [each.name for each in read.targets] == ["p1", "p2"]
    shifts = {(each.target, each.shift_mm[2]) for each in read.strokes}
    assert shifts == {(n, z) for n in (0, 1) for z in (-1.0, -2.0)}
    with pytest.raises(SettingsError, match="is used besides moving"):
        module(f"{main}{outer}{inner}x:=p.trans.z;\nENDPROC\n")
    with pytest.raises(SettingsError, match="may be changed there"):
        module(f"{main}{outer}{inner}ENDPROC\n".replace("robtarget q", "INOUT robtarget q"))
    with pytest.raises(SettingsError, match="calls itself"):
        module("PROC At(robtarget p)\nAt p;\nMoveL p,v1,fine,t;\nENDPROC\n")


@pytest.mark.parametrize("value", ["p1", "p1.trans", "[p1.trans.x,2,3]"])
def test_data_that_begin_with_a_target_are_refused(value: str) -> None:
    data = f"VAR robtarget pX:={value};\n"
    for said in (refusal(MOVE, data), refusal(data + MOVE)):
        assert "pX begins as p1: its correction would go there too" in said
    one(MOVE, data.replace("p1", "p2"))


def test_a_local_name_hides_that_of_the_module() -> None:
    own = f"CONST robtarget p1:=[[7,8,9],[1,0,0,0],[0,0,0,0],{NONE}];\n"
    read = module(f"PROC a()\n{own}{MOVE}ENDPROC\nPROC b()\nx:=p1;\nENDPROC\n")
    assert read.values()[:, :3].tolist() == [[7, 8, 9]]
    assert "not used by a motion, left: p1, p2" in read.notes


@pytest.mark.parametrize("block", ["ERROR\n{}", "ENDPROC\nTRAP x\n{}ENDTRAP\nPROC z()\n"])
@pytest.mark.parametrize("moves", [MOVE, "Rise;\n"])
def test_handlers_and_traps_that_move_are_refused(block: str, moves: str) -> None:
    rise = f"PROC Rise()\n{MOVE}ENDPROC\n"
    text = f"{rise}PROC main()\n{MOVE}{{}}ENDPROC\n"
    module(text.format(block.format("StopMove;\n")))
    with pytest.raises(SettingsError, match="moves in an error handler or trap"):
        module(text.format(block.format(moves)))


@pytest.mark.parametrize(
    ("body", "refused"),
    [
        ("Shift w;", True),
        ("Outer w;", True),
        ("Shift w.oframe;", True),
        ("IF di1 = 1 Shift w;", True),
        ("Lengthen\\tt:=t;", True),
        ("x := Moved(w);", True),
        ("x := (Moved(w) + 1) * 2;", True),
        ("IF Moved(w) > 1 THEN\nENDIF", True),
        ("x := Foreign(w);", True),
        ("Add w.oframe.trans.z, 5;", True),
        ("Read w;", False),
        ("x := PoseInv(w.oframe);", False),
        ("pX := CRobT(\\Tool:=t\\WObj:=w);", False),
        ("x := Moved(rec.w);", False),
        ("Copy w;", False),
        ("Copy 2 * (w.oframe.trans.z);", False),
        ("Itself w;", False),
    ],
)
def test_own_routines_that_may_change_a_frame(body: str, *, refused: bool) -> None:
    """By a PERS, INOUT or VAR parameter, that they assign or pass on; a copy is free."""
    own = """PROC Shift(PERS wobjdata o)
o.oframe.trans.z:=o.oframe.trans.z+5;
ENDPROC
PROC Outer(INOUT wobjdata a)
Shift a;
ENDPROC
PROC Lengthen(\\PERS tooldata tt)
Incr tt.tframe.trans.z;
ENDPROC
FUNC num Moved(VAR wobjdata o)
o:=wobj0;
RETURN 1;
ENDFUNC
PROC Copy(wobjdata o)
o.oframe.trans.z:=5;
ENDPROC
PROC Read(PERS wobjdata o)
TPWrite "z"\\Num:=o.oframe.trans.z;
MoveL p2,v1,fine,t\\WObj:=o;
ENDPROC
PROC Itself(PERS wobjdata o)
Itself o;
ENDPROC
"""
    text = f"PROC main()\nMoveL p1,v1,fine,t\\WObj:=w;\n{body}\nENDPROC\n{own}"
    if not refused:
        module(text)
        return
    with pytest.raises(SettingsError) as raised:
        module(text)
    (problem,) = raised.value.problems
    assert problem.startswith(f"drill.mod line {BODY + 1}: ")
    assert problem.endswith("and motions work in it")


def test_a_routine_that_only_other_modules_call() -> None:
    text = "PROC At(robtarget p,PERS tooldata tt)\nMoveL Offs(p,0,0,1),v1,fine,tt;\nENDPROC\n"
    read = module(f"{text}PROC main()\n{MOVE}ENDPROC\n")
    assert [each.name for each in read.targets] == ["p1"]
    assert not read.strokes
    assert sum("no call in this module passes P to AT" in each for each in read.notes) == 1
    with pytest.raises(SettingsError, match="its shift up is computed at run time"):
        module("PROC At(num up)\nMoveL Offs(p1,0,0,up),v1,fine,t;\nENDPROC\n")


@pytest.mark.parametrize(
    ("home", "axes", "refused"),
    [
        ("MoveJ pHome,v1,fine,t", "300", True),
        ("MoveL Offs(pHome,0,0,9),v1,fine,t", "300", True),
        ("MoveJ hHome{2},v1,fine,t", "300", True),
        ("MoveAbsJ jHome,v1,fine,t", "300", True),
        ("MoveJ pHome,v1,fine,t", "9E9", False),
        ("MoveAbsJ jHome,v1,fine,t", "9E9", False),
        ("MoveJ pHomeX,v1,fine,t", "300", False),
    ],
)
def test_homes_that_move_the_slide_away_from_targets_that_do_not_say(
    home: str, axes: str, *, refused: bool
) -> None:
    external = NONE.replace("9E+09", axes, 1)
    pose = f"[[1,2,3],[1,0,0,0],[0,0,0,0],{external}]"
    data = f"CONST robtarget pHome:={pose};\nCONST robtarget hHome{{2}}:=[{pose},{pose}];\n"
    data += f"CONST jointtarget jHome:=[[0,0,0,0,90,0],{external}];\n"
    stated = f"MoveL [[1,2,3],[1,0,0,0],[0,0,0,0],{external}],v1,fine,t;\n"
    one(f"{home};\n{stated}", data)
    if refused:
        (problem,) = refusal(f"{home};\n{MOVE}", data).splitlines()
        assert problem.startswith(f"drill.mod line {BODY + 3}: ")
        assert "moves external axes, and the targets do not say where they stand" in problem
    else:
        one(f"{home};\n{MOVE}", data)


def test_home_poses_are_left_unchanged_and_named() -> None:
    read = one(f"MoveAbsJ j1,v1,fine,t;\n{MOVE}MoveAbsJ [[0,0,0,0,0,0],{NONE}],v1,fine,t;")
    assert sum("joint target" in each for each in read.notes) == 2
    data = f"CONST jointtarget jSafe1:=[[0,0,0,0,90,0],{NONE}];\n"
    data += f"CONST robtarget pHome:=[[1,2,3],[1,0,0,0],[0,0,0,0],{NONE}];\n"
    read = one(
        f"MoveJ pHome,v1,fine,t\\WObj:=w;\n{MOVE}MoveAbsJ jSafe1,v1,fine,t;\n{MOVE}"
        "MoveL Offs(pHome,0,0,9),v1,fine,tOther;\nMoveJ pSafeS2,v1,fine,t;",
        data,
    )
    assert [each.name for each in read.targets] == ["p1"]
    for name in ("jSafe1", "pHome", "pSafeS2"):
        assert sum(f"{name} is left unchanged" in each for each in read.notes) == 1


@pytest.mark.parametrize(
    ("name", "expected"),
    [("pHome", True), ("JHOME", True), ("Target_Home", True), ("home_pos", True), ("pPark10", True),
     ("pSafePosition", True), ("pHole1", False), ("pSparkHole", False), ("pSafetyWire", False),
     ("pHomeBracket", False)],
)  # fmt: skip
def test_names_of_home_poses(name: str, expected: bool) -> None:
    assert is_home(name) is expected


def test_joint_targets_of_routines_aside() -> None:
    """A service pose in a routine of its own is no hole of this program."""
    for aside in ("zero", "GoHome"):
        call = f"{aside};\n" * (aside == "GoHome")
        read = module(
            f"PROC {aside}()\nMoveAbsJ j1,v1,fine,t;\nENDPROC\nPROC main()\n{call}{MOVE}ENDPROC\n"
        )
        assert "joint target j1 is left unchanged" in read.notes[0]
    with pytest.raises(SettingsError, match="a joint target may be a hole"):
        module(f"PROC a()\nMoveAbsJ j1,v1,fine,t;\nENDPROC\nPROC main()\na;\n{MOVE}ENDPROC\n")


def test_a_line_has_one_problem() -> None:
    said = refusal(f"{MOVE}MoveC p1,p1,v1,fine,t;\nMoveC p1,p1,v1,fine,t;")
    assert [each.partition(": ")[0] for each in said.splitlines()] == [
        f"drill.mod line {BODY + n}" for n in (1, 2)
    ]


def with_axis(*values: str) -> str:
    return "".join(
        f"MoveL [[1,2,3],[1,0,0,0],[0,0,0,0],[{each},9E9,9E9,9E9,9E9,9E9]],v1,fine,t;\n"
        for each in values
    )


def test_external_axes_stand_at_one_station() -> None:
    read = one(with_axis("300", "300.0"))
    assert read.slide == (f"target (drill.mod line {BODY}) by eax_a", 300.0)
    for other in ("301", "9E9"):
        assert "a program is corrected for one station" in refusal(with_axis("300", other))
    home = "CONST jointtarget jHome:=[[0,0,0,0,0,0],[300,9E9,9E9,9E9,9E9,9E9]];\n"
    assert "do not say where" in refusal(f"MoveAbsJ jHome,v1,fine,t;\n{MOVE}", home)
    one(f"MoveAbsJ jHome,v1,fine,t;\n{with_axis('300')}", home)


def test_configurations_are_checked_where_the_controller_does() -> None:
    for switch, by_joints, straight in (
        ("", True, True),
        ("ConfJ\\Off;", False, True),
        ("ConfL\\Off;", True, False),
        ("ConfL\\Off;ConfL\\On;", True, True),
    ):
        read = one(f"{switch}\nMoveJ p1,v1,z1,t;\nMoveL p2,v1,fine,t;")
        assert [each.is_controlled for each in read.targets] == [by_joints, straight]


@pytest.mark.parametrize(
    "text",
    ["", "PROC main()\nENDPROC\n", "module golang", "MODULE m\nPROC a()\nENDMODULE\n",
     "MODULE m\nENDMODULE\n", "MODULE m\nPROC a()\nENDPROC\nPROC a()\nENDPROC\nENDMODULE\n",
     "MODULE m\nPROC a()\nPROC b()\nENDPROC\nENDMODULE\n", "MODULE", "MODULE m PROC a(",
     "MODULE m\nCONST robtarget p{2}\n",
     "MODULE m\nCONST", "MODULE m LOCAL", "MODULE m IF", "MODULE m\nCONST num a:=[1,"],
)  # fmt: skip
def test_what_is_no_module_with_a_target(text: str) -> None:
    with pytest.raises(SettingsError):
        read_program("drill.mod", text)


@given(st.text(alphabet='MODULE m()\n[]{},;:="\\!%1.E-PROCIF', max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    for each in (text, f"MODULE m\nPROC a()\n{text}\nENDPROC\nENDMODULE\n"):
        try:
            read = read_program("drill.mod", each)
        except SettingsError:
            continue
        assert moved(read, read.values()[:, :3]) != ""


def test_statements_on_one_line_and_over_several() -> None:
    read = read_program(
        "drill.mod",
        f"MODULE m PROC a() IF x=(1) MoveL [[1,2,3],[1,0,0,0],[0,0,0,0],{NONE}],v1,fine,tool0; "
        "IF x=1 THEN Stop; ELSEIF y=2 THEN ELSE ENDIF WHILE TRUE DO ENDWHILE ENDPROC ENDMODULE",
    )
    assert len(read.targets) == 1
    again = moved(read, read.values()[:, :3], "corrected")
    assert "! corrected\nMODULE m" in again.replace("  ! ", "! ")
    assert len(read_program("drill.mod", again).targets) == 1
