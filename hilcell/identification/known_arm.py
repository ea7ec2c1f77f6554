"""An arm that an earlier calibration identified, followed by a few poses.

The earlier posterior is the prior, less certain: an arm changes slowly, and the same poses must not
count again and again. Sudden changes are added to its covariance in components: the zero of each
joint (a motor was exchanged), the arm's growth, its loads (another tool), the reflector on its
mount. Each is small unless the marginal likelihood of the poses is clearly greater with a larger
one, so that poses that err as predicted leave the arm as it was. {B} is free: it was measured
again. Another gear or a loose link, which these do not explain, shows in chi^2 of the poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hilcell.geometry.jacobian import KINDS
from hilcell.geometry.kinematics import Array, Ints
from hilcell.geometry.statistics import chi2_quantile, f_quantile
from hilcell.identification.estimate import Estimate, gross, solve
from hilcell.identification.kinematics import BASE, Kinematics, State
from hilcell.identification.measured_poses import IdentificationError, Noise, Readings

AGED = 2.0  # factor of the prior's covariance: a chain of calibrations knows as much as two
BASE_MM, BASE_RAD = 2.0, 2e-3  # 1 sigma of {B} against the earlier one
RISK = 1e-3  # that an unchanged arm is refused
MOST_STRUCK = 0.2  # share of the poses beyond which they are not slips


GROWTH, REFLECTOR = "growth of the arm", "reflector"  # all other changes are angles


def in_words(changed: Mapping[str, float]) -> str:
    """Return changes by name, ratios, mm or rad, as a person reads them."""
    said = []
    for name, size in changed.items():
        unit = f"{size:.2f} mm" if name == REFLECTOR else f"{np.degrees(size):.3f}°"
        said.append(f"{name} by " + (f"{1e6 * size:.0f} µm/m" if name == GROWTH else unit))
    return ", ".join(said)


class ArmChanged(IdentificationError):
    """Poses that contradict the arm of an earlier calibration."""

    code = "HC-C27"


@dataclass(frozen=True, slots=True)
class Component:
    """A change that is possible: ``columns`` (P, J) of the parameters by J numbers of 1 sigma
    ``typical`` where few data tell.
    """

    name: str
    typical: float
    columns: Array


@dataclass(frozen=True, eq=False)
class KnownArm:
    """Kinematics, state and its covariance (P, P) in the earlier {B}; the noise that ``samples``
    poses showed. ``run`` names the calibration.
    """

    run: str
    kinematics: Kinematics
    state: State
    covariance: Array
    noise: Noise
    samples: float

    @cached_property
    def components(self) -> list[Component]:
        kinematics, arm = self.kinematics, self.kinematics.arm
        names, unit = kinematics.names, np.eye(len(kinematics.names))
        links = kinematics.placed + np.arange(kinematics.links).reshape(len(KINDS), -1)
        lengths = unit[links[KINDS.index("a_mm")]].T @ arm.a_mm
        lengths += unit[links[KINDS.index("d_mm")]].T @ arm.d_mm
        lengths[BASE : kinematics.placed] = self.state.smr_mm.ravel()
        behind = range(kinematics.placed + kinematics.links, len(names))
        loads = [n for n in behind if names[n].endswith(" rad") and "tool" in names[n]]
        zeros = links[KINDS.index("offset_rad")]
        return [
            *(
                Component(f"zero of axis {n + 1}", 5e-6, unit[:, [at]])
                for n, at in enumerate(zeros)
            ),
            Component(GROWTH, 20e-6, lengths[:, None]),
            Component(REFLECTOR, 0.02, unit[:, BASE : kinematics.placed]),
            *([Component("loads", 5e-6, unit[:, loads])] if loads else []),
        ]

    def prior(self, sigmas: Array) -> Array:
        """Covariance (P, P) before a pose is measured, by the components' sigmas (C,)."""
        covariance = AGED * self.covariance
        covariance[:BASE] = covariance[:, :BASE] = 0.0
        covariance[:BASE, :BASE] = np.diag([BASE_MM**2] * 3 + [BASE_RAD**2] * 3)
        for sigma, each in zip(sigmas, self.components, strict=True):
            covariance += sigma**2 * each.columns @ each.columns.T
        return covariance

    @property
    def typical(self) -> Array:
        return np.array([each.typical for each in self.components])

    def misses(self, readings: Readings) -> tuple[Array, Array]:
        """Positions of the first reflector, the only one read at N poses, less their prediction
        (N, 3), and the covariance (3N, 3N) of that, in the earlier {B}.
        """
        found = self.kinematics.linearised(self.state, readings.joints_rad)
        size, by_joint = 3 * len(readings), found.by_joint[:, :1]
        own = self.noise.covariance(by_joint, readings.covariance_mm2, readings.known)
        A = found.by_parameter[:, 0].reshape(size, -1)
        C = (A @ (AGED * self.covariance) @ A.T).reshape(-1, 3, len(readings), 3)
        C[np.arange(len(readings)), :, np.arange(len(readings)), :] += own
        return readings.xyz_mm[:, 0] - found.positions_mm[:, 0], C.reshape(size, size)

    def followed(self, readings: Readings) -> Followed:
        """Return the arm as it is now; raises `ArmChanged`."""
        struck, found = np.zeros_like(readings.known), self._followed(readings)
        while (more := gross(found.estimate.system)).any():  # the worst first: it bends the others
            off = np.where(more.any(axis=1), found.estimate.system.distances()[1], 0.0)
            struck[np.argmax(off)] |= more[np.argmax(off)]
            if struck.any(axis=1).mean() > MOST_STRUCK:
                raise ArmChanged(found.contradiction)
            found = self._followed(readings.without(struck))
        if found.contradicts:
            raise ArmChanged(found.contradiction)
        return replace(found, estimate=replace(self._with_noise(found), outliers=struck))

    def _followed(self, readings: Readings) -> Followed:
        A, e, R, by_joint, pose = self._rows(readings)
        sigmas = self._likeliest(A, e, R)
        start = replace(self.state, moved=np.zeros(self.kinematics.placed))
        prior = self.prior(sigmas)
        kinematics = replace(self.kinematics, learnt=(self.kinematics.flat(start), prior))
        state, system = solve(kinematics, readings, start, self.noise)
        estimate = Estimate(kinematics, readings, state, self.noise, system, ~readings.known)
        return Followed(self, estimate, sigmas, e, A @ prior @ A.T + R, R, by_joint, pose)

    def _with_noise(self, found: Followed) -> Estimate:
        """The estimate with the noise that the earlier poses and these show together."""
        count = len(found.estimate.readings)
        factor = (self.samples + count * found.ratio) / (self.samples + count)
        kinematics, readings = found.estimate.kinematics, found.estimate.readings
        noise = self.noise.scaled(factor**0.5)
        state, system = solve(kinematics, readings, found.estimate.state, noise)
        return Estimate(kinematics, readings, state, noise, system, ~readings.known)

    def _rows(self, readings: Readings) -> tuple[Array, Array, Array, Array, Ints]:
        """Derivatives (N, P) of known coordinates, these less their prediction (N,), covariance
        (N, N) by the noise alone, derivatives by the joints (N, n), and poses (N,).
        """
        found = self.kinematics.linearised(self.state, readings.joints_rad)
        known = readings.known
        C = self.noise.covariance(found.by_joint, readings.covariance_mm2, known)
        count, rows = C.shape[:2]
        R = np.zeros((count, rows, count, rows))
        R[np.arange(count), :, np.arange(count), :] = C
        kept = np.repeat(known, 3, axis=1).ravel()
        size = count * rows
        return (
            found.by_parameter.reshape(size, -1)[kept],
            (readings.xyz_mm - found.positions_mm).reshape(size)[kept],
            R.reshape(size, size)[np.ix_(kept, kept)],
            found.by_joint.reshape(size, -1)[kept],
            np.repeat(np.arange(count), rows)[kept],
        )

    def _likeliest(self, A: Array, e: Array, R: Array) -> Array:
        """Sigmas (C,) of the components: typical, or larger where the poses clearly say so."""
        sigmas, factors = self.typical, [A @ each.columns for each in self.components]
        covariance = A @ self.prior(sigmas) @ A.T + R
        clearly = chi2_quantile(1.0 - 0.01 / len(sigmas), 1.0)  # gained by chance at 1 %
        while True:
            here, tried = likelihood(covariance, e), []
            for n, F in enumerate(factors):
                for sigma in self.typical[n] * 2.0 ** np.arange(1.0, 9.0):
                    larger = covariance + (sigma**2 - sigmas[n] ** 2) * F @ F.T
                    tried.append((likelihood(larger, e), n, float(sigma)))
            best, n, sigma = max(tried)
            if not best > here + clearly:
                return sigmas
            covariance = covariance + (sigma**2 - sigmas[n] ** 2) * factors[n] @ factors[n].T
            sigmas[n] = sigma


def likelihood(covariance_mm2: Array, error_mm: Array) -> float:
    """Twice the log-likelihood of errors (N,), but for a constant."""
    L = np.linalg.cholesky(covariance_mm2)
    white = np.linalg.solve(L, error_mm)
    return -float(white @ white) - 2.0 * float(np.log(np.diag(L)).sum())


@dataclass(frozen=True, eq=False)
class Followed:
    """The estimate, and the sigmas (C,) of the possible changes.

    ``error_mm`` (N,) are the poses' coordinates less their prediction by the known arm, with
    ``covariance_mm2`` (N, N) under the prior of these sigmas, ``noise_mm2`` its part by the noise
    alone; ``by_joint`` (N, n) are their
    derivatives by the joints, ``pose`` (N,) their poses.
    """

    known: KnownArm
    estimate: Estimate
    sigmas: Array
    error_mm: Array
    covariance_mm2: Array
    noise_mm2: Array
    by_joint: Array
    pose: Ints

    @property
    def changed(self) -> dict[str, float]:
        """The size of each change that the poses show, by its name: rad, mm, or a ratio."""
        estimate, known = self.estimate, self.known
        A = known.kinematics.linearised(known.state, estimate.readings.joints_rad).by_parameter
        rows = A[estimate.readings.known].reshape(len(self.error_mm), -1)
        pull = rows.T @ np.linalg.solve(self.covariance_mm2, self.error_mm)
        return {
            each.name: float(np.linalg.norm(sigma**2 * each.columns.T @ pull))
            for each, sigma in zip(known.components, self.sigmas, strict=True)
            if sigma > each.typical
        }

    @property
    def freedom(self) -> int:
        return len(self.error_mm) - BASE

    @property
    def ratio(self) -> float:
        """Chi^2 of the poses over its degrees of freedom."""
        weighted = np.linalg.solve(self.covariance_mm2, self.error_mm)
        return float(self.error_mm @ weighted) / self.freedom

    @property
    def limit(self) -> float:
        """The ratio that an unchanged arm exceeds at the risk."""
        return f_quantile(1.0 - RISK, self.freedom, self.known.samples)

    @cached_property
    def gear(self) -> tuple[float, float, int]:
        """The axis (from 0) whose scatter from pose to pose explains most: twice its gain of
        log-likelihood over larger noise, the size of the scatter (rad), the axis.
        """
        factors = np.array([1.0, 1.5, 2.0, 3.0, 5.0])  # of the noise, which is known by samples
        doubts = self.known.samples * (np.log(factors) + 1.0 / factors - 1.0)
        larger = [self.covariance_mm2 + (factor - 1.0) * self.noise_mm2 for factor in factors]
        alone = self._likeliest(larger, doubts)
        found = []
        for axis, lever in enumerate(self.by_joint.T):
            own = np.outer(lever, lever) * (self.pose[:, None] == self.pose)
            for size_rad in np.geomspace(5e-6, 1e-3, 24).tolist():
                with_ = [C + size_rad**2 * own for C in larger]
                found.append((self._likeliest(with_, doubts) - alone, size_rad, axis))
        return max(found)

    def _likeliest(self, covariances_mm2: Sequence[Array], doubts: Array) -> float:
        """The greatest likelihood of the poses' errors, less the doubts."""
        found = np.array([likelihood(C, self.error_mm) for C in covariances_mm2])
        return float((found - doubts).max())

    @property
    def most_gain(self) -> float:
        """The gain by a gear's scatter that an unchanged arm exceeds at the risk: in half of all
        cases it has none (Self and Liang 1987), and each axis has its chance.
        """
        return chi2_quantile(1.0 - 2.0 * RISK / self.by_joint.shape[1], 1.0)

    @property
    def contradicts(self) -> bool:
        return not (self.ratio <= self.limit and self.gear[0] <= self.most_gain)

    @property
    def contradiction(self) -> str:
        """Why the arm is no longer the known one, with the gear that would explain most."""
        _, size_rad, axis = self.gear
        return (
            f"the arm is no longer that of {self.known.run}: {len(self.estimate.readings)} poses "
            f"miss it {self.ratio**0.5:.1f} times as far as expected, as if axis {axis + 1} erred "
            f"by {1e6 * size_rad:.0f} µrad at each (another gear?); run calibrate without --from"
        )
