"""The correction from the grid's data, and the verification of its sign.

Cross-validation chooses the model. Then one target is measured uncorrected and corrected, because
the paper's text has the wrong sign, which doubles every error: nothing is released before the
corrected one is closer.
"""

from __future__ import annotations

from itertools import product
from operator import attrgetter

import numpy as np

from hilcell.calibration.grid import grid_errors_mm, grid_of, measured_errors, outlying_vertices
from hilcell.calibration.position_errors import position_errors
from hilcell.cell.file import Cell
from hilcell.compensation.correction import corrected
from hilcell.compensation.grid import Grid
from hilcell.compensation.kinematic import curves_used
from hilcell.compensation.model import Measured
from hilcell.compensation.model_choice import MODELS, chosen
from hilcell.decoding import typed
from hilcell.geometry.frames import apply
from hilcell.geometry.statistics import lengths_mm
from hilcell.journal.log import Log, noise_at, run_noise
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId, Sent
from hilcell.model.results import StepResult
from hilcell.model.verdicts import CurvesUsed, Fitted, SignChecked
from hilcell.ports import Array, HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures import plan


class Choice(StepResult, frozen=True, kw_only=True):
    """The choice of the error model, as in `Fitted`."""

    loocv: dict[str, dict[str, float]]
    reason: str
    refused: dict[str, str]
    curves: CurvesUsed
    outliers: list[PointId]
    orientation: str = ""


class Fit:
    """Compares the models by leaving each vertex out, and chooses."""

    name = "fit"
    needs = "the grid measured, the stations framed"
    moves = "nothing"
    measures = "nothing"
    yields = "the chosen correction"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse a grid of one cell: nothing in it could be left out."""
        shape = grid_of(cell).shape
        if max(shape) < 3 and not cell.plan.recalibrates:
            raise HilcellError(
                f"grid of {' x '.join(map(str, shape))} vertices, expected three along one axis "
                "at least; choose a smaller pitch_mm",
                code="HC-C10",
            )
        return PlannedStep(self.name, 0, 0.0)

    def perform(self, session: CellSession) -> None:
        session.retake_waiting()
        if session.log.verdict(Fitted) is None:
            session.judge("fit", fitted(session.log))
        session.reach("fit")

    def result(self, log: Log) -> Result:
        found = fitted(log)
        return {"method": found.method, "fit": typed(found, Choice, from_attributes=True)}


def fitted(log: Log) -> Fitted:
    measured = measured_errors(log)
    choice = chosen(measured, reoriented=log.cell.plan.turns)
    model, orientation = choice.model, ""
    if log.cell.orients:
        orientation = f"left as it is: {model} predicts positions only"
        if _orients(log.cell, model, measured):
            orientation = f"corrected: {model} predicts it"
    return Fitted(
        holds=True,
        method=model,
        loocv={name: each._asdict() for name, each in choice.figures.items()},
        reason=choice.reason,
        refused=choice.refused,
        curves=curves_used(measured),
        outliers=outlying_vertices(log),
        orientation=orientation,
        tail=_tail(model, measured) if log.cell.plan.quick else None,
    )


def _tail(name: str, measured: Measured) -> float:
    sizes_mm = MODELS[name].left_out_sizes_mm(measured)
    return float(sizes_mm.max() / np.median(sizes_mm))


def orients(log: Log) -> bool:
    return _orients(log.cell, log.method, measured_errors(log))


def _orients(cell: Cell, name: str, measured: Measured) -> bool:
    vertex = plan.poses_at(cell, grid_of(cell).origin_mm[None])
    return MODELS[name].learn(measured).predict(vertex).orientation is not None


SIGN_IDS = {how: PointId("sign", how=how) for how in (Sent.BEFORE, "corrected")}


class SignErrors(StepResult, frozen=True, kw_only=True):
    """The errors of the target before and corrected, and their ratio."""

    before_mm: float
    corrected_mm: float
    ratio: float


class SignCheck:
    """The target is the middle of the grid's worst cell, with the largest correction."""

    name = "sign-check"
    needs = "the fitted correction"
    moves = "the robot to one target in the cube, as it is and corrected, at the grid's station"
    measures = "the flange reflector at both"
    yields = "whether the correction takes the error away instead of doubling it"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse a grid with a cell out of reach: any may be the worst."""
        grid = grid_of(cell)
        there, middles_mm = cell.reference, self._cells(grid)[1]
        joints_rad = plan.check_targets(
            cell, there, plan.poses_at(cell, middles_mm), "middle of a grid cell"
        )
        last = there if cell.plan.quick else plan.stations_in_order(cell)[-1]
        back = plan.leg(cell, last, there)
        both = plan.flange_points(cell, joints_rad[[0] * len(SIGN_IDS)])
        return PlannedStep.of_spans(self.name, len(SIGN_IDS), [*back, both, *plan.closing(cell)])

    def perform(self, session: CellSession) -> None:
        if "sign" in session.log.verdicts:
            return
        station = session.cell.reference
        target_mm = self.worst_mm(session.log)
        commands = {Sent.BEFORE: target_mm, "corrected": self.command(session.log, target_mm)}
        nominal_mm = apply(session.frames.base_in_world(station), target_mm)[0]
        for how, command in commands.items():
            joints = plan.joints_for(session.cell, command)[0]
            session.flange_point(SIGN_IDS[how], station, joints, nominal_mm=nominal_mm)
        session.close_step()
        found = self.errors(session.log)
        limit = self._limit(session.log, found.before_mm)
        judged = SignChecked(
            holds=found.ratio < limit,
            limit=limit,
            before_mm=found.before_mm,
            corrected_mm=found.corrected_mm,
            ratio=found.ratio,
        )
        session.judge("sign", judged)

    def command(self, log: Log, target_mm: Array) -> Array:
        """Return the command (1, 3) in {B} for the target (1, 3), as `compensate` does."""
        model = MODELS[log.method].learn(measured_errors(log))
        return corrected(grid_of(log.cell), plan.poses_at(log.cell, target_mm), model)

    def result(self, log: Log) -> Result:
        return {"sign": self.errors(log)}

    @staticmethod
    def _limit(log: Log, before_mm: float) -> float:
        """Return the limit of the ratio: wider by twice the readings' noise, 1 at most.

        The wrong sign gives about 2, a right correction less than the middle.
        """
        clearly = 0.5  # the corrected error over the one before
        noise, points = run_noise(log), [log.point(id) for id in SIGN_IDS.values()]
        before_mm2, corrected_mm2 = np.trace(noise_at(noise, points), axis1=-2, axis2=-1)
        noise_mm = float(np.sqrt(corrected_mm2 + clearly**2 * before_mm2))
        return min(1.0, clearly + 2.0 * noise_mm / before_mm)

    @staticmethod
    def table(result: Result) -> Table:
        return Table(
            [
                Column("before", attrgetter("before_mm"), "mm", ".4f"),
                Column("corrected", attrgetter("corrected_mm"), "mm", ".4f"),
                Column("ratio", attrgetter("ratio"), form=".4f"),
            ],
            [typed(result["sign"], SignErrors)],
        )

    @staticmethod
    def errors(log: Log) -> SignErrors:
        points = [log.point(id) for id in SIGN_IDS.values()]
        before_mm, corrected_mm = position_errors(log, points).norms_mm.tolist()
        ratio = corrected_mm / before_mm
        return SignErrors(before_mm=before_mm, corrected_mm=corrected_mm, ratio=ratio)

    @staticmethod
    def worst_mm(log: Log) -> Array:
        """Return the middle (1, 3) in {B} of the cell whose vertices' mean error is the largest."""
        grid, errors_mm = grid_of(log.cell), grid_errors_mm(log)
        cells, middles_mm = SignCheck._cells(grid)
        mean_mm = [
            errors_mm[i : i + 2, j : j + 2, k : k + 2].mean(axis=(0, 1, 2)) for i, j, k in cells
        ]
        return middles_mm[[int(np.argmax(lengths_mm(mean_mm)))]]

    @staticmethod
    def _cells(grid: Grid) -> tuple[list[tuple[int, ...]], Array]:
        """Return the lowest vertex of each cell, and its middle, (N, 3) in {B}."""
        cells = list(product(*(range(count - 1) for count in grid.shape)))
        return cells, grid.origin_mm + grid.pitch_mm * (np.array(cells) + 0.5)
