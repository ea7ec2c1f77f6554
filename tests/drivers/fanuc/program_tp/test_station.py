"""The program of a station as a TP listing, read by a parser of its own."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from drivers.fanuc.program_tp import read_program, write_station
from hilcell.calibration.tool_point import tool_tips
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.compensation.programs import StationProgram
from hilcell.compensation.targets import CorrectedBefore, Stamp, refuse_corrected
from hilcell.geometry.frames import poses_from_zyx
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array, HilcellError
from hilcell.programs.drilling import Drilling, WorkPiece, station_program
from tests.drivers.fanuc.program_tp.samples import parsed
from tests.hilcell.calibration.calibrations import T_W_B

CELL = load_cell("paper")
STAMP = Stamp("a-run", "2026-11-22T14:00:00Z", "S1100")
TARGETS = np.array([[0.0, 0.0, 1200.0, 0.0, 75.0, 0.0], [0.0, 50.0, 1250.0, 3.0, 74.0, 2.0]])
NAMES = ["Träger; °1", "H2\n  L P[1]"]


@pytest.fixture(scope="module")
def program() -> StationProgram:
    drilling = Drilling(CELL, T_W_B, tool_tips(CELL)[0], 100.0)
    part = WorkPiece(TARGETS[:, :3], -poses_from_zyx(TARGETS)[:, :3, 2])
    return replace(
        station_program(drilling, "S1100", NAMES, TARGETS, part, ["SIMULATED: not real"]),
        station="s 1100",
    )


def written(program: StationProgram) -> str:
    ((name, content),) = write_station(program, STAMP).items()
    assert name == "S_1100.ls"
    assert content.count(b"\n") == content.count(b"\r\n")
    return content.decode("ascii")


def test_its_positions_are_those_of_the_holes_in_the_root(program: StationProgram) -> None:
    poses, moves = parsed(written(program))
    ways = (program.approach, program.standoff, program.command)
    for letter, places in zip("ASP", ways, strict=True):
        for n, values in enumerate(places.values, start=1):
            (at,) = (pose for name, pose in poses.items() if name.endswith(f":X{letter}{n}]"))
            expected = poses_from_zyx(values[None])[0]
            np.testing.assert_allclose((T_W_B @ at)[:3, 3], expected[:3, 3], atol=1e-3)
            np.testing.assert_allclose((T_W_B @ at)[:3, :3], expected[:3, :3], atol=2e-5)
    safe = forward(program.arm, np.radians(program.safe_deg))
    np.testing.assert_allclose(poses[moves[0][1]], safe, atol=1e-3)


def test_its_tool_is_given_by_the_numbers_of_the_pendant(program: StationProgram) -> None:
    x, y, z = CELL.robot.smr_mm
    remarks = " ".join(re.findall(r"!(.*?) *;", written(program)))
    assert f"UT 1 must be X {x:.3f} Y {y:.3f} Z {z:.3f} W 0.000 P 0.000 R 0.000" in remarks


def test_its_order_of_motions(program: StationProgram) -> None:
    _, moves = parsed(written(program))
    names = [f"{kind} {re.sub(r'P.[0-9]+:|]', '', name)}" for kind, name in moves]
    direct = [each for each in names if "XV" not in each]
    holes = [f"{way}{n}" for n in (1, 2) for way in ("J XA", "J XS", "L XP", "L XS")]
    assert direct == ["J SAFE1", *holes, "J SAFE1"]
    count = sum(len(each.values) for each in program.via)
    assert len(names) - len(direct) == count
    lines = written(program).splitlines()
    assert "LINE_COUNT\t= {};".format(lines[lines.index("/POS") - 1].split(":")[0].strip()) in lines
    kinds = ("UFRAME_NUM=0", "UTOOL_NUM=1", "PAUSE ;", "SAFE1] ", "XA1] ")
    order = [kind for each in lines for kind in kinds if kind in each]
    assert order[: len(kinds) + 1] == [*kinds[:4], "PAUSE ;", "XA1] "]
    first = next(n for n, each in enumerate(lines) if "PAUSE ;" in each)
    said = " ".join(each.partition("!")[2].removesuffix(" ;") for each in lines[:first])
    assert "origin is 645 mm below axis 2" in said
    assert all(len(each.partition("!")[2]) <= 32 + len(" ;") for each in lines)
    assert any("!1 of 2: Trager, deg1 ;" in each for each in lines)


def test_its_postures_are_those_of_the_joints(program: StationProgram) -> None:
    assert set(re.findall(r"CONFIG : '(.*)'", written(program))) == {"F U T, 0, 0, 0"}
    turned = replace(
        program,
        command=replace(
            program.command,
            joints_rad=program.command.joints_rad + np.radians([0, 0, 0, -361.0, 0, 200.0]),
        ),
    )
    (first, *_) = re.findall(r"XP1\"\]{[^']*'(.*)'", written(turned))
    assert first == "F U T, 0, -1, 1"


def off(program: StationProgram, joints_deg: Array) -> StationProgram:
    joints = np.tile(np.radians(joints_deg), (2, 1))
    return replace(program, command=replace(program.command, joints_rad=joints))


@pytest.mark.parametrize(
    ("joints_deg", "reason"),
    [
        ([0.0, -90.0, 90.0, 180.001, -30.0, 0.0], "XP1: axis 4 at 180 deg"),
        ([-180.001, -90.0, 90.0, 0.0, -30.0, 540.0], "XP1: axis 1 at 180 deg, axis 6 at 180 deg"),
        ([0.0, -90.0, 90.0, 0.0, -0.001, 0.0], "XP1: axis 5 at 0 deg"),
    ],
)
def test_a_posture_that_its_config_does_not_say(
    program: StationProgram, joints_deg: list[float], reason: str
) -> None:
    with pytest.raises(HilcellError, match=reason):
        write_station(off(program, np.array(joints_deg)), STAMP)
    behind = replace(program.standoff, status=program.standoff.status | 1)
    with pytest.raises(HilcellError, match="XS1: the arm behind axis 1"):
        write_station(replace(program, standoff=behind), STAMP)


def test_its_tool_has_a_number(program: StationProgram) -> None:
    drill = replace(program, tool_name="drill")
    with pytest.raises(SettingsError, match="by the controller's number"):
        write_station(drill, STAMP)
    assert "UTOOL_NUM=3" in written(replace(drill, tool_number=3))
    assert "UT : 3," in written(replace(drill, tool_number=3))


def test_it_is_not_corrected_again(program: StationProgram) -> None:
    read = read_program("s.ls", written(program))
    assert read.in_root
    assert read.name == "S_1100"
    with pytest.raises(CorrectedBefore):
        refuse_corrected("s.ls", read.remarks)
