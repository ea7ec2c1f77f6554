"""TP listings: positions, refusals by line, and that nothing else changes."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fanuc.program_tp import posture, read_program
from hilcell.cell.file import load_cell
from hilcell.compensation.targets import CorrectedBefore, Stamp, refuse_corrected
from hilcell.geometry.frames import pose_from_zyx, poses_from_zyx, zyx_from_pose
from hilcell.geometry.inverse import BEYOND, inverse_kinematics, status_of
from hilcell.geometry.kinematics import forward
from hilcell.ports import HilcellError
from tests.drivers.fanuc.program_tp.samples import (
    HOME,
    LISTING,
    listing,
    moved,
    one,
    parsed,
    position,
    refusals,
)

ARM = load_cell("paper").robot.arm()
L2, L3, J2 = "L P[2] 500mm/sec FINE", "L P[3] 500mm/sec FINE", "J P[2] 100% FINE"
J1 = "J P[1] 100% FINE"


def test_targets_are_the_positions_that_motions_use() -> None:
    read = read_program("drill.ls", LISTING)
    assert read.names == ["P[2] (drill.ls line 44)", "P[3] (drill.ls line 50)"]
    expected = [[-200.0, 100.123, 1000.5, 0.0, 75.0, 0.0], [0.054, -50.0, 1200.0, -0.5, 75.0, 0.0]]
    np.testing.assert_array_equal(read.values(), expected)
    assert read.tool is not None
    assert (read.tool.number, read.tool.frame, read.in_root) == (1, None, False)
    said = "\n".join(read.notes)
    assert "home move (line 23) left unchanged: P[1] is given as joint angles" in said
    assert "COUNT (line 30) is another program" in said
    assert "without a stop there, line 26" in said
    assert "P[4]" in said


def test_w_p_r_turn_about_the_fixed_axes() -> None:
    """r_z(R) r_y(P) r_x(W), as roboception's pose formats have it for FANUC."""
    read = one(J2, positions=position(2, 1.0, 2.0, 3.0, 10.0, 20.0, 30.0))
    ((_, pose),) = parsed(read.text)[0].items()
    np.testing.assert_allclose(pose_from_zyx(*read.values()[0]), pose, atol=1e-12)


def test_the_corrected_file_is_the_golden_one() -> None:
    """Numbers end in their column where blanks before them leave room."""
    read = read_program("drill.ls", LISTING)
    poses = read.values() + [0.5, -150.25, 0.1254, 0.0, 0.5, -1.0]
    golden = (
        LISTING.replace("X =  -200.000  mm,\tY =   100.123  mm,\tZ =  1000.500  mm",
                        "X =  -199.500  mm,\tY =   -50.127  mm,\tZ =  1000.625  mm")
        .replace("X =      .054  mm,\tY =\t-50.000000\tmm,\tZ =1200.000  mm",
                 "X =     0.554  mm,\tY =\t-200.250000\tmm,\tZ =1200.125  mm")
        .replace("W =     0.000 deg,\tP =    75.000 deg,\tR =     0.000",
                 "W =    -1.000 deg,\tP =    75.500 deg,\tR =     0.000")
        .replace("W =     0.000 deg,\tP =    75.000 deg,\tR =     -.500",
                 "W =    -1.000 deg,\tP =    75.500 deg,\tR =    -0.500")
        .replace("LINE_COUNT\t= 17;", "LINE_COUNT\t= 19;")
        .replace("50% FINE    ;\n/POS", "50% FINE    ;\n  18:  !by hand, by the test of the ;\n"
                 "  19:  !golden file ;\n/POS")
    )  # fmt: skip
    assert moved(read, poses, "by hand; by the test of the golden file") == golden
    again = read_program("drill.ls", golden)
    assert again.remarks[-1] == "by hand, by the test of the golden file"


def test_a_stamp_is_known_again() -> None:
    read = read_program("drill.ls", LISTING.replace("\n", "\r\n"))
    stamp = Stamp("20261101-120000-calibrate-abcd", "2026-11-22T14:00:00Z", "S1100", remarks=("é",))
    text = moved(read, read.values(), stamp.text)
    assert "\n" not in text.replace("\r\n", "")
    lines = [line for line in text.splitlines() if ":  !" in line]
    assert max(len(line.partition("!")[2]) - 2 for line in lines) <= 32
    with pytest.raises(CorrectedBefore, match="20261101-120000-calibrate-abcd for S1100"):
        refuse_corrected("drill.ls", read_program("drill.ls", text).remarks)


NUMBER = re.compile(r" *[-+]?(?:\d+\.?\d*|\.\d+)")


@given(st.lists(st.floats(-9000.0, 9000.0), min_size=6, max_size=6))
def test_all_but_the_numbers_of_targets_is_unchanged(places_mm: list[float]) -> None:
    text = LISTING.replace("\n", "\r\n").replace("done", "gebohrt \xfc")
    read = read_program("drill.ls", text)
    positions = np.array(places_mm).reshape(2, 3)
    written = moved(read, positions)
    assert NUMBER.sub("#", written) == NUMBER.sub("#", text)
    pairs = zip(NUMBER.findall(text), NUMBER.findall(written), strict=True)
    assert sum(before != after for before, after in pairs) <= 6
    np.testing.assert_allclose(
        read_program("drill.ls", written).values()[:, :3], positions, atol=5e-4 + 1e-9
    )
    remarked = re.sub(r"  18:  !r ;\r\n", "", moved(read, positions, "r"))
    assert remarked.replace("LINE_COUNT\t= 18", "LINE_COUNT\t= 17") == written


@pytest.mark.parametrize(
    ("statement", "reason"),
    [
        ("C P[2]\n    :  P[3] 100mm/sec FINE", "auxiliary points"),
        ("A P[2] 100mm/sec FINE", "auxiliary points"),
        ("S P[2] 100mm/sec FINE", "auxiliary points"),
        (
            "L P[2] 500mm/sec FINE Offset,PR[1]",
            "OFFSET,PR[1]: the robot may go elsewhere than to P[2]",
        ),
        ("L P[2] 500mm/sec FINE Offset", "elsewhere"),
        ("L P[2] 500mm/sec FINE ACC80 Tool_Offset,PR[1:x]", "TOOL_OFFSET,PR[1]"),
        ("L P[2] 500mm/sec FINE VOFFSET,VR[1]", "elsewhere"),
        ("L P[2] 500mm/sec FINE INC", "elsewhere"),
        ("L P[2] 500mm/sec FINE COORD", "elsewhere"),
        ("L P[2] 500mm/sec FINE RTCP", "elsewhere"),
        ("L P[2] 500mm/sec FINE Skip,LBL[1]", "stop before it"),
        ("L P[2] 500mm/sec FINE TB .10sec,P-SPS", "elsewhere"),
        ("L P[R[1]] 500mm/sec FINE", "P[R[1]] is no position of /POS"),
        ("L P[9] 500mm/sec FINE", "P[9] is no position of /POS"),
        ("L PR[1:home] 500mm/sec FINE", "PR[1] is a register"),
        ("L P[1] 500mm/sec FINE", "P[1] is given as joint angles"),
        ("L P[2] FINE", "expected J or L"),
        ("L P[2] 500mm/sec", "expected J or L"),
        ("  OFFSET CONDITION PR[1]", "not known to leave"),
        ("  TOOL_OFFSET CONDITION PR[1]", "not known to leave"),
        ("  SKIP CONDITION DI[1]=ON", "not known to leave"),
        ("  Weave Sine[1]", "not known to leave"),
        ("  SOFTFLOAT[1]", "not known to leave"),
        ("  TRACK TAST[1]", "not known to leave"),
        ("  GRIPPER OPEN", "not known to leave"),
        ("  $MNUFRAMENUM[1]=2", "not known to leave"),
        ("  IF DI[1]=ON,SOFTFLOAT[1]", "not known to leave"),
        ("  UFRAME[1]=PR[1]", "changes a frame"),
        ("  UTOOL[R[1]]=PR[1]", "changes a frame"),
        ("  UFRAME_NUM=R[1]", "UFRAME_NUM is not known before"),
        ("  UTOOL_NUM=AR[1]", "UTOOL_NUM is not known before"),
        ("  IF DI[1]=ON,UTOOL_NUM=R[1]", "UTOOL_NUM is not known before"),
        ("  !a remark ; L P[3] 9mm/sec FINE", "one statement a line"),
        ("L P[2] 9mm/sec FINE ; J PR[1] 9% FINE", "one statement a line"),
        ("  P[2]=P[3]", "besides the motions"),
        ("  PR[1]=P[2]", "besides the motions"),
        ("  P[2,1]=(100)", "besides the motions"),
        ("  R[1]=P[2,3]", "besides the motions"),
    ],
)
def test_refused_by_line(statement: str, reason: str) -> None:
    """The statement is the second, in line 6."""
    (problem,) = refusals(listing([L2, statement, L3], HOME + position(2) + position(3)))
    assert problem.startswith("drill.ls line 6 (statement 2): ")
    assert reason in problem
    assert len(problem.splitlines()) == 1


@pytest.mark.parametrize(
    ("stated", "reason"),
    [
        (position(3, more="\n   GP2:\n\tUF : 1, UT : 1,\n\tJ1= 0.000  mm"), "motion groups 1, 2"),
        (position(3).replace("GP1", "GP2"), "motion groups 2"),
        (position(3).replace("1200.000", "********"), "P[3] is not taught"),
        (position(3, config=""), "P[3] has the CONFIG ''"),
        (position(3, config="N L U T, 0, 0, 0"), "expected N or F, U or D, T or B"),
        (position(3, config="N D B, 0, 0, 0"), "P[3] is behind axis 1"),
        (position(3).replace("CONFIG", "KONFIG"), "P[3] states no CONFIG"),
        (position(3).replace("\tX", "\tQ"), "P[3] states no X"),
        (position(3).replace("\tX", "\tZ"), "P[3] states Z twice"),
        (position(3).replace("1200.000  mm", "1200.000 deg"), "Z = 1200.000 deg: expected"),
        (position(3).replace("1200.000  mm", "1200.000"), "Z = 1200.000: expected"),
        (position(3).replace("1200.000", "1E999"), "expected a number of mm"),
        (position(3, uf="R"), "P[3]: UF R is no number"),
        (position(3, more=",\n\tV = 1.0 mm"), "P[3] states V, which"),
        (position(3, more="\n\t!"), "P[3]: ! is not understood"),
    ],
)
def test_positions_that_a_motion_cannot_be_corrected_at(stated: str, reason: str) -> None:
    (problem,) = refusals(listing([L2, L3], HOME + position(2) + stated))
    assert problem.startswith("drill.ls line 6 (statement 2): L P[3] 500mm/sec FINE: ")
    assert reason in problem
    read = read_program("drill.ls", listing([L2], HOME + position(2) + stated))
    assert len(read.targets) == 1, "one that no motion uses is left"


@pytest.mark.parametrize(
    ("statements", "line", "reason"),
    [
        ([L2, "J P[1] 100% FINE", L3], 6, "P[1] is given as joint angles: only a home move J"),
        ([L2, "J PR[1] 100% FINE", L3], 6, "PR[1] is a register: its place is not known: only"),
        ([L2, "  UFRAME_NUM=2"], 6, "UFRAME_NUM=2, expected UF 1, as P[2] (drill.ls line 13) has"),
        (["  UTOOL_NUM=2", L2], 5, "UTOOL_NUM=2, expected UT 1, as P[2] (drill.ls line 13) has"),
        (["  IF DI[1]=ON,UFRAME_NUM=2", L2], 5, "UFRAME_NUM=2, expected UF 1"),
        (["  LBL[1]"], 4, "no motion to a position with X, Y, Z: nothing to correct"),
        (["J P[1] 100% FINE"], 4, "nothing to correct"),
        (["L P[2] 1mm/sec FINE\n 7:  END"], 5, "expected ';' at its end"),
    ],
)
def test_homes_and_frames(statements: list[str], line: int, reason: str) -> None:
    (problem,) = refusals(listing(statements, HOME + position(2) + position(3)))
    statement = f" (statement {line - 4})" if line > 4 else ""
    assert problem.startswith(f"drill.ls line {line}{statement}: ")
    assert reason in problem


def test_a_home_before_and_after_the_work_is_left() -> None:
    read = one("J PR[1:home] 100% FINE", "J P[1] 50% CNT100", L2, "  LBL[1]", "J P[1] 100% FINE")
    assert sum("left unchanged" in note for note in read.notes) == 2
    assert [target.position.index for target in read.targets] == [2]


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (position(3, uf=2), "P[3] is in UF 2, expected UF 1, as P[2] (drill.ls line 8) has"),
        (position(3, ut=2), "P[3] is in UT 2, expected UT 1"),
        (position(3, uf="F"), "P[3] is in UF None, expected UF 1"),
        (
            position(3, more=",\n\tE1= 300.000  mm"),
            "P[3] has E1 300 mm, P[2] (drill.ls line 8) has no",
        ),
    ],
)
def test_one_frame_one_tool_one_station(given: str, reason: str) -> None:
    (problem,) = refusals(listing([L2, L3], position(2) + given))
    assert problem.startswith("drill.ls line 14: ")
    assert reason in problem


@pytest.mark.parametrize("more", ["", ",\n\tE1= 300.000  mm"])
def test_a_home_that_moves_the_slide_away_from_positions_that_do_not_say(more: str) -> None:
    home = HOME.replace("deg\n}", f"deg{more}\n}}")
    stated = read_program("drill.ls", listing([J1, L2], home + position(2, more=more)))
    assert (stated.slide is None) == (not more)
    text = listing([J1, L2], home + position(2))
    if more:
        (problem,) = refusals(text)
        assert problem.startswith("drill.ls line 5 (statement 1): P[1] has E1 300 mm, and P[2] ")
        assert problem.endswith("state it in both, or in none")
    else:
        read_program("drill.ls", text)


@pytest.mark.parametrize(
    ("statements", "frame", "refused"),
    [
        (["  UFRAME_NUM=3", L2], 3, ""),
        (["  R[1]=1", "  UFRAME_NUM=3", "  UFRAME_NUM=3", L2], 3, ""),
        ([L2], None, ""),
        (["  LBL[1]", "  UFRAME_NUM=3", L2], None, "below line 5"),
        (["J P[1] 100% FINE", "  UFRAME_NUM=3", L2], None, "below line 5"),
        (["  IF DI[1]=ON,UFRAME_NUM=3", L2], None, "below line 5"),
    ],
)
def test_the_frame_in_force(statements: list[str], frame: int | None, refused: str) -> None:
    text = listing(statements, HOME + position(2, uf="F", ut="F"))
    if refused:
        assert refused in refusals(text)[0]
    else:
        read = read_program("drill.ls", text)
        assert (read.frame, read.tool, read.in_root) == (frame, None, False)


def test_frame_0_is_the_root_and_tool_0_the_flange() -> None:
    read = one(L2, positions=position(2, uf=0, ut=0))
    assert read.in_root
    assert read.tool is not None
    assert read.tool.frame is not None
    np.testing.assert_array_equal(read.tool.frame, np.eye(4))


@pytest.mark.parametrize("groups", ["1,1,*,*,*", "*,1,*,*,*", "*,*,*,*,*"])
def test_a_program_for_other_groups(groups: str) -> None:
    (problem,) = refusals(listing([L2], position(2), groups))
    assert problem.startswith(f"drill.ls line 3: DEFAULT_GROUP is {groups}: expected the robot's")


def test_the_slide_is_external_axis_1() -> None:
    stated = position(2, more=",\n\tE1=  1100.000  mm,\tE2= 3.000 deg")
    assert one(L2, positions=stated).slide == ("P[2] (drill.ls line 12)", 1100.0)
    assert one(L2, positions=stated.replace("1100.000  mm", "10.000 deg")).slide is None


@pytest.mark.parametrize("text", ["", "/MN\n/POS\n", "/PROG A\n/POS\n/MN\n", "\0"])
def test_no_listing(text: str) -> None:
    assert refusals(text) == ["drill.ls: expected the sections /PROG, /MN, /POS of a listing"]


def test_broken_positions() -> None:
    twice = refusals(listing([L2], position(2) + position(2)))
    assert twice == ["drill.ls line 13: P[2] is in /POS twice"]
    (open_,) = refusals(listing([L2], position(2) + "P[3]{\n"))
    assert "it is no position" in open_


def test_numbers_of_many_digits() -> None:
    many = 5000 * "9"
    assert "it is no position" in refusals(listing([L2], position(2) + f"P[{many}]{{\n}};\n"))[0]
    for statement in (f"L P[{many}] 9mm/sec FINE", f"  UFRAME_NUM={many}"):
        assert refusals(listing([L2, statement], position(2)))[0].startswith(
            "drill.ls line 6 (statement 2): "
        )
    assert "no number of a frame" in refusals(listing([L2], position(2, uf=many)))[0]
    counted = listing([L2], position(2)).replace("/MN", f"LINE_COUNT = {many};\n/MN")
    read = read_program("drill.ls", counted)
    assert many in moved(read, read.values(), "r")


def test_every_refusal_is_listed_and_cleaned() -> None:
    found = refusals(listing(["  A\x1b[2J", L2, "  B" + 90 * "+"], position(2)))
    assert [each[:15] for each in found] == ["drill.ls line 5", "drill.ls line 7"]
    assert "\x1b" not in "".join(found)
    assert "...:" in found[1]


@pytest.mark.parametrize("signs", [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
def test_the_letters_of_a_posture_are_the_arms_shape(signs: tuple[float, float]) -> None:
    """N: bent down with axis 4 at 0; U: the elbow above the line from axis 2 to the wrist."""
    sign = ARM.sign.copy()
    sign[2], sign[4] = signs
    arm = replace(ARM, sign=sign, offset_rad=ARM.offset_rad)
    for elbow_deg, letter in ((110.0, "U"), (-40.0, "D")):
        for bend_deg, wrist in ((40.0, "N"), (-40.0, "F")):
            shape = np.radians([0.0, -90.0, elbow_deg, 0.0, bend_deg, 0.0])
            joints = shape * ARM.sign * arm.sign
            letters = posture(arm, int(status_of(arm, joints)))
            assert letters == f"{wrist}{letter}T"
            straight = joints * [1.0, 1.0, 1.0, 1.0, 0.0, 1.0]
            z, forearm = (forward(arm, each)[:3, 2] for each in (joints, straight))
            assert (np.cross(forearm, z)[1] > 0) == (wrist == "N"), "down is about +y"


def test_a_published_position_has_its_published_joints() -> None:
    """An R-2000iB/165F in NUT 000 (onerobotics, "The perils of six-axis robots", 2013). Its axis 3
    is counted from the horizontal; UF 0 is at the height of axis 2.
    """
    sign, offset_deg = (
        np.array([1.0, 1.0, -1.0, -1.0, -1.0, -1.0]),
        [0.0, -90.0, 0.0, 0.0, 0.0, 0.0],
    )
    arm = replace(
        ARM,
        a_mm=np.array([312.0, 1075.0, 225.0, 0.0, 0.0, 0.0]),
        d_mm=np.array([0.0, 0.0, 0.0, 1280.0, 0.0, 270.0]),
        offset_rad=np.radians(offset_deg),
        sign=sign,
        tool=np.eye(4),
        coupling=1.0,
    )
    stated = position(2, 1500.0, 0.0, 360.0, 135.0, -45.0, 0.0, uf=0, config="N U T, 0, 0, 0")
    read = one(L2, positions=stated)
    ((_, status),) = read.statuses(0, arm)
    joints_deg = np.degrees(inverse_kinematics(arm, poses_from_zyx(read.values()), status))[0]
    np.testing.assert_allclose(joints_deg[:3], [7.962, -5.284, -36.250], atol=6e-4)
    assert np.abs(joints_deg).max() < 180.0
    assert joints_deg[4] < 0.0, "bent down where axis 4 is at 0"


def test_a_posture_is_read_as_the_arms_status() -> None:
    read = one(L2, L3, positions=position(2) + position(3, config="N U T, 0, 0, 1"))
    assert read.statuses(0, ARM) == [
        ("P[2] (drill.ls line 13), CONFIG 'F U T, 0, 0, 0'", 6),
        ("P[3] (drill.ls line 19), CONFIG 'N U T, 0, 0, 1'", BEYOND),
    ]


@pytest.mark.parametrize(("shift_mm", "axis"), [(-0.4, ""), (0.4, "J6")])
def test_turns_that_the_correction_changes(shift_mm: float, axis: str) -> None:
    """Axis 6 stands 0.005 deg below 180 deg."""
    joints = np.radians([10.0, -90.0, 100.0, 5.0, -40.0, 179.995])
    x, y, z, r, p, w = zyx_from_pose(forward(ARM, joints)[None])[0]
    read = one(L2, positions=position(2, x, y, z, w, p, r, uf=0))
    command = read.values() + [0.0, shift_mm, 0.0, 0.0, 0.0, 0.0]
    if not axis:
        read.check_joints(ARM, np.eye(4), command)
        return
    with pytest.raises(HilcellError) as raised:
        read.check_joints(ARM, np.eye(4), command)
    assert f"P[2] (drill.ls line 12): {axis} goes from" in str(raised.value)
