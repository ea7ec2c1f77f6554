"""The robot of the cell file: nominal kinematics, reflectors, tools, motion settings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import combinations
from typing import Annotated

import numpy as np
from msgspec import Meta, field

from hilcell.cell.settings import refuse
from hilcell.cell.surroundings import EnvelopeTable
from hilcell.cell.tables import (
    Angle,
    Frozen,
    Length,
    Name,
    Percent,
    Point,
    Pose,
    Six,
    Speed,
    Tolerance,
    refuse_descending,
)
from hilcell.decoding import Json
from hilcell.geometry.inverse import NominalRobot
from hilcell.geometry.kinematics import Arm, Array


class Joint(Frozen, frozen=True, kw_only=True):
    """One DH row, ``Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha)``, with its software limits.

    ``coupled_to = 2`` on axis 3: the controller counts the axis not from the link before it, so
    that a motion of its joint 2 alone turns axis 3 by ``coupling`` (1 or -1) times as much; in the
    row, q is then ``q3 + coupling q2``. Limits are of the controller's own values.
    """

    a_mm: Length
    alpha_deg: Angle
    d_mm: Length
    offset_deg: Angle
    sign: Annotated[int, Meta(ge=-1, le=1)] = 1
    min_deg: Angle = -180.0
    max_deg: Angle = 180.0
    speed_deg_s: Speed = 100.0
    coupled_to: int | None = None
    coupling: Annotated[int, Meta(ge=-1, le=1)] = 1

    def __post_init__(self) -> None:
        if not self.sign:
            raise ValueError("sign must be 1 or -1")
        if not self.coupling:
            raise ValueError("coupling must be 1 or -1")
        refuse_descending(self, "min_deg", "max_deg")


class RobotTable(Frozen, frozen=True, kw_only=True):
    """The robot: nominal kinematics, positions of the reflectors, motion settings.

    ``smr_mm`` is the tool point. Two or more other reflectors, ``more_smr_mm``, make the tool's
    orientation measurable. ``rp_mm`` is the pose repeatability (ISO 9283) of the data sheet.
    ``program``: form of written programs, None for the driver's.
    """

    driver: Name
    name: str
    joint: list[Joint]
    smr_mm: Point
    more_smr_mm: list[Point] = field(default_factory=list)
    home_deg: Six
    safe_deg: Six
    status: Annotated[int, Meta(ge=0, le=7)]
    speed_percent: Percent = 30.0
    approach_deg: Annotated[float, Meta(gt=0, le=90)] = 0.5
    joint_margin_deg: Annotated[float, Meta(ge=0, le=90)] = 2.0
    ramp_s: Annotated[float, Meta(ge=0, le=10)] = 0.5
    rp_mm: Tolerance | None = None
    first_pass_percent: Percent = 10.0
    first_pass_pause: bool | None = None
    envelope: EnvelopeTable | None = None
    program: Name | None = None
    options: Json = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.joint) != 6:
            raise ValueError(f"expected six joints, got {len(self.joint)}")
        refuse(
            [
                f"joint[{n}].coupled_to: axis {n + 1} coupled to axis {joint.coupled_to}; only "
                "axis 3 can be coupled, to axis 2"
                for n, joint in enumerate(self.joint)
                if joint.coupled_to is not None and (n, joint.coupled_to) != (2, 2)
            ]
            + [
                f"{key}: A{n} at {deg} deg is outside its limits "
                f"{joint.min_deg} .. {joint.max_deg} deg"
                for key in ("home_deg", "safe_deg")
                for n, (joint, deg) in enumerate(
                    zip(self.joint, getattr(self, key), strict=True), 1
                )
                if not joint.min_deg <= deg <= joint.max_deg
            ]
            + list(self._bad_reflector_places())
        )

    def _bad_reflector_places(self) -> Iterator[str]:
        if not self.more_smr_mm:
            return
        seats_mm = self.seats_mm
        reflectors = range(3, 7)  # on the flange, where the tool's orientation is measured
        if len(seats_mm) not in reflectors:
            more = f"{reflectors[0] - 1} .. {reflectors[-1] - 1}"
            yield f"more_smr_mm: expected {more} reflectors, got {len(self.more_smr_mm)}"
            return
        least_mm = 50.0  # closer: easily confused, and a poor measure of angles
        for one, other in combinations(range(len(seats_mm)), 2):
            apart_mm = float(np.linalg.norm(seats_mm[one] - seats_mm[other]))
            if not apart_mm >= least_mm:
                apart = f"reflectors {one + 1} and {other + 1} are {apart_mm:.1f} mm apart"
                yield f"more_smr_mm: {apart}, expected >= {least_mm:g} mm"
        spread = np.linalg.svd(seats_mm - seats_mm.mean(axis=0), compute_uv=False)
        if not spread[1] > 0.2 * spread[0]:  # less: hardly a triangle
            yield (
                f"more_smr_mm: expected a triangle, got reflectors on one line (spread "
                f"{spread[0]:.1f} mm along it, {spread[1]:.1f} mm across)"
            )

    @cached_property
    def seats_mm(self) -> Array:
        """Return the reflectors' nominal positions (K, 3) on the flange, the tool point first."""
        seats_mm = np.array([self.smr_mm, *self.more_smr_mm])
        seats_mm.flags.writeable = False
        return seats_mm

    def arm(self) -> Arm:
        """Return the nominal arm; its tool point is the reflector's centre."""
        return self._arm

    @cached_property
    def _arm(self) -> Arm:
        tool = np.eye(4)
        tool[:3, 3] = self.smr_mm
        return arm_from_joints(self.joint, tool)

    def nominal(self) -> NominalRobot:
        home_rad = np.radians(self.home_deg)
        return NominalRobot(self.arm(), self.status, self.margin_limits_rad, home_rad)

    @cached_property
    def approach_rad(self) -> Array:
        """Return the change of the joints (6,) that turns every axis by ``approach_deg``."""
        return self.arm().joints(np.full(6, np.radians(self.approach_deg)))

    @cached_property
    def margin_limits_rad(self) -> Array:
        """Return the limits (2, 6), lower and upper, less the margin; poses come from below."""
        margin_deg = self.joint_margin_deg
        low_deg = [joint.min_deg + max(margin_deg, self.approach_deg) for joint in self.joint]
        limits = np.radians([low_deg, [joint.max_deg - margin_deg for joint in self.joint]])
        if self.joint[2].coupled_to is not None:
            lower_rad = np.radians(self.joint[2].min_deg) + self.approach_rad[2]
            limits[0, 2] = max(limits[0, 2], lower_rad)
        limits.flags.writeable = False
        return limits


def arm_from_joints(joints: list[Joint], tool: Array) -> Arm:
    """Return the arm of six DH rows with the tool frame (4, 4) on the flange."""
    return Arm(
        a_mm=np.array([j.a_mm for j in joints]),
        alpha_rad=np.radians([j.alpha_deg for j in joints]),
        d_mm=np.array([j.d_mm for j in joints]),
        offset_rad=np.radians([j.offset_deg for j in joints]),
        sign=np.array([float(j.sign) for j in joints]),
        tool=tool,
        coupling=0.0 if joints[2].coupled_to is None else float(joints[2].coupling),
    )


REFLECTOR = "reflector"  # the tool whose tip is the reflector's centre, {T}
STANDOFF_MORE_MM = 20.0  # minimum beyond the drill's length
MOST_STANDOFF_MM = 1000.0


class ToolTable(Pose, frozen=True, kw_only=True):
    """A tool: the frame of its tip in the flange, z along the drill, out of the spindle.

    ``number`` is the controller's, if it numbers tools. ``measured`` describes how the tip was
    measured relative to the reflector, ``u_mm`` is 1 sigma of that. ``drill_mm`` is the free length
    of the drill, ``standoff_mm`` the distance of the tip from the part between holes.
    """

    name: Name
    measured: Annotated[str, Meta(min_length=1)]
    u_mm: Annotated[float, Meta(ge=0, le=10)]
    drill_mm: Annotated[float, Meta(gt=0, le=MOST_STANDOFF_MM - STANDOFF_MORE_MM)]
    number: Annotated[int, Meta(ge=1, le=32)] | None = None
    standoff_mm: Annotated[float, Meta(gt=0, le=MOST_STANDOFF_MM)] | None = None

    def __post_init__(self) -> None:
        if self.standoff_mm is not None and not self.standoff_mm >= self.least_standoff_mm:
            least = f"drill_mm + {STANDOFF_MORE_MM:g}, {self.least_standoff_mm:g}"
            raise ValueError(f"standoff_mm: expected at least {least}, got {self.standoff_mm:g}")
        if not self.drill_mm <= self.reach_mm:
            raise ValueError(
                f"drill_mm {self.drill_mm:g}: the tip is {self.reach_mm:.1f} mm in front of the "
                "flange along its z, expected >= drill_mm; z points along the drill, outwards"
            )

    @property
    def reach_mm(self) -> float:
        """Return the distance of the tip from the flange's centre along the tip's z."""
        T = self.matrix()
        return float(T[:3, 3] @ T[:3, 2])

    @property
    def least_standoff_mm(self) -> float:
        """Return the drill's length plus a margin."""
        return self.drill_mm + STANDOFF_MORE_MM


def tool_problems(tools: Sequence[ToolTable], reflector: object) -> Iterator[str]:
    """Yield problems of tools; ``reflector`` is the number of the reflector's tool, if any."""
    names = Counter(each.name for each in tools)
    numbers = Counter(each.number for each in tools if each.number is not None)
    for key, counts in (("names", names), ("numbers", numbers)):
        for value, count in counts.items():
            if count > 1:
                yield f"tool: {key} must differ, found {value} {count} times"
    for n, each in enumerate(tools):
        if each.name == REFLECTOR:
            yield f"tool[{n}].name: {REFLECTOR!r} is the tool of the reflector's centre"
        if each.number is not None and each.number == reflector:
            yield f"tool[{n}].number: {each.number} is the reflector's (robot.options.tool)"
