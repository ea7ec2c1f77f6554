"""The grid's data become a correction; cross-validation chooses the model."""

from __future__ import annotations

from hilcell.calibration.frames import grid_of, measured_of, outlying_vertices
from hilcell.cell.file import Cell
from hilcell.compensation.choice import MODELS, chosen
from hilcell.compensation.kinematic import curves_used
from hilcell.compensation.measured import Measured
from hilcell.journal.log import Log
from hilcell.model.plan import Step
from hilcell.model.point import PointId
from hilcell.model.results import ActResult
from hilcell.model.verdicts import CurvesUsed, Fitted
from hilcell.ports import HilcellError
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from hilcell.typed import typed
from procedures.plan import poses_at


class Choice(ActResult, frozen=True, kw_only=True):
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

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse a grid of one cell: nothing in it could be left out."""
        shape = grid_of(cell).shape
        if max(shape) < 3:
            raise HilcellError(
                f"grid of {' x '.join(map(str, shape))} vertices, wanted three along one axis "
                "at least; choose a smaller pitch_mm",
                code="HC-C10",
            )
        return Step(self.name, 0, 0.0)

    def perform(self, session: CellSession) -> None:
        """Journal the choice, on the points as they are wanted."""
        session.retake_waiting()
        if session.log.verdict(Fitted) is None:
            session.judge("fit", fitted(session.log))
        session.reach("fit")

    def result(self, log: Log) -> Result:
        """Return the method, its cross-validation and the reasons."""
        found = fitted(log)
        return {"method": found.method, "fit": typed(found, Choice, from_attributes=True)}


def fitted(log: Log) -> Fitted:
    """Return the choice of the error model, by what was measured."""
    measured = measured_of(log)
    choice = chosen(measured, turned=log.cell.plan.turns)
    turned = log.cell.robot.more_smr_mm
    return Fitted(
        holds=True,
        method=choice.model,
        loocv={name: each._asdict() for name, each in choice.figures.items()},
        reason=choice.reason,
        refused=choice.refused,
        curves=curves_used(measured),
        outliers=outlying_vertices(log),
        orientation=_orientation(log.cell, choice.model, measured) if turned else "",
    )


def orients(log: Log) -> bool:
    """Whether the chosen correction turns the tool as well."""
    return _orients(log.cell, log.method, measured_of(log))


def _orients(cell: Cell, name: str, measured: Measured) -> bool:
    """Whether a model learnt from what was measured predicts orientation."""
    vertex = poses_at(cell, measured.grid.grid.origin_mm[None])
    return MODELS[name].learn(measured).predict(vertex).turn is not None


def _orientation(cell: Cell, name: str, measured: Measured) -> str:
    """Return in words what becomes of the tool's orientation."""
    if _orients(cell, name, measured):
        return f"corrected: {name} predicts it"
    return f"left as it is: {name} predicts positions only"
