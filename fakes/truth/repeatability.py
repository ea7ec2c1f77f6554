"""RP of ISO 9283 that joint noise makes; it leads from a data sheet to the noise of each joint.

RP = mean + 3 s of the 3-D distances from the mean position (ISO 9283, 7.2.2).
"""

from __future__ import annotations

import numpy as np

from fakes.truth.transforms import Array

# Substitution t = exp(u) for the integral below; the range covers distances of any shape.
EXPONENTS = np.linspace(-30.0, 30.0, 601)


def unit_rp_mm(jacobians_mm: Array) -> Array:
    """Return RP (N,) for independent normal noise of 1 rad in every joint.

    ``jacobians_mm`` (N, 3, 6) are d(position) / d(joints). With eigenvalues l of the covariance J
    J', mean distance = 1 / (2 sqrt(pi)) * integral of (1 - prod (1 + 2 l t)^-1/2) t^-3/2 dt, which
    is the usual form of E[sqrt(Q)] for a quadratic form Q; its mean square is the trace.
    """
    eigenvalues = np.linalg.eigvalsh(jacobians_mm @ np.swapaxes(jacobians_mm, -1, -2))
    total = eigenvalues.sum(axis=-1)
    shares = eigenvalues / total[:, None]
    t = np.exp(EXPONENTS)
    left = 1.0 - np.prod(1.0 / np.sqrt(1.0 + 2.0 * shares[:, :, None] * t), axis=1)
    step = EXPONENTS[1] - EXPONENTS[0]
    mean = (left / np.sqrt(t)).sum(axis=-1) * step / (2.0 * np.sqrt(np.pi))
    rp: Array = np.sqrt(total) * (mean + 3.0 * np.sqrt(1.0 - mean**2))
    return rp
