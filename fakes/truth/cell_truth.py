"""The one physical truth of a simulated cell: a machine's rail, robot, tracker and nests.

Frames: {W} world, {S} the slide as the cell file assumes it (nominal {B}), {R} the robot's own base
frame, bolted slightly askew on the slide, {T} the tool point on the flange. Machine and seed
determine truth and noise, whatever the plan measures; a restarted cell draws the same values again.
A calibration identifies neither nominal {B} nor {R}, but `base_in_world`.

`ReplayTruth` replays recorded data in place of a machine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fakes.faults import Faults
from fakes.time import CellTime
from fakes.truth.arm_truth import ArmTruth
from fakes.truth.machine import cell_machine
from fakes.truth.noise import KeyedNoise
from fakes.truth.person import Person
from fakes.truth.rail_truth import FloorTruth, RailTruth
from fakes.truth.robot_motion import RobotMotion, RobotState
from fakes.truth.tracker_truth import ReplayTracker, StreamTruth, TrackerTruth
from fakes.truth.transforms import Array, frame, rigid, rotation, transform_point
from hilcell.cell.file import Cell, Nest
from hilcell.cell.layout import Layout
from hilcell.cell.settings import SettingsError
from hilcell.cell.surroundings import KeepOut
from hilcell.ports import HilcellError

FLANGE = "flange"


class CellTruth:
    """One simulated cell."""

    def __init__(
        self, cell: Cell, seed: int, time: CellTime, faults: Faults, run_seed: int | None = None
    ) -> None:
        """``seed``: of the machine; ``run_seed``: of the run, as of `KeyedNoise`. Raises
        `SettingsError` for an impossible machine.
        """
        fixed, landing = KeyedNoise(seed), KeyedNoise(seed, "robot", run_seed)
        machine = cell_machine(cell)
        mounting = machine.mounting
        self.cell, self.time = cell, time
        self.rail = (
            RailTruth(cell, seed, time, faults, run_seed) if cell.has_rail else FloorTruth(cell)
        )
        try:
            self.arm = ArmTruth(machine, cell.robot.smr_mm, fixed.generator("arm"))
        except HilcellError as error:
            name = "" if cell.simulation is None else cell.simulation.machine
            raise SettingsError(f"simulation.machine {name!r}", [str(error)]) from error

        def landing_errors(key: str) -> Callable[[], Array]:
            draw = landing.later_normal(key, 6)
            return lambda: np.hypot(self.arm.joint_sigma_rad, self.arm.slip_rad) * draw()

        self.robot = RobotMotion(cell, time, landing_errors)
        rng = fixed.generator("base")
        tilt_rad = mounting.bolted_urad * 1e-6 * _limited(rng, 3)
        self._T_S_R = rigid(rotation(tilt_rad), mounting.bolted_mm * _limited(rng, 3))
        self._slip_pose = np.eye(4)
        self._growing, self._grows_since = 0.0, 0
        rng = fixed.generator("seats")  # of the other reflectors, from the first and in its axes
        from_first_mm = np.array(cell.robot.more_smr_mm).reshape(-1, 3) - cell.robot.smr_mm
        self._seats: dict[str, Array] = {
            f"{FLANGE} {number}": at_mm + mounting.seat_mm * _limited(rng, 3)
            for number, at_mm in enumerate(from_first_mm, start=2)
        }
        layout, floor_mm, draw = cell.layout, mounting.floor_nest_mm, fixed.generator
        self._floor_nests = _placed(layout.floor, floor_mm, draw("floor"))
        self._floor_nests |= self._bars(layout, floor_mm, draw("bars"))
        self._slide_nests = _placed(layout.slide, mounting.slide_nest_mm, draw("slide"))
        self._joints_cache: tuple[RobotState | None, Array] = (None, np.zeros(6))  # the true joints
        self._base_cache: tuple[float, Array, dict[str, Array]] = (math.nan, np.eye(4), {})
        self._places_cache: tuple[tuple[Array, Array, float], dict[str, Array]] | None = None
        self.reflector_at = ""  # place of the one reflector carried by hand; "": out of sight
        self.tracker = TrackerTruth(cell, seed, faults, self.reflectors_in_world, run_seed)
        self.streams = StreamTruth(seed, self.robot, self.tracker, self.path_in_world, run_seed)
        taught = [] if cell.volumes is None else cell.volumes.teach
        self._corners = corners_in_world([each for each in cell.keep_out if each.name in taught])
        self._in_hand = ""  # the corner at which the person holds a further reflector
        by_hand = cell.layout.by_hand  # then bars come later, in the run
        at_first = [nest.name for nest in layout.floor] if by_hand else [*self._floor_nests]
        self._person = Person(
            (at_first, [FLANGE], [nest.name for nest in cell.layout.slide]),
            [*self._corners],
            fixed.generator("person"),
            time,
        )

    def release_beam(self) -> None:
        """Let the person in the hall take the beam."""
        self._person.take_beam()

    def keep_beam(self) -> None:
        """Let the tracker aim by itself again."""
        self._in_hand = ""
        self._person.leave_beam()

    def begin_round(self) -> None:
        """Let the person who carries the only reflector begin again at the first nest."""
        if self.cell.layout.by_hand:
            self._person.begin_again()

    def aimed_at(self) -> str | None:
        """Return, once, the nest that the person has put the beam on; None before."""
        place = self._person.put_down()
        if place is not None:
            self._in_hand = place if place in self._corners else ""
            if self.cell.layout.by_hand and not self._in_hand:
                self.reflector_at = place  # it was carried there in the beam
        return place

    def lose_zero(self, lost_rad: float, axis: int = 1) -> None:
        """Shift the zero of an axis of the robot, 1 to 6, permanently."""
        self.arm.lost_rad[axis - 1] += lost_rad
        self._forget()

    def lose_motion(self, lost_rad: float) -> None:
        """Widen the backlash of axis 3 of the robot, permanently."""
        if lost_rad:
            self.arm.half_gap_rad[2] += lost_rad / 2
            self._forget()

    def grow(self, um_m: float) -> None:
        """Let the arm grow from now on, by ``um_m`` in 1000 of the tracker's measurements."""
        self._growing, self._grows_since = 1e-6 * um_m, self.tracker.measured

    def loosen(self, axis: int, slip_rad: float) -> None:
        """Let the brake of an axis, 1 to 6, slip at random at each stop (1 sigma), permanently."""
        self.arm.slip_rad[axis - 1] = slip_rad

    def slip_mount(self, along_mm: float) -> None:
        self._slip_pose[0, 3] += along_mm
        self._forget()

    def place_reflector(self, place: str) -> None:
        """Move the reflector to a nest, the flange, or (empty) away; raises `ValueError`."""
        if not self.cell.layout.by_hand:
            raise ValueError("the reflectors of this cell are mounted")
        places = [*self._floor_nests, *self._slide_nests, FLANGE, ""]
        if place not in places:
            raise ValueError(f"place {place!r} is none of {', '.join(places)}")
        self.reflector_at = place

    def carry_reflector(self, near_mm: Array) -> None:
        """Move the reflector to the place nearest to (3,), tracker's frame; raises `ValueError`."""
        near = transform_point(self.tracker.pose_in_world, near_mm).tolist()
        places = self.places_in_world()
        off_mm = {name: math.dist(at_mm.tolist(), near) for name, at_mm in places.items()}
        self.place_reflector(min(off_mm, key=off_mm.__getitem__))

    def reflectors_in_world(self) -> dict[str, Array]:
        """Return the visible reflectors (3,) in {W}, by their place."""
        places = self.places_in_world()
        if self.cell.layout.by_hand:
            place = self.reflector_at
            places = {place: places[place]} if place else {}
        in_hand = self._in_hand
        return places | {in_hand: self._corners[in_hand]} if in_hand else places

    def path_in_world(self, name: str, times_s: Array) -> Array:
        """Return the true positions (N, 3) of a reflector in {W} at times (N,) up to now.

        Empty where it is out of sight. Assumes that the slide is at rest.
        """
        if self.cell.layout.by_hand and name != self.reflector_at:
            return np.zeros((0, 3))
        if name != FLANGE and name not in self._seats:
            return np.tile(self.places_in_world()[name], (len(times_s), 1))
        joints_rad, side, landing_rad = self.robot.past(times_s)
        rates_rad_s = self._rates_rad_s(times_s, joints_rad)
        true_rad = self.arm.true_joints(joints_rad, side, landing_rad, rates_rad_s)
        arm = self.arm.reflector_pose(true_rad, self._strain()) @ self._slip_pose
        tool = self.rail.slide_pose() @ self._T_S_R @ arm
        return tool[:, :3, 3] + tool[:, :3, :3] @ self._seats.get(name, np.zeros(3))

    def places_in_world(self) -> dict[str, Array]:
        """Return the true position (3,) in {W} of a reflector in each nest and on the flange."""
        true_rad, strain = self._true_joints(), self._strain()
        base, around = self._base_and_nests()
        if self._places_cache is not None:  # several calls a measurement at rest
            (cached_rad, cached_base, cached_strain), places = self._places_cache
            if true_rad is cached_rad and base is cached_base and strain == cached_strain:
                return places
        tool = base @ self.arm.reflector_pose(true_rad, strain) @ self._slip_pose
        places = around | {FLANGE: tool[:3, 3]}
        places |= {name: transform_point(tool, at_mm) for name, at_mm in self._seats.items()}
        self._places_cache = ((true_rad, base, strain), places)
        return places

    def _strain(self) -> float:
        grown = self._growing * (self.tracker.measured - self._grows_since) / 1000.0
        return self.arm.strain(self.tracker.warm_k) + grown

    def _true_joints(self) -> Array:
        """Return the true joint angles (6,): the same array while the robot is at rest."""
        robot = self.robot.state()
        cached, true_rad = self._joints_cache
        if robot is not cached:
            now_s, rates_rad_s = np.array([self.time.now_s()]), None
            if robot.moving:
                rates_rad_s = self._rates_rad_s(now_s, robot.joints_rad)[0]
            true_rad = self.arm.true_joints(
                robot.joints_rad, robot.side, robot.landing_rad, rates_rad_s
            )
            self._joints_cache = (robot, true_rad)
        return true_rad

    def _rates_rad_s(self, times_s: Array, joints_rad: Array) -> Array:
        """Return the rates (N, 6) of the controller's joints, which are at (N, 6) at times (N,)."""
        before_s = 1e-3
        rates_rad_s: Array = (joints_rad - self.robot.past(times_s - before_s)[0]) / before_s
        return rates_rad_s

    def _base_and_nests(self) -> tuple[Array, dict[str, Array]]:
        """Return {R} (4, 4) and all nests, in {W}: the same objects while the slide is at rest."""
        slide_mm = self.rail.slide_mm()
        at_mm, base, nests = self._base_cache
        if slide_mm != at_mm:
            T_W_S = self.rail.slide_pose()
            base = T_W_S @ self._T_S_R
            slide_nests = self._slide_nests.items()
            nests = self._floor_nests | {
                name: transform_point(T_W_S, nest_mm) for name, nest_mm in slide_nests
            }
            self._base_cache = (slide_mm, base, nests)
        return base, nests

    def _forget(self) -> None:
        self._joints_cache, self._places_cache = (None, np.zeros(6)), None

    def base_in_world(self) -> Array:
        """Return the base frame (4, 4) in {W} that circles of axes 1 and 6 give without errors."""
        return self.rail.slide_pose() @ self._T_S_R @ self.arm.ideal_base

    @staticmethod
    def _bars(layout: Layout, sigma_mm: float, rng: np.random.Generator) -> dict[str, Array]:
        nests = _placed(layout.bar, sigma_mm, rng)
        for bar in layout.length:
            one, other = bar.nests
            if one in nests and other in nests:
                along_mm = nests[other] - nests[one]
                nests[other] = nests[one] + bar.length_mm * along_mm / np.linalg.norm(along_mm)
        return nests


def corners_in_world(volumes: Sequence[KeepOut]) -> dict[str, Array]:
    """Return the corners (3,) of boxes in {W} that a person touches, in their order: three above,
    and one on the floor.
    """
    ends = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, -1]], dtype=float) / 2
    return {
        f"{volume.name} {n}": transform_point(frame(volume.centre), end * volume.size_mm)
        for volume in volumes
        for n, end in enumerate(ends, start=1)
    }


def _placed(nests: list[Nest], sigma_mm: float, rng: np.random.Generator) -> dict[str, Array]:
    return {nest.name: nest.xyz_mm + sigma_mm * _limited(rng, 3) for nest in nests}


def _limited(rng: np.random.Generator, size: int) -> Array:
    farthest_sigma = 2.0
    return rng.standard_normal(size).clip(-farthest_sigma, farthest_sigma)


class ReplayTruth:
    """A cell that replays: commanded joints in, the recorded measurement out.

    The data are rows of commanded joints and measured positions in the tracker's frame, of one or
    several reflectors a pose. No reflector is visible at other poses; the rail does not move; there
    are no floor nests or slide nests. Raises `SettingsError` where the data cannot be read.
    """

    def __init__(self, cell: Cell, data: Path, time: CellTime, faults: Faults) -> None:
        self.cell, self.time = cell, time
        self.rail = RailTruth(cell, 0, time, faults) if cell.has_rail else FloorTruth(cell)
        self.robot = RobotMotion(cell, time, lambda key: lambda: np.zeros(6))
        self.tracker = ReplayTracker(data, self.robot)
        self.streams: None = None

    def release_beam(self) -> None:
        """Nobody is in a hall that is replayed."""

    def keep_beam(self) -> None:
        """Let the tracker aim by itself again."""

    def begin_round(self) -> None:
        """Do nothing: nobody is there."""

    def aimed_at(self) -> None:
        """Return None: nobody has put the beam anywhere."""

    def place_reflector(self, place: str | Array) -> None:
        """Raise `ValueError`: recorded reflectors do not move."""
        raise ValueError("the reflectors of recorded data cannot be moved")

    carry_reflector = place_reflector


class MotionFaults(NamedTuple):
    """A motion with its faults: its target (6,), whether it freezes or is never acknowledged."""

    target_deg: Array
    frozen: bool
    acknowledge_lost: bool


def apply_start_faults(
    faults: Faults, truth: CellTruth | ReplayTruth, target_deg: Array
) -> MotionFaults:
    """Apply the faults that strike when a robot's motion to joints (6,) starts."""
    number = faults.number
    lost_zeros = (
        "robot.lost_zero", "robot.lost_zero_2", "robot.lost_zero_3",
        "robot.lost_zero_4", "robot.lost_zero_5", "robot.lost_zero_6",
    )  # fmt: skip
    lost_deg = {axis: number(fault) for axis, fault in enumerate(lost_zeros, start=1)}
    slipped_mm, lost_urad = faults.amount("robot.mount_slip"), faults.amount("robot.lost_motion")
    um_m, slip_deg = number("robot.growing"), number("robot.brake_slips")
    if isinstance(truth, CellTruth):  # faults do not change recorded data
        for axis, each_deg in lost_deg.items():
            if each_deg is not None:
                truth.lose_zero(float(np.radians(each_deg)), axis)
        truth.slip_mount(slipped_mm)
        truth.lose_motion(1e-6 * lost_urad)
        if um_m is not None:
            truth.grow(um_m)
        if slip_deg is not None:
            truth.loosen(2, float(np.radians(slip_deg)))
    acknowledge_lost = faults.strikes("robot.ack_previous")
    frozen = faults.strikes("robot.frozen")
    target_deg = target_deg - faults.amount("robot.stops_short")
    if faults.strikes("robot.wrong_turn"):
        target_deg = target_deg + np.array([0.0] * 5 + [360.0])
    return MotionFaults(target_deg, frozen, acknowledge_lost)
