"""The arm that DH rows and URDF can state: link parameters alone, without gravity and waves.

It is the method `mdh` of a fit, identified by itself. The links of a model that has gravity too are
others, and without it they would leave the mean deflection as an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hilcell.fit.fitted_arm import FittedArm
from hilcell.fit.methods import Fitted
from hilcell.fit.placement import FitError
from hilcell.geometry.jacobian import KINDS
from hilcell.geometry.kinematics import Arm, Array
from hilcell.geometry.statistics import Figures
from hilcell.identification.estimate import Estimate
from hilcell.identification.kinematics import LINKS
from hilcell.identification.system import DETERMINED

RIGID = "mdh"  # of the methods
UNITS = {"mm": ("mm", 1.0), "rad": ("deg", float(np.degrees(1.0)))}


@dataclass(frozen=True, slots=True)
class Parameter:
    """A link parameter in mm or deg; ``u`` and ``prior_u`` are standard uncertainties."""

    name: str
    unit: str
    nominal: float
    identified: float
    u: float
    prior_u: float

    @property
    def determined(self) -> bool:
        """Return whether the poses say more about it than the prior, by itself."""
        return self.u < DETERMINED * self.prior_u


@dataclass(frozen=True, eq=False)
class RigidArm:
    """The identified ``arm``; ``T_L_B`` (4, 4): its base in the tracker's frame.

    ``smr_mm``: reflectors (3,) on the flange. ``covariance`` (30, 30) is the parameters', in their
    units. ``figures`` are of what the arm leaves at training poses left out in turn.
    """

    arm: Arm
    T_L_B: Array
    smr_mm: Mapping[str, Array]
    parameters: list[Parameter]
    covariance: Array
    figures: Figures


def rigid_arm(nominal: Arm, fitted: Fitted) -> RigidArm:
    """Return the arm that a fit identified by link parameters alone; raises `FitError`."""
    found = fitted.methods.get(RIGID)
    if not isinstance(found, FittedArm):
        raise FitError(f"no arm is identified: {fitted.result['refused'][RIGID]}")
    estimate, figures = found.estimate, fitted.validated[RIGID]
    parameters, covariance = _parameters(nominal, estimate)
    return RigidArm(
        estimate.kinematics.arm_of(estimate.state),
        found.base,
        found.smr_mm,
        parameters,
        covariance,
        Figures(*(figures[f"{name}_mm"] for name in Figures._fields)),
    )


def _parameters(nominal: Arm, found: Estimate) -> tuple[list[Parameter], Array]:
    """Return the link parameters, and their covariance (30, 30) in the same units."""
    kinematics, links = found.kinematics, slice(found.kinematics.placed, None)
    labels = [name.split() for name in kinematics.names[links][:LINKS]]
    scale = np.array([UNITS[unit][1] for _, unit in labels])
    rows = [
        getattr(arm, kind) for arm in (nominal, kinematics.arm_of(found.state)) for kind in KINDS
    ]
    before, after = np.array(rows).reshape(2, LINKS) * scale
    covariance = found.system.covariance[links, links][:LINKS, :LINKS] * np.outer(scale, scale)
    prior = kinematics.prior()[1][links, links][:LINKS, :LINKS] * np.outer(scale, scale)
    u, prior_u = (np.sqrt(np.diag(each)) for each in (covariance, prior))
    return [
        Parameter(name, UNITS[unit][0], *map(float, values))
        for (name, unit), *values in zip(labels, before, after, u, prior_u, strict=True)
    ], covariance
