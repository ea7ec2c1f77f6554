"""The one physical truth of a simulated cell: rail, robot, tracker, nests, and how they stand.

Frames: {W} world, {S} the slide as the cell file thinks it (nominal {B}), {R} the robot's own
base frame, which is bolted a little askew on the slide, {T} the reflector on the flange. The
seed fixes the truth and the noise; a cell that is started anew draws it anew from its
beginning. The trap: nominal {B} is not {R} and neither
is what a calibration finds; that is `base_in_world`.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fakes.arm_truth import ArmTruth
from fakes.faults import Faults
from fakes.noise import KeyedNoise
from fakes.rail_truth import RailTruth
from fakes.robot_motion import RobotMotion
from fakes.time import PlantTime
from fakes.tracker_truth import TrackerTruth
from hilcell.cell import Cell, Nest
from hilcell.geometry.frames import apply
from hilcell.geometry.kinematics import Array

AXIS_REPEATABILITY_RAD = 16.6e-6  # RP 0.06 mm
BOLTED_MM, BOLTED_RAD = 1.2, 5e-4  # 1 sigma of the robot on the slide
FLOOR_NEST_MM, SLIDE_NEST_MM = 1.0, 1.2  # 1 sigma of each coordinate
FARTHEST_SIGMA = 2.0
FLANGE = "flange"


class Plant:
    """One simulated cell."""

    def __init__(self, cell: Cell, seed: int, time: PlantTime, faults: Faults) -> None:
        fixed, landing = KeyedNoise(seed), KeyedNoise(seed, "robot")
        self.cell, self.time = cell, time
        self.rail = RailTruth(cell, seed, time, faults)
        self.robot = RobotMotion(
            cell, time, lambda key: AXIS_REPEATABILITY_RAD * landing.normal(key, 6)
        )
        self.arm = ArmTruth(cell, fixed.generator("arm"))
        self._bolted = _bolted(fixed.generator("base"))
        self._floor = _placed(cell.layout.floor, FLOOR_NEST_MM, fixed.generator("floor"))
        self._slide = _placed(cell.layout.slide, SLIDE_NEST_MM, fixed.generator("slide"))
        self.seated = ""  # where the one reflector is that is carried by hand; "": out of sight
        self.tracker = TrackerTruth(cell, seed, faults, self.reflectors_in_world)

    def lose_zero(self, axis_1_rad: float) -> None:
        """Turn the robot's axis 1 against its encoder for good, by turning its base."""
        turn = np.eye(4)
        angle = self.cell.robot.joint[0].sign * axis_1_rad
        turn[:3, :3] = Rotation.from_euler("z", angle).as_matrix()
        self._bolted = self._bolted @ turn

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

    def places_in_world(self) -> dict[str, Array]:
        """Return where a reflector (3,) in each nest and on the flange really is, in {W}."""
        T_W_S = self.rail.slide_pose()
        found = dict(self._floor)
        found |= {name: apply(T_W_S, at_mm[None])[0] for name, at_mm in self._slide.items()}
        found[FLANGE] = (T_W_S @ self._bolted @ self._tool())[:3, 3]
        return found

    def base_in_world(self) -> Array:
        """Return the base frame (4, 4) in {W} that a faultless section 4.2 would find now."""
        base: Array = self.rail.slide_pose() @ self._bolted @ self.arm.ideal_base
        return base

    def _tool(self) -> Array:
        state = self.robot.state()
        return self.arm.pose(state.joints_rad, state.side, state.landing_rad)


def _bolted(rng: np.random.Generator) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(BOLTED_RAD * _limited(rng, 3)).as_matrix()
    T[:3, 3] = BOLTED_MM * _limited(rng, 3)
    return T


def _placed(nests: list[Nest], sigma_mm: float, rng: np.random.Generator) -> dict[str, Array]:
    return {nest.name: nest.xyz_mm + sigma_mm * _limited(rng, 3) for nest in nests}


def _limited(rng: np.random.Generator, size: int) -> Array:
    return rng.standard_normal(size).clip(-FARTHEST_SIGMA, FARTHEST_SIGMA)
