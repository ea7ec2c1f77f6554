"""Statistics of position errors and of repeated positions: each figure is defined here only.

Arrays in mm; vectors (N, 3), lengths (N,). ISO 9283:1998; GUM is JCGM 100:2008. Names and
docstrings distinguish figures of one coordinate from those of a 3D length, sqrt(3) times larger in
root mean squares; the mean of lengths lies between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hilcell.geometry.kinematics import Array

CONFIDENCE = 0.95
LEAST_BOUNDED = 19  # values from which on one more is below the largest with this confidence


class Figures(NamedTuple):
    """Mean, 95 % quantile and maximum of 3D errors (mm)."""

    mean: float
    p95: float
    max: float


def lengths_mm(vectors_mm: ArrayLike) -> Array:
    """Return the 3D lengths (N,) of vectors (N, 3): of errors those of the paper's eq 18."""
    return np.asarray(np.linalg.norm(np.asarray(vectors_mm, dtype=float), axis=1))


def figures_of(lengths: Array) -> Figures:
    """Return mean, 95 % quantile and maximum of lengths (N,), N >= 1."""
    return Figures(float(lengths.mean()), float(np.quantile(lengths, 0.95)), float(lengths.max()))


def rms(values: ArrayLike) -> float:
    """Return the root mean square of all values: of vectors that of one coordinate."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, dtype=float)))))


def from_mean_mm(cloud_mm: Array) -> Array:
    """Return the distances (N,) of points (N, 3) from their barycentre, l_j of ISO 9283, 7.2.2."""
    return lengths_mm(cloud_mm - cloud_mm.mean(axis=0))


def repeatability_mm(distances_mm: Array) -> float:
    """Return mean + 3 s of distances (N,); of the l_j of one pose it is RP (ISO 9283, 7.2.2)."""
    return float(distances_mm.mean() + 3 * distances_mm.std(ddof=1))


def without_noise(scatter_mm2: float, noise_mm2: float) -> float:
    """Factor that takes the readings' noise off a radius; 0 where the noise explains all.

    Mean squares subtract (mm^2 of 3D distances); they are assumed to keep the shape of their
    distribution.
    """
    return math.sqrt(1.0 - noise_mm2 / scatter_mm2) if scatter_mm2 > noise_mm2 else 0.0


def pooled_std_mm(clouds_mm: Sequence[Array]) -> float:
    """Standard deviation of one coordinate, pooled over clouds (N_i, 3) (GUM 4.2.4). Each cloud
    spends one degree of freedom a coordinate on its own mean.
    """
    squares = sum(float(np.square(cloud - cloud.mean(axis=0)).sum()) for cloud in clouds_mm)
    return math.sqrt(squares / (3 * sum(len(cloud) - 1 for cloud in clouds_mm)))


def variance_of_mean(values: ArrayLike) -> float:
    """Return the variance s^2 / n of the mean of n values (n,) (GUM 4.2.3, eq 5)."""
    found = np.asarray(values, dtype=float)
    return float(found.var(ddof=1)) / len(found)


def ranks(values: ArrayLike) -> Array:
    """Return the ranks (N,) of values (N,), from 1; equal values share their mean rank."""
    _, group, count = np.unique(np.asarray(values), return_inverse=True, return_counts=True)
    shared: Array = np.cumsum(count) - (count - 1) / 2
    return shared[group]


def slope(x: Array, y: Array) -> tuple[float, float]:
    """Return the slope of the line through points (N,) by least squares in y, and its u."""
    xx, xy, _, yy = np.cov(x, y, bias=True).ravel()
    correlation = xy / np.sqrt(xx * yy) if yy > 0.0 else 0.0
    left = max(0.0, 1.0 - correlation**2) * yy
    return float(xy / xx), float(np.sqrt(left / xx / (np.size(x) - 2)))


def chi2_quantile(share: float, freedom: float) -> float:
    """Return the chi^2 with so many degrees of freedom below which lies a share of all."""
    from scipy.special import gammaincinv  # scipy.stats takes a second to import

    return float(2.0 * gammaincinv(freedom / 2.0, share))


def f_quantile(share: float, above: float, below: float) -> float:
    """Return the F(above, below) below which lies a share of all."""
    from scipy.special import fdtri

    return float(fdtri(above, below, share))


def coverage_factor(sigmas: float, freedom: float) -> float:
    """Factor of an estimated standard deviation with the risk of ``sigmas`` known ones. Student's t
    (GUM G.3).
    """
    from scipy.special import ndtr, stdtrit

    return -float(stdtrit(freedom, float(ndtr(-sigmas))))


def expanded(covariance: Array, freedom: float = math.inf) -> float:
    """Return U (k = 2) of one coordinate in the worst direction of a covariance (N, N); of an
    estimated one by Student's t (GUM G.3).
    """
    return coverage_factor(2.0, freedom) * float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def rounded(value: float, U: float) -> float:
    """Return a value with the digits that its uncertainty supports: two of U's; U 0: all."""
    digits = 1 - math.floor(math.log10(U)) if U > 0.0 else None
    return (value if digits is None else round(value, digits)) + 0.0  # no -0.0


def chance_of_at_most(count: int, of: int, share: float) -> float:
    """Return the probability of ``count`` or fewer of so many, each with probability ``share``."""
    from scipy.special import bdtr

    return float(bdtr(count, of, share))


def rectangular_variance(half_width: float) -> float:
    """Return the variance of a value known to lie within +- its half-width (GUM 4.3.7, eq 7)."""
    return half_width**2 / 3.0


def reading_variances_mm2(std_mm: ArrayLike, samples: ArrayLike) -> Array:
    """Variances (N, 3) of averaged readings (GUM 4.2.3, eq 5). ``std_mm`` (N, 3): of a single
    reading; ``samples`` (N,): number averaged.
    """
    return np.asarray(np.square(np.asarray(std_mm, dtype=float)) / np.asarray(samples)[:, None])


def bounds95_mm(covariances_mm2: ArrayLike, freedom: ArrayLike = math.inf) -> Array:
    """95 % bounds (N,) of 3D errors by their covariances (N, 3, 3).

    ``|e|^2`` is a quadratic form of normal variables, approximated by ``g`` times chi^2 of ``h``
    degrees of freedom with the same mean and variance (Satterthwaite 1946; Box 1954, theorem 3.1):
    ``g h = tr C``, ``h = (tr C)^2 / tr C^2``, from 1 for one direction to 3 for a sphere. Exact
    where all variances are equal or 0, else within 1.5 % of the length. ``freedom`` (N,) is that of
    the estimate of tr C, as of `effective_freedom`: chi^2 / h becomes F(h, freedom). NaN for an
    invalid covariance.
    """
    from scipy.special import fdtri

    covariances = np.asarray(covariances_mm2, dtype=float)
    trace = np.trace(covariances, axis1=-2, axis2=-1)
    squares = np.square(covariances).sum(axis=(-2, -1))
    sizes = np.divide(trace**2, squares, out=np.full_like(trace, 3.0), where=squares != 0)
    most_freedom = 1e6  # as good as infinite; beyond F is not computed exactly
    return np.asarray(np.sqrt(trace * fdtri(sizes, np.minimum(freedom, most_freedom), CONFIDENCE)))


def conformal_factor(scores: ArrayLike) -> float:
    """Factor of a bound, by scores (N,) of values not learnt from: each one's size over its bound.

    `CONFIDENCE` of further values are within the bound times it, whatever their distribution, if
    they are exchangeable with the scored ones (split conformal prediction: Vovk et al. 2005;
    Lei et al. 2018). Infinite below `LEAST_BOUNDED` scores, which bound no 95 %.
    """
    ordered = np.sort(np.asarray(scores, dtype=float))
    rank = math.ceil((len(ordered) + 1) * CONFIDENCE)
    return float(ordered[rank - 1]) if rank <= len(ordered) else math.inf


def effective_freedom(traces_mm2: ArrayLike, freedom: ArrayLike) -> Array:
    """Degrees of freedom (N,) of sums of variances (Welch-Satterthwaite, GUM eq G.2b).

    ``traces_mm2`` (K, N): parts of the sums; ``freedom`` (K,): of each estimate, infinite where
    known.
    """
    traces = np.asarray(traces_mm2, dtype=float)
    spread = (traces**2 / np.asarray(freedom, dtype=float)[:, None]).sum(axis=0)
    total = traces.sum(axis=0) ** 2
    return np.asarray(np.divide(total, spread, out=np.full_like(total, np.inf), where=spread != 0))


def trace_freedom(covariance_mm2: ArrayLike, samples: int) -> float:
    """Degrees of freedom of the trace of a covariance (3, 3) from ``samples`` vectors.

    ``samples``: those that count, each subtracted mean costs one. The trace scatters as a chi^2 of
    ``samples (tr C)^2 / tr C^2``: each vector has one to three independent coordinates.
    """
    covariance = np.asarray(covariance_mm2, dtype=float)
    squares = float(np.square(covariance).sum())
    return samples * float(np.trace(covariance)) ** 2 / squares if squares else math.inf


@dataclass(frozen=True, slots=True)
class BeamNoise:
    """Variances of a single reading: along the beam, and across it at a range of 1 m.

    The noise is a length along the beam and an angle across it, so the scatter at many places gives
    that at any other. A few readings at one place say little: the spread of 2 along a beam is half
    the noise or less in 38 % of all places. Tracker's frame. ``freedom``: degrees of freedom of the
    estimate.
    """

    along_mm2: float
    across_mm2_m2: float
    freedom: float

    def at(self, at_mm: Array, samples: ArrayLike) -> Array:
        """Return the covariances (N, 3, 3) of averages of so many readings at places (N, 3)."""
        along, range_m2 = _beams(at_mm)
        across_mm2 = (self.across_mm2_m2 * range_m2)[:, None, None]
        single_mm2 = self.along_mm2 * along + across_mm2 * (np.eye(3) - along)
        return np.asarray(single_mm2 / np.asarray(samples, dtype=float)[:, None, None])


def beam_noise(at_mm: Array, std_mm: ArrayLike, samples: ArrayLike) -> BeamNoise:
    """Noise shown by the scatter of readings at places (N, 3), N >= 1.

    ``std_mm`` (N, 3): of a single reading, axes of the tracker, from ``samples`` (N,); one sample:
    as the instrument states. Least squares with weights as of variances, both non-negative. A
    reading that is no number shows nothing.
    """
    std_mm = np.asarray(std_mm, dtype=float)
    finite = np.isfinite(at_mm).all(axis=1) & np.isfinite(std_mm).all(axis=1)
    along, range_m2 = _beams(at_mm[finite])
    freedom = np.maximum(np.asarray(samples, dtype=float)[finite] - 1.0, 1.0)
    shares = np.diagonal(along, axis1=1, axis2=2)
    A = np.stack([shares, range_m2[:, None] * (1.0 - shares)], axis=-1).reshape(-1, 2)
    stated_mm2 = np.square(std_mm[finite]).reshape(-1)
    known = np.repeat(np.sqrt(freedom), 3)
    weights: Array = known
    found: Array = np.zeros(2)
    least_share = 1e-3  # of the largest variance: none counts as better known than that
    for _ in range(8):  # the weights follow from the variances that are fitted
        found = _non_negative(A * weights[:, None], stated_mm2 * weights)
        fitted_mm2 = A @ found
        if not fitted_mm2.max() > 0.0:
            break
        weights = known / np.maximum(fitted_mm2, least_share * fitted_mm2.max())
    return BeamNoise(float(found[0]), float(found[1]), float(freedom.sum()))


def _beams(at_mm: Array) -> tuple[Array, Array]:
    """Return the projections (N, 3, 3) on the beams and their squared lengths (N,) in m^2."""
    range_mm = lengths_mm(at_mm)
    directed = range_mm > 1.0  # the centre of the tracker has no direction: all is along there
    beams = at_mm / np.where(directed, range_mm, 1.0)[:, None]
    along = np.where(directed[:, None, None], beams[:, :, None] * beams[:, None, :], np.eye(3))
    return along, np.square(range_mm / 1000.0)


def _non_negative(A: Array, b: Array) -> Array:
    """Return x (2,) >= 0 that leaves least of ``A x = b``."""
    both = np.linalg.lstsq(A, b, rcond=None)[0]
    if bool(np.all(both >= 0.0)):
        return np.array(both, dtype=float)
    alone = np.maximum(0.0, (A.T @ b) / np.square(A).sum(axis=0))
    each = np.diag(alone)
    return np.array(min(each, key=lambda x: float(np.square(A @ x - b).sum())))
