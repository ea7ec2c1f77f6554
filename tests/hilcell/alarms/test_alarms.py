"""Alarms of a journal's records: one each, with its place, its words and its steps."""

from __future__ import annotations

import msgspec
import pytest
from msgspec.structs import replace

from hilcell.alarms import alarms_of
from hilcell.cell.devices import ConnectFailed
from hilcell.cell.settings import SettingsError
from hilcell.errors import DeviceError, DeviceRefused, HilcellError, NoReading
from hilcell.identification.sweeps import without_curve
from hilcell.journal.log import Log
from hilcell.model.verdicts import Judged
from hilcell.run.cell_lock import CellLocked
from tests.hilcell.alarms.journals import (
    BEAM,
    BEGUN,
    CLOSED,
    RUN,
    Row,
    alarms,
    asks,
    ended,
    event,
    faulted,
    no_reading,
    point,
    problem,
    state,
    verdict,
)
from tests.hilcell.verdicts import (
    DOUBLED,
    FITTED,
    JUDGED,
    REJECTED,
    STRIP,
    SUSPECTED,
    SUSPICION,
    UNDECIDED,
)

STALLED = DeviceError(
    "HC-R31",
    "Rail",
    "move to 500.000 mm",
    "no progress for 3 s at 480.000 mm",
    expected="target reached at 500.000 mm",
    act="check the slide for an obstacle",
)
LOST = DeviceError(
    "HC-R01",
    "Rail",
    "CAN",
    "link lost: [Errno 32] Broken pipe",
    expected="a link",
    act="check the gateway, the cable and the terminators, then resume",
)
LATE = HilcellError("no answer within 10 s")
HELD = {"station": "S1100", "tries": 2, "rail_mm": 1100.0, "strip_mm": 1100.0}
DONE = (CLOSED, state("finished"), ended(None, 0, "finished"))
OVER = (*BEGUN, *DONE)

REFUSED = msgspec.structs.asdict(without_curve(0, "upwards: 9 samples"))

NO_FILE = "HC-J11"  # no record tells of it, but the run's folder

# The alarm of each of these records; the sites that raise errors are another test's.
BY_EVENTS: dict[str, tuple[Row, ...]] = {
    "HC-C02": (*BEGUN, problem("safe stop", "Rail", LOST), *DONE),
    "HC-C03": (*BEGUN, problem("closed", "Rail", LATE), *DONE[1:]),
    "HC-C05": (*BEGUN, state("stopping"), CLOSED, state("aborted")),
    "HC-C06": (*BEGUN, event("command refused", command="proceed", **{"in": "running"}), *DONE),
    "HC-C07": (*BEGUN, CLOSED, faulted(KeyError("x")), event("internal error", trace="...")),
    "HC-C08": (*BEGUN, event("screen lost"), *DONE),
    "HC-C09": (*BEGUN, event("answer refused", reason="nothing is seen"), *DONE),
    "HC-C14": (*BEGUN, event("retake refused", key="grid/0", reason="it is fitted"), *DONE),
    "HC-J05": BEGUN,
    "HC-R12": (
        *BEGUN,
        event("link", frames=995, bad_lines=2, refused=2, malformed=1),
        *DONE,
    ),
    "HC-S08": (*BEGUN, event("station held", **HELD | {"tries": 5}), *DONE),
    "HC-S09": (
        *BEGUN,
        event("station held", **HELD),
        event("station held", **HELD | {"rail_mm": 1101.5}),
        *DONE,
    ),
    "HC-V01": (*OVER, verdict("validation.others", REJECTED)),
    "HC-V02": (*OVER, verdict("sign", DOUBLED)),
    "HC-V03": (*OVER, verdict("station-repeatability", replace(STRIP, holds=False, found_mm=0.1))),
    "HC-V04": (point("a"), point("b", 22.5), *OVER),
    "HC-V05": (*BEGUN, event("outlier measured again", key="grid/1-2-3"), *DONE),
    "HC-V06": (*BEGUN, event("curve", **REFUSED), *DONE),
    "HC-V17": (*OVER, verdict("validation.S1", UNDECIDED)),
    "HC-V99": (*OVER, ("verdict", "beauty", {"holds": False})),
}


@pytest.mark.parametrize(("rail_mm", "codes"), [(1098.5, ["HC-S09"]), (1099.5, [])])
def test_a_drive_that_falls_behind_the_strip_is_noticed(rail_mm: float, codes: list[str]) -> None:
    holds = event("station held", **HELD), event("station held", **HELD | {"rail_mm": rail_mm})
    assert [alarm.code for alarm in alarms(*BEGUN, *holds, *DONE)] == codes


@pytest.mark.parametrize("code", BY_EVENTS)
def test_each_record_worth_an_alarm_becomes_one(code: str) -> None:
    (alarm,) = alarms(*BY_EVENTS[code])
    assert alarm.code == code


def test_a_good_run_has_none() -> None:
    good: list[Row] = [
        *BEGUN,
        event("station held", **HELD),
        point("a"),
        point("b", 21.9),
        event("safe stop", problems={}),
        event("link", frames=996, bad_lines=2, refused=1, malformed=1),
        verdict("validation.others", JUDGED),
    ]
    assert alarms(*good, *DONE) == []
    assert alarms(*good, live=True) == []
    assert alarms_of(Log(), RUN, live=False) == []


def test_a_fault_has_its_code_place_and_next_step() -> None:
    (alarm,) = alarms(*BEGUN, CLOSED, faulted(STALLED), ended(STALLED))
    assert (alarm.code, alarm.severity) == ("HC-R31", "fault")
    assert (alarm.t, alarm.seq) == ("2026-11-21T12:00:06Z", 6)
    assert (alarm.cause, alarm.by, alarm.continues) == ("not watched", ("you",) * 3, True)
    assert "480.000 mm" in alarm.found
    assert RUN in alarm.do[-1]


@pytest.mark.parametrize(("act", "step"), [("feed it", "Feed it."), ("", "Check the drive")])
def test_a_code_of_no_list_is_the_device_s_general_alarm_with_its_own_advice(
    act: str, step: str
) -> None:
    error = DeviceError("HC-R98", "Rail", "move", "the horse is hungry", act=act)
    (alarm,) = alarms(*BEGUN, CLOSED, faulted(error))
    assert alarm.code == "HC-R99"
    assert alarm.do[0].startswith(step)


def test_devices_that_failed_together_are_reported_one_by_one() -> None:
    error = ConnectFailed(
        {
            "Rail": DeviceError(
                "HC-R04", "Rail", "connect", "slcan x:1: refused", act="check the CAN gateway"
            ),
            "Tracker": DeviceRefused("HC-T03", "Tracker", "connect", "serial 7", expected="8"),
        }
    )
    rows = (state("checking"), CLOSED, faulted(error))
    assert [(a.code, a.where) for a in alarms(*rows)] == [
        ("HC-R04", "Rail: connect"),
        ("HC-T03", "Tracker: connect"),
    ]
    assert {a.seq for a in alarms(*rows)} == {4}


NO_READING = no_reading("grid/1", BEAM)


def test_a_reading_that_came_at_the_second_try_is_a_notice() -> None:
    (alarm,) = alarms(*BEGUN, NO_READING, point("grid/1"), live=True)
    assert (alarm.code, alarm.severity) == ("HC-T10", "notice")
    assert alarm.where == "Tracker: measure grid/1"
    assert not alarm.continues


def test_a_run_that_asks_for_it_is_a_warning_while_it_asks() -> None:
    asking = (*BEGUN, NO_READING, asks("grid/1", BEAM))
    *_, alarm = alarms(*asking, live=True)
    assert (alarm.code, alarm.severity) == ("HC-T10", "warning")
    assert alarm.continues
    assert [a.severity for a in alarms(*asking, state("running"), live=True)] == ["notice"]


def test_what_stopped_an_earlier_session_was_dealt_with() -> None:
    first = (
        *BEGUN,
        NO_READING,
        problem("safe stop", "Rail", LOST),
        CLOSED,
        faulted(STALLED),
        ended(STALLED),
    )
    assert alarms(*first, *BEGUN, live=True) == []
    later = alarms(*first, state("checking"), CLOSED, faulted(BEAM), ended(BEAM))
    assert [alarm.code for alarm in later] == ["HC-T10"]


@pytest.mark.parametrize(
    ("exit_code", "more"),
    [(1, []), (4, []), *((refused, ["HC-C04"]) for refused in (2, 3, 5, 6, 7))],
)
def test_a_resume_that_was_refused_stands_beside_the_fault(exit_code: int, more: list[str]) -> None:
    first = (*BEGUN, CLOSED, faulted(STALLED), ended(STALLED))
    locked = CellLocked("device rail is locked by run x (pid 1); wait for its end")
    found = alarms(*first, ended(locked, exit_code))
    assert [alarm.code for alarm in found] == ["HC-R31", *more]


def test_a_run_that_never_began_says_why() -> None:
    error = SettingsError("robot", ["port: not a number", "host: missing"])
    (alarm,) = alarms(ended(error, 2, "idle"))
    assert (alarm.code, alarm.severity) == ("HC-C11", "fault")
    assert all(problem in alarm.found for problem in error.problems)


def test_a_lost_screen_is_no_alarm_any_more_when_one_is_back() -> None:
    lost = (*BEGUN, event("screen lost"))
    assert [alarm.code for alarm in alarms(*lost, live=True)] == ["HC-C08"]
    assert alarms(*lost, event("screen back"), live=True) == []
    again = (*lost, event("screen back"), event("screen lost"))
    assert [alarm.seq for alarm in alarms(*again, live=True)] == [len(again) + 1]


def test_temperature_is_judged_from_the_first_point_and_reported_once() -> None:
    (alarm,) = alarms(point("a"), point("b", 17.9), point("c", 15.0), *BEGUN, live=True)
    assert alarm.found.startswith("17.9 C at b, -2.1 K")
    (alarm,) = alarms(point("a"), point("b", float("nan")), *BEGUN, live=True)
    assert alarm.code == "HC-V04"
    assert alarms(point("a", None), point("b", 10.0), point("c", None), *BEGUN, live=True) == []


@pytest.mark.parametrize(
    ("judged", "code", "why"),
    [
        (REJECTED, "HC-V01", "mean 0.2000 mm exceeds 0.12 mm by more than its U of 0.0400 mm"),
        (UNDECIDED, "HC-V17",
         "mean 0.1000 mm keeps 0.12 mm, but not with its U of 0.0400 mm added"),
    ],
)  # fmt: skip
def test_only_what_was_rejected_is_called_out_of_tolerance(
    judged: Judged, code: str, why: str
) -> None:
    (alarm,) = alarms(*OVER, verdict("validation.S1100", judged))
    assert (alarm.code, alarm.found) == (code, why)


def test_newest_is_last() -> None:
    found = alarms(
        *BEGUN,
        NO_READING,
        event("command refused", command="abort", **{"in": "x"}),
        problem("safe stop", "Rail", LOST),
        CLOSED,
        faulted(STALLED),
        verdict("sign", DOUBLED),
    )
    assert [alarm.code for alarm in found] == ["HC-T10", "HC-C06", "HC-C02", "HC-R31", "HC-V02"]
    assert [alarm.seq for alarm in found] == sorted(alarm.seq for alarm in found)


def test_a_device_s_hostile_words_stay_words() -> None:
    hostile = "\x1b]0;owned\x07[bold][/nope][@click=app.quit]x[/]\u202e\x9b2J\ninjected: line\r"
    error = DeviceError("HC-R98", "Tracker", hostile, hostile, expected=hostile, act=hostile)
    failed = NoReading("HC-T10", hostile, hostile, hostile)
    rows = (
        *BEGUN,
        no_reading(hostile, failed),
        problem("closed", "Rail", error),
        faulted(error),
    )
    found = alarms(*rows)
    assert len(found) == 3
    for alarm in found:
        for text in (alarm.where, alarm.found, alarm.title, *alarm.do):
            assert text.isprintable(), text
            assert "\u202e" not in text
            assert len(text) <= 420


@pytest.mark.parametrize("error", [{}, {"code": 7, "causes": None}])
def test_facts_that_hilcell_has_not_written_are_a_general_alarm(error: dict[str, object]) -> None:
    (alarm,) = alarms(*BEGUN, state("faulted", reason="x", error=error))
    assert alarm.code == "HC-C99"


FIT = verdict("fit", FITTED)


def test_a_calibration_without_a_file_is_reported_with_its_remedy() -> None:
    (alarm,) = alarms(*BEGUN, FIT, *DONE, lost=True)
    assert (alarm.code, alarm.severity) == (NO_FILE, "warning")
    assert RUN in alarm.do[-1]


@pytest.mark.parametrize(
    ("rows", "live"),
    [
        ((*BEGUN, FIT, *DONE), True),  # its engine is just writing it
        ((*BEGUN, *DONE), False),  # a procedure that calibrates nothing
        ((*BEGUN, FIT, state("aborted")), False),
    ],
)
def test_a_run_that_owes_no_file_has_lost_none(rows: tuple[Row, ...], live: bool) -> None:
    assert NO_FILE not in [alarm.code for alarm in alarms(*rows, live=live, lost=True)]


def test_a_cause_that_the_run_suspects_stands_in_its_alarm_with_the_run_to_look_at() -> None:
    """Another run may be the newest by the time somebody reads the steps."""
    (alarm,) = alarms(*OVER, verdict("suspicions", SUSPECTED))
    assert alarm.found.endswith(SUSPICION.text)
    shown = [step for step in alarm.do if "hilcell show" in step]
    assert shown
    assert not any("show last" in step for step in alarm.do)
