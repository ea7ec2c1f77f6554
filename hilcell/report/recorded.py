"""A recorded run for programs: points, frames, verdicts, result, and its tables as data frames."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from hilcell.calibration.file import Calibration, read_calibration
from hilcell.cell.file import Cell
from hilcell.decoding import Json
from hilcell.errors import HilcellError
from hilcell.journal.index import find_run
from hilcell.journal.runs import CALIBRATION
from hilcell.journal.runs_folder import usual_runs
from hilcell.model.frame import Frame
from hilcell.model.point import Point
from hilcell.model.verdicts import Verdict
from hilcell.present.table import Named, Table
from hilcell.report.export import sheets
from hilcell.report.facts import Facts, read_facts

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False)
class Run:
    """A run as its journal proves it; a live run is read once, and not followed.

    ``points`` are raw readings in the tracker's frame (mm), ``frames`` have their matrix ``T``
    (4, 4) in {W}; the places and errors of points in {W} are columns of the table ``points``.
    """

    folder: Path
    facts: Facts

    @property
    def name(self) -> str:
        return self.facts.run

    @property
    def procedure(self) -> str:
        return self.facts.inputs.procedure

    @property
    def cell(self) -> Cell:
        """Return the cell as it was frozen when the run began."""
        return self.facts.cell

    @property
    def simulated(self) -> bool:
        return self.facts.inputs.simulated

    @property
    def state(self) -> str:
        """Return the state of the run: ``finished``, ``faulted``, ``aborted``, .."""
        return self.facts.log.state

    @property
    def points(self) -> Mapping[str, Point]:
        return self.facts.log.points

    @property
    def frames(self) -> Mapping[str, Frame]:
        return self.facts.log.frames

    @property
    def verdicts(self) -> Mapping[str, Verdict]:
        return self.facts.log.verdicts

    @property
    def result(self) -> Json:
        """Return the result as ``hilcell show --json`` prints it, computed from the journal."""
        return self.facts.result

    @property
    def calibration(self) -> Calibration | None:
        """Return the calibration that the run wrote, if it did; raises `SettingsError`."""
        file = self.folder / CALIBRATION
        return read_calibration(file) if file.is_file() else None

    @cached_property
    def tables(self) -> Mapping[str, Table]:
        """Return the sheets of ``hilcell export xlsx``, by title."""
        return {table.title: table for table in sheets(self.facts)}

    def data_frame(self, table: str = "points") -> DataFrame:
        """Return one of `tables` as a data frame; column names end in their unit.

        Raises `HilcellError` for an unknown table, and where pandas is not installed.
        """
        if table not in self.tables:
            known = ", ".join(self.tables)
            raise HilcellError(f"unknown table {table!r}; expected one of {known}")
        try:
            import pandas
        except ImportError as error:
            raise HilcellError(
                "data frames: pandas is not installed; in a clone, `pip install '.[pandas]'`"
            ) from error
        found = self.tables[table]
        plain = [
            [value.name if isinstance(value, Named) else value for value in row]
            for row in found.rows
        ]
        frame = pandas.DataFrame(plain, columns=found.keys)
        for key in found.keys:
            if key.endswith("_utc"):
                frame[key] = pandas.to_datetime(frame[key], utc=True)
        return frame


def open_run(name: str | Path = "last", runs: Path | str | None = None) -> Run:
    """Open a recorded run: a folder with a journal, or a name or the start of one in ``runs``.

    ``last`` is the newest; without ``runs`` the folder is that of the command ``hilcell``. Raises
    `HilcellError` where no run or several are meant, and where the journal is damaged.

    Examples:
        >>> run = open_run("small")
        >>> run.procedure, run.state, run.simulated
        ('calibrate', 'finished', True)
        >>> run.frames["base"].T.shape
        (4, 4)
        >>> {verdict.outcome.value for verdict in run.verdicts.values()}
        {'accepted'}
    """
    folder = find_run(usual_runs(os.environ)[0] if runs is None else Path(runs), str(name))
    return Run(folder, read_facts(folder))
