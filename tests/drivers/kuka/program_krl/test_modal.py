"""In which base and tool each motion of a KRL program runs, whatever way led to it."""

from unittest.mock import patch

import pytest

from drivers.kuka.program_krl.files import read_program
from drivers.kuka.program_krl.frames import FrameRule
from tests.drivers.kuka.program_krl.test_program import P1, P2, one, refusal

DAT = P1 + P2 + "".join(
    f"DECL FDAT {name}={{TOOL_NO {tool},BASE_NO {base},IPO_FRAME #BASE}}\n"
    for name, tool, base in [("FP1", 1, 1), ("FP2", 1, 1), ("FP7", 1, 7), ("FHOME", 0, 0)]
)  # fmt: skip
SETS = "BAS(#TOOL,1)\nBAS(#BASE,1)"
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
        f"{HOME}\n{SETS}\nLIN XP1\nLIN XP2\n{HOME}",
        f"{HOME}\n{SETS}\nLOOP\n{SETS}\nLIN XP1\n{HOME}\nENDLOOP",
        f"{SETS}\nLIN XP1\nSUB( )\n{SETS}\nLIN XP2{SUB}{HOME}",
        f"IF $IN[1] THEN\n{form('FP1')}\nELSE\n{form('FP2')}\nENDIF\nLIN XP1",
        f"{form('FP1', 'PTP XP1')}\nIF $IN[1] THEN\n{HOME}\nENDIF\n{form('FP2', 'LIN XP2')}",
        f"{form('FP1', 'PTP XP1')}\nSUB( )\nEND\nDEF SUB( )\n{HOME}\n{form('FP1', 'LIN XP2')}",
        f"{form('FHOME')}\nBAS(#FRAMES)\n{SETS}\nLIN XP1",
        "BAS(#PTP_PARAMS,100)\nLIN XP1\nBAS(#CP_PARAMS,0.5)\nLIN XP2",
        f"{SETS}\nBAS(#VEL_CP,0.1)\nBAS(#PTP_DAT)\nLIN XP1",
    ],
)
def test_programs_that_keep_one_base_and_tool(body: str) -> None:
    assert one(body, DAT).targets


@pytest.mark.parametrize(
    ("body", "line", "words"),
    [
        (f"{SETS}\nSUB( )\nLIN XP2{SUB}{HOME}", 5, "TOOL_DATA[0] by FHOME (line 8)"),
        (f"{SETS}\nSUB(1)\nLIN XP2{SUB}{form('FP7')}", 5, "BASE_DATA[7] by FP7 (line 8)"),
        (f"{SETS}\nIF SUB( ) THEN\nHALT\nENDIF\nLIN XP2\nEND\nDEFFCT BOOL SUB( )\n{HOME}", 7, ""),
        (f"{SETS}\nLIN XP1\nSUB( )\nLIN XP2{SUB}{HOME}", 6, "FHOME (line 9)"),
        (f"{SETS}\nLOOP\nLIN XP1\n{HOME}\nENDLOOP", 5, "FHOME (line 6)"),
        (f"{SETS}\nWHILE $IN[1]\nLIN XP1\n{HOME}\nENDWHILE", 5, "FHOME (line 6)"),
        (f"{SETS}\nFOR I=1 TO 2\nLIN XP1\n{HOME}\nENDFOR", 5, "FHOME (line 6)"),
        (f"{SETS}\nREPEAT\nLIN XP1\n{HOME}\nUNTIL $IN[1]", 5, "FHOME (line 6)"),
        (f"{SETS}\nAGAIN:\nLIN XP1\n{HOME}\nGOTO AGAIN", 5, "FHOME (line 6)"),
        (f"{HOME}\n{SETS}\nLOOP\nLIN XP1\n{HOME}\nENDLOOP", 8, "FHOME (line 9)"),
        (f"IF $IN[1] THEN\n{form('FP7')}\nELSE\n{form('FP1')}\nENDIF\nLIN XP1", 9, "[7] by FP7"),
        (f"IF $IN[1] THEN\n{form('FP1', 'PTP XP1')}\nENDIF\nLIN XP2", 7, "before the program"),
        (f"{spline('FP7', 'XP1')}\nLIN XP2", 3, "WITH holds for its own motion"),
        (f"LIN XP2\n{spline('FP7', 'XP1')}", 2, "WITH holds for its own motion"),
        (f"{HOME}\n{spline('FP7', 'XP1')}\nLIN_REL {{Z 5}} #TOOL", 6, "[0] by FHOME (line 2)"),
        (f"{HOME}\n{SETS}\nLIN XP1\nBAS(#CP_PARAMS,0.5)\nLIN XP2", 9, "FHOME (line 8)"),
        (f"{HOME}\n{SETS}\nLIN XP1\nBAS (#PTP_PARAMS,50 )\nLIN XP2", 9, "FHOME (line 8)"),
        (f"{SETS}\nLIN XP1\nBAS(#CP_PARAMS,0.5)\nLIN XP2", 6, "FDAT_ACT, which is not in these"),
        (f"{SETS}\nLIN XP1\nIF $IN[1] THEN\nFDAT_ACT=FNONE\nENDIF\nLIN XP2", 8, "FNONE"),
    ],
)
def test_a_motion_that_may_run_in_another_base_or_tool_is_refused(
    body: str, line: int, words: str
) -> None:
    said = refusal(body, DAT)
    assert f"drill.src line {line}: " in said
    assert words in said


def test_a_tool_that_a_with_leaves_out_is_the_one_in_force() -> None:
    motion = "SLIN XP1 WITH $BASE=SBASE(FP1.BASE_NO)"
    assert one(f"{form('FP1')}\n{motion}", DAT).targets
    assert "line 2: SLIN may run in another tool" in refusal(motion, DAT)


def test_subprograms_that_call_one_another_too_deeply_are_refused() -> None:
    calls = "\n".join(f"END\nDEF S{n}( )\nS{n + 1}( )" for n in range(300))
    said = refusal(f"{SETS}\nLIN XP1\nS0( )\n{calls}\nEND\nDEF S300( )\nLIN XP2", DAT)
    assert "is called within more than 50 others" in said


def test_subprograms_that_call_one_another_alone_are_followed_as_well() -> None:
    """Other files may call them; no way from the program leads there."""
    body = f"{SETS}\nLIN XP1\nEND\nDEF SA( )\nLIN XP2\nSB( )\nEND\nDEF SB( )\n{HOME}\nSA( )"
    assert "drill.src line 7: LIN may run in another tool" in refusal(body, DAT)


def test_frame_data_are_set_by_a_statement_of_its_own() -> None:
    body = f"{SETS}\nTRIGGER WHEN DISTANCE=0 DELAY=0 DO FDAT_ACT=FP7\nLIN XP1"
    assert "line 4: FDAT_ACT is set within another statement" in refusal(body, DAT)


def test_an_interrupt_may_change_base_and_tool_at_any_time() -> None:
    body = f"{SETS}\nINTERRUPT DECL 3 WHEN $IN[1] DO SUB( )\nLIN XP1{SUB}{HOME}"
    assert "drill.src line 5: LIN may run in another" in refusal(body, DAT)


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
