"""Drill strokes keep the correction of their point, and are refused where that is not known."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.kuka.program_krl.files import load_program, read_program
from hilcell.calibration.file import Calibration
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import apply, inverse, pose_from_zyx, poses_from_zyx, zyx_from_pose
from hilcell.ports import Array
from hilcell.programs.target_jobs import StrokeError, StrokeLimits, StrokeMiss, check_strokes
from tests.drivers.kuka.program_krl.samples import P1, P2, Workplace, one, refusal
from tests.hilcell.calibration.calibrations import T_W_B, calibration

DAT = """DEFDAT DRILL
DECL E6POS XP1={X 0.0,Y 0.0,Z 1200.0,A 1.0,B 75.0,C 0.5,S 6,T 19}
DECL E6POS XP2={X 0.0,Y 50.0,Z 1200.0,A 0.0,B 75.0,C 0.0,S 6,T 19}
FRAME HOLE[2]
HOLE[1]={X 0.0,Y 0.0,Z 1200.0,A 0.0,B 75.0,C 0.0}
HOLE[2]={X 0.0,Y 50.0,Z 1200.0,A 0.0,B 75.0,C 0.0}
ENDDAT
"""
DRILL = "LIN_REL {X 20} #TOOL\nLIN_REL {X -20.0} C_DIS #TOOL"


def strokes(body: str) -> list[tuple[int, tuple[float, ...]]]:
    """Return target and shift of each stroke of a program whose body begins on line 2."""
    read = read_program("drill.src", f"DEF drill()\n{body}\nEND\n", ("drill.dat", DAT))
    return [(each.target, each.shift_mm) for each in read.strokes]


def test_a_stroke_leads_from_its_point_along_the_tool() -> None:
    there, back = strokes(f"PTP XP2\nLIN XP1\n{DRILL}\nLIN XP2")
    along = pose_from_zyx(0, 0, 0, 1, 75, 0.5)[:3, :3] @ [20.0, 0.0, 0.0]
    assert (there[0], back[0]) == (1, 1)
    np.testing.assert_allclose(there[1], along)
    np.testing.assert_allclose(back[1], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("body", "targets"),
    [
        (f"FOR I=1 TO 2\nLIN HOLE[I]\nWAIT SEC 0.1\nSPINDLE(TRUE)\n{DRILL}\nENDFOR", [0, 1, 0, 1]),
        (f"LIN XP1\nON()\n{DRILL}\nEND\nDEF ON()\n$OUT[1]=TRUE", [0, 0]),
        (f"LIN XP1\nGO( )\nLIN XP2\nGO( )\nGO( )\nEND\nDEF GO( )\n$OUT[1]=TRUE\n{DRILL}",
         [0, 0, 1, 1, 1, 1]),
    ],
)  # fmt: skip
def test_strokes_behind_arrays_and_in_subprograms(body: str, targets: list[int]) -> None:
    assert [target for target, _ in strokes(body)] == targets


def test_a_stroke_goes_on_where_the_former_one_ended() -> None:
    forth = "LIN XP1\nGO( )\nGO( )\nEND\nDEF GO( )\nLIN_REL {X 5} #TOOL"
    assert [round(np.linalg.norm(shift), 6) for _, shift in strokes(forth)] == [5.0, 10.0]


@pytest.mark.parametrize(
    "body",
    [
        DRILL,
        f"LIN XP1\nPTP HOME\nGO( )\nEND\nDEF GO( )\n{DRILL}",
        f"LIN XP1\nTRIGGER WHEN DISTANCE=0 DELAY=0 DO GO( )\nEND\nDEF GO( )\n{DRILL}",
        f"LIN XP1\nGO( )\nEND\nDEF GO( )\nIF $IN[1] THEN\n{DRILL}\nENDIF",
        f"LIN XP1\nGO(5)\nEND\nDEF GO(N :IN)\n{DRILL}",
        f"LIN XP1\nGO( )\n{DRILL}\nEND\nDEF GO( )\nLIN XP2\n{DRILL}",
        f"PTP HOME\n{DRILL}\nLIN XP1",
        f"LIN XP1\nIF $IN[1] THEN\n{DRILL}\nENDIF",
        f"LIN XP1\nIF $IN[1] THEN\nLIN XP2\nENDIF\n{DRILL}",
        f"LIN XP1\nAGAIN:\n{DRILL}\nGOTO AGAIN",
        f"LIN XP1\nGO()\n{DRILL}\nEND\nDEF GO()\nLIN XP2",
        f"LIN XP1\nGO()\n{DRILL}\nEND\nDEF GO()\nON()\nEND\nDEF ON()\nLIN XP2",
        f"LIN XP1\nEND\nDEF STROKE()\n{DRILL}",
        f"LIN XP1\nPTP $AXIS_ACT\n{DRILL}",
        "$BASE={X 1,Y 2,Z 3}\nLIN XP1",
    ],
)
def test_where_a_stroke_starts_must_be_known(body: str) -> None:
    with pytest.raises(SettingsError):
        strokes(body)


@pytest.mark.parametrize(
    ("stroke", "token"),
    [
        ("LIN_REL {Z 20}", "in the base"), ("LIN_REL {X 20} #BASE", "in the base"),
        ("LIN_REL {X 20,A 5} #TOOL", "A"), ("LIN_REL {E1 20} #TOOL", "E1"),
        ("LIN_REL {X DEPTH} #TOOL", "DEPTH"), ("LIN_REL XP2 #TOOL", "structure"),
        ("LIN_REL {X 20} #TOOL #TOOL", "not understood"),
        ("LIN_REL {X 20} #TOOL WITH $VEL=1", "not understood"),
        ("LIN_REL", "structure"), ("PTP_REL {X 20} #TOOL", "PTP_REL"),
    ],
)  # fmt: skip
def test_other_relative_motions_are_refused_with_their_line(stroke: str, token: str) -> None:
    with pytest.raises(SettingsError) as raised:
        strokes(f"LIN XP1\n{stroke}\nLIN XP2")
    assert raised.value.problems[0].startswith("drill.src line 3: ")
    assert token in raised.value.problems[0]


def test_a_stroke_aside_from_the_drills_axis_gets_a_note() -> None:
    body = "LIN XP1\nLIN_REL {Z 20} #TOOL\nLIN_REL {Z -20} #TOOL\nLIN_REL {X 5} #TOOL"
    read = read_program("p.src", body, ("p.dat", DAT))
    (note,) = (note for note in read.notes if "strokes" in note)
    assert "line 4;" in note


def test_a_drill_stroke_stays_as_it_is_and_arrives(workplace: Workplace) -> None:
    workplace.program(f"DEF drill()\nLIN XP1\n{DRILL}\nEND\n", DAT)
    done = workplace.run()
    assert done.returncode == 0
    assert DRILL in workplace.out.read_text()
    nominal, command = load_program(workplace.source), load_program(workplace.out)
    along = np.array(nominal.strokes[0].shift_mm) / 20.0
    missed = []
    for depth_mm in range(21):
        places = [
            np.hstack([read.values()[:1, :3] + depth_mm * along, read.values()[:1, 3:]])
            for read in (nominal, command)
        ]
        expected, sent = (inverse(T_W_B) @ poses_from_zyx(each) for each in places)
        arrived = sent[:, :3, 3] + calibration().error_model().predict(sent).error_mm
        off_mm = T_W_B[:3, :3] @ (arrived - expected[:, :3, 3])[0]
        missed.append([np.linalg.norm(off_mm - off_mm @ along * along), abs(off_mm @ along)])
    assert 0.002 < np.max(missed) < 0.02
    across_mm, along_mm = np.max(missed, axis=0)
    assert f"{across_mm:.3f} mm across" in done.stderr
    assert f"{along_mm:.3f} mm along" in done.stderr


def test_a_stroke_is_judged_along_its_whole_path() -> None:
    """Ripple that is gone at the end moves the hole; what it does along moves the depth alone."""
    made, read = (
        calibration(),
        read_program("p.src", "LIN XP1\nLIN_REL {X 20} #TOOL", ("p.dat", DAT)),
    )
    values, shift_mm = read.values(), np.array(read.strokes[0].shift_mm)
    aside = np.cross(shift_mm, [0, 0, 1])

    def judged(direction: NDArray[Any], size_mm: float, most_mm: float) -> StrokeMiss:
        unit = T_W_B[:3, :3].T @ direction / np.linalg.norm(direction)

        def predict(poses: Array) -> SimpleNamespace:
            depth_mm = (apply(T_W_B, poses[:, :3, 3]) - values[0, :3]) @ shift_mm / 20.0
            return SimpleNamespace(error_mm=size_mm * np.sin(np.pi * depth_mm / 20)[:, None] * unit)

        model = SimpleNamespace(predict=predict)
        rippled = SimpleNamespace(base=made.base, grid=made.grid, error_model=lambda: model)
        limits = StrokeLimits(20.0, most_mm, "")
        return check_strokes(
            cast("Calibration", rippled), "S1100", values, values, read.strokes, limits
        )

    assert judged(aside, 0.1, 0.11) == pytest.approx((0.1, 0.0), abs=1e-6)
    assert judged(shift_mm, 0.1, 0.11) == pytest.approx((0.0, 0.1), abs=1e-6)
    for direction, token in ((aside, "0.100 mm across at 10 mm"), (shift_mm, "0.100 mm along")):
        with pytest.raises(StrokeError, match=token):
            judged(direction, 0.1, 0.09)
    with pytest.raises(StrokeError):
        judged(aside, np.nan, 0.09)


@pytest.mark.parametrize(
    ("stroke", "words", "token"),
    [
        ("LIN_REL {X 25} #TOOL", (), "20 mm"),
        ("LIN_REL {X 25} #TOOL", ("--allow-stroke", "25"), ""),
        ("LIN_REL {X 199} #TOOL", ("--allow-stroke", "200"), ""),
        ("LIN_REL {X 25} #TOOL", ("--allow-stroke", "25", "--stroke-tolerance", "0.001"),
         "--stroke-tolerance"),
        ("LIN_REL {X 15} #TOOL\nLIN_REL {X 15} #TOOL", (), "(drill.src line 4) from XP1"),
        ("LIN_REL {X 25} #TOOL", ("--stroke-tolerance", "0"), "tolerance"),
        ("LIN_REL {X 25} #TOOL", ("--stroke-tolerance", "6"), "tolerance"),
        ("LIN_REL {X 25} #TOOL", ("--stroke-tolerance", "nan"), "tolerance"),
        ("LIN_REL {X 25} #TOOL", ("--allow-stroke", "-5"), "allow-stroke"),
        ("LIN_REL {X 25} #TOOL", ("--allow-stroke", "201"), "allow-stroke"),
        ("LIN_REL {X 25} #TOOL", ("--allow-stroke", "long"), "allow-stroke"),
    ],
)  # fmt: skip
def test_a_stroke_as_far_as_it_is_declared(
    workplace: Workplace, stroke: str, words: tuple[str, ...], token: str
) -> None:
    workplace.program(f"DEF drill()\nLIN XP1\n{stroke}\nEND\n", DAT)
    if token:
        assert token in workplace.refused(*words)
    else:
        assert workplace.compensate(*words) == 0
        assert workplace.out.exists()


def test_a_stroke_out_of_the_calibrated_volume_is_refused(workplace: Workplace) -> None:
    edge = apply(T_W_B, calibration().grid().far_mm[None])[0] - [2.0, 60.0, 60.0]
    numbers = ",".join(f"{axis} {value:.3f}" for axis, value in zip("XYZ", edge, strict=True))
    point = f"DECL E6POS XP1={{{numbers},A 0.0,B 75.0,C 0.0}}"
    workplace.program("DEF drill()\nLIN XP1\nLIN_REL {Z 20} #TOOL\nEND\n", point)
    assert "LIN_REL (drill.src line 3) from XP1" in workplace.refused()


def test_a_stroke_that_corrected_angles_turn_away_is_refused() -> None:
    """A command turned by 5 mrad takes 20 mm of stroke 0.1 mm aside."""
    made, read = calibration(), read_program("p.src", f"LIN XP1\n{DRILL}", ("p.dat", DAT))
    values = read.values()
    limits = StrokeLimits(20.0, 0.05, "")
    straight = check_strokes(made, "S1100", values, values, read.strokes, limits)
    assert max(straight) < 0.02
    turned = values + [0, 0, 0, 0, np.degrees(5e-3), 0]
    with pytest.raises(StrokeError):
        check_strokes(made, "S1100", values, turned, read.strokes, limits)


def base_of(frame: Array) -> str:
    values = zyx_from_pose(frame[None])[0]
    numbers = zip("XYZABC", values, (4, 4, 4, 6, 6, 6), strict=True)
    return ",".join(f"{axis} {value:.{decimals}f}" for axis, value, decimals in numbers)


@pytest.mark.parametrize(
    ("base", "code"),
    [
        (f"{{{base_of(inverse(T_W_B))}}}", 0),
        ("$NULLFRAME", 2),
        (f"{{{base_of(inverse(T_W_B) @ pose_from_zyx(0.2, 0, 0, 0, 0, 0))}}}", 2),
        ("BASE_DATA[3]", 0),
    ],
)
def test_a_base_set_by_numbers_must_be_the_world(
    workplace: Workplace, base: str, code: int
) -> None:
    workplace.program(f"DEF drill()\n$BASE={base}\nLIN XP1\nEND\n", DAT)
    done = workplace.run()
    assert done.returncode == code
    in_controller = base.startswith("BASE_DATA")
    assert (base_of(inverse(T_W_B)) in done.stderr) == (code == 2 or in_controller)


def test_a_missing_data_list_is_named_once(workplace: Workplace) -> None:
    workplace.source.write_text("DEF drill()\nPTP XHOME\nLIN XP1\nLIN XP2\nEND\n")
    workplace.source.with_suffix(".dat").unlink()
    said = workplace.refused()
    assert "XP1, XP2" in said
    assert said.count("drill.dat") == 1


def test_a_global_point_gets_a_note(workplace: Workplace) -> None:
    shared = DAT.replace("DECL E6POS XP1", "DECL GLOBAL E6POS XP1")
    workplace.program("DEF drill()\nLIN XP1\nLIN XP2\nEND\n", shared)
    said = workplace.run().stderr
    assert "XP1 is GLOBAL" in said
    assert "XP2 is GLOBAL" not in said


@pytest.mark.parametrize(
    "when", ["INTERRUPT DECL 3 WHEN $IN[1]==TRUE DO", "GLOBAL INTERRUPT DECL 3 WHEN $IN[1] DO"]
)
def test_no_stroke_begins_where_an_interrupt_may_have_moved_the_robot(when: str) -> None:
    body = f"{when} AWAY( )\nINTERRUPT ON 3\nLIN XP1\nLIN_REL {{Z 10}} #TOOL"
    said = refusal(f"{body}\nEND\nDEF AWAY( )\nLIN XP2", P1 + P2)
    assert "line 2 may move the robot before it" in said


@pytest.mark.parametrize(
    "call",
    ["TRIGGER WHEN DISTANCE=1 DELAY=0 DO SUB( ) PRIO=-1", "INTERRUPT DECL 3 WHEN $IN[1] DO SUB( )"],
)
def test_programs_that_are_called_at_any_time_are_named(call: str) -> None:
    notes = one(f"{call}\nLIN XP1", P1).notes
    (note,) = (each for each in notes if each.startswith("SUB "))
    assert note == (
        "SUB is another program: its motions are not corrected, and it must leave base, tool, "
        "slide and posture as they are (line 2)"
    )


@pytest.mark.parametrize(
    "statement",
    [
        "OK=SUB(5.0)",
        "IF NOT SUB(7) THEN\nENDIF",
        "WHILE (N<3) AND SUB( )\nENDWHILE",
        "N=ABS(SUB(2))",
        "WAIT FOR SUB( )",
        "RETURN SUB (N)",
        "IF $IN[1] THEN\nN=1+sub( )\nENDIF",
    ],
)
def test_functions_of_other_files_are_named_within_expressions(statement: str) -> None:
    notes = [each for each in one(f"{statement}\nLIN XP1", P1).notes if "another" in each]
    assert [each.split()[0].upper() for each in notes] == ["SUB"]


def test_functions_that_are_the_controllers_own_are_not_named() -> None:
    body = (
        'RET=EKI_Init("Cell")\nN=ABS(SQRT(N)+SIN(3.0))\nWAIT SEC (0.5)\nIF VARSTATE("N")==#X THEN'
        "\nENDIF\nN=StrLen(S[])\nCAST_TO(B[],OFFS,N)\nN=N MOD (3)\nOK=OWN(2)\nLIN XP1\nEND\n"
        "DEFFCT BOOL OWN(K:IN)\nRETURN (K>1)\nENDFCT\nDEF LAST( )"
    )
    assert not [each for each in one(body, P1).notes if "another" in each]


def test_the_controllers_own_handler_of_stop_messages_is_no_other_program() -> None:
    call = "INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )\nINTERRUPT ON 3"
    assert not any("IR_STOPM" in note for note in one(f"{call}\nLIN XP1", P1).notes)
