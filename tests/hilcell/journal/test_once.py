"""What is computed of a log is computed once, and again as soon as a record comes."""

from __future__ import annotations

from hilcell.decoding import Json
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.records import Kind


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


POINT = {
    "id": {"kind": "noise"}, "group": "noise", "station": "", "reflector": "", "samples": 1,
    "xyz_mm": [1.0, 2.0, 3.0], "std_mm": [0.0, 0.0, 0.0], "session": 1, "frame": "tracker",
}  # fmt: skip


def test_a_record_that_is_not_read_leaves_a_result_as_it_is() -> None:
    log, asked = Log(), list[int]()

    def frames(log: Log) -> int:
        asked.append(len(log.frames))
        return len(log.frames)

    verdict, frame, state = (
        {"holds": True},
        {"matrix": [[1.0]]},
        {"machine": "run", "to": "running"},
    )
    rows: tuple[tuple[Kind, Json], ...] = (
        ("frame", frame), ("verdict", verdict), ("intent", {}), ("state", state), ("frame", frame),
        ("point", POINT), ("event", {"what": "said"}),
    )  # fmt: skip
    for seq, (kind, body) in enumerate(rows, start=1):
        log.take(Record(seq, "2026-01-01T00:00:00.000Z", kind, "own", body))
        assert log.once_measured(frames) == 1
    assert asked == [1] * 4  # once for each frame, for the point and for the event
