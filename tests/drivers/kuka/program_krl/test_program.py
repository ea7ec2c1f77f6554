"""KRL programs: targets, refusals by line, and that nothing else changes."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.kuka.program_krl.program import comment, turn_of
from drivers.program_text import ENCODING, formatted, plain
from hilcell.cell.settings import SettingsError
from tests.drivers.kuka.program_krl.samples import DAT, P1, P2, SRC, moved, one, program, refusal

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def test_targets_are_the_points_that_motions_use() -> None:
    read = program()
    assert read.names == [
        "XP1 (drill.dat line 8)",
        "XP2 (drill.dat line 10)",
        "LIN target (drill.src line 33)",
        "HOLE[1] (drill.dat line 15)",
        "HOLE[2] (drill.dat line 16)",
    ]
    np.testing.assert_array_equal(
        read.values(),
        [
            [-200.0, 100.123456, 1000.5, 0, 75, 0],
            [100.0, -0.5, 1100.0, 0, 75, 0],
            [10.5, -20.0, 1250.25, 0, 75, 0],
            [0.0, 0.0, 1200.0, 0, 75, 0],
            [0.0, 50.0, 1200.0, 0, 75, 0],
        ],
    )


@pytest.mark.parametrize("dat", ["\n", "; a list without a line\n"])
def test_a_data_list_without_a_statement_takes_the_remark_first(dat: str) -> None:
    read = one("LIN {X 1.5,Y 2,Z 3,A 0,B 0,C 0}", dat)
    files = read.with_positions(read.values()[:, :3], "corrected")
    assert files["drill.dat"].decode(ENCODING) == f"; corrected\n{dat}"


def test_remarks_name_the_lines_left_as_they_are() -> None:
    notes = program().notes
    for token in ("XHOME", "(line 20)", "CHECK_HOLE", "(line 40)", "(line 42)", "FP1", "XP3"):
        assert any(token in note for note in notes)


def test_the_golden_program() -> None:
    """Every changed line, as it must come out."""
    read = program()
    texts = moved(read, read.values()[:, :3] + [1.0, -2.0, 0.12345])
    changed = {
        name: [
            new
            for old, new in zip(before.split("\n"), texts[name].split("\n"), strict=True)
            if old != new
        ]
        for name, before in (("drill.src", SRC), ("drill.dat", DAT))
    }
    assert changed["drill.src"] == [
        "LIN {X 11.500,Y -22.000, Z 1250.373 ,A 0.0,B 75.0,C 0.0} C_DIS"
    ]
    xp1 = "DECL E6POS XP1={X -199.000,Y 98.123456,Z 1000.623,A 0.0,B 75.0,C 0.0,S 6,T 19"
    xp1 += ",E1 0.0,E2 0.0}"
    assert changed["drill.dat"] == [
        xp1,
        "decl pos xp2={pos: x 101.000, y -2.500, z 1100.123, a 0, b 75, c 0, s 6, t 19} ; 2nd",
        "HOLE[1]={X 1.000,Y -2.000,Z 1200.123,A 0.0,B 75.0,C 0.0}",
        "HOLE[2]={X 1.000,Y 48.000,Z 1200.123,A 0.0,B 75.0,C 0.0}",
    ]


mm = st.floats(-5000, 5000, allow_nan=False)


@given(
    moves=st.lists(st.tuples(mm, mm, mm), min_size=5, max_size=5),
    crlf=st.booleans(),
    comment=st.text(st.characters(min_codepoint=32, max_codepoint=255, exclude_characters="\x85")),
)
def test_bytes_outside_the_numbers_stay(
    moves: list[tuple[float, float, float]], crlf: bool, comment: str
) -> None:
    def ends(text: str) -> str:
        return text.replace("\n", "\r\n") if crlf else text

    src, dat = ends(SRC + f";{comment}\n"), ends(f";{comment}\n" + DAT)
    read = program(src, dat)
    texts = moved(read, np.array(moves))
    for name, before in (("drill.src", src), ("drill.dat", dat)):
        assert NUMBER.sub("#", texts[name]) == NUMBER.sub("#", before)
    again = program(texts["drill.src"], texts["drill.dat"])
    np.testing.assert_allclose(again.values()[:, :3], moves, atol=5.001e-4)
    np.testing.assert_array_equal(again.values()[:, 3:], read.values()[:, 3:])


def test_correcting_by_nothing_is_idempotent() -> None:
    first = program()
    once = moved(first, first.values()[:, :3])
    second = program(once["drill.src"], once["drill.dat"])
    np.testing.assert_array_equal(second.values(), first.values())
    assert moved(second, second.values()[:, :3]) == once


@pytest.mark.parametrize(
    ("value", "like", "text"),
    [
        (1.0, "1.0", "1.000"),
        (-1.23456, "0", "-1.235"),
        (1.23456, "1.00000", "1.23456"),
        (1234.5, "1.2E3", "1234.500"),
        (0.00125, "1.5E-4", "0.00125"),
        (-0.0001, "0.0", "0.000"),
        (5.0, "+4.", "5.000"),
        (0.5, "-.5", "0.500"),
    ],
)
def test_numbers_keep_their_decimals(value: float, like: str, text: str) -> None:
    assert formatted(value, like, 3) == text


@pytest.mark.parametrize(
    "body",
    [
        "PTP_REL {Z 10}", "lin_rel {Z 10} #TOOL", "CIRC XP1,XP2", "SCIRC XP1,XP2", "SPLINE",
        "PTP_SPLINE", "LIN XP1:XP2", "XP3=XP1:XP2", "XP1.Z=5", "xp1 = XP2", "XP1={X 1.0}",
        "TRIGGER WHEN DISTANCE=0 DELAY=0 DO XP1.X=5", "R=XP1.Z+5",
        "LIN {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}", "PTP {A1 0,A2 -90,A3 90,A4 0,A5 B,A6 0}",
        "PTP XP1\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}", "PTP XJ", "PTP XNOWHERE", "PTP $POS_ACT",
        "PTP SOME.P", "LIN XP1+XP2", "LIN INV_POS(XP1)", "LIN {Z 10}",
        "PTP {X 1,Y 2,Z 3,A W,B 0,C 0}", "PTP {X 1,X 1,Y 2,Z 3,A 0,B 0,C 0}",
        "PTP {X 1,5,Y 2,Z 3,A 0,B 0,C 0}", "PTP {X 1E999,Y 2,Z 3,A 0,B 0,C 0}",
        "PTP {X 1,Y 2,Z 3,A 0,B 0,C 0,S 1.5,T 2}", "PTP {X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T ABC}",
        "PTP {X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 64}", "PTP {X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T -1}",
        "PTP {X 1,Y 2,Z 3,A 0,B 0,C 0,S 99,T 2}", "PTP {X 1,Y 2", "PTP FP1", "PTP",
        "$BASE=BASE_DATA[1]\n$BASE=BASE_DATA[2]", "$BASE={X 1,Y 0,Z 0,A 0,B 0,C 0}\nBAS(#BASE,3)",
        "PTP XP1\n$BASE=BASE_DATA[1]", "$BASE.X=5", "$BASE=BASE_DATA[I]", "BASE_DATA[1].X=5",
        "$TOOL=TOOL_DATA[1]\nPTP XP1\n$TOOL=TOOL_DATA[2]", "PTP XP1\nBAS(#TOOL,2)",
        "PTP XP1\nBAS(#INITMOV,0)", "BAS(N,0)", "$IPO_MODE=#TCP",
        "SLIN XP1 WITH $BASE=BASE_DATA[2]", "SLIN XP1 WITH $TOOL=STOOL2(FP1)",
        "SLIN XP1 WITH $BASE=SBASE(FP1.BASE_NO), $TOOL=STOOL2(FP2)", "SLIN XP1 WITH $ROBROOT=W",
        "SLIN XP1 WITH $BASE=SBASE(FNONE.BASE_NO)",
        "SLIN XP1 WITH $BASE=SBASE(FP1.BASE_NO)\nSLIN XP2 WITH $BASE=SBASE(FP2.BASE_NO)",
        "FDAT_ACT=FP1\nPTP XP1\nFDAT_ACT=FP2\nPTP XP2", "FDAT_ACT=FHOME\nPTP XP1",
        "FDAT_ACT=FTCP\nPTP XP1", "$BASE=$NULLFRAME\nFDAT_ACT=FP1\nPTP XP1", "FDAT_ACT.BASE_NO=3",
        "DRILL(XP1)", "DRILL({X 1.0})", "PTP {A1 5,A2 -90.0}", "ASYPTP {E1 100}",
        "IF A THEN PTP XP1", 'MSG("open)',
    ],
)  # fmt: skip
def test_refused_with_its_line(body: str) -> None:
    dat = (
        P1 + P2 + "DECL E6AXIS XJ={A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\n"
        "DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}\n"
        "DECL FDAT FP2={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}\n"
        "DECL FDAT FTCP={TOOL_NO 1,BASE_NO 2,IPO_FRAME #TCP}\n"
    )
    assert one("PTP XP1\nLIN XP2", dat).targets, "without the line the program works"
    said = refusal(f"{body}\nPTP XP1\nLIN XP2", dat)
    assert f"drill.src line {2 + body.count(chr(10))}: " in said


@pytest.mark.parametrize(
    ("dat", "token"),
    [
        (P1 + P1, "drill.dat line 2"),
        (P1 + "XP1.X=5.0\n", "drill.dat line 2"),
        ("DECL E6POS XP1\n" + 2 * P1.removeprefix("DECL E6POS "), "drill.dat line 3"),
        (P1 + "$BASE={X 5.0}\n", "drill.dat line 2"),
        ("DECL E6POS XP1={X 1.0,Y 2.0,Z 3.0}", "A, B, C"),
        ("DECL E6POS XP1={X 1.0,Y 2.0", "drill.dat line 1"),
        ("DECL E6POS XP1", "XP1"),
        ("DECL E6POS XP1=XP0", "XP0"),
    ],
)
def test_data_that_is_no_point(dat: str, token: str) -> None:
    assert token in refusal("PTP XP1", dat)


def test_faulty_data_that_no_motion_uses_are_allowed() -> None:
    read = one("PTP XP1", P1 + "DECL E6POS XP9={X 1.0}\n")
    assert read.notes == ["not used by a motion, left: XP9"]


def test_external_axes_that_differ() -> None:
    moved = P2.replace("E1 0.0", "E1 500.0")
    said = refusal("PTP XP1\nPTP XP2", P1 + moved)
    assert said.startswith("drill.dat line 2: XP2 has E1 500")


def test_variables_of_the_program_hide_points() -> None:
    assert "XP1 is a variable" in refusal("DECL E6POS XP1\nPTP XP1", P1)
    said = refusal("END\nDEF GO(XP1 :IN)\nPTP XP1", P1)
    assert said.startswith("drill.src line 4: XP1 is a variable")


def test_inline_forms_of_single_splines() -> None:
    """Frame data of one motion hold for it alone; those of home moves do not count."""
    form = "$VEL_AXIS[1] = SVEL_JOINT(100.0), $TOOL = STOOL2({0}), $BASE = SBASE({0}.BASE_NO), "
    form += "$IPO_MODE = SIPO_MODE({0}.IPO_FRAME), $LOAD = SLOAD({0}.TOOL_NO)"
    read = one(
        f"SPTP XHOME WITH {form.format('FHOME')}\nSPTP XP1 C_SPL WITH {form.format('FP1')}\n"
        f"SLIN XP2 WITH {form.format('FP1')}",
        P1 + P2 + "DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE}\n",
    )
    assert [target.name for target in read.targets] == ["XP1", "XP2"]


def test_a_program_without_targets() -> None:
    assert refusal("PTP HOME")


def test_all_problems_are_reported_at_once() -> None:
    said = refusal("PTP_REL {Z 1}\nLIN XP1\nCIRC XP1,XP1", P1).split("\n")
    assert [line.split(":")[0] for line in said[:2]] == ["drill.src line 2", "drill.src line 4"]


def test_allowed_statements() -> None:
    """The first base and tool, loops, own subprograms, splines' single motions, home moves."""
    read = one(
        "BAS(#INITMOV,0)\n$BASE=BASE_DATA[3]\n$TOOL={X 98,Y 0,Z 127,A 0,B 0,C 0}\nPTP $AXIS_ACT\n"
        "AGAIN:\nWHILE (TRUE)\nPTP XP1 C_PTP C_DIS\nSLIN XP1 WITH $VEL=SVEL_CP(0.1)\nGO()\n"
        "ENDWHILE\nIF $IN[1]==TRUE THEN\nGOTO AGAIN\nENDIF\nPTP XHOME\nEND\nDEF GO()\nLIN XP2",
        P1 + P2,
    )
    assert [target.name for target in read.targets] == ["XP1", "XP2"]


@pytest.mark.parametrize(
    ("body", "posture"),
    [
        ("PTP XP1", 6),
        ("LIN XP1", None),
        ("LIN XP1\nPTP XP1", 6),
        ("PTP XP1\nLIN XP1", 6),
        ("SPTP {X 1,Y 2,Z 3,A 0,B 75,C 0,S 'B010',T 1}", 2),
        ("PTP {X 1,Y 2,Z 3,A 0,B 75,C 0,S 2}", None),
    ],
)
def test_which_targets_fix_their_joints(body: str, posture: int | None) -> None:
    assert [target.posture for target in one(body, P1).targets] == [posture]


def test_turn_bits() -> None:
    assert turn_of(np.radians([1, -90, 90, 0, -30, -1])) == 0b110010
    np.testing.assert_array_equal(turn_of(np.zeros((2, 6))), [0, 0])


def test_a_program_without_a_data_list() -> None:
    read = program("LIN {X 1,Y 2,Z 3,A 0,B 75,C 0}", None)
    assert moved(read, np.array([[1.5, 2.0, 3.0]])) == {
        "drill.src": "LIN {X 1.500,Y 2.000,Z 3.000,A 0,B 75,C 0}"
    }


@given(st.text(st.sampled_from("PTXLIN12{}[]():=,.+-;\"'&#$ \n\r1\xe4ABCYZ_"), max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        read = program(text, text)
    except SettingsError:
        return
    assert read.targets


def test_angles_change_where_they_were_corrected() -> None:
    read = one("LIN XP1", P1)
    files = read.with_positions(np.array([[1.5, 2.5, 3.5, -0.012345, 75.0321, 0.0]]))
    text = files["drill.dat"].decode(ENCODING)
    assert "XP1={X 1.500,Y 2.500,Z 3.500,A -0.012,B 75.032,C 0.000,S 6,T 19,E1 0.0}" in text


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("Träger 7 µ", "Träger 7 µ"),
        ("Černý Łódź", "Cerný Lódz"),
        ("Бъл-7", "B'l-7"),
        ("Щит", "Shchit"),
        ("Ωμέγα", "Omega"),
        ("孔1", "U+5B541"),
        ("5€ – x", "5U+20AC - x"),
    ],
)
def test_a_name_is_written_in_letters_that_the_controller_shows(name: str, written: str) -> None:
    assert plain(name) == written
    assert plain(name).encode(ENCODING).decode(ENCODING) == written


def test_a_comment_is_one_line() -> None:
    assert comment("a\nb") == "; ab"
