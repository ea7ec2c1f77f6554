"""Which axis each joint turns, and in which sense, by small motions of single joints.

A reflector on the flange is seen in a reference pose and after a small motion of each joint.
Hypotheses (signs of the joints, a coupling of axis 3 to axis 2, two joints exchanged, a joint that
does not turn) are compared by how well the arm, with base and reflector unknown, meets the
positions. All angles count from the model's zeros: a joint that counts backwards is at ``-q``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from hilcell.geometry.kinematics import Arm, Array
from hilcell.identification.mounted_reflector import flanges_of, placements, sigma_of

MARGIN = 25.0  # of chi^2 between two hypotheses, 5 sigma: below neither is excluded
FITS = 5.0  # of chi^2 a degree of freedom: above a hypothesis does not explain the positions
SMR_MM = 300.0  # standard uncertainty of a reflector on a flange that nobody measured
MOST_DEG = 10.0  # of a motion that makes an unclear axis clear
JOINTS = range(6)


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """How the controller's joints turn the model's axes.

    ``axes`` (6,): which axis (0 to 5) joint n turns; ``signs`` (6,): 1 as the model, -1 against it,
    0 not at all; ``coupling``: of axis 3 to joint 2, as `Arm.coupling`.
    """

    axes: tuple[int, ...]
    signs: tuple[int, ...]
    coupling: float

    def angles(self, joints_rad: Array) -> Array:
        """Return the angles of the axes (N, 6) at joints (N, 6), the first the reference pose."""
        signs = np.array(self.signs, dtype=float)
        turned = np.where(signs == 0.0, joints_rad[0], signs * joints_rad)
        turned[:, 2] += self.coupling * turned[:, 1]
        angles = np.empty_like(turned)
        angles[:, list(self.axes)] = turned
        return angles


@dataclass(frozen=True, slots=True)
class AxisVerdict:
    """The motion of joint 1 to 6 in ``words``; whether it is the model's, None if not determined.

    ``turn_deg``: a motion of this joint that would make it clear; None where it is clear, or where
    none of up to 10 deg would: choose another pose.
    """

    axis: int
    holds: bool | None
    words: str
    turn_deg: float | None = None


@dataclass(frozen=True, slots=True)
class AxesChecked:
    """The best hypothesis, whether it explains the positions, and a verdict on each axis.

    ``rms_mm`` of its residuals (one coordinate); ``margin``: chi^2 to the next hypothesis.
    """

    best: Hypothesis
    explained: bool
    rms_mm: float
    margin: float
    smr_mm: Array
    verdicts: tuple[AxisVerdict, ...]

    @property
    def holds(self) -> bool:
        """Whether all axes turn as the model says."""
        return self.explained and all(each.holds is True for each in self.verdicts)


def check_axes(
    arm: Arm,
    joints_rad: Array,
    seen_mm: Array,
    noise_mm: float,
    smr_mm: Sequence[float] = (0.0, 0.0, 0.0),
    u_smr_mm: float = SMR_MM,
) -> AxesChecked:
    """Judge small motions: joints (N, 6) as the controller states them, reflector (N, 3) in {L}.

    The first row is the reference pose; each other row differs from it by a motion of one joint,
    and each joint has at least one. ``noise_mm``: 1 sigma of a coordinate seen. Raises `ValueError`
    for a joint that never moved.
    """
    turns_rad = np.abs(joints_rad - joints_rad[0]).max(axis=0)
    still = [str(n + 1) for n in JOINTS if not turns_rad[n] > 1e-4]
    if still:
        raise ValueError(f"joint {', '.join(still)}: expected a motion, got none")
    sigma_mm = sigma_of(seen_mm, noise_mm)
    freedom = 3 * len(seen_mm) - 9
    assumed = np.asarray(smr_mm, dtype=float)
    tried: list[Hypothesis] = []
    chi2, smr, squares = np.empty(0), np.empty((0, 3)), np.empty(0)
    for group in (list(_signed()), list(_odd())):
        angles = np.array([each.angles(joints_rad) for each in group])
        flanges = flanges_of(arm.by_angles, angles)
        found = placements(flanges, seen_mm, sigma_mm, assumed, u_smr_mm)
        tried += group
        chi2, smr = np.append(chi2, found.chi2), np.vstack([smr, found.smr_mm])
        squares = np.append(squares, np.mean(found.residuals_mm**2, axis=(1, 2)))
        if chi2.min() <= FITS * freedom:
            break
    order = np.argsort(chi2)
    best, excess = tried[order[0]], chi2 - chi2.min()
    explained = bool(chi2.min() <= FITS * freedom)
    verdicts = []
    for axis in JOINTS:
        others = [
            excess[n] for n, each in enumerate(tried) if _part(each, axis) != _part(best, axis)
        ]
        verdicts.append(_verdict(arm, best, axis, explained, min(others), turns_rad[axis]))
    return AxesChecked(
        best, explained, float(np.sqrt(squares[order[0]])), float(excess[order[1]]),
        smr[order[0]], tuple(verdicts),
    )  # fmt: skip


def _signed() -> Iterator[Hypothesis]:
    for signs, coupling in product(product((1, -1), repeat=6), (0.0, 1.0, -1.0)):
        yield Hypothesis(tuple(JOINTS), signs, coupling)


def _odd() -> Iterator[Hypothesis]:
    """Two joints exchanged, at most one sign against the model; one joint that does not turn."""
    upright = [1] * 6
    for one, other in combinations(JOINTS, 2):
        axes = list(JOINTS)
        axes[one], axes[other] = other, one
        yield Hypothesis(tuple(axes), tuple(upright), 0.0)
        for against in JOINTS:
            signs = [-1 if n == against else 1 for n in JOINTS]
            yield Hypothesis(tuple(axes), tuple(signs), 0.0)
    for still in JOINTS:
        signs = [0 if n == still else 1 for n in JOINTS]
        yield Hypothesis(tuple(JOINTS), tuple(signs), 0.0)


def _part(hypothesis: Hypothesis, axis: int) -> tuple[int, int, float]:
    """Return what a hypothesis says of one joint; a coupling concerns axis 3."""
    coupling = hypothesis.coupling if axis == 2 else 0.0
    return hypothesis.axes[axis], hypothesis.signs[axis], coupling


def _verdict(
    arm: Arm, best: Hypothesis, axis: int, explained: bool, excess: float, turned_rad: float
) -> AxisVerdict:
    name = f"axis {axis + 1}"
    if not explained:
        return AxisVerdict(axis + 1, None, f"{name}: no hypothesis explains the positions")
    if not excess >= MARGIN:
        needed_deg = np.degrees(turned_rad) * np.sqrt(2.0 * MARGIN / max(excess, 1e-9))
        clear = bool(needed_deg <= MOST_DEG)
        turn_deg = float(np.ceil(needed_deg)) if clear else None
        advice = f"turn it by {turn_deg:g} deg" if clear else "choose another pose"
        return AxisVerdict(axis + 1, None, f"{name}: not determined; {advice}", turn_deg)
    words = []
    if best.axes[axis] != axis:
        words.append(f"turns as axis {best.axes[axis] + 1}: exchanged")
    if best.signs[axis] == 0:
        words.append("does not turn")
    if best.signs[axis] < 0:
        words.append("turns against the model")
    if axis == 2 and best.coupling != arm.coupling:
        words.append(
            f"turns with axis 2 (coupled, {best.coupling:+.0f})"
            if best.coupling
            else "does not turn with axis 2, the model couples them"
        )
    holds = not words
    return AxisVerdict(
        axis + 1, holds, f"{name} " + (", ".join(words) or "turns as the model says")
    )
