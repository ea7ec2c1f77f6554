"""The same holes as a program of each form, and parsers that share nothing with hilcell's readers.

These use marks of the text alone, rotations of scipy, and joints by link matrices of their own. A
form is one row of `FORMS`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hilcell.calibration.tool_point import tool_tips
from hilcell.cell.file import load_cell
from hilcell.compensation.programs import StationProgram, program_writer
from hilcell.compensation.targets import Stamp
from hilcell.geometry.frames import inverse, poses_from_zyx, zyx_from_pose
from hilcell.ports import Array
from hilcell.programs.drilling import Drilling
from tests.hilcell.calibration.calibrations import T_W_B

CELL = load_cell("paper")
NUM = r"([-+]?[\d.]+(?:[eE][-+]?\d+)?)"
STAMP = Stamp("a-run", "2026-11-22T14:00:00Z", "S1100")


@dataclass(frozen=True)
class Parsed:
    """The base that a program works in, and its holes in it, in the order of its motions."""

    base: Array
    holes: Array

    @property
    def in_root(self) -> Array:
        return self.base @ self.holes


def pose(place: Array | Sequence[float], turn: Rotation) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), place
    return T


def numbers(pattern: str, text: str) -> list[float]:
    match = re.search(pattern, text)
    assert match is not None, f"{pattern} in {text[:80]!r}"
    return [float(each) for each in match.groups()]


def parsed_krl(texts: Mapping[str, str]) -> Parsed:
    """Points of the data list that LIN goes to, as X, Y, Z and angles about Z, Y, X."""
    source, data = texts[".src"], texts[".dat"]
    form = ",".join(f"{letter} {NUM}" for letter in "XYZABC")

    def frame(values: Sequence[float]) -> Array:
        return pose(values[:3], Rotation.from_euler("ZYX", values[3:], degrees=True))

    stated = dict(re.findall(r"DECL E6POS (XP\d+)=\{(.*)\}", data))
    holes = [
        frame(numbers(form, stated[name])) for name in re.findall(r"^LIN (XP\d+)", source, re.M)
    ]
    return Parsed(frame(numbers(rf"\$BASE=\{{{form}\}}", source)), np.array(holes))


def parsed_rapid(texts: Mapping[str, str]) -> Parsed:
    """Robtargets that MoveL goes to, as places and quaternions with the real part first."""
    text = texts[".mod"]

    def frame(values: Sequence[float]) -> Array:
        return pose(values[:3], Rotation.from_quat([*values[4:7], values[3]]))

    form = rf"\[\[{NUM},{NUM},{NUM}\],\[{NUM},{NUM},{NUM},{NUM}\]"
    stated = dict(re.findall(r"robtarget (XP\d+):=(.*);", text))
    moves = re.findall(r"MoveL (XP\d+),", text)
    base = frame(numbers(rf'wobjdata \w+:=\[FALSE,TRUE,"",{form}', text))
    assert ",[[0,0,0],[1,0,0,0]]];" in text, "its object frame is none"
    return Parsed(base, np.array([frame(numbers(form, stated[name])) for name in moves]))


def parsed_urscript(texts: Mapping[str, str]) -> Parsed:
    """Joints, or poses in m with rotation vectors, that movel goes to, without the way back."""
    text = texts[".script"]
    listed = [
        [float(each) for each in values.split(",")]
        for values in re.findall(r"movel\(\[([^\]]*)\]", text)
    ][::2]
    holes = [joints_pose(values) for values in listed]
    for values in re.findall(r"movel\(p\[([^\]]*)\]", text):
        x, y, z, *vector = (float(each) for each in values.split(","))
        holes.append(pose(1000.0 * np.array([x, y, z]), Rotation.from_rotvec(vector)))
    return Parsed(np.eye(4), np.array(holes))


def joints_pose(joints_rad: Sequence[float]) -> Array:
    """Pose of the reflector in {B} by the links of the cell file."""
    T = np.eye(4)
    for joint, angle in zip(CELL.robot.joint, joints_rad, strict=True):
        turned = joint.sign * np.degrees(angle) + joint.offset_deg
        T = T @ pose([0, 0, joint.d_mm], Rotation.from_euler("Z", turned, degrees=True))
        T = T @ pose([joint.a_mm, 0, 0], Rotation.from_euler("X", joint.alpha_deg, degrees=True))
    return T @ pose(CELL.robot.smr_mm, Rotation.identity())


def parsed_tp(texts: Mapping[str, str]) -> Parsed:
    """Positions that L goes to in user frame 0, with angles about the fixed X, Y, Z."""
    text = texts[".ls"].replace("\r", "")
    holes = []
    for label in re.findall(r"^ *\d+:L P\[(\d+):XP\d+\]", text, re.M):
        stated = text[text.index(f'P[{label}:"XP') :].partition("};")[0]
        assert "UF : 0" in stated
        x, y, z, w, p, r = (numbers(rf"\b{letter} = +{NUM}", stated)[0] for letter in "XYZWPR")
        holes.append(pose([x, y, z], Rotation.from_euler("xyz", [w, p, r], degrees=True)))
    return Parsed(np.eye(4), np.array(holes))


def as_poses(program: StationProgram, _: Mapping[str, str]) -> dict[str, str]:
    """The same holes as a URScript program of poses: a written one has joints, which stay."""
    moves = []
    for T in poses_from_zyx(program.base[None])[0] @ poses_from_zyx(program.command.values):
        values = [*(T[:3, 3] / 1000.0), *Rotation.from_matrix(T[:3, :3]).as_rotvec()]
        moves.append(f"  movel(p[{', '.join(f'{each:.7f}' for each in values)}], a=0.5, v=0.1)\n")
    return {".script": f"def drill():\n{''.join(moves)}end\n"}


def as_written(_: StationProgram, texts: Mapping[str, str]) -> Mapping[str, str]:
    return texts


@dataclass(frozen=True)
class Form:
    """A form: its writer's name, its parser, and the program of the holes that can be corrected,
    with so many points for each.
    """

    writer: str
    parse: Callable[[Mapping[str, str]], Parsed]
    correctable: Callable[[StationProgram, Mapping[str, str]], Mapping[str, str]] = as_written
    points_a_hole: int = 3


FORMS = [
    Form("kuka-c3", parsed_krl),
    Form("ur-rtde", parsed_urscript, as_poses, 1),
    Form("abb-egm", parsed_rapid),
    Form("fanuc-tp", parsed_tp),
]


@cache
def station(count: int, turned_deg: float) -> StationProgram:
    """Holes beside the calibrated place, every third with an orientation of its own; the points
    before each are along its tool, so that they are of the calibrated orientation, too. No axis is
    near zero, where a correction would be refused.
    """
    rng = np.random.default_rng(20261130)
    values = np.empty((count, 6))
    values[:, :3] = [0.0, 180.0, 1200.0] + rng.uniform(-150.0, 150.0, (count, 3))
    values[:, 3:] = [0.0, 75.0, 0.0]
    values[::3, 3:] += rng.uniform(-turned_deg, turned_deg, values[::3, 3:].shape)
    values = np.round(values, 3)
    drilling = Drilling(CELL, T_W_B, tool_tips(CELL)[0], 100.0)
    names = [f"H{n}" for n in range(1, count + 1)]
    straight_rad = drilling.straight_rad(names, values)
    none = drilling.places(np.empty((0, 6)))
    return StationProgram(
        station="S1100",
        names=names,
        command=drilling.places(straight_rad[:, -1]),
        standoff=drilling.places(straight_rad[:, 0]),
        approach=drilling.places(straight_rad[:, 5]),
        via=[none] * (count + 1),
        base=zyx_from_pose(inverse(T_W_B)[None])[0],
        tool=zyx_from_pose(CELL.robot.arm().tool[None])[0],
        tool_name="reflector",
        tool_number=None,
        safe_deg=np.degrees(straight_rad[0, 0]),
        arm=drilling.arm,
        speed_percent=30.0,
        options={},
        remarks=[],
    )


def written(form: Form, program: StationProgram) -> Mapping[str, str]:
    """Return its texts by suffix."""
    writer = program_writer(form.writer)
    assert writer is not None
    return texts_of(writer(program, STAMP))


def correctable(form: Form, program: StationProgram) -> Mapping[str, str]:
    """Return the texts of a program of the holes that can be corrected, without a stamp."""
    texts = form.correctable(program, written(form, program))
    return {suffix: unstamped(text) for suffix, text in texts.items()}


def texts_of(files: Mapping[str, bytes]) -> dict[str, str]:
    return {Path(name).suffix: content.decode("latin-1") for name, content in files.items()}


def unstamped(text: str) -> str:
    return "\n".join(line for line in text.split("\n") if STAMP.by not in line)
