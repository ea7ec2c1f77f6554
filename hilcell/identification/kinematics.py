"""A robot with kinematic errors: its unknown parameters, and the resulting reflector positions.

Unknown are the base frame, the reflectors on the flange, the link parameters (Denavit, Hartenberg,
Hayati), the deflection of axes by gravity and by a tool's weight, waves of each joint that repeat
once or a few times a revolution, and the amplitudes and shift of given transmission curves. Many
have the same effect (d of the parallel axes 2 and 3, base and first link, reflector and last link);
priors decide, so the parameters may be arbitrary where the positions are not. Weight acts on
revolute joints alone (`hilcell.identification.weight`); a prismatic joint has an error of its pitch
in place of waves.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from hilcell.geometry.frames import cross_matrix, from_rotvec, motion_levers
from hilcell.geometry.jacobian import KINDS, by_joints, tool_and_jacobian
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.identification.weight import (
    flange_levers_mm,
    gravity_basis,
    gravity_loads,
    tool_basis,
    tool_loads,
)


@dataclass(frozen=True, eq=False)
class TransmissionCurve:
    """Joint error ``sum_k A_k cos(n_k q) + B_k sin(n_k q)`` (rad) at commanded angles q (rad).

    ``cycles`` (K,) are n_k, ``amplitude_rad`` (K, 2) are A_k and B_k, ``covariance_rad2`` (2K, 2K)
    in the order A_1, B_1, A_2, ... K may be 0. The sweep determines q only up to the constant lag
    between tracker and controller: the curve is valid at ``q + shift_rad``, with
    ``shift_sigma_rad``.
    """

    axis: int
    cycles: Array
    amplitude_rad: Array
    covariance_rad2: Array
    shift_rad: float
    shift_sigma_rad: float
    low_rad: float
    high_rad: float
    noise_rad: float

    def basis(self, joint_rad: Array) -> Array:
        """Return cosines and sines (..., 2K) at commanded angles (...)."""
        phase = self.cycles * (np.asarray(joint_rad, dtype=float)[..., None] + self.shift_rad)
        pairs = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        return pairs.reshape(*phase.shape[:-1], 2 * len(self.cycles))

    def slope(self, joint_rad: Array) -> Array:
        """Return d(basis)/dq (..., 2K) at commanded angles (...)."""
        pairs = self.basis(joint_rad).reshape(*np.shape(joint_rad), len(self.cycles), 2)
        turned = np.stack([-pairs[..., 1], pairs[..., 0]], axis=-1) * self.cycles[:, None]
        return turned.reshape(*np.shape(joint_rad), 2 * len(self.cycles))

    def evaluate(self, joint_rad: Array) -> Array:
        """Return the joint's error (...) in rad at commanded angles (...)."""
        return self.basis(joint_rad) @ self.amplitude_rad.ravel()


BASE = 6


@dataclass(frozen=True, eq=False)
class State:
    """Values of the unknowns: base frame {B} in the readings' frame (4, 4), reflectors (K, 3) on
    the flange, and the joints' and links' parameters (V,) as differences from nominal.

    ``moved`` (P - V,): base and reflectors against their assumed values.
    """

    T: Array
    smr_mm: Array
    values: Array
    moved: Array


@dataclass(frozen=True, eq=False)
class Linearised:
    """Positions (M, K, 3), their derivatives by all parameters (M, K, 3, P), by the angles of the
    axes (M, K, 3, n).
    """

    positions_mm: Array
    by_parameter: Array
    by_joint: Array


@dataclass(frozen=True, slots=True)
class Placed:
    """Standard deviations of the assumed base and reflectors."""

    base_mm: float = 1000.0
    base_rad: float = 1.0
    reflector_mm: float = 1000.0


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Possible errors of a robot; ``arm`` is nominal, its tool frame is not used.

    Order of the P parameters: base (shift in mm, rotation vector about its origin), reflectors,
    links by kind and row, then, if requested, gravity, waves of ``orders`` a revolution, tool,
    curves. Gears err more under load: with ``levers_mm`` of the first axes, their curves grow by an
    unknown share of the relative growth of the flange's lever over these. ``learnt``: mean (P,) and
    covariance (P, P) of the parameters where an earlier calibration knows them.
    """

    arm: Arm
    reflectors: int = 1
    _: KW_ONLY
    gravity: bool = True
    waves: bool = True
    orders: tuple[int, ...] = (1, 2)
    tool: bool = False
    curves: tuple[TransmissionCurve, ...] = ()
    levers_mm: tuple[float, ...] = ()
    assumed: Placed = Placed()
    learnt: tuple[Array, Array] | None = None

    @property
    def placed(self) -> int:
        return BASE + 3 * self.reflectors

    @property
    def links(self) -> int:
        return len(KINDS) * len(self.arm)

    @property
    def names(self) -> list[str]:
        names = [f"base {axis} mm" for axis in "xyz"] + [f"base r{axis} rad" for axis in "xyz"]
        names += [f"reflector {k + 1} {axis} mm" for k in range(self.reflectors) for axis in "xyz"]
        for kind, unit in (each.rsplit("_", 1) for each in KINDS):
            names += [f"{kind}{row + 1} {unit}" for row in range(len(self.arm))]
        names += [f"axis {axis + 1}: {effect}" for axis, effect, _ in self._effects]
        for curve in self.curves:
            axis = f"axis {curve.axis + 1}"
            names += [f"{axis}: {w} {n:g}q rad" for n in curve.cycles for w in ("cos", "sin")]
            names.append(f"{axis}: shift rad")
            if self._grows(curve):
                names.append(f"{axis}: growth by lever")
        return names

    def _grows(self, curve: TransmissionCurve) -> bool:
        """Return whether the load changes a curve's size."""
        return curve.axis < len(self.levers_mm)

    def size(self, curve: TransmissionCurve) -> int:
        """Return the number of a curve's parameters: amplitudes, shift, growth."""
        return 2 * len(curve.cycles) + 1 + self._grows(curve)

    @cached_property
    def _effects(self) -> list[tuple[int, str, float]]:
        """Return which joint each parameter between links and curves turns, as what, and the 1
        sigma of its prior.
        """
        gravity_rad = 0.5e-3  # of the deflection at full load
        wave_rad = 50e-6  # of the amplitudes of one and two waves a revolution; half for three
        pitch = 1e-3  # of a prismatic joint's way
        waves = [
            (f"{wave} {order}q rad", wave_rad / max(order - 1, 1))
            for order in self.orders
            for wave in ("cos", "sin")
        ]
        drives: list[tuple[int, str, float]] = []
        for axis, turns in enumerate(self.arm.turning):
            if turns:
                drives += [(axis, *wave) for wave in waves]
            else:
                drives.append((axis, "pitch m/m", pitch))
        gravity, tool = gravity_loads(self.arm), tool_loads(self.arm)
        return [
            *((axis, f"{load} rad", gravity_rad) for axis, load in gravity if self.gravity),
            *(drives if self.waves else []),
            *((axis, f"{load} rad", gravity_rad) for axis, load in tool if self.tool),
        ]

    @cached_property
    def prior_root(self) -> Array:
        """Return W (P, P) with W'W the inverse of the prior's covariance."""
        covariance = self.prior[1]
        sigma = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        jitter = 1e-9  # of a prior's correlation, so that a singular one has a root
        correlation = covariance / np.outer(sigma, sigma) + jitter * np.eye(len(sigma))
        return np.linalg.inv(np.linalg.cholesky(correlation)) / sigma

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """The parameters' prior mean (P,) and covariance (P, P). Base and reflectors count from
        their assumed values.
        """
        if self.learnt is not None:
            return self.learnt
        length_mm, angle_rad = 1.0, 2e-3  # prior sigmas of link parameters
        links = [length_mm if kind.endswith("mm") else angle_rad for kind in KINDS]
        assumed = self.assumed
        sigmas = [
            *[assumed.base_mm] * 3, *[assumed.base_rad] * 3,
            *[assumed.reflector_mm] * (3 * self.reflectors),
            *np.repeat(links, len(self.arm)), *(sigma for _, _, sigma in self._effects),
        ]  # fmt: skip
        size = len(sigmas) + sum(map(self.size, self.curves))
        mean, covariance, grown = np.zeros(size), np.zeros((size, size)), list[int]()
        at = len(sigmas)
        covariance[:at, :at] = np.diag(np.square(sigmas))
        for curve in self.curves:
            end = at + 2 * len(curve.cycles)
            mean[at:end], mean[end] = curve.amplitude_rad.ravel(), curve.shift_rad
            covariance[at:end, at:end] = curve.covariance_rad2
            covariance[end, end] = max(curve.shift_sigma_rad, 1e-12) ** 2
            at += self.size(curve)
            if self._grows(curve):
                grown.append(at - 1)
        growth, alike = 1.0, 0.8  # as the load itself; those of one arm correlate
        covariance[np.ix_(grown, grown)] = growth**2 * alike
        covariance[grown, grown] = growth**2
        return mean, covariance

    def start(self, T: Array, smr_mm: Array) -> State:
        """Return the nominal robot at a base (4, 4) with reflectors (K, 3)."""
        return State(T, smr_mm, self.prior[0][self.placed :], np.zeros(self.placed))

    def flat(self, state: State) -> Array:
        return np.concatenate([state.moved, state.values])

    def moved(self, state: State, step: Array) -> State:
        R = from_rotvec(step[3:6])
        T = state.T.copy()
        T[:3, :3] = R @ T[:3, :3]
        T[:3, 3] += step[:3]
        smr_mm = state.smr_mm + step[BASE : self.placed].reshape(-1, 3)
        moved = state.moved + step[: self.placed]
        return State(T, smr_mm, state.values + step[self.placed :], moved)

    def arm_of(self, state: State) -> Arm:
        by_kind = state.values[: self.links].reshape(len(KINDS), -1)
        changed = {kind: getattr(self.arm, kind) + by_kind[n] for n, kind in enumerate(KINDS)}
        return replace(self.arm, tool=np.eye(4), coupling=0.0, **changed)

    def joints_of(self, state: State, joints_rad: Array) -> Array:
        """True angles of the axes (M, n), those of `arm_of`, at commanded joints (M, n)."""
        return self._bent(state, joints_rad)[0]

    def positions_mm(self, state: State, joints_rad: Array) -> Array:
        """Positions of the reflectors (M, K, 3) at commanded joints (M, n)."""
        flange = state.T @ forward(self.arm_of(state), self.joints_of(state, joints_rad))
        return self._carried(flange, state.smr_mm)

    def linearised(self, state: State, joints_rad: Array) -> Linearised:
        arm = self.arm_of(state)
        joints, basis = self._bent(state, joints_rad)
        flange, J = tool_and_jacobian(arm, joints)
        turned = state.T[:3, :3] @ flange[:, :3, :3]
        levers = turned[:, None] @ motion_levers(state.smr_mm)[..., :6]
        links = levers.reshape(len(joints), -1, 6) @ J[..., : self.links]
        links = links.reshape(*levers.shape[:3], self.links)
        by_joint = by_joints(arm, links)
        positions = self._carried(state.T @ flange, state.smr_mm)
        count, placed, behind = len(joints), self.placed, self.placed + self.links
        derivatives = np.zeros((count, self.reflectors, 3, behind + len(self._axes)))
        derivatives[..., :3] = np.eye(3)
        derivatives[..., 3:BASE] = -cross_matrix(positions - state.T[:3, 3])
        for k in range(self.reflectors):
            derivatives[:, k, :, BASE + 3 * k : BASE + 3 * k + 3] = turned
        derivatives[..., placed:behind] = links
        turns = by_joint[..., self._axes]
        np.multiply(turns, basis[:, None, None], out=derivatives[..., behind:])
        return Linearised(positions, derivatives, by_joint)

    @cached_property
    def _axes(self) -> list[int]:
        """Return which joint (V - 5 n,) each parameter behind the links turns."""
        axes = [axis for axis, _, _ in self._effects]
        for curve in self.curves:
            axes += [curve.axis] * self.size(curve)
        return axes

    def _bent(self, state: State, joints_rad: Array) -> tuple[Array, Array]:
        """True angles of the axes (M, n), and the motion by each parameter behind the links, of
        its joint (M, V - 5 n).
        """
        joints = self.arm.angles(joints_rad)
        blocks = [_steady(self, joints.tobytes())]
        values, linear = state.values[self.links :], np.ones(len(self._axes))
        end = blocks[0].shape[1]
        loads = _loads(self, joints.tobytes())
        for curve in self.curves:
            size, behind = 2 * len(curve.cycles), end + self.size(curve)
            amplitude, shift = values[end : end + size], values[end + size]
            shifted, at = replace(curve, shift_rad=float(shift)), joints[:, curve.axis]
            waves, by_shift = shifted.basis(at), shifted.slope(at) @ amplitude[:, None]
            if self._grows(curve):
                load = loads[:, curve.axis, None]
                grown = 1.0 + values[behind - 1] * load
                blocks += [grown * waves, grown * by_shift, load * (waves @ amplitude)[:, None]]
            else:
                blocks += [waves, by_shift]
            linear[end + size : behind] = 0.0  # shift and growth are in the basis already
            end = behind
        basis = np.concatenate(blocks, axis=1)
        by_axis = np.eye(len(self.arm))[self._axes]
        true: Array = joints + (basis * (values * linear)) @ by_axis
        return true, basis

    @staticmethod
    def _carried(flange: Array, smr_mm: Array) -> Array:
        """Return points (M, K, 3) given on flanges (M, 4, 4)."""
        carried: Array = np.einsum("mij,kj->mki", flange[:, :3, :3], smr_mm)
        carried += flange[:, None, :3, 3]
        return carried


@lru_cache(maxsize=2)
def _steady(kinematics: Kinematics, joints: bytes) -> Array:
    """Basis at angles (M, n) as far as independent of the state, cached for all steps."""
    arm = kinematics.arm.by_angles
    at = np.frombuffer(joints).reshape(-1, len(arm))
    blocks = [np.zeros((len(at), 0))]
    if kinematics.gravity:
        blocks.append(gravity_basis(arm, at))
    if kinematics.waves:
        blocks.append(_drive_basis(arm, at, kinematics.orders))
    if kinematics.tool:
        blocks.append(tool_basis(arm, at))
    return np.concatenate(blocks, axis=1)


@lru_cache(maxsize=2)
def _loads(kinematics: Kinematics, joints: bytes) -> Array:
    """Relative loads (M, G) of the first axes above those at their ``levers_mm``."""
    arm, middle_mm = kinematics.arm.by_angles, np.array(kinematics.levers_mm)
    if not len(middle_mm):
        return np.zeros((0, 0))
    at = np.frombuffer(joints).reshape(-1, len(arm))
    levers_mm: Array = flange_levers_mm(arm, at)[:, : len(middle_mm)]
    return np.asarray(levers_mm / middle_mm - 1.0)


def _drive_basis(arm: Arm, joints_rad: Array, orders: tuple[int, ...]) -> Array:
    """Return cos nq, sin nq of each revolute joint, and q of each prismatic one."""
    angles = joints_rad[..., None] * np.array(orders)
    waves = np.stack([np.cos(angles), np.sin(angles)], axis=-1).reshape(*joints_rad.shape, -1)
    columns = [
        waves[:, axis] if turns else joints_rad[:, axis, None]
        for axis, turns in enumerate(arm.turning)
    ]
    return np.concatenate(columns, axis=1)
