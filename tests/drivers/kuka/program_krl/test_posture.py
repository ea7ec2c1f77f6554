"""The posture that the targets of a KRL program are reached in, by the motion before them."""

import pytest

from drivers.kuka.program_krl.program import Program
from hilcell.cell.file import load_cell
from tests.drivers.kuka.program_krl.test_compensate import Workplace
from tests.drivers.kuka.program_krl.test_program import one

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
    assert read.statuses(6) == [(where, 2)]
    assert read.statuses(1) == [(where, 3)]
    assert one("PTP XP2", DAT).statuses(1) == [("XP2 (drill.dat line 2)", 6)]


@pytest.mark.parametrize(("home", "code"), [("XHOME", 2), ("XHOME1", 0), ("XHOME2", 0)])
def test_a_posture_that_is_kept_from_a_home_move_is_checked(
    tmp_path_factory: pytest.TempPathFactory, home: str, code: int
) -> None:
    desk = Workplace(tmp_path_factory.mktemp("desk"))
    desk.calibrate(digest=load_cell("paper").digest)
    desk.program(f"DEF drill( )\nPTP {home}\nLIN XP1\nEND\n", f"DEFDAT drill\n{DAT}ENDDAT\n")
    done = desk.run("--cell", "paper")
    assert done.returncode == code, done.stderr
    said = "XP1 (drill.dat line 2), kept from drill.src line 2: S 2"
    assert (said in done.stderr) == (code == 2)
