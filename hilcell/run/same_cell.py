"""I18: a resumed run goes on with what it began with, or somebody agrees to what has changed.

Points of one robot, tracker, drive or strip say nothing about another one's. A run keeps the cell
as it was when it began; an edited cell file changes nothing in it, and the operator has to know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hilcell import __version__
from hilcell.cell.differences import differences
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import built_in_cells
from hilcell.journal.asset import same
from hilcell.journal.log import Log
from hilcell.journal.run_journal import RunJournal
from hilcell.model.events import Asset, ChangesAccepted, Connected
from hilcell.ports import DeviceRefused, Identity


@dataclass(frozen=True, slots=True)
class Changes:
    """Changes that were found before the devices were opened, whether all are accepted, and
    whether somebody can be asked.
    """

    inputs: Sequence[str] = ()
    accepted: bool = False
    askable: bool = True

    def check(self, found: Sequence[str]) -> None:
        """Refuse changes that are not accepted and that nobody can agree to."""
        if found and not (self.accepted or self.askable):
            raise not_as_before(found)


NONE = Changes()


def cell_file(where: str) -> str:
    """Return where a run's cell is found again: a built-in name, or an absolute path."""
    return where if where in built_in_cells() else str(Path(where).resolve())


def changed_inputs(log: Log, uses: str) -> list[str]:
    """Return what differs from the journal: hilcell's version, and the cell file.

    ``uses`` is the cell's table into which the run itself wrote its calibration; "" for none.
    """
    changes = []
    before = log.inputs.versions.get("hilcell", __version__)
    if before != __version__:
        changes.append(f"hilcell {before} began this run, this is {__version__}")
    if log.inputs.cell_file:
        changes += _changed_cell(log, uses)
    return changes


def _changed_cell(log: Log, uses: str) -> list[str]:
    where = log.inputs.cell_file
    try:
        cell = load_cell(where, log.inputs.settings)
    except SettingsError as error:
        return [f"cell file {where} has changed, and is no cell any more: {error.problems[0]}"]
    changed = differences(log.cell, cell, without=uses)
    found = f"cell file {where} has changed: {changed}"
    return [f"{found}; the run keeps the cell that it began with"] if changed else []


def changed_assets(before: Sequence[Asset], now: Sequence[Identity]) -> list[str]:
    """Return the assets that are not those which answered before; none answered at a first time."""
    if not before:
        return []
    first = {asset.kind: asset for asset in before}
    found = {asset.kind: asset for asset in Connected.of(now, "").devices}
    return [
        f"{kind}: {_words(first.get(kind))} before, {_words(found.get(kind))} now"
        for kind in sorted(first.keys() | found.keys())
        if not same(first.get(kind), found.get(kind))
    ]


def _words(asset: Asset | None) -> str:
    if asset is None:
        return "none"
    firmware = f", firmware {asset.firmware}" if asset.firmware else ""
    return f"{asset.maker} {asset.model}, serial {asset.serial}{firmware}".lstrip()


def accepted(journal: RunJournal, changes: Sequence[str], by: str) -> None:
    """Journal that somebody, or an option, has accepted changes."""
    if changes:
        journal.append("event", "", ChangesAccepted(changes=list(changes), by=by))


def not_as_before(changes: Sequence[str]) -> DeviceRefused:
    """Return the error for a run with nobody to be asked."""
    return DeviceRefused(
        "HC-C30",
        "Cell",
        "resume",
        "; ".join(changes),
        wanted="as when the run began",
        act="put back what was there; or resume at a terminal and agree, or say --accept-changes",
        fields={"changes": list(changes)},
    )
