"""The record of a cell's commissioning, kept beside the cell file.

A step counts as proved while the cell file still has the values that it proved: an edit opens it
again.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import msgspec
from msgspec import Struct, field

from hilcell.atomic_files import write_whole
from hilcell.cell.settings import SettingsError, read_file
from hilcell.commission.cell_text import CellText
from hilcell.decoding import Json, decoded

SUFFIX = ".commissioning.json"
StepStatus = Literal["proved", "failed", "changed", "open"]


class Check(Struct, frozen=True, kw_only=True):
    """One thing that a step has verified, and the values of the cell file that follow, by path."""

    what: str
    found: str
    expected: str
    holds: bool
    values: Json = field(default_factory=dict)


class StepRecord(Struct, frozen=True, kw_only=True):
    """One performance of a step; ``ended``: UTC, ISO 8601; ``run`` is "" for one without a run."""

    step: str
    ended: str
    operator: str
    holds: bool
    checks: list[Check]
    run: str = ""

    @property
    def values(self) -> Json:
        """Return the proved values of the cell file, by path."""
        found: Json = {}
        for each in self.checks:
            found |= each.values
        return found


class Commissioned(Struct, frozen=True, kw_only=True):
    """All performances of a cell's steps, in sequence."""

    form: Literal[1] = 1
    steps: list[StepRecord] = field(default_factory=list)

    @classmethod
    def read(cls, cell: Path) -> Commissioned:
        """Return the record of a cell file, empty if there is none; raises `SettingsError`."""
        path = record_path(cell)
        if not path.exists():
            return cls()
        try:
            return decoded(read_file(path), cls)
        except msgspec.DecodeError as error:
            act = "restore it from a backup, or move it away to begin again"
            raise SettingsError(str(path), [f"damaged: {error}; {act}"]) from error

    def add(self, step: StepRecord, cell: Path) -> None:
        """Append one performance and write the record; raises `NotWritten`."""
        self.steps.append(step)
        body = msgspec.json.format(msgspec.json.encode(self), indent=1)
        write_whole(record_path(cell), body + b"\n")

    def last(self, step: str) -> StepRecord | None:
        return next((each for each in reversed(self.steps) if each.step == step), None)

    def status(self, step: str, text: CellText) -> StepStatus:
        last = self.last(step)
        if last is None:
            return "open"
        if not last.holds:
            return "failed"
        return "changed" if self.changed(step, text) else "proved"

    def changed(self, step: str, text: CellText) -> Sequence[str]:
        """Return the paths whose values are no longer those that the step proved.

        A value belongs to the last step that has proved it.
        """
        proved: dict[str, tuple[str, object]] = {}
        for each in self.steps:
            if each.holds:
                proved |= {path: (each.step, value) for path, value in each.values.items()}
        return [
            path
            for path, (owner, value) in proved.items()
            if owner == step and text.get(path) != value
        ]


def record_path(cell: Path) -> Path:
    return cell.with_suffix(SUFFIX)
