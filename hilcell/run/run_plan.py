"""Runs that were ordered and checked: nothing that can be known before refuses them.

I18: a resumed run goes on with what it began with, or somebody agrees to what has changed. Points
of one robot, tracker, drive or strip say nothing about another one's. A run keeps the cell as it
was when it began; an edited cell file changes nothing in it, and the operator has to know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hilcell import __version__
from hilcell.cell.differences import differences
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import built_in_cells
from hilcell.journal.log import Log, changed_asset_kinds
from hilcell.ports import DeviceRefused, HilcellError, Identity
from hilcell.run.procedure import Plan, Procedure


@dataclass(frozen=True, slots=True)
class Changes:
    """Changes that were found before the devices were opened, whether all are accepted, and
    whether somebody can be asked.
    """

    inputs: Sequence[str] = ()
    accepted: bool = False
    can_ask: bool = True

    def check(self, found: Sequence[str]) -> None:
        """Refuse changes that are not accepted and that nobody can agree to."""
        if found and not (self.accepted or self.can_ask):
            raise DeviceRefused(
                "HC-C30",
                "Cell",
                "resume",
                "; ".join(found),
                expected="as when the run began",
                act="put back what was there; or resume at a terminal and agree, or say "
                "--accept-changes",
                fields={"changes": list(found)},
            )


NONE = Changes()


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


def checked_machine_seed(asked: int | None, calibrated: int | None) -> int | None:
    """Return the simulated machine of a run that uses a calibration: the one calibrated.

    None is one that is not asked for, or not known. Raises `SettingsError` where they differ.
    """
    if None not in (asked, calibrated) and asked != calibrated:
        problem = f"{asked}: the calibration is of simulated machine {calibrated}; name another"
        raise SettingsError("--machine-seed", [problem])
    return calibrated if asked is None else asked


# -- changes since a run began ---------------------------------------------------------------------


def cell_file(where: str) -> str:
    """Return where a run's cell is found again: a built-in name, or an absolute path."""
    return where if where in built_in_cells() else str(Path(where).resolve())


def changed_inputs(log: Log, uses: str) -> list[str]:
    """Return what differs from the journal: hilcell's version, and the cell file.

    ``uses`` is the cell's table into which the run itself wrote its calibration; "" for none.
    """
    changes = []
    where, before = log.inputs.cell_file, log.inputs.versions.get("hilcell", __version__)
    if before != __version__:
        changes.append(f"hilcell {before} began this run, this is {__version__}")
    found = ""
    if where and where not in built_in_cells() and not Path(where).exists():
        found = "is missing"
    elif where:
        try:
            cell = load_cell(where, log.inputs.settings)
        except SettingsError as error:
            found = f"has changed, and is not valid: {error.problems[0]}"
        else:
            changed = differences(log.cell, cell, without=uses)
            found = changed and f"has changed: {changed}"
    if found:
        changes.append(f"cell file {where} {found}; the run keeps the cell that it began with")
    return changes


def changed_assets(before: Sequence[Identity], now: Sequence[Identity]) -> list[str]:
    """Return the assets that are not those which answered before; none answered at a first time."""
    if not before:
        return []
    first = {asset.kind: asset for asset in before}
    found = {asset.kind: asset for asset in now}
    return [
        f"{kind}: {_words(first.get(kind))} before, {_words(found.get(kind))} now"
        for kind in changed_asset_kinds(first, found)
    ]


def _words(asset: Identity | None) -> str:
    if asset is None:
        return "none"
    firmware = f", firmware {asset.firmware}" if asset.firmware else ""
    return f"{asset.maker} {asset.model}, serial {asset.serial}{firmware}".lstrip()
