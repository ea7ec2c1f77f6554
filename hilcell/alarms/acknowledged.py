"""Acknowledgements of alarms as facts of a run: events of its journal.

The codes stand beside the last record that was seen, because an alarm may have no record (0).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hilcell.journal.log import Log


@dataclass(frozen=True, slots=True)
class Acknowledged:
    """Somebody has acknowledged the alarms of these codes that came up to record ``until``."""

    codes: tuple[str, ...]
    until: int

    def event(self) -> dict[str, object]:
        """Return the body of its event."""
        return {"what": "acknowledged", "codes": list(self.codes), "until": self.until}

    def refusal(self, newest: int) -> str:
        """Return why a run whose newest record is ``newest`` refuses it; "" where it does not."""
        if not self.codes:
            return "acknowledge: the codes of alarms are wanted, found none"
        if not 1 <= self.until <= newest:
            return (
                f"acknowledge: until: record {self.until} cannot have been seen; wanted is one of "
                f"records 1 to {newest}"
            )
        return ""


def acknowledged_in(log: Log) -> dict[str, int]:
    """Return, by code, up to which record the alarms of a run were acknowledged."""
    until: dict[str, int] = {}
    for record in log.events:
        if record.body["what"] == "acknowledged":
            for code in record.body["codes"]:
                until[code] = max(until.get(code, 0), record.body["until"])
    return until
