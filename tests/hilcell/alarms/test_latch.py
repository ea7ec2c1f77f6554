"""Alarms stay until they are acknowledged, at the highest severity they had."""

from __future__ import annotations

from dataclasses import replace

from hilcell.alarms import Alarm, Latch
from hilcell.alarms.catalogue import Severity
from tests.hilcell.alarms.journals import (
    BEAM,
    BEGUN,
    CLOSED,
    alarms,
    asks,
    event,
    faulted,
    no_reading,
    state,
)

ONE = Alarm("HC-T10", "warning", "Beam broken", "Tracker", "broke", "means", ("do",), "t", 5)


def standing(latch: Latch) -> list[tuple[str, str, int]]:
    return [(each.alarm.code, each.severity, each.count) for each in latch.standing()]


def test_the_highest_severity_and_the_newest_words_are_kept() -> None:
    latch = Latch()
    fault = replace(ONE, severity="fault", seq=6, found="first")
    notice = replace(ONE, severity="notice", seq=7, found="second")
    latch.take([ONE, fault])
    latch.take([notice])
    (only,) = latch.standing()
    assert (only.severity, only.count) == ("fault", 3)
    assert only.alarm == notice


def test_the_same_journal_read_again_counts_nothing_twice() -> None:
    latch = Latch()
    again = replace(ONE, seq=9)
    for _ in range(3):
        latch.take([ONE, again])
    assert standing(latch) == [("HC-T10", "warning", 2)]


def test_acknowledged_is_gone_until_it_comes_again() -> None:
    latch = Latch()
    other = replace(ONE, code="HC-R31", severity="fault", seq=6)
    latch.take([ONE, other])
    latch.acknowledge("HC-R31")
    latch.acknowledge("HC-R31")
    assert standing(latch) == [("HC-T10", "warning", 1)]
    latch.acknowledge()
    latch.take([ONE, other])
    assert standing(latch) == []
    latch.take([replace(other, seq=12, severity="notice")])
    assert standing(latch) == [("HC-R31", "notice", 1)]


def test_a_notice_of_what_is_no_more_is_let_go() -> None:
    latch = Latch()
    lost = (*BEGUN, event("screen lost"))
    latch.take(alarms(*lost, live=True))
    assert standing(latch) == [("HC-C08", "notice", 1)]
    latch.take(alarms(*lost, event("screen back"), live=True))
    assert standing(latch) == []
    again = (*lost, event("screen back"), event("screen lost"))
    latch.take(alarms(*again, live=True))
    assert standing(latch) == [("HC-C08", "notice", 1)]


def test_what_was_worse_than_a_notice_stays_until_acknowledged() -> None:
    latch = Latch()
    fault = replace(ONE, code="HC-R31", severity="fault", seq=6)
    latch.take([ONE, fault])
    latch.take([])
    assert standing(latch) == [("HC-R31", "fault", 1), ("HC-T10", "warning", 1)]


def test_a_notice_that_is_let_go_and_raised_again_stands_again() -> None:
    latch = Latch()
    notice = replace(ONE, severity="notice")
    latch.take([notice])
    latch.take([])
    latch.take([notice])
    assert standing(latch) == [("HC-T10", "notice", 1)]
    latch.acknowledge()
    latch.take([])
    latch.take([notice])
    assert standing(latch) == []


def test_an_alarm_of_how_something_stands_goes_with_it_and_comes_back_with_it() -> None:
    latch = Latch()
    passing = replace(ONE, passes=True)
    latch.take([passing])
    latch.take([])
    assert standing(latch) == []
    latch.take([passing])
    latch.acknowledge()
    latch.take([passing])
    assert standing(latch) == []
    latch.take([])
    latch.take([passing])
    assert standing(latch) == [("HC-T10", "warning", 1)]


def test_the_worst_stands_first_and_of_these_the_newest() -> None:
    latch = Latch()
    codes: dict[str, Severity] = {"a": "notice", "b": "fault", "c": "warning", "d": "fault"}
    latch.take(
        replace(ONE, code=code, severity=severity, seq=seq)
        for seq, (code, severity) in enumerate(codes.items())
    )
    assert [each.alarm.code for each in latch.standing()] == ["d", "b", "c", "a"]


def test_a_healed_reading_that_comes_back_as_a_fault_is_one_alarm() -> None:
    latch = Latch()
    tried = (*BEGUN, no_reading("grid/1", BEAM))
    latch.take(alarms(*tried, live=True))
    assert standing(latch) == [("HC-T10", "notice", 1)]
    asking = (*tried, asks("grid/1", BEAM))
    latch.take(alarms(*asking, live=True))
    latch.take(alarms(*asking, state("stopping"), CLOSED, faulted(BEAM)))
    assert standing(latch) == [("HC-T10", "fault", 3)]
