"""Events of the journal in the words of the work, for the screen and for the report."""

from __future__ import annotations

from hilcell.journal.key_words import in_words
from hilcell.journal.log import Log
from hilcell.journal.point_words import step_words
from hilcell.model.events import Event, OtherEvent, StepBegun


def happened_words(event: Event | OtherEvent, log: Log) -> str:
    """Return an event in words, its points by name; "" where there is nothing to say."""
    if isinstance(event, StepBegun):
        name = step_words(event.name, has_rail=log.plan is None or log.cell.has_rail)
        return f"step {event.number} of {event.of} begins: {name}"
    return in_words(event.text, log)
