"""What is computed of a log is computed once, and again as soon as a record comes."""

from __future__ import annotations

from hilcell.journal.journal import Record
from hilcell.journal.log import Log


def test_a_result_is_computed_again_after_the_next_record() -> None:
    log, asked = Log(), list[str]()

    def events(log: Log, name: str = "") -> int:
        asked.append(name)
        return len(log.events)

    for seq in (1, 2):
        log.take(Record(seq, "2026-01-01T00:00:00.000Z", "event", "", {"what": "said"}))
        assert [log.once(events), log.once(events)] == [seq, seq]
        assert log.once(events, "other") == seq
    assert asked == ["", "other"] * 2
