"""Poses are visited again later than they were first, whatever is re-measured in between."""

from __future__ import annotations

import pytest

from hilcell.calibration.diagnosis import CLOSING, REVISIT, overtaken, revisited, revisits
from hilcell.calibration.lost_motion import REVERSAL
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.point import Point
from tests.whole.golden import GoldenRuns
from tests.whole.trace import record_of

VERTEX = (1, 1, 0)  # one that is visited again


@pytest.fixture(scope="module")
def records(golden: GoldenRuns) -> list[Record]:
    return [record_of(event) for event in golden["small"].events]


def re_measured(log: Log, records: list[Record], key: str, off_mm: float = 0.0) -> None:
    """Take a point's record once more, as the newest, beside its first place."""
    (first,) = (each for each in records if each.kind == "point" and each.key == key)
    x, y, z = first.body["xyz_mm"]
    body = first.body | {"xyz_mm": (x + off_mm, y, z), "retaken": True}
    assert log.newest is not None
    log.take(Record(log.newest.seq + 1, first.t, "point", key, body))


def overtaken_of(log: Log, *kinds: str) -> list[Point]:
    return [point for kind in kinds for point in log.select(kind) if overtaken(log, point)]


def test_a_vertex_is_compared_with_a_later_visit_only(records: list[Record]) -> None:
    """A vertex that was re-measured after it was visited again has changed behind that visit."""
    judged = next(n for n, each in enumerate(records, 1) if each.key == "revisits")
    log = Log(records[:judged])
    before = len(revisited(log, REVISIT))
    assert overtaken_of(log, REVISIT, REVERSAL) == []
    re_measured(log, records, "grid/1-1-0", off_mm=1.0)
    assert revisits(log, REVISIT).suspicion is None
    assert len(revisited(log, REVISIT)) == before - 1
    assert {point.id.vertex for point in overtaken_of(log, REVISIT, REVERSAL)} == {VERTEX}
    re_measured(log, records, "revisit/1-1-0", off_mm=1.0)
    assert [point.id.vertex for point in revisited(log, REVISIT)][-1] == VERTEX
    assert {point.id.kind for point in overtaken_of(log, REVISIT, REVERSAL)} == {REVERSAL}
    assert revisits(log, REVISIT).suspicion is None


def test_whatever_is_measured_after_the_closing_visits_overtakes_them(
    records: list[Record],
) -> None:
    log = Log(records)
    assert overtaken_of(log, CLOSING) == []
    re_measured(log, records, "held/S1100/1-0/P1")
    assert overtaken_of(log, CLOSING) == []
    re_measured(log, records, "validate/S300/chosen/001")
    assert overtaken_of(log, CLOSING) == log.select(CLOSING)
    first = log.select(CLOSING)[0]
    re_measured(log, records, first.key)
    assert overtaken_of(log, CLOSING) == log.select(CLOSING)[1:]
