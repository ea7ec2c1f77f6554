"""Where the external axes stand at each target of a KRL program, by whatever motion put them."""

import math

import pytest

from tests.drivers.kuka.program_krl.test_program import one, refusal

POINT = "X {x}.0,Y 2.0,Z 3.0,A 0.0,B 75.0,C 0.0"
HOME = "A1 0,A2 -90,A3 90,A4 0,A5 -30,A6 0"
DAT = (
    f"DECL E6POS XP1={{{POINT.format(x=1)}}}\n"
    f"DECL E6POS XP2={{{POINT.format(x=4)},E1 1100.0}}\n"
    f"DECL E6AXIS XHOME={{{HOME},E1 300.0}}\n"
    f"DECL E6AXIS XHOME1={{{HOME},E1 1100.0}}\n"
    f"DECL E6AXIS XHOME2={{{HOME}}}\n"
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
        (f"PTP {{{HOME},E1 5}}\nLIN XP1", (f"{BY} 2", 5.0)),
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
    assert one(body, DAT).slide == slide


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
def test_an_axis_that_may_stand_elsewhere_is_refused(body: str) -> None:
    said = refusal(body, DAT)
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
def test_a_home_that_stands_elsewhere_is_no_matter_where_each_point_is_known(body: str) -> None:
    slide = one(body, DAT).slide
    assert slide is not None
    assert slide[1] == 1100.0


def test_a_point_that_nothing_before_puts_is_noted() -> None:
    (note,) = [each for each in one("LIN XP1\nLIN XP2", DAT).notes if each.startswith("E1 ")]
    assert "E1 is not known at XP1:" in note


@pytest.mark.parametrize("body", ["PTP HOME", "XHOME.E1=5\nPTP XHOME"])
def test_a_home_without_numbers_leaves_the_slide_unknown(body: str) -> None:
    slide = one(f"LIN XP2\n{body}\nLIN XP1", DAT).slide
    assert slide is not None
    assert slide[0].startswith("XP1 (drill.dat line 1) states no E1")
    assert math.isnan(slide[1])
