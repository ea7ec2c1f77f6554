"""Alarms stay until they are acknowledged, at the highest severity they had."""

from __future__ import annotations

from dataclasses import replace

from hilcell.alarms import Alarm, Latch
from hilcell.alarms.alarm import acknowledged_in
from hilcell.alarms.catalogue import Severity
from hilcell.errors import DeviceError
from tests.hilcell.alarms.journals import (
    BEAM,
    BEGUN,
    CLOSED,
    alarms,
    asks,
    ended,
    event,
    faulted,
    log_of,
    no_reading,
    point,
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


def test_the_journal_s_acknowledgement_holds_for_what_came_before_it() -> None:
    later = replace(ONE, seq=9)
    for first in ([ONE], []):  # seen before it was acknowledged, and by a screen that comes later
        latch = Latch()
        latch.take(first)
        latch.take([ONE], "t", {"HC-T10": 5})
        assert standing(latch) == []
        latch.take([ONE, later], "t", {"HC-T10": 5})
        assert standing(latch) == [("HC-T10", "warning", 1)]
        assert latch.waits()
    latch = Latch()
    latch.take([ONE, later], "t", {"HC-T10": 5, "HC-R31": 9})
    assert standing(latch) == [("HC-T10", "warning", 1)], "only what came after it"


def test_an_alarm_without_a_record_is_acknowledged_by_its_code() -> None:
    rows = (*BEGUN, point("grid/1"), point("grid/2", 23.0))
    (drift,) = [each for each in alarms(*rows, live=True) if each.code == "HC-V04"]
    assert drift.seq == 0
    for code, left in (("HC-V05", ["HC-V04"]), ("HC-V04", [])):
        told = event("acknowledged", codes=[code], until=3)
        latch = Latch()
        latch.take(alarms(*rows, live=True), "t", acknowledged_in(log_of(*rows, told)))
        assert [each.alarm.code for each in latch.standing()] == left


def test_of_several_acknowledgements_the_latest_counts() -> None:
    told = [event("acknowledged", codes=["HC-T10", f"HC-R0{n}"], until=n) for n in (3, 7, 5)]
    found = acknowledged_in(log_of(*BEGUN, *told))
    assert found == {"HC-T10": 7, "HC-R03": 3, "HC-R07": 7, "HC-R05": 5}


def test_a_notice_stays_until_it_is_acknowledged_though_its_cause_is_gone() -> None:
    latch = Latch()
    lost = (*BEGUN, event("screen lost"))
    latch.take(alarms(*lost, live=True), "t4")
    assert [each.gone for each in latch.standing()] == [""]
    latch.take(alarms(*lost, event("screen back"), live=True), "t5")
    assert [each.gone for each in latch.standing()] == ["t5"]
    latch.acknowledge()
    assert standing(latch) == []
    again = (*lost, event("screen back"), event("screen lost"))
    latch.take(alarms(*again, live=True), "t6")
    assert standing(latch) == [("HC-C08", "notice", 1)]


def test_acknowledged_stays_until_the_cause_is_gone() -> None:
    latch = Latch()
    watched = replace(ONE, cause="watched")
    latch.take([watched], "t1")
    assert latch.waits()
    latch.acknowledge()
    assert not latch.waits()
    latch.take([watched], "t2")
    assert [(each.acknowledged, each.gone) for each in latch.standing()] == [(True, "")]
    latch.take([], "t3")
    assert latch.standing() == []


def test_a_cause_is_not_gone_where_nothing_has_proven_it() -> None:
    """A run that is opened again raises the alarms of its last session no more."""
    latch = Latch()
    latch.take(alarms(*BEGUN, state("stopping"), CLOSED, faulted(BEAM)))
    latch.acknowledge()
    latch.take(
        alarms(*BEGUN, state("stopping"), CLOSED, faulted(BEAM), state("checking"), live=True)
    )
    assert [(each.acknowledged, each.gone) for each in latch.standing()] == [(True, "")]
    latch.take([], "t9")
    assert latch.standing() == []


def test_an_alarm_of_a_condition_comes_back_with_it() -> None:
    latch = Latch()
    passing = replace(ONE, passes=True, cause="watched")
    latch.take([passing], "t1")
    latch.acknowledge()
    latch.take([], "t2")
    assert standing(latch) == []
    latch.take([passing], "t3")
    assert standing(latch) == [("HC-T10", "warning", 1)]
    assert latch.waits()


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


def test_a_crash_stands_until_it_is_acknowledged_in_a_later_screen_too() -> None:
    went_on = (*BEGUN, *BEGUN)
    aborted = (*went_on, state("stopping"), CLOSED, state("aborted"))
    first, later = Latch(), Latch()
    first.take(alarms(*BEGUN))
    for latch in (first, later):
        latch.take(alarms(*went_on, live=True), "t7")
        assert standing(latch) == [("HC-J05", "fault", 1)]
        latch.take(alarms(*aborted))
        assert standing(latch)[0] == ("HC-J05", "fault", 1), "still not acknowledged"
        latch.acknowledge()
        assert standing(latch) == []
        latch.take(alarms(*aborted))
        assert standing(latch) == []


def test_a_refused_resume_does_not_count_a_crash_twice() -> None:
    refused = (*BEGUN, event("retake asked", key="grid/1"), ended(BEAM, 6, "running"))
    latch = Latch()
    for rows in (BEGUN, refused[:-1], refused, (*refused, *refused[-1:])):
        latch.take(alarms(*rows))
        assert ("HC-J05", "fault", 1) in standing(latch)
    latch.take(alarms(*refused, *BEGUN, live=True), "t9")
    assert ("HC-J05", "fault", 1) in standing(latch)
    (crash,) = [each for each in latch.standing() if each.alarm.code == "HC-J05"]
    assert crash.alarm.seq == 5, "its time is that of the last record before the resume"


def test_a_device_that_is_lost_while_the_run_waits_stands_until_it_is_back() -> None:
    gone = DeviceError("HC-R01", "Rail", "read", "link lost")
    asking = (*BEGUN, asks("grid/1", BEAM))
    lost = (*asking, event("device lost", device="rail", reason=str(gone), error=gone.facts()))
    latch = Latch()
    latch.take(alarms(*lost, live=True), "t1")
    (rail,) = [each for each in latch.standing() if each.alarm.code == "HC-R01"]
    assert (rail.severity, rail.gone, rail.alarm.cause) == ("fault", "", "watched")
    latch.acknowledge()
    assert ("HC-R01", "fault", 1) in standing(latch), "acknowledged, and still lost"
    latch.take(alarms(*lost, event("device back", device="rail"), live=True), "t2")
    assert "HC-R01" not in [code for code, *_ in standing(latch)]
    again = alarms(*lost, event("device back", device="robot"), live=True)
    assert "HC-R01" in [alarm.code for alarm in again], "another device is back"
    assert "HC-R01" not in [alarm.code for alarm in alarms(*lost)], "nobody watches any more"
    went_on = alarms(*lost, state("running"), live=True)
    assert "HC-R01" not in [alarm.code for alarm in went_on]
