from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import supervision
from drivers.device_errors import ProtocolError
from drivers.spatialanalyzer import tracker_t2sa as t2sa
from drivers.spatialanalyzer.tracker_t2sa import Reply, T2saTracker
from drivers.tracker_readings import matching_form
from hilcell.ports import (
    Aims,
    DeviceError,
    DeviceRefused,
    Discovers,
    Inspects,
    NoReading,
    Searches,
    Stopped,
    Streams,
    Tracker,
)
from tests.drivers.peers import Bed, WireTime, always, in_thread, kind, refusal, wire_time
from tests.drivers.spatialanalyzer.t2sa_peer import POINTS, Answer, T2saPeer

PLACE = np.array([4010.0, -2990.0, 5.0])
SMR = "SMR 1.5in"


class BedTracker(T2saTracker):
    """A bridge's tracker at its peer."""

    def __init__(self, peer: T2saPeer, time: WireTime, **options: Any) -> None:
        values = {
            "host": "127.0.0.1",
            "port": peer.port,
            "reflector": SMR,
            "max_std_mm": 0.05,
            "find_radius_mm": 5.0,
        }
        super().__init__(msgspec.convert(values | options, self.Options), time)
        self.peer, self.time = peer, time


T2saBed = Bed[T2saPeer, BedTracker]


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> WireTime:
    monkeypatch.setattr(t2sa, "REPLY_S", 2.0)  # looks for a peer that is late, not silent
    monkeypatch.setattr(t2sa, "MEASURE_S", 0.3)
    return wire_time(monkeypatch, supervision)


@pytest.fixture
def points(tmp_path: Path) -> Path:
    path = tmp_path / "points.csv"
    rows = (",".join([name, *map(str, at_mm)]) for name, at_mm in POINTS.items())
    path.write_text("\n".join(rows), "ascii")
    return path


@pytest.fixture
def bed(points: Path, time: WireTime) -> Iterator[T2saBed]:
    build = partial(BedTracker, points=str(points))
    with T2saPeer() as peer, closing(Bed(peer, time, build)) as bed:
        yield bed


@pytest.fixture
def tracker(bed: T2saBed) -> BedTracker:
    return bed.connect()


def result(path: str, xyz_mm: Any) -> str:
    """Return the line of a measurement that has read a position."""
    x, y, z = xyz_mm
    return f"ACK-300 Single Point Measurement {path} result {x},{y},{z} today"


def measuring(tracker: BedTracker) -> DeviceError:
    """Return the error of a measurement."""
    return refusal(lambda: tracker.measure(PLACE, SMR, 1))


def test_it_is_a_tracker_that_does_not_stream(tracker: BedTracker) -> None:
    tracker.time.wait(1.0)
    port: Tracker = tracker
    assert not isinstance(port, Streams)
    reading = port.measure(PLACE, SMR, 3)
    np.testing.assert_allclose(reading.xyz_mm, PLACE, atol=1e-3)
    assert (reading.samples, reading.reflector, reading.air) == (3, SMR, None)
    assert reading.taken_s == tracker.time.pc_s()


def test_connecting_sets_the_bridge_and_compares_points(bed: T2saBed) -> None:
    stated = {"instrument": "API T3", "plate": "T3-1234", "working_frame": "TRACKER"}
    stated |= {"profile": "Single Pt. To SA"}
    (identity,) = bed.make(power_lock=False, **stated).connect()
    assert bed.peer.requests == [
        "?STAT",
        "!SET_SIM:0",
        "?LSTA",
        "!SET_STATION_LOCK:1",
        "SET_POWER_LOCK:0",
        "!SINGLE_POINT_MEAS_PROFILE:Single Pt. To SA",
        "!SET_WORKING_FRAME:TRACKER",
        *(f"?POINT_POS:A;HILCELL;P{n}" for n in (1, 2, 3, 4)),
    ]
    assert (identity.model, identity.serial) == ("API T3, by SpatialAnalyzer", "T3-1234")
    assert (identity.kind, identity.simulated) == ("tracker", False)


def test_a_bridge_that_says_so_is_simulated(bed: T2saBed) -> None:
    bed.peer.answers["?STAT"] = lambda _: "ACK-300 READY (simulated);01/05/2026 8:00:00"
    assert bed.make().connect()[0].simulated


def test_an_instrument_that_stays_simulated_is_refused(bed: T2saBed) -> None:
    bed.peer.answers["!SET_SIM"] = lambda _: "ERR-337 Failed to set simulation"
    assert kind(refusal(bed.make().connect)) == (DeviceRefused, "HC-T71")


def test_a_result_that_is_the_nominal_point_was_not_measured(tracker: BedTracker) -> None:
    tracker.peer.at_mm = np.array(POINTS["P1"]) + 0.3
    error = refusal(
        lambda: tracker.measure(tracker.peer.at_mm, SMR, 1)
    )  # the reflector is expected there
    assert kind(error) == (DeviceRefused, "HC-T71")


def test_a_cold_laser_is_switched_on_and_awaited(bed: T2saBed) -> None:
    states = iter(["LOFF", "WARM, 2.00 seconds", "WARM, 1.00 seconds", "LON"])
    bed.peer.answers["?LSTA"] = lambda _: f"ACK-300 {next(states)}"
    bed.make().connect()
    assert bed.peer.asked("!LST") == ["1"]
    assert len(bed.peer.asked("?LSTA")) == 4


@pytest.mark.parametrize(("state", "code"), [("LNC", "HC-T70"), ("WARM, 9.00 seconds", "HC-T19")])
def test_a_laser_that_does_not_come_is_named(
    bed: T2saBed, monkeypatch: pytest.MonkeyPatch, state: str, code: str
) -> None:
    monkeypatch.setattr(t2sa.T2saTracker, "WARM_S", 0.05)
    bed.peer.laser = state
    assert kind(refusal(bed.make().connect)) == (DeviceError, code)


@pytest.mark.parametrize(
    ("command", "code"),
    [("!SET_STATION_LOCK", 331), ("SET_POWER_LOCK", 317), ("!SINGLE_POINT_MEAS_PROFILE", 307),
     ("!SET_WORKING_FRAME", 314)],
)  # fmt: skip
def test_a_setting_that_is_refused_is_named(bed: T2saBed, command: str, code: int) -> None:
    bed.peer.answers[command] = lambda _: f"ERR-{code} Failed."
    tracker = bed.make(profile="x", working_frame="y")
    assert kind(refusal(tracker.connect)) == (DeviceRefused, "HC-T06")


@pytest.mark.parametrize(
    ("scale", "shift", "words"),
    [(1 / 25.4, 0.0, "inches"), (1.0, 0.02, "4000.020"), (np.nan, 0.0, "nan")],
)
def test_a_job_with_other_points_is_refused(
    bed: T2saBed, scale: float, shift: float, words: str
) -> None:
    def position(path: str) -> str:
        x, y, z = scale * np.array(POINTS[path[-2:]])
        return f"ACK-300 Measured single pt {path} result: X:{x + shift};Y:{y};Z:{z};today"

    bed.peer.answers["?POINT_POS"] = position
    error = refusal(bed.make().connect)
    assert kind(error) == (DeviceRefused, "HC-T73")
    assert words in error.found


def test_a_point_that_the_job_lacks_is_named(bed: T2saBed) -> None:
    bed.peer.answers["?POINT_POS"] = lambda _: "ERR-306 Did not find or set point group."
    assert refusal(bed.make().connect).code == "HC-T72"


@pytest.mark.parametrize("name", ["", "/nowhere/points.csv"])
def test_a_list_that_is_missing_is_named_before_anything_is_sent(bed: T2saBed, name: str) -> None:
    assert kind(refusal(bed.make(points=name).connect)) == (DeviceRefused, "HC-T75")
    assert not bed.peer.requests


def test_a_busy_bridge_is_awaited_and_not_for_ever(bed: T2saBed) -> None:
    states = iter(["ERR-201 busy", "ACK-300 EMP", "ACK-300 Instrument is connected"])
    bed.peer.answers["?STAT"] = lambda _: next(states)
    bed.make().connect()
    for line, alarm in (("ACK-300 2FACE", "T21"), ("ERR-201 busy", "T21"), ("ERR-341 -", "T70")):
        bed.peer.answers["?STAT"] = partial(str.format, line)
        error = refusal(bed.make().connect)
        assert kind(error) == (DeviceError, f"HC-{alarm}")
    assert not bed.peer.halted.is_set()  # another program's measurement is not ended


# -- measuring ----------------------------------------------------------------------------------


def test_one_reading_is_of_two_measurements_with_their_spread(tracker: BedTracker) -> None:
    places = iter([PLACE, PLACE + [0.02, 0.0, 0.0]])
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda path: result(path, next(places))
    reading = tracker.measure(PLACE, SMR, 1)
    assert reading.samples == 2
    np.testing.assert_allclose(reading.xyz_mm, PLACE + [0.01, 0, 0], atol=1e-9)
    np.testing.assert_allclose(reading.std_mm, [0.02 / np.sqrt(2), 0, 0], atol=1e-9)
    assert tracker.peer.asked("!MEAS_SINGLE_POINT") == ["A;HILCELL;P1"] * 2


P1 = "A;HILCELL;P1"


@pytest.mark.parametrize(
    ("lines", "expected", "code"),
    [
        ([result(P1, PLACE), result(P1, PLACE + [0.2, 0.0, 0.0])], NoReading, "HC-T15"),
        ([result(P1, PLACE + 0.1)], NoReading, "HC-T76"),  # the former result again
        ([result(P1, PLACE / 25.4)], DeviceError, "HC-T77"),  # inches
        ([result(P1, PLACE / 1000)], DeviceError, "HC-T77"),
        ([result(P1, PLACE - POINTS["P1"])], DeviceError, "HC-T77"),
        *(
            ([f"ACK-300 Measured single pt {P1} result: X:4010.0;Y:{y};Z:5.0;today"], NoReading,
             "HC-T14")
            for y in ("NaN", "1,5", "1e308")
        ),
    ],
)  # fmt: skip
def test_a_bad_result_is_no_reading(
    tracker: BedTracker, lines: list[str], expected: type, code: str
) -> None:
    answers = iter(lines)
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda _: next(answers, lines[-1])
    assert kind(measuring(tracker)) == (expected, code)


def test_a_place_beside_every_point_is_refused_before_anything_is_sent(tracker: BedTracker) -> None:
    tracker.peer.requests.clear()
    beside_mm = np.array([1000.0, 2000.0, 0.0])
    error = refusal(lambda: tracker.measure(beside_mm, SMR, 1))
    assert kind(error) == (DeviceError, "HC-T74")
    assert not tracker.peer.requests


def test_another_reflector_is_avoided_by_other_points(tracker: BedTracker) -> None:
    honest = tracker.peer.answers["!MEAS_SINGLE_POINT"]
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda path: (
        honest(path) if path.endswith("P3") else result(path, (4100, -2990, 5))
    )
    assert tracker.measure(PLACE, SMR, 1).samples == 2
    assert tracker.peer.asked("!MEAS_SINGLE_POINT") == [f"A;HILCELL;P{n}" for n in (1, 3, 3)]


def test_another_reflector_from_everywhere_is_no_reading(tracker: BedTracker) -> None:
    tracker.peer.at_mm = PLACE + [0.0, 5.1, 0.0]
    assert kind(measuring(tracker)) == (NoReading, "HC-T16")
    assert tracker.peer.asked("!MEAS_SINGLE_POINT") == [f"A;HILCELL;P{n}" for n in (1, 3)]


@pytest.mark.parametrize(
    ("code", "alarm", "expected"),
    [
        (200, "HC-T23", DeviceError),
        (305, "HC-T11", NoReading),
        (306, "HC-T72", DeviceError),
        (323, "HC-T70", DeviceError),
        (330, "HC-T13", NoReading),
        (338, "HC-T70", DeviceError),
        (340, "HC-T11", NoReading),
        (341, "HC-T70", DeviceError),
        (346, "HC-T72", DeviceError),
        (399, "HC-T24", DeviceError),
    ],
)
def test_codes_have_their_alarms(
    tracker: BedTracker, code: int, alarm: str, expected: type
) -> None:
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda _: f"ERR-{code} Failed."
    error = measuring(tracker)
    searched = {"searched_mm": 60.0} if alarm == "HC-T11" else {}
    assert (type(error), error.code) == (expected, alarm)
    assert error.fields == {"status": code} | searched


def test_a_busy_bridge_is_asked_again(tracker: BedTracker) -> None:
    honest, busy = tracker.peer.answers["!MEAS_SINGLE_POINT"], iter([True, True, False, False])
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda path: (
        "ERR-201 busy" if next(busy) else honest(path)
    )
    tracker.measure(PLACE, SMR, 1)
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda _: "ERR-201 busy"
    assert isinstance(measuring(tracker), NoReading)


@pytest.mark.parametrize("group", ["", "A;B", "A\r\n!LST:2", "A:B"])
def test_a_group_that_is_no_name_is_refused_with_the_options(bed: T2saBed, group: str) -> None:
    with pytest.raises(msgspec.ValidationError, match="group"):
        bed.make(group=group)


# -- the wire -----------------------------------------------------------------------------------


def test_letters_of_any_alphabet_in_a_date_are_read_over(tracker: BedTracker) -> None:
    honest = tracker.peer.answers["!MEAS_SINGLE_POINT"]
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda path: (
        f"{honest(path)} 2026/1/5 \xcf\xc2\xce\xe7"
    )
    assert tracker.measure(PLACE, SMR, 1).samples == 2


def lost(tracker: BedTracker) -> None:
    assert measuring(tracker).code == "HC-T02"
    assert measuring(tracker).code == "HC-T34"


@pytest.mark.parametrize(
    "line",
    [
        "hello",
        "ACK-300 READY",
        result("A;HILCELL;P4", (1, 2, 3)),
        "x" * 5000,
    ],
)
def test_a_line_that_is_no_answer_ends_the_connection(tracker: BedTracker, line: str) -> None:
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda _: line
    lost(tracker)


def keeps_silent(peer: T2saPeer, time: WireTime) -> Answer:
    """Have no measurement answered until it is halted; return how they were answered."""
    honest, halt = peer.answers["!MEAS_SINGLE_POINT"], peer.answers["!HALT"]
    peer.answers["!MEAS_SINGLE_POINT"] = lambda _: time.silence(0.1)
    peer.answers["!HALT"] = lambda text: time.behind(halt(text), 0.0)
    return honest


def test_a_measurement_without_a_reply_is_halted(tracker: BedTracker) -> None:
    honest = keeps_silent(tracker.peer, tracker.time)
    assert kind(measuring(tracker)) == (NoReading, "HC-T13")
    assert tracker.peer.requests[-2:] == ["!HALT", "?LSTA"]
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = honest
    tracker.measure(PLACE, SMR, 1)


@pytest.mark.parametrize("asked", ["!HALT", "?LSTA"])
@pytest.mark.parametrize(
    "late",
    [
        "ERR-330 Error executing measure plan",
        result("A;HILCELL;P1", (4011.0, -2990.0, 5.0)),
    ],
)
def test_the_reply_of_a_halted_measurement_is_not_the_next_ones(
    tracker: BedTracker, late: str, asked: str
) -> None:
    honest = keeps_silent(tracker.peer, tracker.time)
    right = tracker.peer.answers[asked]
    tracker.peer.answers[asked] = lambda text: f"{late}\r\n{right(text)}"
    assert isinstance(measuring(tracker), NoReading)
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = honest
    np.testing.assert_allclose(tracker.measure(PLACE, SMR, 1).xyz_mm, PLACE, atol=1e-3)


@pytest.mark.parametrize("silent", ["!HALT", "?LSTA"])
def test_a_halt_that_is_not_confirmed_ends_the_connection(tracker: BedTracker, silent: str) -> None:
    keeps_silent(tracker.peer, tracker.time)
    tracker.peer.answers[silent] = lambda _: tracker.time.silence(0.1)
    lost(tracker)


def test_a_result_of_a_program_that_ran_before_is_passed_over(bed: T2saBed) -> None:
    old = result("A;HILCELL;P1", (1.0, 2.0, 3.0))
    bed.peer.answers["?STAT"] = lambda _: f"{old}\r\nACK-300 Instrument is connected"
    tracker = bed.connect()
    assert tracker.measure(PLACE, SMR, 1).samples == 2


def test_a_connection_that_breaks_is_lost(tracker: BedTracker) -> None:
    tracker.peer.drop()
    lost(tracker)


def test_a_list_that_vanished_is_kept_and_compared(bed: T2saBed, points: Path) -> None:
    tracker = bed.connect()
    points.unlink()
    bed.peer.requests.clear()
    tracker.connect()
    assert len(bed.peer.asked("?POINT_POS")) == len(POINTS)


def test_a_stop_ends_a_wait_and_halts_the_measurement(tracker: BedTracker) -> None:
    begun = threading.Event()
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda _: begun.set()
    with in_thread(lambda: tracker.measure(PLACE, SMR, 1), Stopped) as errors:
        begun.wait()
        tracker.time.stop.set()
        tracker.stop()
    assert len(errors) == 1
    tracker.peer.halted.wait()
    tracker.time.stop.clear()
    assert measuring(tracker).code == "HC-T34"


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        ("ACK-300 Instrument is connected", Reply(True, 300, "Instrument is connected")),
        ("ACK-300 READY;07/27/2021 11:31:06", Reply(True, 300, "READY;07/27/2021 11:31:06")),
        (
            "ERR-201 Command rejected. SA is busy.",
            Reply(False, 201, "Command rejected. SA is busy."),
        ),
        (" ERR-306: Did not find it.", Reply(False, 306, "Did not find it.")),
        ("ACK-300", Reply(True, 300, "")),
    ],
)
def test_replies(line: str, reply: Reply) -> None:
    assert t2sa.parse(line) == reply


@pytest.mark.parametrize("line", ["", "READY", "ACK-30 x", "ACK-3000 x", "NAK-300 x", "ERR-30A x"])
def test_other_lines_are_no_replies(line: str) -> None:
    with pytest.raises(ProtocolError):
        t2sa.parse(line)


@given(st.text(max_size=60))
def test_any_text_is_a_reply_or_an_error(text: str) -> None:
    try:
        t2sa.parse(text)
    except ProtocolError:
        return
    assert text.strip().startswith(("ACK-", "ERR-"))


@pytest.mark.parametrize(
    ("body", "xyz_mm"),
    [
        (
            "Single Point Measurement A;M2;M2_P1 result -529.16349,319.1,285.1 8/19/2022 2:45 PM",
            (-529.16349, 319.1, 285.1),
        ),
        ("Single Point Measurement M2_P1 result 1,-2.5,3e2 19.08.2022 14:45 True", (1, -2.5, 300)),
        (
            "Measured single pt M2_P1 result: X:-529.16349;Y:319.1;Z:285.1;07/27/2021 17:02 True",
            (-529.16349, 319.1, 285.1),
        ),
        ("Measured single pt M2_P1 result: X:1.0;Y:2.0;Z:3.0", (1, 2, 3)),
    ],
)
def test_positions(body: str, xyz_mm: tuple[float, ...]) -> None:
    reply = t2sa.parse(f"ACK-300 {body}")
    assert reply.is_result
    np.testing.assert_array_equal(t2sa.position_of(reply, "M2_P1"), xyz_mm)


@pytest.mark.parametrize("x", ["nan", "NaN", "inf", "-INF", "1_0", "", "0x1", "1e9999"])
def test_values_that_are_no_numbers_are_not_finite(x: str) -> None:
    reply = t2sa.parse(f"ACK-300 Measured single pt P1 result: X:{x};Y:2.0;Z:3.0;today")
    assert not np.isfinite(t2sa.position_of(reply, "P1")[0])


@pytest.mark.parametrize(
    "body",
    [
        "READY",
        "Single Point Measurement P1 result 1,5,2,5,3,5 today",
        "Single Point Measurement P1 result 1.0,2.0 today",
        "Single Point Measurement A;G;P10 result 1,2,3 today",
        "Measured single pt P2 result: X:1;Y:2;Z:3;today",
    ],
)
def test_texts_without_the_points_position_are_refused(body: str) -> None:
    with pytest.raises(ProtocolError):
        t2sa.position_of(t2sa.parse(f"ACK-300 {body}"), "P1")


@pytest.mark.parametrize(
    ("xyz", "form"),
    [
        ([100.0, 0.0, 0.0], "in inches"),
        ([2.54, 0.0, 0.0], "in metres"),
        ([40.0, 0.0, 0.0], "as a deviation from the named point"),
        ([7.0, 0.0, 0.0], ""),
    ],
)
def test_forms_of_a_result(xyz: list[float], form: str) -> None:
    named_mm, near_mm = np.array([2500.0, 0, 0]), np.array([2540.0, 0, 0])
    forms = t2sa.other_forms(np.array(xyz), named_mm)
    assert matching_form(near_mm, 1.0, forms) == form


# -- a wider search --------------------------------------------------------------------------------


def test_a_search_measures_through_the_named_points_around(bed: T2saBed) -> None:
    tracker = bed.make(search_mm=40.0)
    tracker.connect()
    port: Searches = tracker
    assert not isinstance(tracker, Aims)  # the bridge measures named points only
    at_mm = np.array([4005.0, -2930.0, 5.0])

    def seen_from(path: str) -> str:
        name = path.rpartition(";")[2]
        return tracker.peer._measure(path) if name == "P2" else "ERR-305 Measurement failed"

    tracker.peer.at_mm, tracker.peer.answers["!MEAS_SINGLE_POINT"] = at_mm, seen_from
    reading = port.search(np.array([4000.0, -3000.0, 0.0]), SMR, 1, 300.0)
    np.testing.assert_allclose(reading.xyz_mm, at_mm, atol=1e-3)
    names = [path.rpartition(";")[2] for path in tracker.peer.asked("!MEAS_SINGLE_POINT")]
    assert names == ["P1", "P2", "P2", "P2"]  # outwards, then its repeats


def test_a_search_without_success_states_its_radius(tracker: BedTracker) -> None:
    near_mm = np.array([4000.0, -3000.0, 0.0])
    error = refusal(lambda: tracker.search(near_mm, SMR, 1, 5.0))
    assert kind(error) == (NoReading, "HC-T16")  # the peer's reflector is 15 mm from there
    assert error.fields["searched_mm"] == 5.0
    tracker.peer.answers["!MEAS_SINGLE_POINT"] = lambda _: "ERR-305 Measurement failed"
    error = refusal(lambda: tracker.search(near_mm, SMR, 1, 300.0))
    assert (error.code, error.fields["searched_mm"]) == ("HC-T11", 300.0)
    error = refusal(lambda: tracker.search(-near_mm, SMR, 1, 300.0))  # no named point there
    assert (error.code, error.fields["searched_mm"]) == ("HC-T11", 300.0)


# -- what it reports before anything is written --------------------------------------------------


@pytest.mark.parametrize(
    ("lie", "feature", "state", "needed"),
    [
        ({}, "bridge ready", "has", "mandatory"),
        ({"?STAT": "ERR-341 no SA"}, "bridge ready", "has not", "mandatory"),
        ({}, "laser on and warm", "has", "optional"),
        ({"?LSTA": "ACK-300 LOFF"}, "laser on and warm", "has not", "optional"),
        ({}, "points in the job", "has", "mandatory"),
        ({"?POINT_POS": "ERR-306 no point"}, "points in the job", "has not", "mandatory"),
        ({}, "aim by a person", "has not", "optional"),
    ],
)
def test_it_lists_its_abilities_and_changes_nothing(
    bed: T2saBed, lie: dict[str, str], feature: str, state: str, needed: str
) -> None:
    for command, answer in lie.items():
        bed.peer.answers[command] = always(answer)
    inspects: Inspects = bed.make()
    found = {each.feature: each for each in inspects.inspect()}
    assert (found[feature].state, found[feature].needed) == (state, needed)
    assert all(line.startswith("?") for line in bed.peer.requests)


def test_a_missing_list_of_points_is_an_ability_it_lacks(bed: T2saBed) -> None:
    found = {each.feature: each.state for each in bed.make(points="").inspect()}
    assert found["list of points"] == "has not"
    assert found["bridge ready"] == "has"


def test_a_bridge_is_discovered_at_a_host_that_a_person_gave(bed: T2saBed) -> None:
    discovers: type[Discovers] = T2saTracker
    known = {"host": "127.0.0.1", "port": bed.peer.port}
    (found,) = discovers.discover(known)
    assert found.options == known
    assert discovers.discover({}) == []
    bed.peer.answers["?STAT"] = lambda _: "220 ready"
    assert discovers.discover(known) == []
