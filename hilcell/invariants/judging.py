"""The checker: all rules over the records of a journal, in their order."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import msgspec

from hilcell.invariants.identities import Identities
from hilcell.invariants.life import LifeRules
from hilcell.invariants.measurements import Measurements
from hilcell.invariants.motions import Motions
from hilcell.invariants.scene import Scene
from hilcell.invariants.tally import Tally, Verdict
from hilcell.invariants.tracker import TrackerSetUps
from hilcell.journal.journal import Record, StorageError


class Rules(Protocol):
    """Judge each record by what the records before it say."""

    def take(self, record: Record) -> None:
        """Judge a record."""


def judge(records: Iterable[Record]) -> dict[str, Verdict]:
    """Return the verdict of each invariant, I1 to I18; raises `StorageError`."""
    tally, scene = Tally(), Scene()
    rules: list[Rules] = [
        each(tally, scene) for each in (LifeRules, Motions, Measurements, TrackerSetUps, Identities)
    ]
    for record in records:
        try:
            for each in rules:
                each.take(record)
            scene.take(record)
        except (msgspec.ValidationError, KeyError, TypeError, AttributeError) as error:
            raise StorageError(
                f"record {record.seq} ({record.kind} {record.key or '-'}) is damaged: {error}",
                code="HC-J02",
            ) from error
    return tally.verdicts
