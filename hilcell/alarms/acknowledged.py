"""Which alarms of a run were acknowledged, from its journal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hilcell.model.events import AlarmsAcknowledged

if TYPE_CHECKING:
    from hilcell.journal.log import Log


def acknowledged_in(log: Log) -> dict[str, int]:
    """Return, by code, up to which record the alarms of a run were acknowledged."""
    until: dict[str, int] = {}
    for record in log.events:
        if isinstance(record.fact, AlarmsAcknowledged):
            for code in record.fact.codes:
                until[code] = max(until.get(code, 0), record.fact.until)
    return until
