"""Folders of runs that finished with calibrations, written without a cell."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec

from hilcell.calibration.file import write_calibration
from hilcell.calibration.lookup import calibration_status
from hilcell.journal.runs import CALIBRATION
from hilcell.model.verdicts import Verdict
from tests.hilcell import verdicts
from tests.hilcell.calibration.calibrations import calibration
from tests.hilcell.report.journals import Writer


def finished(
    runs: Path,
    name: str,
    judged: Mapping[str, Verdict],
    /,
    used: str = "",
    code: int = 0,
    plan: Mapping[str, Any] = MappingProxyType({}),
    **changes: Any,
) -> None:
    """Write a run that finished, with a calibration of its own; ``changes`` are to that,
    ``plan`` to that of the run."""
    writer = Writer(runs / name, **plan).began()
    if used:
        writer.event("calibration used", run=used)
    for key, verdict in judged.items():
        writer.journal.append("verdict", key, verdict)
    writer.state("run", "finished")
    writer.journal.append("end", "", {"state": "finished", "exit": code, "result": {}})
    writer.journal.close()
    made = msgspec.structs.replace(calibration(run=name, simulated=True), **changes)
    write_calibration(made, runs / name / CALIBRATION)


def text_of(folder: Path) -> str | None:
    """Return how a run's calibration stands, in words."""
    found = calibration_status(folder)
    return None if found is None else found.text


FIT: dict[str, Verdict] = {"fit": verdicts.FITTED}
MADE = FIT | {"validation.S1100": verdicts.JUDGED}
REDO: dict[str, Verdict] = {"recheck": verdicts.REDO}
