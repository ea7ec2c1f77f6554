"""What is computed of a log is computed once, and again as soon as a record comes."""

from __future__ import annotations

from typing import Any

from hilcell.journal.journal import Record
from hilcell.journal.log import NO_READINGS, Log
from hilcell.model.records import Kind
from tests.hilcell.verdicts import BASE, plain


def test_a_result_is_computed_again_after_the_next_record() -> None:
    log, asked = Log(), list[str]()

    def events(log: Log, name: str) -> int:
        asked.append(name)
        return len(log.events)

    for seq in (1, 2):
        log.take(Record(seq, "2026-01-01T00:00:00.000Z", "event", "", {"what": "said"}))
        assert [log.once(events, ""), log.once(events, "")] == [seq, seq]
        assert log.once(events, "other") == seq
    assert asked == ["", "other"] * 2


def test_a_record_that_is_not_read_leaves_a_result_as_it_is() -> None:
    log, asked = Log(), list[int]()

    def frames(log: Log) -> int:
        asked.append(len(log.frames))
        return len(log.frames)

    frame = plain(BASE)
    kinds: tuple[tuple[Kind, dict[str, Any]], ...] = (
        ("frame", frame), ("verdict", {"holds": True}), ("intent", {}), ("frame", frame),
    )  # fmt: skip
    for seq, (kind, body) in enumerate(kinds, start=1):
        log.take(Record(seq, "2026-01-01T00:00:00.000Z", kind, "base", body))
        assert log.once(frames, besides=NO_READINGS) == 1
    assert asked == [1, 1]
