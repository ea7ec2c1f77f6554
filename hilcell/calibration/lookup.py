"""The calibration that a procedure uses: lookup, checks before any motion, its journal.

The cell's table of the procedure names the file; its content is journalled when the run begins, so
that the result depends on the journal alone.
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple, Self

import msgspec

from hilcell.calibration.decision_rule import tolerance_limits
from hilcell.calibration.file import Calibration, read_calibration
from hilcell.calibration.known_arm import unfit
from hilcell.calibration.validity import CalibrationRefused, check_usable
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.decoding import Json, typed
from hilcell.journal.calibration_status import CalibrationStatus, current_of, statuses
from hilcell.journal.index import RunRow, find_run, in_order, read_index, row_of
from hilcell.journal.journal import StorageError
from hilcell.journal.log import Log
from hilcell.journal.runs import CALIBRATION, JOURNAL, is_run, read_log
from hilcell.model.calibration import Provenance
from hilcell.model.events import CalibrationUsed
from hilcell.model.verdicts import Fitted, Rechecked
from hilcell.ports import HilcellError

CURRENT = "current"  # names the current calibration, as no name does


class NoCalibration(HilcellError):
    """No calibration exists, or the named one is invalid."""

    code = "HC-C25"


@dataclass(frozen=True)
class CalibrationFile:
    """A calibration file, and its status by the journal of the run that wrote it. The run of a
    separate file is searched in ``runs``.
    """

    calibration: Calibration
    path: Path
    runs: Path

    @classmethod
    def named(cls, name: str, runs: Path) -> Self:
        """Read that of a run or a file; raises `NoCalibration`, `SettingsError`, `HilcellError`."""
        path = Path(name)
        if not os.path.isfile(path):  # noqa: PTH113 - Path.is_file raises for a name too long
            folder = find_run(runs, name)
            path = folder / CALIBRATION
            if not path.is_file():
                raise NoCalibration(
                    f"run {folder.name} wrote no calibration; {cls._instead(folder)}"
                )
        return cls(read_calibration(path), path, runs)

    @cached_property
    def folder(self) -> Path | None:
        """Folder of the run that wrote it, if present; a copied folder is the same run."""
        here = self.path.resolve().parent
        runs = here.parent if is_run(here) else self.runs
        wrote = runs / self.calibration.provenance.latest
        folder = here if is_run(here) and not is_run(wrote) else wrote
        return folder.resolve() if is_run(folder) else None

    @cached_property
    def status(self) -> CalibrationStatus | None:
        """Its status; None where its run is missing. A run in a copy of ``runs`` may have been
        revoked since in ``runs``.
        """
        folder = self.folder
        if folder is None:
            return None
        status = calibration_status(folder) or _unproven(row_of(folder))
        here = (self.runs / folder.name).resolve()
        if here == folder or not is_run(here) or row_of(here).origin != row_of(folder).origin:
            return status
        there = calibration_status(here) or _unproven(row_of(here))
        return status if there.usable else there

    @cached_property
    def cell(self) -> Cell | None:
        with suppress(HilcellError):  # of a journal that cannot be read only the hint is lost
            return read_log(self.folder).cell if self.folder else None
        return None

    @staticmethod
    def _instead(folder: Path) -> str:
        used = recheck = None
        with suppress(HilcellError):  # of a journal that cannot be read only the hint is lost
            log = read_log(folder)
            used, recheck = calibration_in(log), log.verdict(Rechecked)
        if used is None:
            with suppress(HilcellError):
                rows = read_index(folder.parent)
                for row in rows:
                    if row.name == folder.name and row.readable:
                        of_cell = (row.cell, row.serial, row.simulated, row.machine_seed)
                        if current := current_of(rows, *of_cell):
                            return f"name {current}, the current calibration of its cell"
            return "name a finished `hilcell run calibrate`"
        latest = used.provenance.latest
        if recheck is not None and recheck.verdict == "valid":
            return f"it used that of {latest}, and a re-check that holds writes none: name {latest}"
        if recheck is not None and recheck.verdict == "redo":
            return f"it found that the calibration of {latest} no longer holds: calibrate again"
        return f"it used that of {latest}"


class Chosen(NamedTuple):
    """A cell whose table names a usable file, accepted reasons against it, and the file."""

    cell: Cell
    accepted: list[str]
    words: str = ""


def with_calibration(
    cell: Cell,
    table: str,
    runs: Path,
    *,
    machine: int | None = None,
    accept_out_of_tolerance: bool = False,
    accept_not_current: bool = False,
) -> Chosen:
    """The cell with the path of a usable calibration file in ``table``, if it has that.

    The table names a run or a file; "" is the current calibration of this cell, and of the
    simulated ``machine``, in ``runs``. Raises `NoCalibration`, `CalibrationRefused`,
    `SettingsError`.
    """
    chosen = getattr(cell, table)
    if chosen is None:
        return Chosen(cell, [])  # the plan says which keys it lacks
    named = chosen.calibration
    if named in ("", CURRENT):
        named = str(_current(runs, cell, table, machine))
    used = CalibrationFile.named(named, runs)
    calibration, status = used.calibration, used.status
    carries = table == "plan"  # the arm alone: frames and corrections are measured again
    reasons = [*_exchanged(used)] or [*_foreign(used, cell, table, carries=carries)]
    if carries and not reasons:
        reasons += unfit(calibration, cell)
    if reasons:  # first: nothing accepts that of another cell
        raise CalibrationRefused(calibration, reasons)
    accepted = check_usable(
        calibration,
        datetime.now(UTC),
        max_age_days=math.inf,  # its age and the temperature are why it is checked
        limits=None if carries else tolerance_limits(cell),  # the arm is unchanged
        accept_out_of_tolerance=accept_out_of_tolerance,
        status=None if carries and status and status.to_redo else status,
        accept_not_current=accept_not_current,
    )
    words = f"the calibration of {calibration.provenance.named} is used"
    if status is not None:
        words += f": {status.text}"
        if not (status.usable or (carries and status.to_redo)):
            accepted.append(f"it is {status.text}")
    changed = msgspec.structs.replace(chosen, calibration=str(used.path.resolve()))
    return Chosen(msgspec.structs.replace(cell, **{table: changed}), accepted, words)


def calibration_named(cell: Cell, table: str) -> Calibration:
    chosen = getattr(cell, table)
    path = chosen.calibration if chosen is not None else ""
    if not path:
        raise NoCalibration(
            f"{table}.calibration is missing: name a run or its calibration.json with "
            f"--set {table}.calibration=RUN"
        )
    return read_calibration(Path(path))


def calibrated_machine(cell: Cell, table: str) -> int | None:
    """Seed of the simulated machine of the calibration in ``table``, if it is a run's."""
    chosen = getattr(cell, table)
    if chosen is None or cell.simulation is None or cell.simulation.address:
        return None
    folder = Path(chosen.calibration).parent
    if not is_run(folder):
        return None
    return read_log(folder).inputs.machine_seed


def record_of(calibration: Calibration, path: str) -> Json:
    content = msgspec.to_builtins(calibration)
    return {"run": calibration.provenance.latest, "file": path, "content": content}


def calibration_in(log: Log) -> Calibration | None:
    facts = (record.fact for record in reversed(log.events))
    used = next((fact for fact in facts if isinstance(fact, CalibrationUsed)), None)
    return None if used is None else typed(used.content, Calibration)


def used_calibration(log: Log) -> Calibration:
    """The calibration that the run uses; raises `NoCalibration` before it does."""
    calibration = calibration_in(log)
    if calibration is None:
        raise NoCalibration("the run has used no calibration yet")
    return calibration


def _current(runs: Path, cell: Cell, table: str, machine: int | None) -> Path:
    """The current calibration, or the newest that is not known to be bad. A touched base is valid
    for one visit, which ends when this run homes the slide.
    """
    gone, unproven, foreign, simulated = "", None, None, cell.simulation is not None
    rows = read_index(runs)
    known = statuses(rows)
    for row in reversed(in_order(rows)):
        path = runs / row.name / CALIBRATION
        status = known.get(row.name, _unproven(row))
        if (made := _made(path, row, status, cell, table)) is None or made.cell != cell.name:
            continue
        if machine is not None and row.machine_seed not in (None, machine):
            gone = gone or f" (that of run {row.name} is of simulated machine {row.machine_seed})"
        elif made.simulated != simulated:
            foreign = foreign or path  # a real cell and a simulated one of its name are two
        elif made.is_of_visit:
            gone = gone or f" (that of run {row.name} has a base that was touched on a visit)"
        elif status.state == "current":
            return path
        elif row.name in known and status.state == "in doubt" and not status.current:
            return path  # which is refused with its reason: it may supersede all others
        elif status.usable:
            unproven = unproven or path
        else:
            gone = gone or f" (that of run {row.name} is {status.text})"
    if fallback := unproven or (None if gone else foreign):  # which is refused with its reason
        return fallback
    raise NoCalibration(
        f"no finished run in {runs} has calibrated cell {cell.name}{gone}; `hilcell run calibrate` "
        f"first, or name a run or its calibration.json with {_option(table)}"
    )


def _made(
    path: Path, row: RunRow, status: CalibrationStatus, cell: Cell, table: str
) -> Provenance | None:
    """Provenance of a run's calibration; None where it has none that may be current. A damaged file
    raises only where it may be needed: by the run's journal, or of any cell without a journal.
    """
    if not path.is_file():
        return None
    try:
        return read_calibration(path).provenance
    except SettingsError as error:
        of_cell = (row.cell, row.simulated) == (cell.name, cell.simulation is not None)
        needed = status.usable or status.state == "in doubt"
        if needed and (of_cell or not row.readable):
            raise SettingsError(
                error.source, [*error.problems, _way_out(path.parent, table)]
            ) from error
        return None


def _way_out(folder: Path, table: str) -> str:
    """Return what to do about a run whose cell or calibration cannot be read."""
    return (
        f"restore {folder} from the backup; move it out of {folder.parent} if it is of another "
        f"cell; or name a calibration with {_option(table)}"
    )


def _option(table: str) -> str:
    """Return the option that names a calibration."""
    return "--from RUN" if table == "plan" else f"--set {table}.calibration=RUN"


def calibration_status(folder: Path) -> CalibrationStatus | None:
    folder = folder.resolve()
    return calibration_statuses(folder.parent, read_index(folder.parent)).get(folder.name)


def calibration_statuses(runs: Path, rows: Sequence[RunRow]) -> dict[str, CalibrationStatus]:
    """Statuses by journals and files; in doubt where a later one is unread. Also in doubt is a
    calibration with which its run did not end.
    """
    readable = {row.name for row in rows if row.readable}
    by_run = statuses(rows)
    for name in [name for name, each in by_run.items() if each.state == "current"]:
        for later in _later_unread(runs / name, readable):
            why = (
                f"run {later} wrote a later calibration of the cell, its journal is damaged or gone"
            )
            by_run[name] = CalibrationStatus("in doubt", "", why)
            break
    for row in rows:
        if row.name not in by_run and os.path.isfile(f"{runs}/{row.name}/{CALIBRATION}"):  # noqa: PTH113 - of ten thousand runs a Path each is too slow
            by_run[row.name] = _unproven(row)
    return by_run


def _later_unread(folder: Path, readable: Collection[str]) -> Iterator[str]:
    """Yield folders with a later calibration of the cell and no readable journal."""
    made = None
    for name in os.listdir(folder.parent):  # noqa: PTH208 - of ten thousand runs a Path each is too slow
        path = folder.parent / name / CALIBRATION
        if name in readable or not path.is_file():
            continue
        with suppress(SettingsError):  # a file that is none, or damaged, supersedes nothing
            made = made or read_calibration(folder / CALIBRATION).provenance
            other = read_calibration(path).provenance
            of_cell = (other.cell, other.simulated) == (made.cell, made.simulated)
            if of_cell and other.latest == name and other.written > made.written:
                yield name


def _unproven(row: RunRow) -> CalibrationStatus:
    ended = "made no calibration by its journal" if row.finished else f"is {row.condition}"
    return CalibrationStatus("in doubt", "", f"its run {ended}")


def _exchanged(used: CalibrationFile) -> Iterator[str]:
    """Yield why a run's calibration file is that of another run, by its journal."""
    folder = used.path.parent
    with suppress(StorageError):  # of a journal that cannot be read the status says so
        if is_run(folder) and not _wrote(read_log(folder), used.calibration):
            yield (
                f"{CALIBRATION} in {folder} is not the one that this run wrote, by its journal; "
                f"restore the run's own, or name run {used.calibration.provenance.latest} itself"
            )


def _wrote(log: Log, calibration: Calibration) -> bool:
    """Whether a run has made or updated a calibration as its file says. One that has done neither
    is judged by its status.
    """
    made, fit, used = calibration.provenance, log.verdict(Fitted), calibration_in(log)
    if fit is not None:
        own, there = (msgspec.json.encode(each) for each in (fit.loocv, made.scores))
        return own == there and not made.updates
    if used is None:
        return True
    return [*used.provenance.updates] == made.updates[:-1] and made.run == used.provenance.run


def _foreign(used: CalibrationFile, cell: Cell, table: str, *, carries: bool) -> Iterator[str]:
    """Yield why a calibration is of another cell; of one that ``carries`` the arm alone, why of
    another robot.
    """
    calibration, folder = used.calibration, used.path.parent
    made = calibration.provenance
    if made.simulated != (cell.simulation is not None):
        kinds = ("a simulated", "a real") if made.simulated else ("a real", "a simulated")
        yield f"it is of {kinds[0]} cell, this is {kinds[1]} one; calibrate this cell"
    if missing := calibration.uncertainty.missing:
        yield f"it states no uncertainty to judge by: {missing}; calibrate again"
    if not carries and cell.grid.station not in calibration.stations:
        yield f"station {cell.grid.station} is not calibrated by it"
    if made.digest == cell.digest:
        return
    if not is_run(folder):
        yield (
            f"it is of cell {made.cell} with digest {made.digest[:12]}, this one has "
            f"{cell.digest[:12]}; name the run that wrote it, or run with the cell file of then"
        )
        return
    try:
        then = read_log(folder).cell
    except StorageError:
        unknown = f"whether it is of this cell is unknown: {folder / JOURNAL} cannot be read"
        yield f"{unknown}; {_way_out(folder, table)}"
        return
    fixed = (
        "name", "serial", "robot.joint", "robot.smr_mm", "robot.more_smr_mm", "robot.status",
        *(("tracker.reflector",) if carries else
          ("layout.base", "layout.floor", "station", "grid.station")),
    )  # fmt: skip
    for key in fixed:
        if attrgetter(key)(then) != attrgetter(key)(cell):
            yield f"{key} differs from the cell that was calibrated; calibrate this cell"
