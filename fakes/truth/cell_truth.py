"""The one physical truth of a simulated cell: a machine's rail, robot, tracker and nests.

Frames: {W} world, {S} the slide as the cell file thinks it (nominal {B}), {R} the robot's own base
frame, which is bolted a little askew on the slide, {T} the tool point on the flange. Machine and
seed fix the truth and the noise, whatever the cell's plan measures; a cell that is started again
draws the same again from its beginning. Nominal {B} is not {R}, and a calibration finds neither; it
finds `base_in_world`.

Recorded data may stand in for the machine: `ReplayPlant`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fakes.faults import Faults
from fakes.time import PlantTime
from fakes.truth.arm_truth import ArmTruth
from fakes.truth.machine import machine_of
from fakes.truth.noise import KeyedNoise
from fakes.truth.rail_truth import FloorTruth, RailTruth
from fakes.truth.robot_motion import RobotMotion, RobotState
from fakes.truth.tracker_truth import ReplayTracker, StreamTruth, TrackerTruth
from fakes.truth.transforms import Array, carried, rigid, rotation
from hilcell.cell.file import Cell, Nest
from hilcell.cell.layout import Layout
from hilcell.cell.settings import SettingsError
from hilcell.ports import HilcellError

FLANGE = "flange"


class Plant:
    """One simulated cell."""

    def __init__(self, cell: Cell, seed: int, time: PlantTime, faults: Faults) -> None:
        """Raises `SettingsError` that names a machine that cannot be."""
        fixed, landing = KeyedNoise(seed), KeyedNoise(seed, "robot")
        machine = machine_of(cell)
        mounting = machine.mounting
        self.cell, self.time = cell, time
        self.rail = RailTruth(cell, seed, time, faults) if cell.has_rail else FloorTruth(cell)
        try:
            self.arm = ArmTruth(machine, cell.robot.smr_mm, fixed.generator("arm"))
        except HilcellError as error:
            name = "" if cell.simulation is None else cell.simulation.machine
            raise SettingsError(f"simulation.machine {name!r}", [str(error)]) from error

        def misses(key: str) -> Callable[[], Array]:
            draw = landing.later_normal(key, 6)
            return lambda: np.hypot(self.arm.joint_sigma_rad, self.arm.slip_rad) * draw()

        self.robot = RobotMotion(cell, time, misses)
        rng = fixed.generator("base")
        turn = mounting.bolted_urad * 1e-6 * _limited(rng, 3)
        self._bolted = rigid(rotation(turn), mounting.bolted_mm * _limited(rng, 3))
        self._slipped = np.eye(4)
        self._growing, self._grows_since = 0.0, 0
        rng = fixed.generator("seats")  # of the other reflectors, from the first and in its axes
        from_first_mm = np.array(cell.robot.more_smr_mm).reshape(-1, 3) - cell.robot.smr_mm
        self._seats: dict[str, Array] = {
            f"{FLANGE} {number}": at_mm + mounting.seat_mm * _limited(rng, 3)
            for number, at_mm in enumerate(from_first_mm, start=2)
        }
        self._floor = _placed(cell.layout.floor, mounting.floor_nest_mm, fixed.generator("floor"))
        self._floor |= self._bars(cell.layout, mounting.floor_nest_mm, fixed.generator("bars"))
        self._slide = _placed(cell.layout.slide, mounting.slide_nest_mm, fixed.generator("slide"))
        self._stood: tuple[RobotState | None, Array] = (None, np.zeros(6))  # the true joints
        self._bolts: tuple[float, Array, dict[str, Array]] = (math.nan, np.eye(4), {})
        self._places: tuple[tuple[Array, Array, float], dict[str, Array]] | None = None
        self.seated = ""  # where the one reflector is that is carried by hand; "": out of sight
        self.tracker = TrackerTruth(cell, seed, faults, self.reflectors_in_world)
        self.streams = StreamTruth(seed, self.robot, self.tracker, self.path_in_world)

    def lose_zero(self, lost_rad: float, axis: int = 1) -> None:
        """Turn an axis of the robot, 1 to 6, against its encoder for good."""
        self.arm.lost_rad[axis - 1] += lost_rad
        self._forget()

    def lose_motion(self, lost_rad: float, axis: int = 3) -> None:
        """Widen the gap of an axis of the robot, 1 to 6, for good."""
        if lost_rad:
            self.arm.half_gap_rad[axis - 1] += lost_rad / 2
            self._forget()

    def grow(self, um_m: float) -> None:
        """Let the arm grow from now on, by this share in 1000 of the tracker's measurements."""
        self._growing, self._grows_since = 1e-6 * um_m, self.tracker.measured

    def loosen(self, axis: int, slip_rad: float) -> None:
        """Let an axis of the robot, 1 to 6, slip at random at each stop: 1 sigma, for good."""
        self.arm.slip_rad[axis - 1] = slip_rad

    def slip_mount(self, along_mm: float) -> None:
        """Shift the reflector on the flange along its x for good."""
        self._slipped[0, 3] += along_mm
        self._forget()

    def seat(self, place: str) -> None:
        """Carry the reflector to a nest, the flange, or (empty) away; raises `ValueError`."""
        if not self.cell.layout.by_hand:
            raise ValueError("the reflectors of this cell are mounted")
        places = [*self._floor, *self._slide, FLANGE, ""]
        if place not in places:
            raise ValueError(f"place {place!r} is none of {', '.join(places)}")
        self.seated = place

    def reflectors_in_world(self) -> dict[str, Array]:
        """Return where reflectors (3,) are seen, in {W}: everywhere, or where the one sits."""
        places = self.places_in_world()
        if not self.cell.layout.by_hand:
            return places
        seated = self.seated
        return {seated: places[seated]} if seated else {}

    def path_in_world(self, name: str, times_s: Array) -> Array:
        """Return where a reflector really was, (N, 3) in {W}, at times (N,) up to now.

        None are left where it is out of sight. The slide is taken to stand meanwhile.
        """
        if self.cell.layout.by_hand and name != self.seated:
            return np.zeros((0, 3))
        if name != FLANGE and name not in self._seats:
            return np.tile(self.places_in_world()[name], (len(times_s), 1))
        joints_rad, side, landing_rad = self.robot.past(times_s)
        true_rad = self.arm.true_joints(joints_rad, side, landing_rad)
        arm = self.arm.pose_of(true_rad, self._strain()) @ self._slipped
        tool = self.rail.slide_pose() @ self._bolted @ arm
        return tool[:, :3, 3] + tool[:, :3, :3] @ self._seats.get(name, np.zeros(3))

    def places_in_world(self) -> dict[str, Array]:
        """Return where a reflector (3,) in each nest and on the flange really is, in {W}."""
        true_rad, strain = self._true_joints(), self._strain()
        base, around = self._bolted_and_nests()
        if self._places is not None:  # at rest it is asked for several times a measurement
            (known_rad, known_base, known_strain), found = self._places
            if true_rad is known_rad and base is known_base and strain == known_strain:
                return found
        tool = base @ self.arm.pose_of(true_rad, strain) @ self._slipped
        found = around | {FLANGE: tool[:3, 3]}
        found |= {name: carried(tool, at_mm) for name, at_mm in self._seats.items()}
        self._places = ((true_rad, base, strain), found)
        return found

    def _strain(self) -> float:
        grown = self._growing * (self.tracker.measured - self._grows_since) / 1000.0
        return self.arm.strain(self.tracker.warm_k) + grown

    def _true_joints(self) -> Array:
        """Return how the joints (6,) really are turned: the same array while the robot stands."""
        robot = self.robot.state()
        stood, true_rad = self._stood
        if robot is not stood:
            true_rad = self.arm.true_joints(robot.joints_rad, robot.side, robot.landing_rad)
            self._stood = (robot, true_rad)
        return true_rad

    def _bolted_and_nests(self) -> tuple[Array, dict[str, Array]]:
        """Return the robot's base (4, 4) and all nests, in {W}: the same while the slide stands."""
        slide_mm = self.rail.slide_mm()
        at_mm, base, nests = self._bolts
        if slide_mm != at_mm:
            T_W_S = self.rail.slide_pose()
            base = T_W_S @ self._bolted
            on_slide = {name: carried(T_W_S, nest_mm) for name, nest_mm in self._slide.items()}
            nests = self._floor | on_slide
            self._bolts = (slide_mm, base, nests)
        return base, nests

    def _forget(self) -> None:
        """Compute from the start what is kept while nothing moves."""
        self._stood, self._places = (None, np.zeros(6)), None

    def base_in_world(self) -> Array:
        """Return the base frame (4, 4) in {W} that a faultless section 4.2 would find now."""
        return self.rail.slide_pose() @ self._bolted @ self.arm.ideal_base

    @staticmethod
    def _bars(layout: Layout, sigma_mm: float, rng: np.random.Generator) -> dict[str, Array]:
        """Return the nests of bars: each certified length is true between them."""
        found = _placed(layout.bar, sigma_mm, rng)
        for each in layout.length:
            one, other = each.nests
            if one in found and other in found:
                way_mm = found[other] - found[one]
                found[other] = found[one] + each.length_mm * way_mm / np.linalg.norm(way_mm)
        return found


def _placed(nests: list[Nest], sigma_mm: float, rng: np.random.Generator) -> dict[str, Array]:
    return {nest.name: nest.xyz_mm + sigma_mm * _limited(rng, 3) for nest in nests}


def _limited(rng: np.random.Generator, size: int) -> Array:
    farthest_sigma = 2.0
    return rng.standard_normal(size).clip(-farthest_sigma, farthest_sigma)


class ReplayPlant:
    """A plant that replays: commanded joints in, the recorded measurement out.

    The data are rows of commanded joints and measured positions in the tracker's frame; one pose
    may carry several reflectors. Where the robot stands on no recorded pose, nothing is found. The
    rail stands where it was switched on. A replay has no floor and no slide nests, and no harm
    changes the recorded data. Raises `SettingsError` where the data cannot be read.
    """

    def __init__(self, cell: Cell, data: Path, time: PlantTime, faults: Faults) -> None:
        self.cell, self.time = cell, time
        self.rail = RailTruth(cell, 0, time, faults) if cell.has_rail else FloorTruth(cell)
        self.robot = RobotMotion(cell, time, lambda key: lambda: np.zeros(6))
        self.tracker = ReplayTracker(data, self.robot)
        self.streams: None = None

    def seat(self, place: str) -> None:
        """Refuse: the recorded reflectors stay; raises `ValueError`."""
        raise ValueError("the reflectors of recorded data are where they were")


class Struck(NamedTuple):
    """The motion after its faults: its target (6,), whether it is frozen or never acknowledged."""

    target_deg: Array
    frozen: bool
    keeps_acknowledge: bool


def strike(faults: Faults, plant: Plant | ReplayPlant, target_deg: Array) -> Struck:
    """Let the faults that strike when a robot's motion to joints (6,) starts happen."""
    number = faults.number
    lost_zeros = (
        "robot.lost_zero",
        "robot.lost_zero_2",
        "robot.lost_zero_3",
        "robot.lost_zero_4",
        "robot.lost_zero_5",
        "robot.lost_zero_6",
    )
    lost_deg = {axis: number(fault) for axis, fault in enumerate(lost_zeros, start=1)}
    slipped_mm, lost_urad = number("robot.mount_slip"), number("robot.lost_motion")
    um_m, slip_deg = number("robot.growing"), number("robot.brake_slips")
    if isinstance(plant, Plant):  # nothing harms recorded data
        for axis, each_deg in lost_deg.items():
            if each_deg is not None:
                plant.lose_zero(float(np.radians(each_deg)), axis)
        plant.slip_mount(slipped_mm or 0.0)
        plant.lose_motion(1e-6 * (lost_urad or 0.0))
        if um_m is not None:
            plant.grow(um_m)
        if slip_deg is not None:
            plant.loosen(2, float(np.radians(slip_deg)))
    keeps_acknowledge = faults.take("robot.ack_previous") is not None
    frozen = faults.take("robot.frozen") is not None
    target_deg = target_deg - (number("robot.stops_short") or 0.0)
    if faults.take("robot.wrong_turn") is not None:
        target_deg = target_deg + np.array([0.0] * 5 + [360.0])
    return Struck(target_deg, frozen, keeps_acknowledge)
