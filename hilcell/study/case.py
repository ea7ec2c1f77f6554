"""One case measured: in a worker's process, which gets everything it needs and knows no file."""

from __future__ import annotations

import os
import platform
import tempfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from hilcell import __version__
from hilcell.cell.devices import load_entry
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError, convert
from hilcell.errors import HilcellError
from hilcell.model.results import Calibrated
from hilcell.run.direct_run import direct_run
from hilcell.run.procedure import Procedure
from hilcell.study.outcome import RESULTS
from hilcell.typed import typed

Row = dict[str, Any]
STATES = DONE, CANNOT_BE, FAILED = "done", "cannot be", "failed"


def packed(cell: Cell) -> bytes:
    """Return a cell as bytes, which a worker of another PC reads."""
    return msgspec.json.encode(cell)


def unpacked(content: bytes) -> Cell:
    """Return the cell of such bytes."""
    return convert(_stated(msgspec.json.decode(content)), Cell, "cell")


def measured(cell: bytes, machine: int, seed: int, wanted: Mapping[str, str]) -> Row:
    """Calibrate a cell without wires; return its state, reason, minutes and figures.

    ``wanted`` are the versions of the study; on another worker the row says `other versions`.
    A case that cannot be planned, or whose run ends early, is a row with its reason.
    """
    here = versions()
    if here != dict(wanted):
        return {"other versions": here}
    built = unpacked(cell)
    calibrate: Procedure = load_entry("procedures", "calibrate")
    try:
        plan = calibrate.plan(built, seed)
    except HilcellError as error:
        return _without(CANNOT_BE, str(error))
    row: Row = {"state": DONE, "reason": "", "minutes": plan.duration_s / 60.0}
    with tempfile.TemporaryDirectory(prefix="hilcell-study-") as folder:
        try:
            log = direct_run(
                built, calibrate, seed=seed, machine_seed=machine, folder=Path(folder), plan=plan
            )
            result = typed(calibrate.result(log), Calibrated)
            return row | {name: value(result) for name, (_, value) in RESULTS.items()}
        except SettingsError as error:  # a machine that cannot be
            return _without(CANNOT_BE, str(error))
        except HilcellError as error:
            return _without(FAILED, str(error))
        except Exception as error:  # noqa: BLE001 - a defect spoils its own case only
            return _without(FAILED, f"a defect, please report it: {type(error).__name__}: {error}")


def versions() -> dict[str, str]:
    """Return what the digits of a result depend on."""
    return {
        "hilcell": __version__,
        "python": ".".join(platform.python_version_tuple()[:2]),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
        "threads of BLAS": os.environ.get("OMP_NUM_THREADS", "not limited"),
    }


def _without(state: str, reason: str) -> Row:
    return {"state": state, "reason": reason, "minutes": None} | dict.fromkeys(RESULTS)


def _stated(values: Any) -> Any:
    """Return tables without what is not stated: null in JSON, a missing key in a cell."""
    if isinstance(values, dict):
        return {key: _stated(value) for key, value in values.items() if value is not None}
    return [_stated(value) for value in values] if isinstance(values, list) else values
