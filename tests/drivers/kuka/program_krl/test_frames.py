"""Base and tool of each motion of a KRL program: their numbers, on each path that leads to it."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest

from drivers.kuka.program_krl.files import read_program
from drivers.kuka.program_krl.frames import FrameRule
from drivers.kuka.program_krl.program import Program
from hilcell.compensation.programs import StatedTool
from hilcell.geometry.frames import pose_from_zyx
from tests.drivers.kuka.program_krl.samples import P1, P2, one, program, refusal

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
def test_statements_that_may_never_be_executed_set_nothing(body: str, why: str) -> None:
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
def test_statements_before_the_motions_set_base_and_tool(body: str) -> None:
    found = one(body, P1 + HOME_FORM)
    assert found.base is not None
    assert found.base.values == NULL
    assert found.tool is not None
    assert found.tool.number == 1


MODAL_DAT = P1 + P2 + "".join(
    f"DECL FDAT {name}={{TOOL_NO {tool},BASE_NO {base},IPO_FRAME #BASE}}\n"
    for name, tool, base in [("FP1", 1, 1), ("FP2", 1, 1), ("FP7", 1, 7), ("FHOME", 0, 0)]
)  # fmt: skip
SET_1 = "BAS(#TOOL,1)\nBAS(#BASE,1)"
SUB = "\nEND\nDEF SUB( )\n"


def form(name: str, motion: str = "", how: str = "PTP") -> str:
    """Return an inline form, of which a motion is left out where none is given."""
    return f"FDAT_ACT={name}\nBAS(#{how}_PARAMS,100)\n{motion}".rstrip()


def spline(name: str, point: str) -> str:
    return (
        f"SLIN {point} WITH $VEL=SVEL_CP(0.1,,LCPDAT1),$TOOL=STOOL2({name}),"
        f"$BASE=SBASE({name}.BASE_NO),$IPO_MODE=SIPO_MODE({name}.IPO_FRAME)"
    )


HOME = form("FHOME", "PTP HOME")


@pytest.mark.parametrize(
    "body",
    [
        f"{HOME}\n{form('FP1', 'PTP XP1')}\n{form('FP2', 'LIN XP2', 'CP')}\n{HOME}",
        f"{HOME}\nLOOP\n{form('FP1', 'PTP XP1')}\n{form('FP2', 'LIN XP2', 'CP')}\n{HOME}\nENDLOOP",
        f"{HOME}\n{spline('FP1', 'XP1')}\n{spline('FP2', 'XP2')}\n{HOME}",
        f"{form('FP1', 'PTP XP1')}\n{spline('FP2', 'XP2')}\nLIN_REL {{Z 5}} #TOOL\nLIN XP1",
        f"{HOME}\n{SET_1}\nLIN XP1\nLIN XP2\n{HOME}",
        f"{HOME}\n{SET_1}\nLOOP\n{SET_1}\nLIN XP1\n{HOME}\nENDLOOP",
        f"{SET_1}\nLIN XP1\nSUB( )\n{SET_1}\nLIN XP2{SUB}{HOME}",
        f"IF $IN[1] THEN\n{form('FP1')}\nELSE\n{form('FP2')}\nENDIF\nLIN XP1",
        f"{form('FP1', 'PTP XP1')}\nIF $IN[1] THEN\n{HOME}\nENDIF\n{form('FP2', 'LIN XP2')}",
        f"{form('FP1', 'PTP XP1')}\nSUB( )\nEND\nDEF SUB( )\n{HOME}\n{form('FP1', 'LIN XP2')}",
        f"{form('FHOME')}\nBAS(#FRAMES)\n{SET_1}\nLIN XP1",
        "BAS(#PTP_PARAMS,100)\nLIN XP1\nBAS(#CP_PARAMS,0.5)\nLIN XP2",
        f"{SET_1}\nBAS(#VEL_CP,0.1)\nBAS(#PTP_DAT)\nLIN XP1",
    ],
)
def test_programs_that_keep_one_base_and_tool(body: str) -> None:
    assert one(body, MODAL_DAT).targets


@pytest.mark.parametrize(
    ("body", "line", "words"),
    [
        (f"{SET_1}\nSUB( )\nLIN XP2{SUB}{HOME}", 5, "TOOL_DATA[0] by FHOME (line 8)"),
        (f"{SET_1}\nSUB(1)\nLIN XP2{SUB}{form('FP7')}", 5, "BASE_DATA[7] by FP7 (line 8)"),
        (f"{SET_1}\nIF SUB( ) THEN\nHALT\nENDIF\nLIN XP2\nEND\nDEFFCT BOOL SUB( )\n{HOME}", 7, ""),
        (f"{SET_1}\nLIN XP1\nSUB( )\nLIN XP2{SUB}{HOME}", 6, "FHOME (line 9)"),
        (f"{SET_1}\nLOOP\nLIN XP1\n{HOME}\nENDLOOP", 5, "FHOME (line 6)"),
        (f"{SET_1}\nWHILE $IN[1]\nLIN XP1\n{HOME}\nENDWHILE", 5, "FHOME (line 6)"),
        (f"{SET_1}\nFOR I=1 TO 2\nLIN XP1\n{HOME}\nENDFOR", 5, "FHOME (line 6)"),
        (f"{SET_1}\nREPEAT\nLIN XP1\n{HOME}\nUNTIL $IN[1]", 5, "FHOME (line 6)"),
        (f"{SET_1}\nAGAIN:\nLIN XP1\n{HOME}\nGOTO AGAIN", 5, "FHOME (line 6)"),
        (f"{HOME}\n{SET_1}\nLOOP\nLIN XP1\n{HOME}\nENDLOOP", 8, "FHOME (line 9)"),
        (f"IF $IN[1] THEN\n{form('FP7')}\nELSE\n{form('FP1')}\nENDIF\nLIN XP1", 9, "[7] by FP7"),
        (f"IF $IN[1] THEN\n{form('FP1', 'PTP XP1')}\nENDIF\nLIN XP2", 7, "before the program"),
        (f"{spline('FP7', 'XP1')}\nLIN XP2", 3, "WITH holds for its own motion"),
        (f"LIN XP2\n{spline('FP7', 'XP1')}", 2, "WITH holds for its own motion"),
        (f"{HOME}\n{spline('FP7', 'XP1')}\nLIN_REL {{Z 5}} #TOOL", 6, "[0] by FHOME (line 2)"),
        (f"{HOME}\n{SET_1}\nLIN XP1\nBAS(#CP_PARAMS,0.5)\nLIN XP2", 9, "FHOME (line 8)"),
        (f"{HOME}\n{SET_1}\nLIN XP1\nBAS (#PTP_PARAMS,50 )\nLIN XP2", 9, "FHOME (line 8)"),
        (f"{SET_1}\nLIN XP1\nBAS(#CP_PARAMS,0.5)\nLIN XP2", 6, "FDAT_ACT, which is not in these"),
        (f"{SET_1}\nLIN XP1\nIF $IN[1] THEN\nFDAT_ACT=FNONE\nENDIF\nLIN XP2", 8, "FNONE"),
    ],
)
def test_a_motion_that_may_run_in_another_base_or_tool_is_refused(
    body: str, line: int, words: str
) -> None:
    said = refusal(body, MODAL_DAT)
    assert f"drill.src line {line}: " in said
    assert words in said


def test_a_tool_that_a_with_leaves_out_is_the_one_in_force() -> None:
    motion = "SLIN XP1 WITH $BASE=SBASE(FP1.BASE_NO)"
    assert one(f"{form('FP1')}\n{motion}", MODAL_DAT).targets
    assert "line 2: SLIN may run in another tool" in refusal(motion, MODAL_DAT)


def test_subprograms_that_call_one_another_too_deeply_are_refused() -> None:
    calls = "\n".join(f"END\nDEF S{n}( )\nS{n + 1}( )" for n in range(300))
    said = refusal(f"{SET_1}\nLIN XP1\nS0( )\n{calls}\nEND\nDEF S300( )\nLIN XP2", MODAL_DAT)
    assert "is called within more than 50 others" in said


def test_subprograms_that_call_one_another_alone_are_followed_as_well() -> None:
    """Other files may call them; no way from the program leads there."""
    body = f"{SET_1}\nLIN XP1\nEND\nDEF SA( )\nLIN XP2\nSB( )\nEND\nDEF SB( )\n{HOME}\nSA( )"
    assert "drill.src line 7: LIN may run in another tool" in refusal(body, MODAL_DAT)


def test_frame_data_are_set_by_a_statement_of_its_own() -> None:
    body = f"{SET_1}\nTRIGGER WHEN DISTANCE=0 DELAY=0 DO FDAT_ACT=FP7\nLIN XP1"
    assert "line 4: FDAT_ACT is set within another statement" in refusal(body, MODAL_DAT)


def test_an_interrupt_may_change_base_and_tool_at_any_time() -> None:
    body = f"{SET_1}\nINTERRUPT DECL 3 WHEN $IN[1] DO SUB( )\nLIN XP1{SUB}{HOME}"
    assert "drill.src line 5: LIN may run in another" in refusal(body, MODAL_DAT)


def test_branches_cost_the_same_each() -> None:
    """600 branches with inline forms took 268 s: each branch was followed for all before it."""
    after = FrameRule.after
    counted = []
    for branches in (20, 40):
        names = range(branches)
        body = [f"IF $IN[1] THEN\n{form(f'FP{n}', f'PTP XP{n}')}\nENDIF" for n in names]
        data = [
            f"DECL FDAT FP{n}={{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}}\n"
            f"DECL E6POS XP{n}={{X 1000,Y {n},Z 1200,A 0,B 75,C 0,S 6,T 2}}"
            for n in names
        ]
        src = "\n".join(["DEF p()", *body, "END", ""])
        dat = "\n".join(["DEFDAT p", *data, "ENDDAT"])
        with patch.object(FrameRule, "after", autospec=True, side_effect=after) as steps:
            assert len(read_program("p.src", src, ("p.dat", dat)).targets) == branches
        counted.append(steps.call_count)
    assert counted[1] < 2.2 * counted[0]
