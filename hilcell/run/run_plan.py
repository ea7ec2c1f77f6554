"""Runs that were ordered and checked before anything moves.

I18: a resumed run continues with the same devices and inputs, or the operator accepts the changes.
A run keeps the cell file it began with; a later edit has no effect and is reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hilcell import __version__
from hilcell.cell.differences import differences
from hilcell.cell.file import Cell, load_cell, states
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import built_in_cells
from hilcell.identity import Identity, changed_asset_kinds
from hilcell.journal.log import Log
from hilcell.ports import DeviceRefused, HilcellError
from hilcell.run.procedure import Plan, Procedure


@dataclass(frozen=True, slots=True)
class Changes:
    """Changes known before the devices are opened, whether all are accepted, and whether the
    operator can be prompted.
    """

    inputs: Sequence[str] = ()
    accepted: bool = False
    can_ask: bool = True

    def check(self, found: Sequence[str]) -> None:
        """Raise `DeviceRefused` for changes that cannot be accepted."""
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


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """A run in its folder; ``points`` is the planned number, ``changes`` are those of a resume."""

    folder: Path
    cell: Cell
    procedure: Procedure
    points: int
    changes: Changes = Changes()


@dataclass(frozen=True, kw_only=True)
class NewRun(RunPlan):
    """``machine_seed`` is the simulated machine's, None where no simulator is started; ``accepted``
    are the accepted defects of the calibration that the run uses, ``settings`` those of its cell.
    """

    steps: Plan
    settings: Mapping[str, str]
    seed: int
    machine_seed: int | None
    accepted: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class ResumedRun(RunPlan):
    """A run that ``continues``: points are missing or re-measured; otherwise it only writes its
    calibration file.

    ``retakes`` are the newly requested points; ``operator_present``: can be prompted.
    """

    continues: bool
    retakes: Sequence[str]
    operator_present: bool


QUICK = "plan.quick"


def with_plan(where: str, settings: Mapping[str, str], procedure: Procedure) -> dict[str, str]:
    """Return the settings, with the quick plan where it is the procedure's and none is stated."""
    if not procedure.quick or states(where, settings, QUICK):
        return dict(settings)
    return {**settings, QUICK: "true"}


def check_of_simulator(cell: Cell, option: str, value: float | None) -> None:
    """Raise `HilcellError` for a simulator's option where the run starts no simulator."""
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
    """Return the seed of the simulated machine: its own, else the run's; None without one."""
    if cell.simulation is None or cell.simulation.address:
        return None
    return seed if own is None else own


def checked_machine_seed(requested: int | None, calibrated: int | None) -> int | None:
    """Return the machine seed of a run that uses a calibration; None is unknown.

    Raises `SettingsError` where the requested and the calibrated one differ.
    """
    if None not in (requested, calibrated) and requested != calibrated:
        problem = f"{requested}: the calibration is of simulated machine {calibrated}; name another"
        raise SettingsError("--machine-seed", [problem])
    return calibrated if requested is None else requested


# -- changes since a run began ---------------------------------------------------------------------


def cell_file(where: str) -> str:
    """Return the name of a built-in cell, or the absolute path of a cell file."""
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
    """Return the devices that differ from those of the last session, if there was one."""
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
