"""The calibration from which a re-calibration starts, and the parts of it that are carried.

Gears, stiffness and repeatability do not change in weeks: the arm that the earlier calibration
identified, with the curves of its sweeps, is the prior of the new one, and the scatter of a visit
and the lost motion are the earlier ones. Frames and corrections are measured again.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np

from hilcell.calibration.file import Calibration
from hilcell.calibration.influence import Influence
from hilcell.cell.file import Cell
from hilcell.compensation.kinematic import Kinematic
from hilcell.decoding import typed
from hilcell.geometry.frames import turned_deg
from hilcell.identification.known_arm import KnownArm
from hilcell.journal.log import Log, of_measured
from hilcell.model.events import ArmCarried
from hilcell.ports import Array

REPEATABILITY, APPROACH = "Robot repeatability", "Approach direction"
USUAL_SAMPLES = 27.0  # poses that showed the noise, where the file states none: a quick grid's


@of_measured
def carried_calibration(log: Log) -> Calibration | None:
    """The calibration from which a run re-calibrates; None where it starts from none."""
    found = log.happened(ArmCarried)
    return typed(found[-1].content, Calibration) if found else None


def known_arm(calibration: Calibration) -> KnownArm:
    """The arm of a calibration for which `unfit` yields nothing."""
    model = calibration.learnt_model()
    assert isinstance(model, Kinematic)  # noqa: S101 - `unfit` yields that it is not
    samples = calibration.budget.model_samples or USUAL_SAMPLES
    return KnownArm(
        calibration.provenance.latest,
        model.kinematics,
        model.state,
        model.covariance,
        model.noise,
        samples,
    )


@of_measured
def carried_arm(log: Log) -> KnownArm | None:
    calibration = carried_calibration(log)
    return None if calibration is None else known_arm(calibration)


def carried_line(calibration: Calibration, name: str) -> Influence:
    """The line of a budget that a re-calibration does not measure again."""
    carried = ", in an earlier run"
    line = next(line for line in calibration.budget.lines if line.name == name)
    return msgspec.structs.replace(line, how=line.how.removesuffix(carried) + carried)


def carried_scatter(calibration: Calibration) -> tuple[Array, float]:
    """Covariance (3, 3) in {B} of one visit without the reading's noise, and how many visits, less
    their places, showed it.
    """
    line = carried_line(calibration, REPEATABILITY)
    robot_mm2 = np.array(line.covariance)[:3, :3]
    squares = float(np.square(robot_mm2).sum())
    if line.freedom is None or not squares:
        return robot_mm2, USUAL_SAMPLES
    return robot_mm2, line.freedom * squares / float(np.trace(robot_mm2)) ** 2


def unfit(calibration: Calibration, cell: Cell) -> Iterator[str]:
    """Yield why a cell cannot be re-calibrated from a calibration."""
    valid = calibration.validity
    again = "run calibrate without --from"
    model = calibration.learnt_model()
    if not isinstance(model, Kinematic):
        yield f"it corrects by {calibration.model.name}, which knows no arm; {again}"
    elif not (model.decision.used and model.kinematics.curves):
        yield f"it has no curves of the gears (axis sweeps), which are carried; {again}"
    elif model.kinematics.reflectors != len(cell.robot.seats_mm):
        yield (
            f"it measured {model.kinematics.reflectors} reflectors on the flange, this cell has "
            f"{len(cell.robot.seats_mm)}; {again}"
        )
    centre, half_mm = cell.grid.centre.matrix(), np.array(cell.grid.size_mm) / 2
    beyond_mm = max(
        float((np.array(valid.low_mm) - (centre[:3, 3] - half_mm)).max()),
        float((centre[:3, 3] + half_mm - np.array(valid.high_mm)).max()),
    )
    rounding_mm = 1e-6
    if not beyond_mm <= rounding_mm:
        yield f"the grid's cube leaves the calibrated volume by {beyond_mm:.0f} mm; {again}"
    turned = float(turned_deg(np.array(valid.orientation), centre[None])[0])
    most_deg = valid.orientation_tolerance_deg
    if not turned + cell.plan.tilt_deg <= most_deg:
        yield (
            f"the grid's orientation and plan.tilt_deg turn the tool by {turned:.1f} + "
            f"{cell.plan.tilt_deg:g} deg, calibrated within {most_deg:g} deg; {again}"
        )
    if cell.plan.grid_orientations:
        yield f"plan.grid_orientations are measured with the whole grid; {again}"
