"""Which calibration of a cell is current, and which are superseded, revoked or out of date.

It follows from the runs of a folder in the order in which they name one another, not by the clock.
A later validated calibration supersedes those before it, as does one that a re-check or a pass over
targets has derived from the current one. A re-check with the verdict redo revokes the one that it
checked, `hilcell revoke` any; one derived from a revoked one is revoked as well. A revoked
calibration supersedes nothing. One that differs from the current one beyond its uncertainty
supersedes it only when that is revoked. A touched base is out of date once the cell has moved in a
later run.

The calibration of an unreadable journal is in doubt: it may have been revoked.

A copied folder is the same run; it is revoked as soon as one of both is revoked.

A replay of a recorded run measures nothing: it changes no status, and has one of its own.

Each simulated machine is a cell of its own with a current calibration; it is named where there are
several.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

from msgspec.structs import replace as replace_struct

from hilcell.journal.calibration_facts import CalibrationFacts
from hilcell.journal.index import UNREADABLE, RunRow, in_order
from hilcell.model.outcome import Outcome

State = Literal[
    "current", "superseded", "revoked", "in doubt", "out of date", "not validated", "undecided",
    "suspected", "replayed", "copy",
]  # fmt: skip


REDO = "its re-check says redo"


@dataclass(frozen=True, slots=True)
class CalibrationStatus:
    """``by`` is the run that superseded or revoked it, ``current`` the cell's current one; "" where
    there is none. ``machine`` names a simulated one where runs of several are there.
    """

    state: State
    by: str = ""
    reason: str = ""
    current: str = ""
    machine: str = ""

    @property
    def usable(self) -> bool:
        """Whether it may be used; one whose validation does not hold is judged by its verdicts."""
        return self.state in ("current", "not validated", "undecided", "suspected")

    @property
    def to_redo(self) -> bool:
        """Whether only a re-check is against it: its arm may still be a good prior."""
        return self.state == "revoked" and self.reason == REDO

    @property
    def text(self) -> str:
        by = f" by {self.by}" if self.by else ""
        of = f" of {self.machine}" if self.machine and self.state == "current" else ""
        return f"{self.state}{of}{by}" + (f": {self.reason}" if self.reason else "")


def statuses(rows: Iterable[RunRow]) -> dict[str, CalibrationStatus]:
    """Return the status of each calibration of finished runs, by the run's name.

    A run whose journal cannot be read has one as well: it may have made a calibration.
    """
    rows = list(rows)
    runs = _Runs(rows)
    known, cells = runs.known, {name: runs.cell(row) for name, row in runs.known.items()}
    calibrated = {cells[name] for name, row in known.items() if row.calibrates}
    ordered = sorted(in_order(known.values()), key=lambda row: cells[row.name])
    repeats = (row for row in rows if row.replayed and row.finished and row.facts.kind)
    replayed = CalibrationStatus("replayed", "", "a replay measures nothing")
    found = {row.name: replayed for row in repeats}
    unread = (row for row in rows if row.state == UNREADABLE)
    found |= {row.name: CalibrationStatus("in doubt", "", row.reason) for row in unread}
    for cell, of_cell in groupby(ordered, key=lambda row: cells[row.name]):
        several = sum(other[:-1] == cell[:-1] for other in calibrated) > 1
        machine = cell[-1] if several else ""
        status = _CellRuns(list(of_cell), runs).statuses()
        found |= {name: replace(each, machine=machine) for name, each in status.items()}
    for name, original in runs.copies.items():
        if known[original].calibrates:
            current = found[original].current
            found[name] = CalibrationStatus("copy", "", f"the run is {original}", current)
    return found


def current_of(
    rows: Iterable[RunRow], cell: str, serial: str, simulated: bool, machine_seed: int | None
) -> str:
    """Return the run of a cell's current calibration, for a simulated one of a machine; else ""."""
    rows = list(rows)
    runs = _Runs(rows)
    wanted = (cell, serial, str(simulated), _simulated(machine_seed) if simulated else "")
    return next(
        (
            name
            for name, status in statuses(rows).items()
            if status.current == name and runs.cell(runs.known[name]) == wanted
        ),
        "",
    )


def measured_by(rows: Iterable[RunRow], name: str) -> str:
    """Return the run that measured the calibration which the run ``name`` has changed, or made."""
    runs = _Runs(rows)
    return runs.origins(runs.known[runs.copies.get(name, name)])[-1].name


def descended_from(rows: Iterable[RunRow], name: str) -> list[RunRow]:
    """Return the runs of calibrations that rest on the one of the run ``name``: updates of it,
    re-calibrations from it, and so on, in their order.
    """
    found, names = list[RunRow](), {name}
    for row in in_order(row for row in rows if row.readable and row.calibrates):
        if {row.facts.used, row.facts.carried} & names:
            found.append(row)
            names.add(row.name)
    return found


class _Runs:
    """The runs that measured, by their names.

    Of folders with one beginning the run is the one that went on, which others name, or the first.
    """

    def __init__(self, rows: Iterable[RunRow]) -> None:
        rows = [row for row in rows if row.readable and not row.replayed]
        named = {name for row in rows for name in (row.facts.used, row.order.after)}
        rows.sort(key=lambda row: (-row.order.number, row.name not in named, row.name))
        self.known: dict[str, RunRow] = {}
        self.copies: dict[str, str] = {}  # by the names of copies, what they are of
        originals = dict[str, str]()
        for row in rows:
            original = originals.setdefault(row.origin or row.name, row.name)
            if original == row.name:
                self.known[row.name] = row
                continue
            self.copies[row.name] = original
            run = self.known[original]
            if row.facts.revoked and not run.facts.revoked:
                facts = replace_struct(run.facts, revoked=row.facts.revoked)
                self.known[original] = replace_struct(run, facts=facts)

    def cell(self, row: RunRow) -> tuple[str, ...]:
        """Return the identity of a run's cell; last is the simulated machine, "" for a real one.

        A run that uses a calibration counts for the machine of that.
        """
        first = self.origins(row)[-1]
        machine = _simulated(first.machine_seed) if first.simulated else ""
        return row.cell, row.serial, str(row.simulated), machine

    def origins(self, row: RunRow) -> list[RunRow]:
        """Return a run, the run whose calibration it used, and so on."""
        found = [row]
        while (used := self.known.get(found[-1].facts.used)) is not None and used not in found:
            found.append(used)
        return found

    def doubt(self, row: RunRow) -> str:
        """Return the doubt of a run's calibration, or of one that it rests on, "" for none."""
        return next(filter(None, (each.facts.doubt for each in self.origins(row))), "")


def _simulated(seed: int | None) -> str:
    return "a simulator that ran before" if seed is None else f"simulated machine {seed}"


@dataclass(frozen=True, slots=True)
class _CellRuns:
    """The runs of one cell in their order, of all ``runs``."""

    rows: list[RunRow]
    runs: _Runs

    def statuses(self) -> dict[str, CalibrationStatus]:
        found: dict[str, CalibrationStatus] = {}
        touches = {row.name: row.facts.used for row in self.rows if row.facts.kind == "touch"}
        revoked = self._revoked()
        current = ""
        for row in (row for row in self.rows if row.calibrates):
            made, used = row.facts.kind == "made", touches.get(row.facts.used, row.facts.used)
            if made and not (row.facts.validated and self._accepted(row, revoked)):
                found[row.name] = self._not_validated(row.facts)
            elif not made and current and used != current:
                found[row.name] = CalibrationStatus("superseded", current)
            else:
                doubt = self.runs.doubt(row)
                found[row.name] = CalibrationStatus("in doubt" if doubt else "current", "", doubt)
                if not (row.facts.revoked or row.name in touches):
                    before = [name for name in found if found[name].state != "superseded"]
                    before.remove(row.name)
                    found |= dict.fromkeys(before, CalibrationStatus("superseded", row.name))
                    current = row.name
        found |= self._left(found) | revoked
        named = current if current and found[current].state == "current" else ""
        calibrated = {row.name for row in self.rows if row.calibrates}
        return {name: replace(found[name], current=named) for name in calibrated}

    @staticmethod
    def _accepted(row: RunRow, revoked: Mapping[str, CalibrationStatus]) -> bool:
        """Whether a validated calibration counts.

        One that differs from the calibration before it counts once an operator has revoked that.
        """
        return row.exit == 0 or row.facts.changed_since in revoked

    @staticmethod
    def _not_validated(facts: CalibrationFacts) -> CalibrationStatus:
        if facts.outcome is Outcome.UNDECIDED:
            return CalibrationStatus("undecided")
        if not (facts.suspected and facts.validated):
            return CalibrationStatus("not validated")
        since = facts.changed_since
        return CalibrationStatus(
            "suspected", "", since and f"it differs from that of {since}; revoke the wrong one"
        )

    def _revoked(self) -> dict[str, CalibrationStatus]:
        """Return those revoked by an operator or a re-check, and those derived from them later.

        An update made before the re-check of an older calibration is not revoked by it.
        """
        found: dict[str, CalibrationStatus] = {}
        for row in self.rows:
            facts = row.facts
            if facts.revoked:
                found[row.name] = CalibrationStatus("revoked", "", facts.revoked)
            elif row.calibrates and facts.used in found:
                why = f"it is based on one {found[facts.used].text}"
                found[row.name] = CalibrationStatus("revoked", facts.used, why)
            if facts.recheck == "redo" and row.finished and not facts.revoked:
                redo = CalibrationStatus("revoked", row.name, REDO)
                found.setdefault(facts.used, redo)
        return found

    def _left(self, found: dict[str, CalibrationStatus]) -> dict[str, CalibrationStatus]:
        """Return the touched bases that are out of date: a later run has moved the cell."""
        left = {}
        for number, row in enumerate(self.rows):
            if row.name in found and row.facts.kind == "touch":
                later = [each.name for each in self.rows[number + 1 :] if each.moved]
                if later and found[row.name].state == "current":
                    left[row.name] = CalibrationStatus("out of date", later[0])
        return left
