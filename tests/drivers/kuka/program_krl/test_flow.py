"""The external axes and the posture at each target of a KRL program, by the motions before it."""

from __future__ import annotations

import math

import pytest

from drivers.kuka.program_krl.program import Program
from hilcell.cell.file import load_cell
from tests.drivers.kuka.program_krl.samples import Workplace, one, refusal

EXTERNAL = "X {x}.0,Y 2.0,Z 3.0,A 0.0,B 75.0,C 0.0"
SIX = "A1 0,A2 -90,A3 90,A4 0,A5 -30,A6 0"
AXES_DAT = (
    f"DECL E6POS XP1={{{EXTERNAL.format(x=1)}}}\n"
    f"DECL E6POS XP2={{{EXTERNAL.format(x=4)},E1 1100.0}}\n"
    f"DECL E6AXIS XHOME={{{SIX},E1 300.0}}\n"
    f"DECL E6AXIS XHOME1={{{SIX},E1 1100.0}}\n"
    f"DECL E6AXIS XHOME2={{{SIX}}}\n"
)
BY = "XP1 (drill.dat line 1) by E1 of drill.src line"
SUB = "\nEND\nDEF SUB( )\n"


@pytest.mark.parametrize(
    ("body", "slide"),
    [
        ("LIN XP1", None),
        ("LIN XP2\nLIN XP1", ("XP2 (drill.dat line 2)", 1100.0)),
        ("PTP XHOME\nLIN XP1\nPTP XHOME", (f"{BY} 2", 300.0)),
        ("PTP XHOME\nLIN XP2\nLIN XP1", ("XP2 (drill.dat line 2)", 1100.0)),
        ("PTP XHOME\nPTP XHOME1\nPTP XHOME2\nLIN XP1",
         (f"{BY} 3", 1100.0)),
        (f"PTP {{{SIX},E1 5}}\nLIN XP1", (f"{BY} 2", 5.0)),
        (f"SUB( )\nLIN XP1{SUB}PTP XHOME", (f"{BY} 6", 300.0)),
        ("IF $IN[1] THEN\nPTP XHOME\nELSE\nPTP XHOME1\nENDIF\nLIN XP2",
         ("XP2 (drill.dat line 2)", 1100.0)),
        ("LOOP\nPTP XHOME1\nLIN XP1\nENDLOOP",
         (f"{BY} 3", 1100.0)),
    ],
)  # fmt: skip
def test_a_component_that_is_left_out_keeps_its_value(
    body: str, slide: tuple[str, float] | None
) -> None:
    assert one(body, AXES_DAT).slide == slide


@pytest.mark.parametrize(
    "body",
    [
        "PTP XHOME\nLIN XP1\nLIN XP2",
        "PTP XHOME\nLIN XP2\nPTP XHOME\nLIN XP1",
        "PTP XHOME1\nIF $IN[1] THEN\nPTP XHOME\nENDIF\nLIN XP1",
        "SWITCH N\nCASE 1\nPTP XHOME\nDEFAULT\nPTP XHOME1\nENDSWITCH\nLIN XP1",
        "PTP XHOME1\nLOOP\nLIN XP1\nPTP XHOME\nENDLOOP",
        "PTP XHOME1\nFOR I=1 TO N\nLIN XP1\nPTP XHOME\nENDFOR",
        "PTP XHOME1\nREPEAT\nLIN XP1\nPTP XHOME\nUNTIL $IN[1]",
        "PTP XHOME1\nAGAIN:\nLIN XP1\nPTP XHOME\nGOTO AGAIN",
        "PTP XHOME1\nLOOP\nIF $IN[1] THEN\nPTP XHOME\nEXIT\nENDIF\nENDLOOP\nLIN XP1\nLIN XP2",
        f"PTP XHOME1\nLIN XP1\nSUB( )\nLIN XP1{SUB}PTP XHOME",
        f"PTP XHOME1\nLIN XP1\nSUB( )\nLIN XP1{SUB}IF $IN[1] THEN\nRETURN\nENDIF\nPTP XHOME",
        f"INTERRUPT DECL 3 WHEN $IN[1] DO SUB( )\nPTP XHOME1\nLIN XP1{SUB}PTP XHOME",
    ],
)
def test_an_axis_that_may_be_elsewhere_is_refused(body: str) -> None:
    said = refusal(body, AXES_DAT)
    assert "E1 300" in said
    assert "a program is corrected for one station" in said


@pytest.mark.parametrize(
    "body",
    [
        "PTP XHOME\nLOOP\nLIN XP2\nLIN XP1\nPTP XHOME\nENDLOOP",
        "PTP XHOME1\nIF $IN[1] THEN\nPTP XHOME\nRETURN\nENDIF\nLIN XP1",
        f"PTP XHOME1\nSUB( )\nLIN XP1{SUB}$OUT[1]=TRUE\nEND\nDEF OTHER( )\nPTP XHOME",
    ],
)
def test_a_home_that_is_elsewhere_is_allowed_where_each_point_is_known(body: str) -> None:
    slide = one(body, AXES_DAT).slide
    assert slide is not None
    assert slide[1] == 1100.0


def test_a_point_that_nothing_before_puts_is_noted() -> None:
    (note,) = [each for each in one("LIN XP1\nLIN XP2", AXES_DAT).notes if each.startswith("E1 ")]
    assert "E1 is not known at XP1:" in note


@pytest.mark.parametrize("body", ["PTP HOME", "XHOME.E1=5\nPTP XHOME"])
def test_a_home_without_numbers_leaves_the_slide_unknown(body: str) -> None:
    slide = one(f"LIN XP2\n{body}\nLIN XP1", AXES_DAT).slide
    assert slide is not None
    assert slide[0].startswith("XP1 (drill.dat line 1) states no E1")
    assert math.isnan(slide[1])


POINT = "X 0.0,Y 0.0,Z 1200.0,A 0.0,B 75.0,C 0.0"
FLIPPED = "A1 0,A2 -90,A3 90,A4 180,A5 60,A6 180"
DAT = (
    f"DECL E6POS XP1={{{POINT}}}\n"
    f"DECL E6POS XP2={{{POINT},S 6,T 19}}\n"
    f"DECL E6POS XP3={{{POINT},S 2,T 19}}\n"
    f"DECL E6AXIS XHOME={{{FLIPPED}}}\n"
    "DECL E6AXIS XHOME1={A1 0,A2 -90,A3 90,A4 0,A5 -30,A6 0}\n"
    "DECL E6AXIS XHOME2={A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\n"
    "DECL E6AXIS XHOME3={A1 0,A2 -90,A3 -60,A4 0,A5 -30,A6 0}\n"
)


def kept(read: Program) -> list[tuple[int, int]]:
    return [(each.known, each.status) for each in read.kept]


@pytest.mark.parametrize(
    ("body", "bits"),
    [
        ("LIN XP1", []),
        ("PTP XHOME\nLIN XP1", [(6, 2)]),
        (f"PTP {{{FLIPPED}}}\nLIN XP1", [(6, 2)]),
        ("PTP XHOME\nPTP XP1", [(6, 2)]),
        ("PTP XHOME\nLIN XP2", [(6, 2)]),
        ("PTP XHOME1\nLIN XP1", [(6, 6)]),
        ("PTP XHOME2\nLIN XP1", [(2, 2)]),
        ("PTP XHOME3\nLIN XP1", [(6, 4)]),
        ("PTP XHOME\nPTP HOME\nLIN XP1", []),
        ("XHOME.A5=-30\nPTP XHOME\nLIN XP1", []),
        ("PTP XHOME\nPTP $AXIS_ACT\nLIN XP1", [(6, 2)]),
        ("PTP XHOME\nPTP XP2\nLIN XP1", [(7, 6)]),
        ("PTP XP3\nLIN XP1\nPTP XP2", [(7, 2)]),
        ("PTP XP2\nLOOP\nLIN XP1\nPTP XHOME\nENDLOOP", [(6, 2), (7, 6)]),
        ("PTP XP2\nSUB( )\nLIN XP1\nEND\nDEF SUB( )\nPTP XHOME", [(6, 2)]),
    ],
)
def test_only_motions_by_joints_take_a_posture(body: str, bits: list[tuple[int, int]]) -> None:
    assert kept(one(body, DAT)) == bits


def test_bits_that_are_not_known_are_taken_as_expected() -> None:
    read = one("PTP XHOME\nLIN XP1", DAT)
    where = "XP1 (drill.dat line 1), kept from drill.src line 2"
    arm = load_cell("paper").robot.arm()
    assert read.statuses(6, arm) == [(where, 2)]
    assert read.statuses(1, arm) == [(where, 3)]
    assert one("PTP XP2", DAT).statuses(1, arm) == [("XP2 (drill.dat line 2)", 6)]


@pytest.mark.parametrize(("home", "code"), [("XHOME", 2), ("XHOME1", 0), ("XHOME2", 0)])
def test_a_posture_that_is_kept_from_a_home_move_is_checked(
    workplace: Workplace, home: str, code: int
) -> None:
    workplace.calibrate(digest=load_cell("paper").digest)
    workplace.program(f"DEF drill( )\nPTP {home}\nLIN XP1\nEND\n", f"DEFDAT drill\n{DAT}ENDDAT\n")
    done = workplace.run("--cell", "paper")
    assert done.returncode == code, done.stderr
    said = "XP1 (drill.dat line 2), kept from drill.src line 2: S 2"
    assert (said in done.stderr) == (code == 2)
