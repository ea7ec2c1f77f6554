"""Runs that were ordered and checked: nothing that can be known before refuses them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.ports import HilcellError
from hilcell.run.procedure import Plan, Procedure
from hilcell.run.same_cell import NONE, Changes


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """A run in its folder, ``points`` of which its procedure measures.

    ``changes`` say what is not as it was when a run that goes on began.
    """

    folder: Path
    cell: Cell
    procedure: Procedure
    points: int
    changes: Changes = NONE


@dataclass(frozen=True, kw_only=True)
class NewRun(RunPlan):
    """``machine_seed`` is of the simulated machine, None where no simulator is started.

    ``accepted`` says why the calibration that the run uses is out of tolerance, or not current.
    """

    steps: Plan
    machine_seed: int | None
    accepted: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class ResumedRun(RunPlan):
    """A run that ``goes_on``, or one that has measured all and only writes its calibration.

    ``retakes`` are keys of points that the journal does not ask for yet; ``somebody`` is there to
    be asked.
    """

    goes_on: bool
    retakes: Sequence[str]
    somebody: bool


def check_attended(cell: Cell, procedure: Procedure, *, unattended: bool) -> None:
    """Refuse to leave a cell alone where the cell, or the procedure, needs somebody's hands."""
    if not unattended:
        return
    if procedure.by_hand:
        raise HilcellError(
            f"{procedure.name} refused before anything moves: somebody must be there to "
            f"{procedure.by_hand}; leave out --unattended",
            code="HC-C16",
        )
    if cell.layout.by_hand:
        raise HilcellError(
            f"cell {cell.name}: layout.reflectors is by_hand: somebody must be there to carry the "
            "reflector; leave out --unattended, or mount reflectors in all nests",
            code="HC-C16",
        )


def check_of_simulator(cell: Cell, option: str, value: float | None) -> None:
    """Refuse an option of the simulator where a run starts none."""
    if value is None:
        return
    if cell.simulation is None:
        raise HilcellError(
            f"{option} is for simulated cells; cell {cell.name} is real", code="HC-C12"
        )
    if cell.simulation.address:
        raise HilcellError(
            f"{option}: the simulated cell at {cell.simulation.address} runs already; "
            f"give {option} to its `hilcell sim`",
            code="HC-C17",
        )


def machine_seed(cell: Cell, seed: int, own: int | None) -> int | None:
    """Return the seed of the machine that is started: its own, or else the run's.

    None where no simulator is started: it is unknown.
    """
    if cell.simulation is None or cell.simulation.address:
        return None
    return seed if own is None else own


def calibrated_or_asked(asked: int | None, calibrated: int | None) -> int | None:
    """Return the simulated machine of a run that uses a calibration: the one calibrated.

    None is one that is not asked for, or not known. Raises `SettingsError` where they differ.
    """
    if None not in (asked, calibrated) and asked != calibrated:
        problem = f"{asked}: the calibration is of simulated machine {calibrated}; name another"
        raise SettingsError("--machine-seed", [problem])
    return calibrated if asked is None else asked
