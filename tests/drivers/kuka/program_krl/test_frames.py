"""Which base and tool a KRL program sets: evaluated where its numbers are at hand, else refused."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.kuka.program_krl.program import Program
from hilcell.compensation.programs import StatedTool
from hilcell.geometry.frames import pose_from_zyx
from tests.drivers.kuka.program_krl.test_program import P1, one, program, refusal

JIG = "DECL FRAME JIG={X 500.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 90.0}\n"
OWN_BASE = "DECL FRAME BASE_DATA[4]\nBASE_DATA[3]={X 1.5,Y 2,Z 3,A 0,B 0,C 0}\n"
OWN_TOOL = "DECL FRAME TOOL_DATA[2]\nTOOL_DATA[1]={X 0,Y 0,Z 200,A 0,B 0,C 0}\n"
FORM = "DECL FDAT FP1={{TOOL_NO {tool},BASE_NO {base},IPO_FRAME #BASE}}\n"
NULL = (0.0,) * 6


def at(body: str, dat: str = "") -> Program:
    return one(f"{body}\nLIN XP1", P1 + dat)


@pytest.mark.parametrize(
    ("body", "dat", "values"),
    [
        ("$BASE={X 1,Y 2,Z 3,A 4,B 5,C 6}", "", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
        ("$BASE=$NULLFRAME", "", NULL),
        ("$BASE=$WORLD", "", NULL),
        ("$BASE=JIG", JIG, (500.0, 0.0, 0.0, 0.0, 0.0, 90.0)),
        ("$BASE = jig", JIG, (500.0, 0.0, 0.0, 0.0, 0.0, 90.0)),
        ("$BASE=JIG", "DECL FRAME JIG\n" + JIG.removeprefix("DECL FRAME "),
         (500.0, 0.0, 0.0, 0.0, 0.0, 90.0)),
        ("$BASE=BASE_DATA[3]", OWN_BASE, (1.5, 2.0, 3.0, 0.0, 0.0, 0.0)),
        ("BAS(#BASE,0)", "", NULL),
        ("$BASE=BASE_DATA[0]", "", NULL),
        ("FDAT_ACT=FP1", FORM.format(tool=1, base=0), NULL),
        ("BAS(#BASE,3)", "", None),
        ("$BASE=BASE_DATA[3]", "", None),
        ("FDAT_ACT=FP1", FORM.format(tool=1, base=3), None),
        ("$TOOL=TOOL_DATA[1]", "", None),
    ],
)  # fmt: skip
def test_the_base_is_known_by_its_numbers_or_by_the_controller(
    body: str, dat: str, values: tuple[float, ...] | None
) -> None:
    base = at(body, dat).base
    assert (None if base is None else base.values) == values
    if base is not None:
        assert base.where.startswith("drill.src line ")


@pytest.mark.parametrize(
    ("body", "dat", "number", "frame"),
    [
        ("$TOOL=TOOL_DATA[7]", "", 7, None),
        ("BAS (#TOOL,7 )", "", 7, None),
        ("FDAT_ACT=FP1", FORM.format(tool=7, base=3), 7, None),
        ("$TOOL=TOOL_DATA[1]", OWN_TOOL, None, (0.0, 0.0, 200.0, 0.0, 0.0, 0.0)),
        ("$TOOL={X 1,Y 2,Z 3,A 4,B 5,C 6}", "", None, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
        ("$TOOL=JIG", JIG, None, (500.0, 0.0, 0.0, 0.0, 0.0, 90.0)),
        ("BAS(#TOOL,0)", "", 0, NULL),
        ("$TOOL=$NULLFRAME", "", None, NULL),
    ],
)
def test_the_tool_is_a_number_or_a_frame(
    body: str, dat: str, number: int | None, frame: tuple[float, ...] | None
) -> None:
    tool = at(body, dat).tool
    assert isinstance(tool, StatedTool)
    assert tool.number == number
    assert (tool.frame is None) == (frame is None)
    if tool.frame is not None and frame is not None:
        np.testing.assert_allclose(tool.frame, pose_from_zyx(*frame), atol=1e-12)


@pytest.mark.parametrize(
    ("body", "dat"),
    [
        ("$BASE=SOMEWHERE", ""),
        ("$TOOL=SOMETHING", ""),
        ("DECL FRAME HERE\n$BASE=HERE", ""),
        ("$BASE=BASE_DATA[2]", OWN_BASE),
        ("$BASE=TOOL_DATA[1]", ""),
        ("$BASE=OTHER[1]", ""),
        ("BAS(#BASE,N)", ""),
        ("BAS(#TOOL)", ""),
        ("JIG.X=4\n$BASE=JIG", JIG),
        ("$BASE=JIG\nJIG={X 1,Y 0,Z 0,A 0,B 0,C 0}", JIG),
        ("FP1.BASE_NO=4", FORM.format(tool=1, base=3)),
        ("$BASE=JIG", "DECL FRAME JIG={X 1,Y 2,Z 3}\n"),
        ("BAS(#BASE,3)\nBAS(#BASE,4)", ""),
        ("$BASE=BASE_DATA[3]\n$BASE={X 1,Y 0,Z 0,A 0,B 0,C 0}", ""),
    ],
)
def test_a_frame_that_is_not_known_is_refused_with_its_line(body: str, dat: str) -> None:
    assert f"drill.src line {2 + body.count(chr(10))}: " in refusal(f"{body}\nLIN XP1", P1 + dat)


def test_the_same_base_and_tool_may_be_set_again() -> None:
    again = "BAS(#TOOL,1)\nBAS(#BASE,3)"
    read = one(f"{again}\nLIN XP1\n{again}\nLIN XP1\n$TOOL=TOOL_DATA[1]", P1)
    assert read.tool is not None
    assert read.tool.where == "drill.src line 2"


def test_a_frame_that_is_a_base_is_not_called_unused() -> None:
    assert not any("JIG" in note for note in at("$BASE=JIG", JIG).notes)


def test_a_first_motion_to_six_joints_is_kept() -> None:
    stated = "PTP {A1 5.5,A2 -90,A3 90,A4 0,A5 -30,A6 0}"
    read = one(f"{stated}\nLIN XP1", P1)
    assert [target.name for target in read.targets] == ["XP1"]
    assert any("A1 5.5" in note for note in read.notes)
    assert "A1 5.5,A2 -90" in read.with_positions(np.zeros((1, 3)))["drill.src"].decode("latin-1")


def test_statements_that_move_nothing_are_no_programs() -> None:
    read = one("PULSE ($OUT[5],TRUE,0.2)\nDRILLING ( )\nLIN XP1", P1)
    assert not any("PULSE" in note for note in read.notes)
    assert any("DRILLING" in note for note in read.notes)


MARK = "\xef\xbb\xbf"


@pytest.mark.parametrize("first", ["&ACCESS RVP\r\n&REL 1\r\n", ""])
def test_a_byte_order_mark_stays_first_and_hides_nothing(first: str) -> None:
    src = f"{MARK}{first}DEF drill( )\r\nLIN XP1\r\nEND\r\n"
    read = program(src, f"{MARK}{first}DEFDAT drill\r\n{P1}ENDDAT\r\n")
    assert [target.name for target in read.targets] == ["XP1"]
    assert read.misnamed("drill") == []
    files = read.with_positions(np.array([[1.0, 2.0, 3.0]]), "corrected")
    text = files["drill.src"].decode("latin-1")
    assert text.startswith(f"{MARK}{first}DEF drill( )\r\n; corrected\r\n")


SETS = "$BASE=$NULLFRAME\nBAS(#TOOL,1)\n"
HOME_FORM = "DECL FDAT FHOME={TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}\n"


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (f"IF $IN[1] THEN\n{SETS}ENDIF\nLIN XP1", "within the IF of line 2"),
        (f"SWITCH N\nCASE 1\n{SETS}ENDSWITCH\nLIN XP1", "within the SWITCH of line 2"),
        (f"FOR I=1 TO N\n{SETS}ENDFOR\nLIN XP1", "within the FOR of line 2"),
        (f"GOTO L1\n{SETS}L1:\nLIN XP1", "after the GOTO of line 2"),
        (f"LOOP\nEXIT\n{SETS}ENDLOOP\nLIN XP1", "after the EXIT of line 3"),
        (f"FIRST( )\n{SETS}END\nDEF FIRST( )\nLIN XP1", "after line 2, by which a subprogram"),
        (f"PREPARE( )\nLIN XP1\nEND\nDEF PREPARE( )\n{SETS}", "in PREPARE, not in DRILL"),
        (f"{SETS}WAIT SEC 0\nEND\nDEF OTHER( )\nLIN XP1", "no statement of this file calls it"),
        (f"{SETS}BAS(#FRAMES)\nLIN XP1", "by FDAT_ACT after line 2"),
        ("BAS(#TCP_IPO)\nLIN XP1", "may set another base"),
        ("FDAT_ACT=FHOME\nBAS(#FRAMES)\n$BASE=$NULLFRAME\nLIN XP1", "the base and tool of FHOME"),
    ],
)
def test_what_may_never_be_executed_sets_nothing(body: str, why: str) -> None:
    assert why in refusal(body, P1 + HOME_FORM)


@pytest.mark.parametrize(
    "body",
    [
        f"{SETS}LOOP\nLIN XP1\nENDLOOP",
        f"LOOP\n{SETS}LIN XP1\nENDLOOP",
        f"LOOP\nEXIT\nENDLOOP\n{SETS}LIN XP1",
        f"{SETS}IF $IN[1] THEN\nLIN XP1\nENDIF",
        f"{SETS}DRILL_ALL( )\nEND\nDEF DRILL_ALL( )\nLIN XP1",
        f"FDAT_ACT=FHOME\nBAS(#FRAMES)\nPTP XHOME\n{SETS}LIN XP1",
    ],
)
def test_what_is_executed_before_the_motions_sets_base_and_tool(body: str) -> None:
    found = one(body, P1 + HOME_FORM)
    assert found.base is not None
    assert found.base.values == NULL
    assert found.tool is not None
    assert found.tool.number == 1
