"""A total station at its peer; lines of GeoCOM as geocompy sends and captures them."""

from __future__ import annotations

import itertools
import math
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.device_errors import ProtocolError
from drivers.leica import tracker_geocom as geocom
from drivers.leica.tracker_geocom import LeicaGeocomTracker, Reply, Rpc
from hilcell.ports import (
    Aims,
    DeviceError,
    DeviceRefused,
    Discovers,
    Inspects,
    NoReading,
    Stopped,
    Streams,
    Tracker,
)
from tests.drivers.leica.geocom_peer import GeocomPeer
from tests.drivers.peers import Bed, WireTime, always, in_thread, kind, refusal

pytestmark = pytest.mark.waits

POINT = np.array([4000.0, -3000.0, 0.0])  # 5 m from the instrument, right of its Hz zero
SMR = "SMR 1.5in"
SETTINGS = [108, 2029, 2023, 2021, 2014, 2007, 18006]  # in the order in which they are read


class Quick(LeicaGeocomTracker):
    """An instrument at its peer, with short deadlines."""

    REPLY_S = 0.3
    MOVE_S = 0.3

    def __init__(self, peer: GeocomPeer, time: WireTime, **options: Any) -> None:
        values: dict[str, Any] = {
            "channel": peer.channel,
            "reflector": SMR,
            "max_std_mm": 1.0,
            "find_radius_mm": 5.0,
            "reading_s": 0.1,
        }
        super().__init__(self.Options(**(values | options)), time)
        self.peer, self.time = peer, time


GeocomBed = Bed[GeocomPeer, Quick]


@pytest.fixture
def bed(time: WireTime) -> Iterator[GeocomBed]:
    with GeocomPeer() as peer, closing(Bed(peer, time, Quick)) as bed:
        yield bed


@pytest.fixture
def tracker(bed: GeocomBed) -> Quick:
    return bed.connect()


def measuring(tracker: Quick, samples: int = 1) -> DeviceError:
    """Return the error of a measurement."""
    return refusal(lambda: tracker.measure(POINT, SMR, samples))


@pytest.mark.parametrize("serial", [False, True])
def test_it_is_a_tracker_that_does_not_stream_on_either_wire(bed: GeocomBed, serial: bool) -> None:
    with GeocomPeer(serial=serial) as peer:
        tracker = bed.make(channel=peer.channel)
        tracker.connect()
        port: Tracker = tracker
        assert not isinstance(port, Streams)
        bed.time.wait(1.0)
        reading = port.measure(POINT, SMR, 1)
        np.testing.assert_allclose(reading.xyz_mm, POINT, atol=1e-6)
        assert (reading.samples, reading.reflector, reading.air) == (1, SMR, None)
        assert reading.taken_s == bed.time.pc_s()


def test_connecting_sets_everything_and_returns_the_identity(bed: GeocomBed) -> None:
    tracker = bed.make(
        serial="884321",
        prism_constant_mm=-16.9,
        temperature_c=23.5,
        wet_bulb_c=17.0,
        pressure_mbar=1002.0,
    )
    (identity,) = tracker.connect()
    assert (identity.model, identity.serial) == ("Leica TS60, R1000", "884321")
    assert (identity.firmware, identity.kind, identity.maker) == ("8.50.0", "tracker", "Leica")
    assert bed.peer.settings == {
        108: "15",
        2007: "1",
        2014: "1,1,1,1",
        2021: "2",
        2023: "-0.0169",
        2029: "0.000000658,1002.0,23.5,17.0",
        18006: "1",
    }


def test_a_setting_that_is_right_is_left_alone(bed: GeocomBed) -> None:
    bed.peer.settings[2023] = "0.0000"
    bed.peer.answers[2024] = lambda _: "5"  # newer instruments take it at their keyboard only
    tracker = bed.connect()
    tracker.close()
    assert not bed.peer.asked(2024)


@pytest.mark.parametrize(
    ("rpc", "answer", "named"),
    [
        (2024, "0", "prism constant"),
        (2024, "5", "prism constant"),
        (2016, "0", "angle corrections"),  # one face is measured
        (2016, "5", "angle corrections"),
        (2029, "0,nan,1013.25,20.0,20.0", ""),
        (2029, "0,inf,1013.25,20.0,20.0", ""),
    ],
)
def test_a_setting_that_does_not_read_back_is_refused(
    bed: GeocomBed, rpc: int, answer: str, named: str
) -> None:
    bed.peer.answers[rpc] = lambda _: answer
    error = refusal(bed.make().connect)
    assert kind(error) == (DeviceRefused, "HC-T06")
    assert named in str(error)


def test_a_command_that_the_instrument_does_not_have_is_named(bed: GeocomBed) -> None:
    bed.peer.reply = lambda number, answer: (
        f"%R1P,{3081 if answer == 'none' else 0},{number}:{0 if answer == 'none' else answer}\r\n"
    ).encode()
    bed.peer.answers[18006] = lambda _: "none"
    error = refusal(bed.make().connect)
    assert (error.code, error.fields["status"]) == ("HC-T23", 3081)


def test_one_measurement(tracker: Quick) -> None:
    peer = tracker.peer
    peer.requests.clear()
    tracker.measure(POINT, SMR, 1)
    procedures = [int(line.split(",")[1]) for line in peer.requests]
    assert procedures == [*SETTINGS, 9027, 9037, 2008, 2008, 2108]
    assert peer.asked(9027) == ["0.643501108793,1.570796326795,0,0,0"]  # to the right: clockwise
    assert peer.asked(9037) == ["0.002,0.002,0"]
    assert peer.asked(2008) == ["3,1", "1,1"]  # the last distance is cleared first
    numbers = [int(line.split(":")[0].split(",")[2]) for line in peer.requests]
    assert numbers == list(range(numbers[0], numbers[0] + len(SETTINGS) + 5))


def test_one_reading_is_as_uncertain_as_the_maker_states(bed: GeocomBed) -> None:
    tracker = bed.connect(distance_mm=0.6, distance_ppm=1.0, angle_arcsec=1.0)
    reading = tracker.measure(POINT, SMR, 1)
    tracker.close()
    along, across = 0.605, 5000 * np.pi / 648_000
    expected = [np.hypot(0.8 * along, 0.6 * across), np.hypot(0.6 * along, 0.8 * across), across]
    np.testing.assert_allclose(reading.std_mm, expected, rtol=1e-6)


def test_repeats_aim_again_and_have_their_own_spread(tracker: Quick) -> None:
    distances = iter([5.0, 5.0002, 4.9998])
    tracker.peer.answers[2108] = lambda _: f"0,{tracker.peer.pointing},{next(distances):.15f}"
    reading = tracker.measure(POINT, SMR, 3)
    assert len(tracker.peer.asked(9037)) == 3
    np.testing.assert_allclose(reading.xyz_mm, POINT, atol=1e-6)
    np.testing.assert_allclose(reading.std_mm, [0.16, 0.12, 0.0], atol=1e-6)


def test_repeats_that_spread_are_no_reading(tracker: Quick) -> None:
    distances = iter([5.0, 5.003])
    tracker.peer.answers[2108] = lambda _: f"0,{tracker.peer.pointing},{next(distances):.15f}"
    assert kind(measuring(tracker, 2)) == (NoReading, "HC-T15")


@pytest.mark.parametrize(
    ("rpc", "code", "alarm", "expected"),
    [
        (2108, 1283, "HC-T50", NoReading),
        (2108, 1284, "HC-T51", NoReading),
        (2108, 1285, "HC-T52", NoReading),
        (2108, 1292, "HC-T52", NoReading),
        (2108, 769, "HC-T53", NoReading),
        (2108, 776, "HC-T53", NoReading),
        (2108, 778, "HC-T53", DeviceError),
        (2108, 22, "HC-T20", DeviceError),
        (2108, 31999, "HC-T24", NoReading),
        (9027, 8704, "HC-T54", NoReading),
        (9027, 8707, "HC-T54", DeviceError),
        (9037, 8710, "HC-T11", NoReading),
        (9037, 8711, "HC-T56", NoReading),
        (9037, 8714, "HC-T23", DeviceError),
        (9037, 27, "HC-T23", DeviceError),
        (2008, 18, "HC-T55", DeviceError),
    ],
)
def test_return_codes_have_their_alarms(
    tracker: Quick, rpc: int, code: int, alarm: str, expected: type
) -> None:
    # With the values of a good reading: a code is never passed over for them.
    tracker.peer.answers[rpc] = lambda _: f"{code},0.643501108793,1.570796326795,5.0"
    error = measuring(tracker)
    assert (type(error), error.code, error.fields["status"]) == (expected, alarm, code)


@pytest.mark.parametrize("code", [1283, 1284])
def test_readings_without_full_correction_are_taken_where_the_file_says_so(
    bed: GeocomBed, code: int
) -> None:
    peer = bed.peer
    tracker = bed.make(accept_uncorrected=True)
    (identity,) = tracker.connect()
    assert "accepted" in identity.model
    peer.answers[2108] = lambda _: f"{code},{peer.pointing},5.000000000000000"
    np.testing.assert_allclose(tracker.measure(POINT, SMR, 1).xyz_mm, POINT, atol=1e-6)
    peer.answers[2108] = lambda _: f"1285,{peer.pointing},5.000000000000000"
    assert measuring(tracker).code == "HC-T52"
    good = peer.answers
    for rpc in (2008, 9027, 9037):  # nothing else is done without full correction
        peer.answers = {**good, rpc: lambda _: "1283"}
        assert measuring(tracker).code == "HC-T50"


@pytest.mark.parametrize("code", [13, 786, 1293])
def test_a_busy_instrument_is_asked_again(tracker: Quick, code: int) -> None:
    codes = iter([code, code, 0])
    tracker.peer.answers[9037] = lambda _: str(next(codes))
    assert tracker.measure(POINT, SMR, 1).samples == 1
    assert len(tracker.peer.asked(9037)) == 3
    tracker.peer.answers[9037] = lambda _: str(code)
    assert kind(measuring(tracker)) == (NoReading, "HC-T21")


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (0, "nan"), (1, "inf"), (2, "NaN"), (2, "-inf"), (2, "0.0"), (2, "-5.0"),
        *product((0, 1, 2), ("1" + "0" * 308, "1" + "0" * 400, "-1" + "0" * 308)),
    ],
)  # fmt: skip
def test_a_result_that_is_no_position_is_no_reading(tracker: Quick, value: str, place: int) -> None:
    values = ["0.643501108793284", "1.570796326794897", "5.000000000000000"]
    values[place] = f"{value}.000000000000000" if value.endswith("0" * 300) else value
    tracker.peer.answers[2108] = lambda _: ",".join(["0", *values])
    assert kind(measuring(tracker)) == (NoReading, "HC-T14")


@pytest.mark.parametrize("damaged", [
    "0.63501108793284,1.570796326794897,5.000000000000000",
    "0.643501108793284,1.57079632,5.000000000000000",
    "0.643501108793284,1.570796326794897,5",
    "0.643501108793284,1.570796326794897,5000000000000000",
    "0.643501108793284,1.570796326794897,5.00000000000000",
])  # fmt: skip
def test_a_reading_that_has_lost_characters_is_measured_again(bed: GeocomBed, damaged: str) -> None:
    tracker = bed.connect(find_radius_mm=100.0)
    good, first = bed.peer.answers[2108], iter([True])
    bed.peer.answers[2108] = lambda text: f"0,{damaged}" if next(first, False) else good(text)
    np.testing.assert_allclose(tracker.measure(POINT, SMR, 1).xyz_mm, POINT, atol=1e-6)
    assert bed.peer.asked(2008) == ["3,1", "3,1", "1,1", "3,1", "1,1"], "a new distance, too"
    others = itertools.cycle([damaged, "0.64501108793284,1.5707963267948,5.00000000000000"])
    bed.peer.answers[2108] = lambda _: f"0,{next(others)}"
    error = measuring(tracker)
    assert kind(error) == (NoReading, "HC-T14")
    assert damaged in error.found


def test_two_readings_that_agree_have_lost_zeros_only(tracker: Quick) -> None:
    """Some instruments leave the zeros at the end of a number out."""
    tracker.peer.answers[2108] = lambda _: (
        f"0,{tracker.peer.pointing.split(',')[0]},1.5707963267949,5.0"
    )
    np.testing.assert_allclose(tracker.measure(POINT, SMR, 1).xyz_mm, POINT, atol=1e-6)


def test_an_instrument_without_a_switch_for_its_corrections_is_taken(bed: GeocomBed) -> None:
    bed.peer.answers[2014] = lambda _: "5"
    tracker = bed.connect()
    assert tracker.measure(POINT, SMR, 1).samples == 1
    assert bed.peer.asked(2016) == []


def test_one_of_many_repeats_that_is_far_from_the_others_is_in_no_mean(bed: GeocomBed) -> None:
    tracker = bed.connect(max_std_mm=3.0, find_radius_mm=20.0)
    distances = iter([5.0003, 4.995, 5.0, 4.9998])
    bed.peer.answers[2108] = lambda _: f"0,{bed.peer.pointing},{next(distances):.15f}"
    error = measuring(tracker, 4)
    assert kind(error) == (NoReading, "HC-T15")
    assert "repeat 2 of 4" in error.found


@pytest.mark.parametrize(
    ("rpc", "value"),
    [
        (108, "4"),
        (2029, "0.000000658,1013.25,55.0,12.0"),
        (2023, "0.0344"),
        (2021, "3"),
        (2014, "1,1,0,1"),
        (2007, "0"),
        (18006, "0"),
    ],
)
def test_a_setting_that_is_changed_at_the_keyboard_is_refused_until_it_is_set_again(
    tracker: Quick, rpc: int, value: str
) -> None:
    tracker.measure(POINT, SMR, 1)
    tracker.peer.settings[rpc] = value
    error = measuring(tracker)
    assert (error.code, type(error)) == ("HC-T06", DeviceError)
    assert not tracker.peer.asked(9027)[1:], "it is not even aimed"
    tracker.connect()
    assert tracker.measure(POINT, SMR, 1).samples == 1


def test_a_setting_that_has_lost_a_character_is_asked_again(tracker: Quick) -> None:
    once = iter(["0,0.00000658,101.25,20.0,20.0"])
    tracker.peer.answers[2029] = lambda _: next(once, f"0,{tracker.peer.settings[2029]}")
    assert tracker.measure(POINT, SMR, 1).samples == 1


def test_a_serial_number_that_has_lost_a_character_is_asked_again(bed: GeocomBed) -> None:
    once = iter(["0,88432"])
    bed.peer.answers[5003] = lambda _: next(once, "0,884321")
    (identity,) = bed.make(serial="884321").connect()
    assert identity.serial == "884321"


def test_an_instrument_that_never_answers_the_same_twice_is_lost(bed: GeocomBed) -> None:
    serials = itertools.count(884321)
    bed.peer.answers[5003] = lambda _: f"0,{next(serials)}"
    assert refusal(bed.make().connect).code == "HC-T02"


@pytest.mark.parametrize("wet_bulb_c", [20.1, float("nan")])
def test_a_wet_bulb_above_the_air_is_refused(bed: GeocomBed, wet_bulb_c: float) -> None:
    with pytest.raises(ValueError, match="wet bulb"):
        bed.make(temperature_c=20.0, wet_bulb_c=wet_bulb_c)


@pytest.mark.parametrize("empty", ["0", "0,", "0,,,"])
def test_a_result_without_values_is_no_reading_and_the_next_is_good(
    tracker: Quick, empty: str
) -> None:
    good, asked = tracker.peer.answers[2108], iter([True])
    tracker.peer.answers[2108] = lambda text: empty if next(asked, False) else good(text)
    assert kind(measuring(tracker)) == (NoReading, "HC-T13")
    np.testing.assert_allclose(tracker.measure(POINT, SMR, 1).xyz_mm, POINT, atol=1e-6)


@pytest.mark.parametrize("rpc", [108, 2029, 5003, 5004, 5034])
def test_a_question_whose_answer_has_no_values_is_asked_again(bed: GeocomBed, rpc: int) -> None:
    good, asked = bed.peer.answers.get(rpc, lambda _: f"0,{bed.peer.settings[rpc]}"), iter([True])
    bed.peer.answers[rpc] = lambda text: "0" if next(asked, False) else good(text)
    tracker = bed.connect()
    tracker.close()
    bed.peer.answers[rpc] = lambda _: "0"
    assert refusal(tracker.connect).code == "HC-T02"


@pytest.mark.parametrize("serial", ["nan", "inf"])
def test_a_serial_number_that_is_none_is_no_identity(bed: GeocomBed, serial: str) -> None:
    bed.peer.answers[5003] = lambda _: f"0,{serial}"
    assert refusal(bed.make().connect).code == "HC-T02"


@pytest.mark.parametrize(
    "name", [r'"TS16 A 1\" R500"', '"TS16 A 1" R500"', '"Leica TS16 A 1" R500"']
)
def test_an_instrument_whose_name_has_the_mark_of_an_arcsecond_connects(
    bed: GeocomBed, name: str
) -> None:
    bed.peer.answers[5004] = lambda _: f"0,{name}"
    (identity,) = bed.make().connect()
    assert identity.model == 'Leica TS16 A 1" R500'


def test_another_reflector_than_the_expected_one_is_no_reading(tracker: Quick) -> None:
    tracker.peer.distance_m = 5.0051
    assert kind(measuring(tracker)) == (NoReading, "HC-T16")


# -- the wire -----------------------------------------------------------------------------------


def lost(tracker: Quick) -> None:
    assert measuring(tracker).code == "HC-T02"
    assert measuring(tracker).code == "HC-T34"


@pytest.mark.parametrize(
    "reply",
    [
        lambda number: f"%R1P,0,{number + 1}:0\r\n".encode(),
        lambda number: f"%R1P,3077,{number}:0\r\n".encode(),
        lambda _: b"\xfe\x80\xf8\x06\r\n",
        lambda _: b"hello\r\n",
        lambda _: b"%R1P,0,1\r\n",
        lambda _: b"x" * 5000,
    ],
    ids=["another request", "communication", "no text", "no reply", "no code", "no end"],
)
def test_a_reply_that_is_none_ends_the_connection(
    tracker: Quick, reply: Callable[[int], bytes]
) -> None:
    tracker.peer.reply = lambda number, answer: reply(number)
    lost(tracker)


def test_a_wrong_baud_rate_shows_when_connecting(bed: GeocomBed) -> None:
    bed.peer.reply = lambda number, answer: b"\x00\xf8\x80\r\n"
    assert "baud rate" in str(refusal(bed.make().connect))


def test_a_result_of_the_wrong_form_ends_the_connection(tracker: Quick) -> None:
    tracker.peer.answers[2108] = lambda _: "0,0.1,0.2"
    lost(tracker)


def test_a_late_result_is_not_the_next_points(tracker: Quick) -> None:
    peer = tracker.peer
    held: list[bytes] = []
    right = peer.reply
    peer.answers[2108] = lambda _: tracker.time.silence(0.1)
    peer.answers[0] = lambda _: tracker.time.behind("0", 0.0)  # it lives
    peer.distance_m = 5.001

    def holding(number: int, answer: str) -> bytes:
        data = b"".join([*held, right(number, answer)])
        held.clear()
        return data

    assert kind(measuring(tracker)) == (NoReading, "HC-T13")
    late = next(line for line in reversed(peer.requests) if ",2108," in line)
    held.append(
        right(int(late.split(":")[0].split(",")[2]), f"0,{peer.pointing},5.001000000000000")
    )
    peer.reply = holding
    peer.answers[2108] = lambda _: f"0,{peer.pointing},5.000000000000000"
    np.testing.assert_allclose(tracker.measure(POINT, SMR, 1).xyz_mm, POINT, atol=1e-6)
    assert not held


def test_a_silent_instrument_is_lost(tracker: Quick) -> None:
    tracker.peer.answers = dict.fromkeys(range(20_000), lambda _: None)
    tracker.time.silence(0.1)
    lost(tracker)


@pytest.mark.parametrize("serial", [False, True])
def test_a_silent_line_is_asked_about_its_baud_rate_or_port(bed: GeocomBed, serial: bool) -> None:
    with GeocomPeer(serial=serial) as peer:
        peer.answers = dict.fromkeys(range(20_000), lambda _: None)
        channel = f"{peer.channel}@9600" if serial else peer.channel
        bed.time.silence(0.1)
        assert ("9600" if serial else "port") in str(refusal(bed.make(channel=channel).connect))


def test_answers_to_a_program_that_ran_before_are_passed_over(bed: GeocomBed) -> None:
    right = bed.peer.reply
    greeting = [right(4711, "0,1.0,1.0,5.0") + b"?\r\n"]
    bed.peer.reply = lambda number, answer: (
        (greeting.pop() if greeting else b"") + right(number, answer)
    )
    tracker = bed.connect()
    assert tracker.measure(POINT, SMR, 1).samples == 1


def test_a_line_that_dies_in_mid_byte_is_lost(bed: GeocomBed) -> None:
    with GeocomPeer(serial=True) as peer:
        tracker = bed.make(channel=peer.channel)
        tracker.connect()
        peer.answers[2108] = lambda _: peer.pull_out()
        assert measuring(tracker).code == "HC-T02"
        assert refusal(tracker.connect).code == "HC-T01"


def test_a_line_that_was_renamed_is_found_by_its_new_name_only(
    tmp_path: Path, bed: GeocomBed
) -> None:
    with GeocomPeer(serial=True) as peer:
        name = tmp_path / "usb-leica"
        assert refusal(bed.make(channel=str(name)).connect).code == "HC-T01"
        name.symlink_to(peer.channel)
        tracker = bed.make(channel=f"{name}@115200")
        assert tracker.connect()[0].address == str(name)
        tracker.close()
        assert os.path.lexists(name)


def test_a_stop_ends_a_wait_and_the_motion(tracker: Quick) -> None:
    turning = threading.Event()
    tracker.peer.answers[9027] = lambda _: turning.set()
    with in_thread(lambda: tracker.measure(POINT, SMR, 1), Stopped) as errors:
        turning.wait()
        tracker.time.stop.set()
        tracker.stop()
    assert len(errors) == 1
    tracker.peer.aborted.wait()
    tracker.close()
    tracker.close()
    tracker.stop()


@pytest.mark.parametrize(
    ("line", "rpc", "number", "parameters"),
    [
        ("%R1Q,0,0:", Rpc.NULL, 0, ()),
        ("%R1Q,2008,7:1,1", Rpc.DO_MEASURE, 7, (1, 1)),
        ("%R1Q,2108,10:5000,1", Rpc.GET_MEASUREMENT, 10, (5000, 1)),
        ("%R1Q,9037,9:0.1,0.1,0", Rpc.FINE_ADJUST, 9, (0.1, 0.1, 0)),
        ("%R1Q,2028,3:0.000000658,1013.0,20.5,20.5", 2028, 3, (658e-9, 1013.0, 20.5, 20.5)),
    ],
)
def test_requests(line: str, rpc: int, number: int, parameters: tuple[float, ...]) -> None:
    assert geocom.request(rpc, number, *parameters) == line


def test_replies() -> None:
    assert geocom.parse("%R1P,0,0:0") == Reply(0, 0, 0)
    assert geocom.parse("%R1P,0,9:8710") == Reply(0, 9, 8710)
    assert geocom.parse("%R1P,3077,9:0") == Reply(3077, 9, 0)
    found = geocom.parse("%R1P,0,8:0,1100.2503,-2.5001,0.1252,12345,1100.2503,-2.5001,0.1252,12345")
    assert geocom.numbers(found.values, 8)[:4] == (1100.2503, -2.5001, 0.1252, 12345.0)
    assert geocom.parse('%R1P,0,2:0,"TS60, R1000",""').values == ("TS60, R1000", "")


@pytest.mark.parametrize(
    ("text", "values"),
    [
        (r'"TS16 A 1\" R500"', ('TS16 A 1" R500',)),
        ('"TS16 A 1" R500"', ('TS16 A 1" R500',)),
        (r'"TS60 0.5\""', ('TS60 0.5"',)),
        ('"TS60 0.5""', ('TS60 0.5"',)),
        (r'"TS16 1\", R500",3', ('TS16 1", R500', "3")),
        (r'"a\\b","c"', (r"a\b", "c")),
        ('"TS16 1", R500"', ("TS16 1", ' R500"')),
    ],
)
def test_a_name_may_have_the_mark_of_an_arcsecond_in_it(text: str, values: tuple[str, ...]) -> None:
    assert geocom.parse(f"%R1P,0,2:0,{text}").values == values


@pytest.mark.parametrize(
    "line",
    ["", "?", "%R1P,0,1", "%R1P,0:0", "%R1P,0,-1:0", "%R1P,a,1:0", "%R1Q,0,1:", '%R1P,0,1:0,"a"b'],
)
def test_other_lines_are_no_replies(line: str) -> None:
    with pytest.raises(ProtocolError):
        geocom.parse(line)


@pytest.mark.parametrize("values", [(), ("1", "2"), ("1", "2", "three"), ("1", "2", "")])
def test_values_of_another_kind_or_number_are_refused(values: tuple[str, ...]) -> None:
    with pytest.raises(ProtocolError, match="3"):
        geocom.numbers(values, 3)


@given(st.text(max_size=60))
def test_any_text_is_a_reply_or_an_error(text: str) -> None:
    try:
        geocom.parse(text)
    except ProtocolError:
        return
    assert text.startswith("%R1P,")


def test_hz_turns_clockwise_in_a_right_handed_frame() -> None:
    quarter = math.pi / 2
    np.testing.assert_allclose(geocom.position_mm(0.0, quarter, 2.0), [2000, 0, 0], atol=1e-9)
    np.testing.assert_allclose(geocom.position_mm(quarter, quarter, 2.0), [0, -2000, 0], atol=1e-9)
    np.testing.assert_allclose(geocom.position_mm(1.0, 0.0, 2.0), [0, 0, 2000], atol=1e-9)


@given(
    st.floats(-1e4, 1e4).filter(lambda x: abs(x) > 1), st.floats(-1e4, 1e4), st.floats(-3e3, 3e3)
)
def test_angles_lead_back_to_their_place(x: float, y: float, z: float) -> None:
    at_mm = np.array([x, y, z])
    hz, v = geocom.LeicaGeocomTracker.angles_to(at_mm)
    assert 0 <= hz <= math.tau
    assert 0 <= v <= math.pi
    distance_m = float(np.linalg.norm(at_mm)) / 1000
    np.testing.assert_allclose(geocom.position_mm(hz, v, distance_m), at_mm, atol=1e-6)


def test_the_class_of_accuracy_is_a_length_along_and_an_angle_across() -> None:
    options = Quick.Options(
        channel="socket://127.0.0.1:1",
        reflector="r",
        max_std_mm=1.0,
        find_radius_mm=50.0,
        angle_arcsec=1.0,
        distance_mm=0.5,
        distance_ppm=10.0,
    )
    std_mm = options.std_mm(np.array([10_000.0, 0.0, 0.0]))
    np.testing.assert_allclose(std_mm, [0.6, 0.0485, 0.0485], atol=1e-4)


# -- a telescope that a person turns, and a wider search -----------------------------------------


def test_a_released_telescope_is_measured_wherever_a_person_has_turned_it(tracker: Quick) -> None:
    port: Aims = tracker
    sent = len(tracker.peer.requests)
    tracker.peer.answers[6002] = lambda _: "1798"  # its motors did not run
    port.release_beam()
    tracker.peer.pointing = f"{3.0:.15f},{2.0:.15f}"  # turned by hand
    reading = port.measure_aimed(SMR, 2)
    at_mm = geocom.position_mm(3.0, 2.0, 5.0)
    np.testing.assert_allclose(reading.xyz_mm, at_mm, atol=1e-6)
    assert (reading.samples, reading.reflector) == (2, SMR)
    assert tracker.peer.asked(6002) == ["0"]
    assert len(tracker.peer.asked(9037)) == 2
    assert not any(",9027," in line for line in tracker.peer.requests[sent:])


def test_motors_that_do_not_stop_are_named(tracker: Quick) -> None:
    tracker.peer.answers[6002] = lambda _: "1793"
    assert refusal(tracker.release_beam).fields["status"] == 1793


@pytest.mark.parametrize(("off_mm", "found"), [(299.0, True), (301.0, False)])
def test_a_wider_search_has_a_wider_window(tracker: Quick, off_mm: float, found: bool) -> None:
    at_mm = POINT * (5000.0 + off_mm) / 5000.0
    tracker.peer.distance_m = 5.0 + off_mm / 1000.0
    if found:
        reading = tracker.search(POINT, SMR, 1, 300.0)
        np.testing.assert_allclose(reading.xyz_mm, at_mm, atol=1e-6)
    else:
        error = refusal(lambda: tracker.search(POINT, SMR, 1, 300.0))
        assert kind(error) == (NoReading, "HC-T16")
    assert tracker.peer.asked(9037) == ["0.12,0.12,0"]


@pytest.mark.parametrize(
    ("answer", "beam"),
    [
        (f"0,{math.pi / 2},{math.pi / 2},0.0", [0, -1, 0]),  # Hz is clockwise
        (f"1284,0.0,{math.pi},0.0", [0, 0, -1]),
        ("5", None),  # an instrument that does not tell
    ],
)
def test_a_failed_search_states_where_the_telescope_looked(
    tracker: Quick, answer: str, beam: list[float] | None
) -> None:
    tracker.peer.answers |= {9037: lambda _: "8710", 2003: lambda _: answer}
    for searched_mm, search in (
        (5.0, lambda: tracker.measure(POINT, SMR, 1)),
        (300.0, lambda: tracker.search(POINT, SMR, 1, 300.0)),
    ):
        error = refusal(search)
        assert (error.code, error.fields["searched_mm"]) == ("HC-T11", searched_mm)
        assert error.fields.get("beam") == (beam and pytest.approx(beam, abs=1e-12))


# -- what it reports before anything is written --------------------------------------------------

READING = {0, 2007, 2014, 2021, 2023, 2029, 5003, 5004, 5034, 5035, 18006}


@pytest.mark.parametrize(
    ("lie", "feature", "state", "needed"),
    [
        ({}, "motors", "has", "mandatory"),
        ({5035: "0,300,8"}, "motors", "has not", "mandatory"),
        ({5035: "0,300,4"}, "automatic target recognition", "has not", "mandatory"),
        ({5035: "5"}, "automatic target recognition", "has not", "optional"),
        ({2014: "5"}, "angle corrections", "has not", "optional"),
        ({2007: "5"}, "compensator", "has not", "mandatory"),
        ({}, "prism constant", "has", "mandatory"),
        ({}, "serial number", "has", "mandatory"),
        ({5003: "0,1"}, "serial number", "has not", "mandatory"),
    ],
)
def test_it_lists_its_abilities_and_changes_nothing(
    bed: GeocomBed, lie: dict[int, str], feature: str, state: str, needed: str
) -> None:
    before = dict(bed.peer.settings)
    for rpc, answer in ({5035: "0,300,28"} | lie).items():
        bed.peer.answers[rpc] = always(answer)
    inspects: Inspects = bed.make(serial="884321")
    found = {each.feature: each for each in inspects.inspect()}
    assert (found[feature].state, found[feature].needed) == (state, needed)
    assert {int(line.split(",")[1]) for line in bed.peer.requests} <= READING
    assert bed.peer.settings == before


def test_an_instrument_is_discovered_at_a_channel_that_a_person_gave(bed: GeocomBed) -> None:
    discovers: type[Discovers] = LeicaGeocomTracker
    (found,) = discovers.discover({"channel": bed.peer.channel})
    assert found.options == {"channel": bed.peer.channel, "serial": "884321"}
    assert found.identities[0].model == "Leica TS60, R1000"
    bed.peer.reply = lambda number, answer: b"%R1P,no reply\r\n"
    assert discovers.discover({"channel": bed.peer.channel}) == []
    assert discovers.discover({"channel": "socket://nowhere"}) == []


def test_serial_lines_are_listed_by_the_names_that_they_keep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LeicaGeocomTracker, "SERIAL_LINES", tmp_path)
    (tmp_path / "usb-Leica_TS60-if00").touch()
    (found,) = LeicaGeocomTracker.discover({})
    assert found.options == {"channel": str(tmp_path / "usb-Leica_TS60-if00")}
    assert not found.identities
