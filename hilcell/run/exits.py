"""Exit codes, and which error means which."""

from __future__ import annotations

from hilcell.cell.devices import ConnectFailed
from hilcell.errors import DriverDefect, StoreAway
from hilcell.journal.calibration_facts import REFUSED
from hilcell.journal.journal import NeverBegan, StorageError
from hilcell.ports import DeviceError, DeviceRefused, HilcellError, Stopped
from hilcell.run.cell_lock import CellLocked
from hilcell.writing import DiskFailed, NotPrinted

EXIT_OK, EXIT_OUT_OF_TOLERANCE, EXIT_REFUSED, EXIT_FAULT = 0, 1, REFUSED, 3
EXIT_ABORTED, EXIT_INTERNAL, EXIT_LOCKED, EXIT_STORAGE = 4, 5, 6, 7
DONE = (EXIT_OK, EXIT_OUT_OF_TOLERANCE)  # the run came to its end
RESUMABLE = (EXIT_FAULT, EXIT_ABORTED, EXIT_STORAGE)

_TABLE: tuple[tuple[type[Exception], int], ...] = (
    (Stopped, EXIT_ABORTED),
    (NeverBegan, EXIT_REFUSED),
    (StorageError, EXIT_STORAGE),
    (StoreAway, EXIT_STORAGE),
    (NotPrinted, EXIT_STORAGE),
    (DiskFailed, EXIT_STORAGE),
    (CellLocked, EXIT_LOCKED),
    (DeviceRefused, EXIT_REFUSED),
    (DeviceError, EXIT_FAULT),
    (DriverDefect, EXIT_INTERNAL),
    (HilcellError, EXIT_REFUSED),
)


def exit_code(error: Exception) -> int:
    """Return the exit code that says how ``error`` ended a run or a command."""
    if isinstance(error, ConnectFailed):
        refused = all(isinstance(each, DeviceRefused) for each in error.causes.values())
        return EXIT_REFUSED if refused else EXIT_FAULT
    return next((code for kind, code in _TABLE if isinstance(error, kind)), EXIT_INTERNAL)
