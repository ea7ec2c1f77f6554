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
from hilcell.cell.settings import SettingsError, read_bytes, unreadable
from hilcell.commission.cell_text import CellText
from hilcell.commission.sequence import NAMES, steps_of
from hilcell.decoding import Json, decoded
from hilcell.identity import Identity

SUFFIX = ".commissioning.json"
RESTORE = "restore the record of this cell, or move this file away to begin again"
StepStatus = Literal["proved", "failed", "changed", "open"]


class Check(Struct, frozen=True, kw_only=True):
    """One thing that a step has verified, and the values of the cell file that follow, by path."""

    what: str
    found: str
    expected: str
    holds: bool
    values: Json = field(default_factory=dict)


class StepRecord(Struct, frozen=True, kw_only=True):
    """One performance of a step, with the devices of its run; ``run`` is "" for one without.

    ``began`` and ``ended`` are UTC, ISO 8601; ``questions``: of the dialogue, asked meanwhile.
    ``confirmed``: values that earlier performances wrote, as the file has them in one that holds.
    """

    step: str
    ended: str
    operator: str
    holds: bool
    checks: list[Check]
    run: str = ""
    began: str = ""
    questions: int = 0
    devices: list[Identity] = field(default_factory=list)
    confirmed: Json = field(default_factory=dict)

    @property
    def values(self) -> Json:
        """Return the proved values of the cell file, by path."""
        found = dict(self.confirmed)
        for each in self.checks:
            found |= each.values
        return found


class Commissioned(Struct, kw_only=True):
    """All performances of the steps of the cell with this name and serial number, in sequence."""

    form: Literal[1] = 1
    cell: str = ""
    serial: str = ""
    steps: list[StepRecord] = field(default_factory=list)

    @classmethod
    def read(cls, cell: Path) -> Commissioned:
        """Return the record of a cell file, empty if there is none.

        Raises `SettingsError` for one that is damaged, of another cell, or has an unknown step.
        """
        path = record_path(cell)
        try:
            found = decoded(read_bytes(path), cls)
        except FileNotFoundError:
            return cls()
        except OSError as error:
            raise unreadable(str(path), error) from error
        except msgspec.DecodeError as error:
            raise SettingsError(str(path), [f"damaged: {error}; {RESTORE}"]) from error
        unknown = sorted({each.step for each in found.steps} - {*NAMES})
        problems = [
            f"step {name!r} is unknown, expected one of {', '.join(NAMES)}; {RESTORE}"
            for name in unknown
        ]
        names = cell_names(CellText.read(cell))
        for what, of_record, of_file in zip(
            ("name", "serial"), (found.cell, found.serial), names, strict=True
        ):
            if of_record and of_file and of_record != of_file:
                problems.append(
                    f"the record is of a cell with {what} {of_record!r}, expected {of_file!r} as "
                    f"in {cell.name}; {RESTORE}"
                )
        if problems:
            raise SettingsError(str(path), problems)
        return found

    def add(self, step: StepRecord, cell: Path) -> None:
        """Append one performance and write the record; raises `NotWritten`."""
        text = CellText.read(cell)
        if step.holds:
            written = (each.values for each in self.steps if each.step == step.step)
            confirmed = {path: text.get(path) for values in written for path in values}
            step = msgspec.structs.replace(step, confirmed=confirmed)
        self.steps.append(step)
        self.cell, self.serial = cell_names(text)
        body = msgspec.json.format(msgspec.json.encode(self), indent=1)
        write_whole(record_path(cell), body + b"\n")

    @property
    def proved(self) -> dict[str, tuple[str, object]]:
        """Return the values that were proved last, each with its step, by path."""
        proved: dict[str, tuple[str, object]] = {}
        for each in self.steps:
            if each.holds:
                proved |= {path: (each.step, value) for path, value in each.values.items()}
        return proved

    def last(self, step: str) -> StepRecord | None:
        return next((each for each in reversed(self.steps) if each.step == step), None)

    def status(self, step: str, text: CellText) -> StepStatus:
        last = self.last(step)
        if last is None:
            return "open"
        if not last.holds:
            return "failed"
        return "changed" if self.changed(step, text) else "proved"

    def unproved(self, text: CellText) -> list[str]:
        """Return the steps that are not proved; one that may be left counts once it has failed."""
        return [
            step.name
            for step in steps_of(text)
            if self.status(step.name, text) != "proved"
            and not (step.pulls and self.last(step.name) is None)
        ]

    def changed(self, step: str, text: CellText) -> Sequence[str]:
        """Return the paths whose values are no longer those that the step proved.

        A value belongs to the last step that has proved it.
        """
        return [
            path
            for path, (owner, value) in self.proved.items()
            if owner == step and text.get(path) != value
        ]


def cell_names(text: CellText) -> tuple[str, str]:
    """Return name and serial number of a cell file, "" for one that it does not have."""
    name, serial = (text.get(key) for key in ("name", "serial"))
    return str(name or ""), str(serial or "")


def record_path(cell: Path) -> Path:
    return cell.with_suffix(SUFFIX)
