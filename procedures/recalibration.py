"""A re-calibration: a calibration that starts from an earlier one, which knows the arm.

`plan.calibration` names that. Its gears, lost motion and repeatability are carried instead of
measured; the arm is followed by a few poses (`procedures.robot_grid.ChosenPoses`).
"""

from __future__ import annotations

from hilcell.calibration.grid import measured_errors
from hilcell.calibration.known_arm import carried_arm, carried_calibration, mount_since
from hilcell.calibration.lookup import NoCalibration, calibration_named, record_of
from hilcell.cell.file import Cell
from hilcell.identification.known_arm import Followed, KnownArm, in_words
from hilcell.journal.log import Log
from hilcell.model.events import ArmCarried
from hilcell.model.plan import PlannedStep
from hilcell.model.results import StepResult
from hilcell.ports import HilcellError
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result, Step

TABLE = "plan"
CARRIED = "carried from the calibration that it starts from"


class CarriedArm:
    """Takes over the calibration that a re-calibration starts from."""

    name = "known-arm"
    needs = "in a re-calibration, an earlier calibration of this robot"
    moves = "nothing"
    measures = "nothing"
    yields = "the arm as it was, in the run's own journal"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse a full plan, whose targets are the whole grid's."""
        if cell.plan.recalibrates and not cell.plan.quick:
            raise HilcellError(
                "plan.quick is false, expected true: a re-calibration measures little; leave it "
                "out, or run calibrate --full without --from",
                code="HC-C10",
            )
        return PlannedStep(self.name, 0, 0.0)

    def perform(self, session: CellSession) -> None:
        """Refuse another robot: the cell file has no serial number of it."""
        cell, log = session.cell, session.log
        if not cell.plan.recalibrates or carried_calibration(log) is not None:
            return
        calibration = calibration_named(cell, TABLE)
        run, kind = calibration.provenance.latest, "robot"
        then = {each.serial for each in calibration.provenance.devices if each.kind == kind}
        now = {each.serial for each in log.assets if each.kind == kind}
        if then != now:
            raise HilcellError(
                f"the calibration of {run} is of the robot with serial {', '.join(then)}, "
                f"connected is {', '.join(now)}; run calibrate without --from",
                code="HC-C26",
            )
        session.add(ArmCarried(**record_of(calibration, cell.plan.calibration)))

    def result(self, log: Log) -> Result:
        """Return how the arm has changed; nothing where it was measured whole."""
        calibration = carried_calibration(log)
        if calibration is None:
            return {}
        found, mount = followed(log), mount_since(log)
        return {
            "known_arm": Change(
                calibration=calibration.provenance.latest,
                poses=len(found.estimate.readings),
                ratio=found.ratio,
                limit=found.limit,
                gain=found.gear[0],
                most_gain=found.most_gain,
                changed=found.changed,
                mount_mm=None if mount is None else mount.shift_mm,
            )
        }


class Change(StepResult, frozen=True, kw_only=True):
    """The poses' chi^2 over its degrees of freedom, the gain of likelihood by a gear's scatter,
    both with their limits, and what has changed by name: rad, mm, or a ratio. ``mount_mm``: by how
    much the reflector has moved on the flange, None where the earlier run swept other circles.
    """

    calibration: str
    poses: int
    ratio: float
    limit: float
    gain: float
    most_gain: float
    changed: dict[str, float]
    mount_mm: float | None

    @property
    def text(self) -> str:
        """The changes in words, and what was not compared."""
        text = f"Unchanged since {self.calibration}: the arm, by {self.poses} poses."
        if self.changed:
            text = f"Changed since {self.calibration}: {in_words(self.changed)}."
        text += " Gears, lost motion and repeatability were not measured."
        if self.mount_mm is None:
            text += " The reflector's mount was not compared: other circles were swept then."
        return text


def arm_in(log: Log) -> KnownArm:
    """Return the arm from which a re-calibration starts; raises `NoCalibration`."""
    arm = carried_arm(log)
    if arm is None:
        raise NoCalibration("the run has carried no arm yet")
    return arm


def followed(log: Log) -> Followed:
    """Return how a re-calibration's arm has changed; raises `ArmChanged`."""
    arm = measured_errors(log).arm
    assert arm is not None  # noqa: S101 - a run measures it
    return arm_in(log).followed(arm.readings)


class Once:
    """A step whose yield a re-calibration carries."""

    def __init__(self, step: Step) -> None:
        self.step = step
        self.name, self.needs, self.moves = step.name, step.needs, step.moves
        self.measures, self.yields = step.measures, step.yields

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        if cell.plan.recalibrates:
            return PlannedStep(self.name, 0, 0.0, note=CARRIED)
        return self.step.plan(cell, seed)

    def perform(self, session: CellSession) -> None:
        if not session.cell.plan.recalibrates:
            self.step.perform(session)

    def result(self, log: Log) -> Result:
        return {} if log.cell.plan.recalibrates else self.step.result(log)
