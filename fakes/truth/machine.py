"""The description of a machine: its components and the sizes of their errors.

A machine is a TOML file; with a seed it is one physical robot, rail, strip and tracker. It does not
depend on a cell's measuring plan: sizes refer to reference poses of its own. Random sizes are
1 sigma.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, field

from fakes.truth.transforms import Array, Chain, axes_from_dh, frame
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError, convert, read_text, refuse, unreadable
from hilcell.cell.tables import Frozen, Length, Point, Pose, Six, Size, Sweep, refuse_descending

Angle = Annotated[float, Meta(ge=0, le=20_000)]  # urad: about a degree
Offset = Annotated[float, Meta(ge=0, le=100)]  # mm
Extent = Annotated[float, Meta(gt=0, le=100)]  # mm
Rate = Annotated[float, Meta(ge=0, le=1000)]  # um, um/m, um/m/K
Share = Annotated[float, Meta(ge=0, lt=1)]
Cycles = tuple[Annotated[int, Meta(ge=1, le=1000)], Annotated[int, Meta(ge=1, le=1000)]]


class JointAxis(Frozen, frozen=True, kw_only=True):
    """One joint's axis at joints zero in the robot's base frame, in its positive sense."""

    axis: Point
    point_mm: Point

    def __post_init__(self) -> None:
        unit = 1e-6
        if not abs(np.linalg.norm(self.axis) - 1.0) < unit:
            raise ValueError(f"axis {self.axis} must have length 1")


class Reference(Frozen, frozen=True, kw_only=True):
    """The poses to which sizes refer: a cube, the axis 6 circle, the parked arm.

    Angles are those about the axes, also of an arm whose joint 3 is coupled.
    """

    centre: Pose
    size_mm: Point
    start_deg: Six
    axis_6_deg: Six
    parked_deg: Six
    points: Annotated[int, Meta(ge=2, le=20)] = 6  # a side of the cube


class Errors(Frozen, frozen=True, kw_only=True):
    """Sizes of errors, and the total to which they are scaled together: the mean error over the
    cube against the ideal base, or its RMS after the best rigid motion.
    """

    scaled_by: Annotated[
        Literal["mean", "varying"],
        "of the total: mean error over the cube, or RMS after the best rigid motion",
    ]
    size_mm: Annotated[Extent, "to which all errors of this table are scaled together"]
    largest_mm: Annotated[Extent, "an arm with a larger error in the cube is drawn again"]
    zero_urad: Annotated[Angle, "zeros of the joints"]
    length_mm: Annotated[Offset, "shift of each axis from the second on: lengths and offsets"]
    twist_urad: Annotated[Angle, "tilt of each axis from the second on"]
    tool_mm: Annotated[Offset, "place of the reflector on the flange, each coordinate"]
    gravity_urad: Annotated[
        Angle, "bending of axes 2 and 3 by weight: half of this to one and a half"
    ]
    gravity_side_urad: Annotated[
        Angle, "the same with the arms upright, where weight hardly bends them"
    ]
    harmonics_urad: Annotated[
        list[Angle], "errors of each joint with one, two, .. cycles a revolution"
    ]
    elastic_urad: Annotated[Angle, "axis 2 by the product of upper arm's and forearm's load"] = 0.0

    def __post_init__(self) -> None:
        refuse_descending(self, "size_mm", "largest_mm")


class Band(Frozen, frozen=True, kw_only=True):
    """A joint's error between two frequencies, no gear's: ``lines`` of random frequency and phase,
    and of equal size in the mean.
    """

    cycles: Cycles  # a turn
    rms_urad: Angle
    lines: Annotated[int, Meta(ge=1, le=100)] = 6

    def __post_init__(self) -> None:
        refuse_backwards(cycles=self.cycles)


class Transmission(Frozen, frozen=True, kw_only=True):
    """Gears: ripple, lost motion, repeatability; and the arm's thermal growth."""

    ripple_urad: Annotated[Angle, "amplitude of a gear's ripple"]
    pins: Annotated[Cycles, "least and most cycles of ripple a revolution"]
    ratios: Annotated[Cycles, "the same, of the faster ripple"]
    half_gap_urad: Annotated[Angle, "half the lost motion of each joint, +-20 %"]
    rp_mm: Annotated[Extent, "repeatability RP (ISO 9283), mean over the cube"]
    load_share: Annotated[Share, "largest relative change of the ripple with a joint's load"] = 0.0
    unlisted_urad: Annotated[Angle, "amplitude of a harmonic that is not in the gear data"] = 0.0
    band: Annotated[
        list[Band], "further ripple: tables of `cycles` (least, most), `rms_urad`, `lines`"
    ] = field(default_factory=list)
    growth_um_m_k: Annotated[Rate, "growth of the arm with the ambient temperature"] = 0.0
    resonance_hz: Annotated[Size, "the arm's lowest, which motion excites"] = 8.0
    damping: Annotated[Share, "of this resonance, as a share of the critical"] = 0.05

    def __post_init__(self) -> None:
        refuse_backwards(pins=self.pins, ratios=self.ratios)


def refuse_backwards(**ranges: tuple[int, int]) -> None:
    refuse(
        [
            f"{key}: expected the lowest first, got {least} .. {most}"
            for key, (least, most) in ranges.items()
            if not least <= most
        ]
    )


class RailSizes(Frozen, frozen=True, kw_only=True):
    """The errors of the rail and of its strip; without a ``strip`` the encoder replaces it."""

    strip: Annotated[
        bool, "whether there is a strip; without one the drive's encoder replaces it"
    ] = True
    power_on_mm: Annotated[Length, "position at power-on"] = 640.0
    backlash_mm: Annotated[Extent, "between drive and slide, +-2 %"]
    curve_mm: Annotated[Offset, "largest error of the position along the rail, on the way up"]
    curve_span_mm: Annotated[Size, "travel over which this error is the largest"]
    ways_mm: Annotated[
        Offset, "difference between the curves up and down, besides the backlash"
    ] = 0.01
    landing_mm: Annotated[Offset, "repeatability after a move of 100 mm or more"] = 0.01
    short_landing_mm: Annotated[Offset, "the same after the shortest moves"] = 0.0015
    straightness_mm: Annotated[Offset, "of the rail, in each direction across"] = 0.06
    lean_urad: Annotated[Angle, "tilt of the slide along the travel, about each axis"] = 100.0
    tilt_urad: Annotated[Angle, "the rail's direction against the cell file's, about each axis"] = (
        300.0
    )
    strip_long_mm: Annotated[Offset, "error of the strip over metres"] = 0.004
    strip_pole_mm: Annotated[Offset, "amplitude of its error within a pole of 5 mm"] = 0.002


class Mounting(Frozen, frozen=True, kw_only=True):
    """Deviations of places from the cell file."""

    bolted_mm: Annotated[Offset, "place of the robot on the slide, each coordinate"] = 1.2
    bolted_urad: Annotated[Angle, "its tilt, about each axis"] = 500.0
    floor_nest_mm: Annotated[Offset, "floor nests and nests of bars, each coordinate"] = 1.0
    slide_nest_mm: Annotated[Offset, "nests on the slide, each coordinate"] = 1.2
    seat_mm: Annotated[
        Offset, "further reflectors on the flange from the first, each coordinate"
    ] = 0.5
    tracker_mm: Annotated[Offset, "place of the tracker, each coordinate"] = 3.0
    tracker_urad: Annotated[Angle, "its tilt, about each axis"] = 1000.0


class TrackerSizes(Frozen, frozen=True, kw_only=True):
    """The tracker's noise and slow drift, and the ambient temperature."""

    radial_um: Annotated[Rate, "noise of a reading along the beam"] = 7.5
    across_um_m: Annotated[Rate, "noise of a reading across the beam, each direction"] = 2.5
    drift_mm: Annotated[Offset, "slow drift, each coordinate, over hours"] = 0.002
    axes_urad: Annotated[
        Angle, "errors of collimation, transit tilt and index after the last adjustment"
    ] = 1.0
    room_c: Annotated[Annotated[float, Meta(ge=-20, le=60)], "mean ambient temperature"] = 23.0
    room_swing_k: Annotated[
        Annotated[float, Meta(ge=0, le=30)], "by how much it swings to either side in three hours"
    ] = 0.8


class Controller(Frozen, frozen=True, kw_only=True):
    """The settings of the robot's controller, where they are not those of the cell file.

    The tool differs by ``tool_off_mm`` (3,) from the reflector's place. ``limits_deg`` are the
    axes' software limits, ``slide_limits_mm`` those of E1; ``program`` is the version of the
    resident program that was copied to it.
    """

    tool_off_mm: Point = (0.0, 0.0, 0.0)
    limits_deg: list[Sweep] | None = None
    slide_limits_mm: tuple[Length, Length] | None = None
    program: Annotated[int, Meta(ge=0)] | None = None

    def __post_init__(self) -> None:
        if self.limits_deg is not None and len(self.limits_deg) != 6:
            raise ValueError(f"limits_deg: expected six axes, got {len(self.limits_deg)}")


class Machine(Frozen, frozen=True, kw_only=True):
    """One kind of machine; axis 3 also turns by ``coupling`` times joint 2.

    ``rail_device`` are the fields of a `fakes.canopen.rail_device.RailDevice` that differ.
    """

    model: str
    serial: int
    flange: Pose
    joint: list[JointAxis]
    coupling: Annotated[float, Meta(ge=-1, le=1)] = 0.0
    reference: Reference
    errors: Errors
    transmission: Transmission
    rail: RailSizes
    mounting: Mounting = field(default_factory=Mounting)
    tracker: TrackerSizes = field(default_factory=TrackerSizes)
    controller: Controller = field(default_factory=Controller)
    rail_device: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.joint) != 6:
            raise ValueError(f"expected six joints, got {len(self.joint)}")

    def chain(self, smr_mm: Point) -> Chain:
        """Return the arm as designed; its last frame is the reflector's, mounted at (3,)."""
        axes = np.array([joint.axis for joint in self.joint])
        points_mm = np.array([joint.point_mm for joint in self.joint])
        return Chain(axes, points_mm, mounted(frame(self.flange), smr_mm), self.coupling)


def mounted(flange: Array, smr_mm: Point) -> Array:
    """Return the reflector's frame (4, 4) on a flange (4, 4)."""
    T = flange.copy()
    T[:3, 3] += flange[:3, :3] @ np.array(smr_mm)
    return T


def cell_machine(cell: Cell) -> Machine:
    """Return the machine of a simulated cell; raises `SettingsError`."""
    if cell.simulation is None:
        return load_machine("paper")
    return load_machine(cell.simulation.machine, cell.simulation.sizes)


def load_machine(where: str, sizes: Mapping[str, Any] | None = None) -> Machine:
    """Read a machine by its built-in name, or a TOML file; ``sizes`` replace single values."""
    folder = resources.files("fakes.truth.machines")
    known = sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if ".toml" in p.name)
    try:
        if where in known:
            text = (folder / f"{where}.toml").read_text("utf-8")
        else:
            text = read_text(Path(where))
        tables = _tables(text)
    except FileNotFoundError:
        problem = f"no such file or machine; built-in machines: {', '.join(known)}"
        raise SettingsError(f"simulation.machine {where!r}", [problem]) from None
    except (OSError, ValueError) as error:
        raise unreadable(f"simulation.machine {where!r}", error, "machine file") from error
    if not sizes:
        return _described(text, where)
    return convert(_replaced(tables, sizes), Machine, f"simulation.sizes of {where}")


def _replaced(values: Mapping[str, Any], sizes: Mapping[str, Any]) -> dict[str, Any]:
    inner = {
        key: _replaced(values[key], each)
        for key, each in sizes.items()
        if isinstance(each, Mapping) and isinstance(values.get(key), Mapping)
    }
    return {**values, **sizes, **inner}


@lru_cache(4)
def _tables(text: str) -> Mapping[str, Any]:
    return tomllib.loads(text)


@lru_cache(4)
def _described(text: str, where: str) -> Machine:
    return convert(_tables(text), Machine, where)


def nominal_chain(cell: Cell) -> Chain:
    """Return the arm of a cell file's DH rows, for a robot without a machine file."""
    rows = cell.robot.joint
    axes, points_mm, flange = axes_from_dh(
        np.array([row.a_mm for row in rows]),
        np.radians([row.alpha_deg for row in rows]),
        np.array([row.d_mm for row in rows]),
        np.radians([row.offset_deg for row in rows]),
        np.array([float(row.sign) for row in rows]),
    )
    return Chain(axes, points_mm, mounted(flange, cell.robot.smr_mm))


@dataclass(frozen=True, slots=True)
class ControllerArm:
    """The arm as its controller knows it: the design, never the truth.

    Status and turn are KUKA's: status bit 0, the wrist is behind axis 1; bit 1, axis 3 is at or
    beyond the stretched arm; bit 2, A5 < 0. Turn bit i: joint i + 1 is below 0.
    """

    chain: Chain
    model: str
    serial: int
    tool_mm: Point  # {T} in the flange
    limits_deg: Array  # (6, 2)
    slide_limits_mm: tuple[float, float]
    program: int | None  # version of the resident program; None for that of the simulated device

    def status(self, joints_rad: Array) -> int:
        """Return the status of joints (6,)."""
        lines, _ = self.chain.lines(joints_rad)
        (axis_2, shoulder_mm), (axis_3, elbow_mm), (_, wrist_mm) = lines[1], lines[2], lines[4]
        ahead = self._cross(axis_2, np.array([0.0, 0.0, 1.0]))
        bent = self._cross(elbow_mm - shoulder_mm, wrist_mm - elbow_mm) @ axis_3
        behind, beyond, flipped = 1, 2, 4
        status = behind * bool(ahead @ wrist_mm < 0) + beyond * bool(bent >= 0)
        return int(status + flipped * bool(joints_rad[4] < 0))

    def turn(self, joints_rad: Array) -> int:
        """Return the turn of joints (6,)."""
        return sum(1 << joint for joint, angle in enumerate(joints_rad) if angle < 0)

    @staticmethod
    def _cross(a: Array, b: Array) -> Array:
        """Return the cross product of two vectors (3,), ten times as fast as numpy's."""
        (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
        return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def controller_arm(cell: Cell) -> ControllerArm:
    """Return the arm as the controller of a simulated cell knows it; raises `SettingsError`.

    A replayed cell has no machine: the arm follows the cell file's rows.
    """
    if cell.simulation is not None and cell.simulation.data:
        model = f"#{cell.robot.name.replace(' ', '').replace('-', '_')} C4 FLR"
        serial = 860112  # the data contain none
        chain, tool_mm, own = nominal_chain(cell), cell.robot.smr_mm, Controller()
    else:
        machine = cell_machine(cell)
        model, serial, own = machine.model, machine.serial, machine.controller
        x_mm, y_mm, z_mm = (a + b for a, b in zip(cell.robot.smr_mm, own.tool_off_mm, strict=True))
        tool_mm = (x_mm, y_mm, z_mm)
        chain = machine.chain(tool_mm)
    limits_deg = own.limits_deg or [(joint.min_deg, joint.max_deg) for joint in cell.robot.joint]
    beyond_mm = 0.5  # of E1's software limits outside the travel
    travel_mm = (cell.rail.travel_min_mm - beyond_mm, cell.rail.travel_max_mm + beyond_mm)
    slide_limits_mm = own.slide_limits_mm or travel_mm
    limits = np.array(limits_deg)
    return ControllerArm(chain, model, serial, tool_mm, limits, slide_limits_mm, own.program)
