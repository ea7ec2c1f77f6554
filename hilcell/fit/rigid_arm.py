"""The arm as DH rows or URDF describe it, and its files: link parameters alone.

It is the method `mdh` of a fit, without gravity: the links of a model with gravity would leave the
mean deflection as an error.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from hilcell import __version__
from hilcell.atomic_files import write_whole
from hilcell.compensation.targets import write_rows
from hilcell.fit.methods import RIGID, FittedArm, RobotFit
from hilcell.fit.placement import FitError
from hilcell.fit.robot_file import Robot
from hilcell.fit.urdf_file import Chain, Urdf, urdf_of
from hilcell.geometry.frames import apply, inverse, zyx_from_pose
from hilcell.geometry.jacobian import KINDS
from hilcell.geometry.kinematics import Arm, Array
from hilcell.geometry.statistics import Figures
from hilcell.identification.estimate import DETERMINED
from hilcell.sanitize import clean


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
        """Whether the poses determine it better than the prior."""
        return self.u < DETERMINED * self.prior_u


@dataclass(frozen=True, eq=False)
class RigidArm:
    """The identified ``arm``; ``T_L_B`` (4, 4): its base in the tracker's frame.

    ``smr_mm``: reflectors (3,) on the flange; ``covariance`` (5 n, 5 n) in the parameters' units;
    ``figures``: residuals at training poses left out in sequence.
    """

    arm: Arm
    T_L_B: Array
    smr_mm: Mapping[str, Array]
    parameters: list[Parameter]
    covariance: Array
    figures: Figures


def rigid_arm(fit: RobotFit) -> RigidArm:
    """The arm identified by link parameters alone; raises `FitError`."""
    nominal = fit.robot.arm
    units = {"mm": ("mm", 1.0), "rad": ("deg", float(np.degrees(1.0)))}
    fitted = fit.methods.get(RIGID)
    if not isinstance(fitted, FittedArm):
        raise FitError(f"no arm is identified: {fit.result['refused'][RIGID]}")
    kinematics, system = fitted.estimate.kinematics, fitted.estimate.system
    arm, links = kinematics.arm_of(fitted.estimate.state), slice(kinematics.placed, None)
    count = kinematics.links
    labels = [name.split() for name in kinematics.names[links][:count]]
    scale = np.array([units[unit][1] for _, unit in labels])
    rows = [getattr(each, kind) for each in (nominal, arm) for kind in KINDS]
    before, after = np.array(rows).reshape(2, count) * scale
    covariance = system.covariance[links, links][:count, :count] * np.outer(scale, scale)
    prior = kinematics.prior[1][links, links][:count, :count] * np.outer(scale, scale)
    u, prior_u = (np.sqrt(np.diag(each)) for each in (covariance, prior))
    parameters = [
        Parameter(name, units[unit][0], *map(float, values))
        for (name, unit), *values in zip(labels, before, after, u, prior_u, strict=True)
    ]
    figures = fit.validated[RIGID]
    return RigidArm(arm, fitted.base, fitted.smr_mm, parameters, covariance, figures)


def write_dh(path: Path, robot: Robot, fitted: RigidArm, *, inputs: Iterable[Path]) -> None:
    """Write the DH table as CSV, or as JSON with the covariance; raises `NotWritten`."""
    if path.suffix.lower() != ".json":
        header = ["parameter", "unit", "nominal", "identified", "u", "prior_u", "determined"]
        rows = []
        for each in fitted.parameters:
            values = (each.nominal, each.identified, each.u, each.prior_u)
            numbers = (f"{round(value, 6) + 0.0:.6f}" for value in values)
            rows.append([each.name, each.unit, *numbers, "yes" if each.determined else "no"])
        write_rows(path, header, rows, inputs=inputs)
        return
    convention = (
        "Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha) Ry(beta); prismatic Rz(offset) Tz(sign q + d)"
    )
    table = {
        "robot": robot.name,
        "convention": convention,
        "sign": fitted.arm.sign.tolist(),
        "prismatic": [row + 1 for row in fitted.arm.prismatic],
        "coupling": robot.arm.coupling,
        "base": robot.base.tolist(),
        "tool": robot.tool.tolist(),
        "parameters": [
            asdict(each) | {"determined": each.determined} for each in fitted.parameters
        ],
        "covariance": fitted.covariance.tolist(),
        "T_L_B": fitted.T_L_B.tolist(),
        "reflectors_mm": {name: point.tolist() for name, point in fitted.smr_mm.items()},
    }
    write_whole(path, msgspec.json.format(msgspec.json.encode(table), indent=1), inputs=inputs)


def urdf_bytes(robot: Robot, fitted: RigidArm, remarks: Sequence[str]) -> bytes:
    """Return the nominal file with the identified origins, or a new one, with remarks."""
    chain = Chain.of(robot.base, replace(fitted.arm, tool=robot.tool))
    left = np.eye(4)
    if isinstance(robot, Urdf):
        chain = chain.beside(robot.chain)
        left = robot.left_at_tip(chain)
    in_tip_mm = {
        label: apply(left @ inverse(robot.tool), point[None])[0]
        for label, point in fitted.smr_mm.items()
    }
    root = fitted.T_L_B @ inverse(robot.base)
    rpy_rad = np.radians(zyx_from_pose(root)[:2:-1])
    placed = f"{_numbers(root[:3, 3])}; {_numbers(rpy_rad * 1000.0)}"
    comment = [
        f"Calibrated by hilcell {__version__}: joint origins only. {remarks[0]}",
        *remarks[1:],
        *_coupled(robot.arm),
        f"Root link in the tracker's frame, xyz in m, rpy in rad: {placed}",
        *(
            f"Reflector {clean(label)} in the tip link, in m: {_numbers(point)}"
            for label, point in in_tip_mm.items()
        ),
    ]
    if isinstance(robot, Urdf):
        return robot.with_chain(chain, comment)
    return urdf_of(robot.name, chain, comment, _axis_limits(robot))


def _axis_limits(robot: Robot) -> Array:
    """Limits (3, n) of the axes' angles: lower, upper, speed. Axis 3 of a coupled arm turns as far
    and as fast as both joints together.
    """
    count = len(robot.arm)
    limits = np.vstack([np.broadcast_to(robot.limits_rad, (2, count)),
                        np.broadcast_to(robot.speeds_rad_s, (1, count))])  # fmt: skip
    if robot.arm.coupling:
        second, third = robot.arm.coupled_rows
        limits[:2, third] += np.sort(robot.arm.coupling * limits[:2, second])
        limits[2, third] += limits[2, second]
    return limits


def _coupled(arm: Arm) -> list[str]:
    if not arm.coupling:
        return []
    second, third = (row + 1 for row in arm.coupled_rows)
    against = "+" if arm.coupling > 0.0 else "-"
    return [f"Joint {third} is the axis's angle, J{third} {against} J{second} of the controller."]


def _numbers(values_mm: Array) -> str:
    return " ".join(f"{value / 1000.0:.7f}" for value in values_mm)


def alone(figures: Figures) -> list[str]:
    """Lines for people: effects that a URDF or DH table omits, and the residual."""
    unsaid = "It cannot state gravity, errors of drives (waves, pitch) and the residual model."
    misses = f"mean {figures.mean:.4f}, p95 {figures.p95:.4f}, max {figures.max:.4f} mm"
    return [
        unsaid,
        f"By itself it leaves {misses} at poses left out of its identification in turn.",
    ]
