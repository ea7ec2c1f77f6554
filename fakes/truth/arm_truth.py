"""The true robot: misaligned axes, and joints whose angles differ from the commanded ones.

Joint errors are gravity, harmonics, gear ripple, elasticity and lost motion; all but lost motion
and repeatability depend on the joint angles alone. Loads follow from the links' direction to
gravity, not from the maker's angle convention.

All but ripple, lost motion, repeatability and growth are scaled together, over the machine's own
reference cube, to the paper's error: against the base frame built from the circles of axes 1 and 6,
here without noise. This ideal {B} is not the frame in which the axes are drawn;
`ideal_base` relates them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import msgspec
import numpy as np

from fakes.truth.machine import Errors, Machine, Transmission, mounted
from fakes.truth.transforms import Array, Chain, frame, rigid, rotation, transform_point
from hilcell.cell.tables import Point
from hilcell.decoding import decoded
from hilcell.ports import HilcellError

URAD = 1e-6


class Ripple:
    """Gear ripple of six joints: one to three harmonics each, whose size may follow the load."""

    def __init__(self, sizes: Transmission, rng: np.random.Generator) -> None:
        most_harmonics = 3
        amplitude, cycles = np.zeros((6, most_harmonics + 1)), np.ones((6, most_harmonics + 1))
        for joint in range(6):
            pins = rng.integers(*sizes.pins, endpoint=True)
            ratio = rng.integers(*sizes.ratios, endpoint=True)
            count = int(rng.integers(1, most_harmonics + 1))
            listed = rng.permutation([pins, 2 * pins, ratio, 2 * ratio])[:count]
            share = rng.uniform(0.3, 1.0, count)
            cycles[joint, :count] = listed
            amplitude[joint, :count] = sizes.ripple_urad * URAD * share / np.linalg.norm(share)
        amplitude[:, -1] = sizes.unlisted_urad * URAD
        unlisted_cycles = (52.0, 149.0)  # between pins and ratios, never a whole number
        cycles[:, -1] = rng.uniform(*unlisted_cycles, 6)
        for band in sizes.band:
            size_rad = band.rms_urad * URAD * np.sqrt(2.0 / band.lines)
            amplitude = np.hstack([amplitude, np.full((6, band.lines), size_rad)])
            cycles = np.hstack([cycles, rng.uniform(*band.cycles, (6, band.lines))])
        self.amplitude_rad, self.cycles = amplitude, cycles
        self.phase_rad = rng.uniform(0.0, 2 * np.pi, amplitude.shape)
        self._resonance_rad_s, self._damping = 2 * np.pi * sizes.resonance_hz, sizes.damping

    def __call__(self, joints_rad: Array, rates_rad_s: Array | None = None) -> Array:
        """Return the ripple (..., 6) at joints (..., 6); None: at rest.

        A turning gear drives the link through the compliance of the joint: each wave is that of a
        resonator driven at its frequency, once the beginning of the motion has faded.
        """
        phase = self.cycles * joints_rad[..., None] + self.phase_rad
        if rates_rad_s is None:
            waves = np.sin(phase)
        else:
            share = self.cycles * rates_rad_s[..., None] / self._resonance_rad_s
            waves = (np.exp(1j * phase) / (1.0 - share**2 + 2j * self._damping * share)).imag
        ripple: Array = (self.amplitude_rad * waves).sum(axis=-1)
        return ripple


def unit_rp_mm(jacobians_mm: Array) -> Array:
    """Return RP (N,) for independent normal noise of 1 rad in every joint.

    RP = mean + 3 s of the 3-D distances from the mean position (ISO 9283, 7.2.2).
    ``jacobians_mm`` (N, 3, 6) are d(position) / d(joints). With eigenvalues l of the covariance J
    J', mean distance = 1 / (2 sqrt(pi)) * integral of (1 - prod (1 + 2 l t)^-1/2) t^-3/2 dt, the
    usual form of E[sqrt(Q)] for a quadratic form Q; its mean square is the trace.
    """
    eigenvalues = np.linalg.eigvalsh(jacobians_mm @ np.swapaxes(jacobians_mm, -1, -2))
    total = eigenvalues.sum(axis=-1)
    shares = eigenvalues / total[:, None]
    # substitution t = exp(u) for the integral; the range covers distances of any shape
    exponents = np.linspace(-30.0, 30.0, 601)
    t = np.exp(exponents)
    left = 1.0 - np.prod(1.0 / np.sqrt(1.0 + 2.0 * shares[:, :, None] * t), axis=1)
    step = exponents[1] - exponents[0]
    mean = (left / np.sqrt(t)).sum(axis=-1) * step / (2.0 * np.sqrt(np.pi))
    rp: Array = np.sqrt(total) * (mean + 3.0 * np.sqrt(1.0 - mean**2))
    return rp


class Design:
    """An arm as designed; its last frame is the reflector's, mounted at ``smr_mm`` (3,).

    Its axes 2 and 3 are level, parallel and turn alike.
    """

    def __init__(self, machine: Machine, smr_mm: Point) -> None:
        self.chain = machine.chain(smr_mm)
        self.targets_mm, self.commands_rad = reference_cube(machine, self.chain)
        for shared in (self.targets_mm, self.commands_rad):
            shared.flags.writeable = False
        shoulder_mm, elbow_mm, wrist_mm = self.chain.points_mm[[1, 2, 4]]
        axis = self.chain.axes[1]
        ahead = np.cross(axis, np.array([0.0, 0.0, 1.0]))
        # of upper arm and forearm against the horizontal, at joints zero
        self._upper_rad, self._fore_rad = (
            float(np.arctan2(axis @ np.cross(ahead, link), ahead @ link))
            for link in (elbow_mm - shoulder_mm, wrist_mm - elbow_mm)
        )
        levers_mm = self._levers_mm(self.commands_rad)
        low, high = levers_mm.min(axis=0), levers_mm.max(axis=0)
        least_mm = 1.0  # a lever that changes by less counts as constant
        self._middle_mm, self._half_mm = (low + high) / 2, np.maximum((high - low) / 2, least_mm)
        of_axes = Chain(self.chain.axes, self.chain.points_mm, self.chain.last)
        jacobians_mm = of_axes.jacobian(self.chain.turns(self.commands_rad))[:, :3]
        self.unit_rp_mm = float(unit_rp_mm(jacobians_mm).mean())
        self.axis_6_rad: Array = self.chain.commands(np.radians(machine.reference.axis_6_deg))
        self.axis_6_mm = axis_6(self.chain, self.axis_6_rad)[1]

    def slopes(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return the angles (...) of upper arm and forearm at joints (..., 6)."""
        turned = self.chain.turns(joints_rad)
        upper = turned[..., 1]
        return upper + self._upper_rad, upper + turned[..., 2] + self._fore_rad

    def loads(self, joints_rad: Array) -> Array:
        """Return the relative load of each joint (..., 6), -1 to 1, at joints (..., 6).

        By the horizontal lever of the reflector; -1 and 1 are the extremes over the reference cube.
        """
        loads: Array = (self._levers_mm(joints_rad) - self._middle_mm) / self._half_mm
        return np.clip(loads, -1.0, 1.0)

    def _levers_mm(self, joints_rad: Array) -> Array:
        levers: Array = np.linalg.norm(self.chain.levers(joints_rad)[..., :2], axis=-1)
        return levers


@lru_cache(4)  # a study has few designs, and draws many robots of each
def _design(machine: bytes, smr_mm: Point) -> Design:
    return Design(decoded(machine, Machine), smr_mm)


def reference_cube(machine: Machine, chain: Chain) -> tuple[Array, Array]:
    """Return targets (N, 3) in {B} through the machine's cube, and joints (N, 6) to command."""
    reference = machine.reference
    centre = frame(reference.centre)
    axes = [
        middle_mm + size_mm * np.linspace(-0.5, 0.5, reference.points)
        for middle_mm, size_mm in zip(centre[:3, 3], reference.size_mm, strict=True)
    ]
    targets_mm = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    poses = np.tile(centre, (len(targets_mm), 1, 1))
    poses[:, :3, 3] = targets_mm
    return targets_mm, chain.solve(poses, chain.commands(np.radians(reference.start_deg)))


def axis_6(chain: Chain, joints_rad: Array) -> tuple[Array, Array]:
    """Return axis 6 (3,) and the centre (3,) of the reflector's circle about it."""
    axis, on_axis_mm = chain.lines(joints_rad)[0][5]
    reflector_mm = chain.pose(joints_rad)[:3, 3]
    return axis, on_axis_mm + ((reflector_mm - on_axis_mm) @ axis) * axis


class Deviations(NamedTuple):
    """Deviations that are scaled together: axes 2 to 6, the reflector, the joints."""

    shift_mm: Array  # (5, 3) of everything from this axis on
    tilt_rad: Array  # (5, 3) about a point on it
    zero_rad: Array  # (6,)
    tool_mm: Array  # (3,)
    gravity_rad: Array  # (6,)
    harmonics_rad: Array  # (6, 2 n): cosines and sines
    elastic_rad: Array  # ()

    @classmethod
    def drawn(cls, sizes: Errors, design: Chain, rng: np.random.Generator) -> Deviations:
        """Draw those of one arm; gravity pulls mostly down."""
        normal = rng.standard_normal
        tilt_rad = sizes.twist_urad * URAD * normal((5, 3))
        along = (tilt_rad * design.axes[1:]).sum(axis=1, keepdims=True)  # that is the joint's zero
        shift_mm = sizes.length_mm * normal((5, 3))
        zero_rad, tool_mm = sizes.zero_urad * URAD * normal(6), sizes.tool_mm * normal(3)
        main = np.array([1.0, 0.0, 1.0, 0.0, 1.0, 0.0])
        gravity = main * rng.uniform(0.5, 1.5, 6) * sizes.gravity_urad
        gravity += (1.0 - main) * normal(6) * sizes.gravity_side_urad
        waves = np.repeat(sizes.harmonics_urad, 2)
        harmonics = normal((6, len(waves))) * waves
        elastic = np.array(sizes.elastic_urad * float(rng.uniform(0.5, 1.5)))
        joints = (gravity * URAD, harmonics * URAD, elastic * URAD)
        return cls(shift_mm, tilt_rad - along * design.axes[1:], zero_rad, tool_mm, *joints)

    def scaled(self, factor: float) -> Deviations:
        return Deviations(*(each * factor for each in self))

    def deflection(self, joints_rad: Array, upper: Array, fore: Array) -> Array:
        """Return the deflection of joints (..., 6), with upper arm and forearm at angles (...)."""
        orders = np.arange(1, self.harmonics_rad.shape[1] // 2 + 1)
        angles = joints_rad[..., None] * orders
        waves = np.empty((*angles.shape, 2))
        np.cos(angles, out=waves[..., 0])
        np.sin(angles, out=waves[..., 1])
        bent: Array = (self.harmonics_rad * waves.reshape(*joints_rad.shape, -1)).sum(axis=-1)
        g = self.gravity_rad
        level, fore_level, fore_sine = np.cos(upper), np.cos(fore), np.sin(fore)
        second = bent[..., 1] + (g[0] * level + g[1] * np.sin(upper))
        second = second + (g[2] * fore_level + g[3] * fore_sine)
        bent[..., 1] = second + self.elastic_rad * level * fore_level
        bent[..., 2] += g[4] * fore_level + g[5] * fore_sine
        return bent


class ArmTruth:
    """One robot's true geometry; its poses are in its own base frame {R}.

    ``smr_mm`` (3,) is the reflector's place on the flange. Raises `HilcellError` where no draw
    gives the errors' sizes.
    """

    DRAWS = 100

    def __init__(self, machine: Machine, smr_mm: Point, rng: np.random.Generator) -> None:
        self._machine, self._smr_mm = machine, smr_mm
        self._design = _design(msgspec.json.encode(machine), smr_mm)
        self.design = self._design.chain
        sizes = machine.transmission
        self.ripple = Ripple(sizes, rng)
        self.lost_rad = np.zeros(6)
        gap_spread = 0.2  # of the half-gaps, over and under the machine's
        self.half_gap_rad = (
            sizes.half_gap_urad * URAD * rng.uniform(1.0 - gap_spread, 1.0 + gap_spread, 6)
        )
        self.targets_mm, self.commands_rad = self._design.targets_mm, self._design.commands_rad
        self.joint_sigma_rad = sizes.rp_mm / self._design.unit_rp_mm
        self.slip_rad = np.zeros(6)  # of brakes
        self._draw(machine.errors, rng)

    def pose(self, joints_rad: Array, side: Array, landing_rad: Array, warm_k: float = 0) -> Array:
        """The reflector's frame in {R}, (..., 4, 4).

        ``joints_rad`` (..., 6): the controller's; ``side`` (..., 6): sign of each joint's last
        motion; ``landing_rad`` (..., 6): repeatability error; ``warm_k``: of the arm above the mean
        ambient.
        """
        true_rad = self.true_joints(joints_rad, side, landing_rad)
        return self.reflector_pose(true_rad, self.strain(warm_k))

    def true_joints(
        self, joints_rad: Array, side: Array, landing_rad: Array, rates_rad_s: Array | None = None
    ) -> Array:
        """Return the true turns about the axes (..., 6), which do not depend on temperature.

        ``rates_rad_s`` (..., 6): of the joints; None at rest.
        """
        lost = side * self.half_gap_rad + landing_rad
        return self._by_angles(joints_rad, rates_rad_s) + lost

    def strain(self, warm_k: float) -> float:
        return self._machine.transmission.growth_um_m_k * 1e-6 * warm_k

    def reflector_pose(self, true_rad: Array, strain: float) -> Array:
        """Return the reflector's frame in {R}, (..., 4, 4), at true joint angles."""
        return self._chain.pose(true_rad, strain)

    def errors_mm(self, commands_rad: Array, targets_mm: Array) -> Array:
        """Return e = actual - nominal (N, 3) in the ideal {B}, without noise, from below."""
        from_below = np.ones_like(commands_rad)
        at_mm = self.pose(commands_rad, from_below, np.zeros(6))[:, :3, 3]
        R, origin_mm = self.ideal_base[:3, :3], self.ideal_base[:3, 3]
        return (at_mm - origin_mm) @ R - targets_mm

    def _draw(self, sizes: Errors, rng: np.random.Generator) -> None:
        """Draw until the largest error of a scaled draw is within its limit."""
        for _ in range(self.DRAWS):
            drawn = Deviations.drawn(sizes, self.design, rng)
            self._scale(sizes, drawn)
            errors_mm = self.errors_mm(self.commands_rad, self.targets_mm)
            if np.linalg.norm(errors_mm, axis=1).max() <= sizes.largest_mm:
                return
        raise HilcellError(
            f"errors.largest_mm: none of {self.DRAWS} draws keeps every error below "
            f"{sizes.largest_mm} mm; increase it, or reduce errors.size_mm"
        )

    def _scale(self, sizes: Errors, drawn: Deviations) -> None:
        """Scale the draw to the machine's error size, by the secant method."""
        factor, before = 1.0, 0.5
        value, value_before = self._size_mm(drawn, factor), self._size_mm(drawn, before)
        solved_mm = 1e-10
        for _ in range(50):
            if abs(value - sizes.size_mm) < solved_mm:
                return
            if value == value_before:  # no factor changes it: nothing but ripple is drawn
                break
            slope = (value - value_before) / (factor - before)
            before, value_before = factor, value
            factor += (sizes.size_mm - value) / slope
            value = self._size_mm(drawn, factor)
        raise HilcellError(
            f"errors.size_mm: no draw has errors of size {sizes.size_mm} mm; change it, or the "
            "sizes of its components"
        )

    def _size_mm(self, drawn: Deviations, factor: float) -> float:
        self._apply(drawn.scaled(factor))
        errors_mm = self.errors_mm(self.commands_rad, self.targets_mm)
        if self._machine.errors.scaled_by == "mean":
            return float(np.linalg.norm(errors_mm, axis=1).mean())
        return varying_rms_mm(self.targets_mm, errors_mm)

    def _apply(self, errors: Deviations) -> None:
        self._errors = errors
        design = self.design
        # the design with each axis from the second on displaced, and all distal axes with it
        axes, points_mm = design.axes.copy(), design.points_mm.copy()
        moved = np.eye(4)
        displacements = zip(errors.shift_mm, errors.tilt_rad, strict=True)
        for joint, (shift_mm, tilt_rad) in enumerate(displacements, 1):
            R, at_mm = rotation(tilt_rad), design.points_mm[joint]
            moved = moved @ rigid(R, at_mm - R @ at_mm + shift_mm)
            axes[joint] = moved[:3, :3] @ design.axes[joint]
            points_mm[joint] = transform_point(moved, at_mm)
        tool_mm = np.array(self._smr_mm) + errors.tool_mm
        last = mounted(frame(self._machine.flange), (tool_mm[0], tool_mm[1], tool_mm[2]))
        self._chain = Chain(axes, points_mm, moved @ last)  # of the turns about the axes
        self.ideal_base = self._base_from_axes(self._design.axis_6_rad)

    def _by_angles(self, joints_rad: Array, rates_rad_s: Array | None = None) -> Array:
        """Return turns about the axes (..., 6) with all errors that depend on them alone."""
        turned_rad = self.design.turns(joints_rad)
        turning = None if rates_rad_s is None else self.design.turns(rates_rad_s)
        ripple = self.ripple(turned_rad, turning)
        share = self._machine.transmission.load_share
        if share:
            ripple *= 1.0 + share * self._design.loads(joints_rad)
        bent = self._errors.deflection(turned_rad, *self._design.slopes(joints_rad))
        return turned_rad + self._errors.zero_rad + self.lost_rad + bent + ripple

    def _base_from_axes(self, axis_6_rad: Array) -> Array:
        """Return the ideal {B} in {R}, (4, 4), as a base frame is measured.

        Axis 1 is {R}'s z. Axis 6 at these joints gives x, and the centre of its circle the height,
        which is nominal by definition.
        """
        joints = self._by_angles(axis_6_rad) + self.half_gap_rad
        axis, centre_mm = axis_6(self._chain, joints)
        x = np.array([axis[0], axis[1], 0.0]) * np.sign(centre_mm[:2] @ axis[:2])
        x /= np.linalg.norm(x)
        z = np.array([0.0, 0.0, 1.0])
        height_mm = centre_mm[2] - self._design.axis_6_mm[2]
        return rigid(np.column_stack([x, np.cross(z, x), z]), height_mm * z)


def varying_rms_mm(targets_mm: Array, errors_mm: Array) -> float:
    """Return the RMS of |e| that the best small rigid motion leaves, for points (N, 3)."""
    levers_mm = targets_mm - targets_mm.mean(axis=0)
    turns = [np.cross(axis, levers_mm).ravel() for axis in np.eye(3)]
    shifts = [np.tile(axis, len(levers_mm)) for axis in np.eye(3)]
    motion = np.column_stack([*shifts, *turns])
    left = errors_mm.ravel() - motion @ np.linalg.lstsq(motion, errors_mm.ravel(), rcond=None)[0]
    return float(np.sqrt((left**2).sum() / len(errors_mm)))
