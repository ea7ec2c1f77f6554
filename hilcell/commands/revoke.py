"""``revoke``: a calibration that must not be used any more, journalled in the run that made it."""

from __future__ import annotations

import os
from pathlib import Path

from hilcell.calibration.in_use import standing_of
from hilcell.clean import encodable
from hilcell.commands.orders import Revoke
from hilcell.commands.output import print_json, print_message
from hilcell.journal.engine_file import live_engine
from hilcell.journal.find_run import find_run
from hilcell.journal.index import row_of
from hilcell.journal.journal import StorageError
from hilcell.journal.run_journal import RunJournal
from hilcell.journal.runs import JOURNAL, read_log
from hilcell.model.events import CalibrationRevoked
from hilcell.ports import HilcellError
from hilcell.run.cell_lock import lock_of_name, locked


def revoke(args: Revoke) -> int:
    """Revoke the calibration of a run, and name the one that is current then."""
    folder = find_run(args.runs, args.run)
    log = read_log(folder)
    if not log.calibrates or live_engine(folder) is not None:
        raise HilcellError(
            f"run {folder.name} has no calibration to revoke: it is {log.state}", code="HC-J09"
        )
    if before := row_of(folder).facts.revoked:
        raise HilcellError(
            f"run {folder.name} is revoked already: {before}; its reason is kept", code="HC-J09"
        )
    cell = f"cell {log.cell.name}"
    _check_permission(folder)
    with locked(lock_of_name(folder.parent, log.cell.name), cell, folder.name):
        name = encodable(folder.name)
        again = f"hilcell revoke {name}"
        journal = RunJournal(folder / JOURNAL, name, create=False, again=again)
        try:
            revoked = CalibrationRevoked(reason=args.reason, operator=args.operator)
            journal.append("event", "", revoked)
        finally:
            journal.close()
    standing = standing_of(folder.resolve())
    current = standing.current
    if args.json:
        print_json({"run": folder.name, "reason": args.reason, "current": current or None})
        return 0
    machine = f" ({standing.machine})" if standing.machine else ""
    none = f"{cell}{machine} has no current calibration any more"
    left = f"current is {current}" if current else none
    print_message(f"the calibration of run {folder.name} is revoked; {left}")
    return 0


def _check_permission(folder: Path) -> None:
    """Raise `StorageError` where a record cannot be added; the lock lies beside the run."""
    for place in (folder / JOURNAL, folder, folder.resolve().parent):
        if os.statvfs(place).f_flag & os.ST_RDONLY:
            raise StorageError(
                f"run {folder.name}: its calibration is not revoked: {place} lies on a read-only "
                f"file system; mount it for writing, then `hilcell revoke "
                f"{encodable(folder.name)}` again"
            )
        if not os.access(place, os.W_OK):
            raise StorageError(
                f"run {folder.name}: its calibration is not revoked: no permission to write "
                f"{place}; ask the owner of that for it, or revoke as the owner, then "
                f"`hilcell revoke {encodable(folder.name)}` again"
            )
