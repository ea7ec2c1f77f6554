"""URScript programs: poses, refusals by line, and that nothing else changes."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.program_text import ENCODING
from drivers.universal_robots.program_urscript import Program, read_program
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import poses_from_zyx
from hilcell.ports import Array
from tests.drivers.universal_robots.program_urscript.samples import SCRIPT

P1 = "P1=p[1.0, 0.0, 0.5, 0.0, 1.0, 0.0]\n"
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def one(body: str) -> Program:
    """Return a program whose body begins on line 2."""
    return read_program("d.script", f"def d():\n{body}\nend\n")


def moved(read: Program, positions: Array, remark: str = "") -> str:
    ((name, content),) = read.with_positions(positions, remark).items()
    assert name == read.file
    return content.decode(ENCODING)


def test_targets_are_the_poses_that_motions_use() -> None:
    read = read_program("drill.script", SCRIPT)
    assert read.names == [
        "P1 (drill.script line 6)",
        "movel target (drill.script line 18)",
        "P2 (drill.script line 7)",
    ]
    expected: list[list[float]] = [[1850, -50, 950, 0, 75, 0], [1800.0000001, 0, 900, 0, 75, 0]]
    expected.append([1900, 50, 1000, 0, 75, 0])
    np.testing.assert_allclose(read.values(), expected, atol=1e-6)
    assert read.notes[0] == "not used by a motion, left: P3"


def test_the_corrected_file_is_the_golden_one() -> None:
    """The numbers of three poses and a comment, by hand; rotation vectors keep their side of pi."""
    read = read_program("drill.script", SCRIPT)
    poses = read.values() + [0.5, -0.25, 0.125, 0.0, 0.5, 0.0]
    golden = (
        SCRIPT.replace("def drill():\n", "def drill():\n  # by hand\n")
        .replace("p[1.85, -.05, 0.95, 0.000000000, 1.308996939, 0.000000000]",
                 "p[1.850500, -0.050250, 0.950125, 0.000000000, 1.317723585, 0.000000000]")
        .replace("p[1.8000000001, 0.0, 0.9, 0.000000000, 1.308996939, 0.000000000]",
                 "p[1.8005000001, -0.000250, 0.900125, 0.000000000, 1.317723585, 0.000000000]")
        .replace("p[ 1.9, 5e-2 ,1, -0.000000000, -4.974188368, -0.000000000]",
                 "p[ 1.900500, 0.049750 ,1.000125, 0.000000000, -4.965461722, 0.000000000]")
    )  # fmt: skip
    assert moved(read, poses, "by hand") == golden
    again = read_program("drill.script", golden)
    assert again.remarks[0] == " by hand"
    np.testing.assert_allclose(poses_from_zyx(again.values()), poses_from_zyx(poses), atol=1e-6)


@given(st.lists(st.floats(-3000.0, 3000.0), min_size=9, max_size=9))
def test_all_but_the_numbers_of_targets_is_unchanged(places_mm: list[float]) -> None:
    text = SCRIPT.replace("\n", "\r\n").replace("drilled", "gebohrt \xfc")
    read = read_program("drill.script", text)
    positions = np.array(places_mm).reshape(3, 3)
    written = moved(read, positions)
    assert NUMBER.sub("#", written) == NUMBER.sub("#", text)
    pairs = zip(NUMBER.findall(text), NUMBER.findall(written), strict=True)
    assert sum(before != after for before, after in pairs) <= 9
    np.testing.assert_allclose(
        read_program("drill.script", written).values()[:, :3], positions, atol=5e-4 + 1e-9
    )
    assert moved(read, positions, "r").replace("  # r\r\n", "") == written


TCP0, TCP1 = "set_tcp(p[0, 0, 0, 0, 0, 0])\n", "set_tcp(p[0, 0, 1, 0, 0, 0])\n"


@pytest.mark.parametrize(
    ("line", "body"),
    [
        (2, "movej([0.0, -1.57, 1.57, 0.0, 0.0, 0.0])"),
        (3, "q=[0, 0, 0, 0, 0, 0]\nmovej(q)"),
        (3, f"{P1}movej(get_inverse_kin(P1))"), (3, f"{P1}movel(pose_trans(P1, P1))"),
        (3, f"{P1}P2=pose_add(P1, P1)\nmovel(P1)"), (3, f"{P1}popup(to_str(P1))\nmovel(P1)"),
        (3, f"{P1}P2=P1\nmovel(P1)"),
        (2, "movel(p[d2r(90), 0, 0, 0, 0, 0])"), (2, "movel(p[1, 0, 0, 0, 0])"),
        (2, "movel(p[1e999, 0, 0, 0, 0, 0])"), (3, "x=1\nmovel(p[x, 0, 0, 0, 0, 0])"),
        (2, "P1=pose_trans(p[1, 0, 0, 0, 0, 0], p[0, 0, 0, 0, 0, 0])"),
        (4, f"{P1}{P1}movel(P1)"), (4, f"{P1}P1=x\nmovel(P1)"),
        (4, f"{P1}while True:\nP1[2]=P1[2]+0.1\nmovel(P1)\nend"),
        (4, f"{P1}def f(P1):\nmovel(P1)\nend"),
        (3, f"{P1}movep(P1)"), (2, "movep(p[1, 0, 0, 0, 0, 0])"),
        (4, f"{P1}movel(P1)\nmovec(x, y)"), (4, f"{P1}movel(P1)\nspeedl(x, 1)"),
        (3, f"{P1}movel(P1, a=1.2, v=0.1, r=0.01)"), (3, f"{P1}movel(P1, 1.2, 0.1, 0, 0.01)"),
        (3, f"{P1}movel(P1, r=radius)"), (3, f"{P1}movel(P1, 1, 1, 1, 0, 1)"),
        (3, f"{P1}movel(P1, b=0)"), (3, f"{P1}x=movel(P1)"), (3, f"{P1}x=movel(y)\nmovel(P1)"),
        (2, f"thread t():\nsync()\nend\n{P1}movel(P1)"), (3, f"{P1}t=run f()\nmovel(P1)"),
        (2, "set_tcp(tool)\nmovel(p[1, 0, 0, 0, 0, 0])"), (4, f"{P1}movel(P1)\n{TCP0}"),
        (3, f"{TCP0}{TCP1}{P1}movel(P1)"), (3, f"def f():\n{TCP0}end\n{P1}movel(P1)"),
        (3, f"if x:\n{TCP0}end\n{P1}movel(P1)"), (2, f"def movel(x):\nend\n{P1}movel(P1)"),
        (3, f"{P1}movel(P1"), (3, f"{P1}movel(P1) + movel(P1)"),
        (3, f"{P1}movel(P1); movel(P1)"), (3, f'{P1}textmsg("a\nmovel(P1)'),
        (3, f"{P1}if x: movel(P1)\nend"), (1, f"{P1}if x:\nmovel(P1)"),
        (5, f"{P1}movel(P1)\nend"),
    ],
)  # fmt: skip
def test_refused_by_line(line: int, body: str) -> None:
    with pytest.raises(SettingsError) as raised:
        one(body)
    assert any(each.startswith(f"d.script line {line}: ") for each in raised.value.problems)


@pytest.mark.parametrize("body", [P1, ""])
def test_a_program_without_a_motion_to_a_pose(body: str) -> None:
    with pytest.raises(SettingsError):
        one(body)


def test_every_refusal_is_listed_and_cleaned() -> None:
    with pytest.raises(SettingsError) as raised:
        one("movej([0])\nspeedl(\x1b[2J)\nmovec(x, y)" + 80 * "+")
    assert [each[:16] for each in raised.value.problems] == [
        "d.script line 2:", "d.script line 3:", "d.script line 4:",
    ]  # fmt: skip
    assert "\x1b" not in "".join(raised.value.problems)
    assert "...:" in raised.value.problems[2]


def test_a_byte_order_mark_stays_first_and_hides_nothing() -> None:
    plain = "def d():\n  movel(p[1.0, 0.0, 0.5, 0.0, 1.0, 0.0])\nend\n"
    read = read_program("d.script", f"\xef\xbb\xbf{plain}")
    assert len(read.targets) == 1
    text = moved(read, read.values(), "corrected")
    assert text.startswith("\xef\xbb\xbfdef d():\n  # corrected\n")


def test_a_tcp_that_another_function_sets_is_none_of_the_motions() -> None:
    text = (
        "def a():\n  set_tcp(p[0.09,0,0.07,0,0,0])\nend\n"
        "def d():\n  movel(p[0.1,0.2,0.3,0,0,0])\nend\n"
    )
    with pytest.raises(SettingsError, match="outside of the program whose line 2 sets the TCP"):
        read_program("d.script", text)
