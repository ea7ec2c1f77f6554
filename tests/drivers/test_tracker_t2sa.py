from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.spatialanalyzer import t2sa_bridge, tracker_t2sa
from drivers.spatialanalyzer.tracker_t2sa import T2saTracker
from hilcell.clock import WallClock
from hilcell.ports import DeviceError, DeviceRefused, NoReading, Stopped, Streams, Tracker
from tests.drivers.peers import wall_clock
from tests.drivers.t2sa_peer import POINTS, T2saPeer

PLACE = np.array([4010.0, -2990.0, 5.0])
SMR = "SMR 1.5in"
Make = Callable[..., T2saTracker]


@pytest.fixture(autouse=True)
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(t2sa_bridge, "BUSY_PAUSE_S", 0.01)
    monkeypatch.setattr(tracker_t2sa, "BUSY_PAUSE_S", 0.01)
    monkeypatch.setattr(tracker_t2sa, "WARM_LOOK_S", 0.01)
    monkeypatch.setattr(t2sa_bridge, "REPLY_S", 0.3)
    monkeypatch.setattr(t2sa_bridge, "MEASURE_S", 0.3)


@pytest.fixture
def points(tmp_path: Path) -> Path:
    path = tmp_path / "points.csv"
    rows = (",".join([name, *map(str, at_mm)]) for name, at_mm in POINTS.items())
    path.write_text("\n".join(rows), "ascii")
    return path


@pytest.fixture
def peer() -> Iterator[T2saPeer]:
    with T2saPeer() as peer:
        yield peer


@pytest.fixture
def make(peer: T2saPeer, points: Path) -> Iterator[Make]:
    made: list[T2saTracker] = []

    def build(clock: WallClock | None = None, **options: Any) -> T2saTracker:
        values = {
            "host": "127.0.0.1",
            "port": peer.port,
            "reflector": SMR,
            "max_std_mm": 0.05,
            "find_radius_mm": 5.0,
            "points": str(points),
        }
        kept = msgspec.convert(values | options, T2saTracker.Options)
        made.append(T2saTracker(kept, clock or wall_clock()))
        return made[-1]

    yield build
    for tracker in made:
        tracker.close()


@pytest.fixture
def tracker(make: Make) -> T2saTracker:
    tracker = make()
    tracker.connect()
    return tracker


def test_it_is_a_tracker_that_does_not_stream(tracker: T2saTracker) -> None:
    port: Tracker = tracker
    assert not isinstance(port, Streams)
    reading = port.measure(PLACE, SMR, 3)
    np.testing.assert_allclose(reading.xyz_mm, PLACE, atol=1e-3)
    assert (reading.samples, reading.reflector, reading.air) == (3, SMR, None)
    assert 0 <= time.monotonic() - reading.taken_s < 5


def test_connecting_sets_the_bridge_and_compares_points(peer: T2saPeer, make: Make) -> None:
    stated = {"instrument": "API T3", "plate": "T3-1234", "working_frame": "TRACKER"}
    stated |= {"profile": "Single Pt. To SA"}
    (identity,) = make(power_lock=False, **stated).connect()
    assert peer.requests == [
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


def test_a_bridge_that_says_so_is_simulated(peer: T2saPeer, make: Make) -> None:
    peer.answers["?STAT"] = lambda _: "ACK-300 READY (simulated);01/05/2026 8:00:00"
    assert make().connect()[0].simulated


def test_an_instrument_that_stays_simulated_is_refused(peer: T2saPeer, make: Make) -> None:
    peer.answers["!SET_SIM"] = lambda _: "ERR-337 Failed to set simulation"
    with pytest.raises(DeviceRefused, match="switch simulation off: ERR-337") as error:
        make().connect()
    assert error.value.code == "HC-T71"


def test_a_result_that_is_the_nominal_point_was_not_measured(
    tracker: T2saTracker, peer: T2saPeer
) -> None:
    peer.at_mm = np.array(POINTS["P1"]) + 0.3
    with pytest.raises(DeviceRefused, match="is the named point P1 itself") as error:
        tracker.measure(peer.at_mm, SMR, 1)  # it is where the reflector is expected
    assert error.value.code == "HC-T71"


def test_a_cold_laser_is_switched_on_and_awaited(peer: T2saPeer, make: Make) -> None:
    states = iter(["LOFF", "WARM, 2.00 seconds", "WARM, 1.00 seconds", "LON"])
    peer.answers["?LSTA"] = lambda _: f"ACK-300 {next(states)}"
    make().connect()
    assert peer.asked("!LST") == ["1"]
    assert len(peer.asked("?LSTA")) == 4


@pytest.mark.parametrize(("state", "code"), [("LNC", "HC-T70"), ("WARM, 9.00 seconds", "HC-T19")])
def test_a_laser_that_does_not_come_is_named(
    peer: T2saPeer, make: Make, monkeypatch: pytest.MonkeyPatch, state: str, code: str
) -> None:
    monkeypatch.setattr(tracker_t2sa, "WARM_S", 0.05)
    peer.laser = state
    with pytest.raises(DeviceError, match=f"state '{state}', wanted LON") as error:
        make().connect()
    assert error.value.code == code


@pytest.mark.parametrize(
    ("command", "code", "what"),
    [
        ("!SET_STATION_LOCK", 331, "station lock"),
        ("SET_POWER_LOCK", 317, "power lock"),
        ("!SINGLE_POINT_MEAS_PROFILE", 307, "measurement profile"),
        ("!SET_WORKING_FRAME", 314, "working frame"),
    ],
)
def test_a_setting_that_is_refused_is_named(
    peer: T2saPeer, make: Make, command: str, code: int, what: str
) -> None:
    peer.answers[command] = lambda _: f"ERR-{code} Failed."
    with pytest.raises(DeviceRefused, match=f"set {what}: ERR-{code}") as error:
        make(profile="x", working_frame="y").connect()
    assert error.value.code == "HC-T06"


@pytest.mark.parametrize(
    ("scale", "shift", "words"),
    [
        (1 / 25.4, 0.0, r"\(157.480, -118.110, 0.000\) in SpatialAnalyzer in inches"),
        (1.0, 0.02, r"\(4000.020, -3000.000, 0.000\) in SpatialAnalyzer, wanted \(4000.000,"),
        (np.nan, 0.0, "in SpatialAnalyzer"),
    ],
)
def test_a_job_with_other_points_is_refused(
    peer: T2saPeer, make: Make, scale: float, shift: float, words: str
) -> None:
    def position(path: str) -> str:
        x, y, z = scale * np.array(POINTS[path[-2:]])
        return f"ACK-300 Measured single pt {path} result: X:{x + shift};Y:{y};Z:{z};today"

    peer.answers["?POINT_POS"] = position
    with pytest.raises(DeviceRefused, match=words) as error:
        make().connect()
    assert error.value.code == "HC-T73"


def test_a_point_that_the_job_lacks_is_named(peer: T2saPeer, make: Make) -> None:
    peer.answers["?POINT_POS"] = lambda _: "ERR-306 Did not find or set point group."
    with pytest.raises(
        DeviceError, match=r"point pos: ERR-306 \(no such group or point\)"
    ) as error:
        make().connect()
    assert error.value.code == "HC-T72"


@pytest.mark.parametrize("name", ["", "/nowhere/points.csv"])
def test_a_list_that_is_missing_is_named_before_anything_is_sent(
    peer: T2saPeer, make: Make, name: str
) -> None:
    with pytest.raises(DeviceRefused) as error:
        make(points=name).connect()
    assert error.value.code == "HC-T75"
    assert not peer.requests


def test_a_busy_bridge_is_awaited_and_not_for_ever(peer: T2saPeer, make: Make) -> None:
    states = iter(["ERR-201 busy", "ACK-300 EMP", "ACK-300 Instrument is connected"])
    peer.answers["?STAT"] = lambda _: next(states)
    make().connect()
    for line, alarm in (("ACK-300 2FACE", "T21"), ("ERR-201 busy", "T21"), ("ERR-341 -", "T70")):
        peer.answers["?STAT"] = partial(str.format, line)
        with pytest.raises(DeviceError, match="wanted 'Instrument is connected'") as error:
            make().connect()
        assert error.value.code == f"HC-{alarm}"
    assert not peer.halted.is_set()  # another program's measurement is not ended


# -- measuring ----------------------------------------------------------------------------------


def test_one_reading_is_of_two_measurements_with_their_spread(
    tracker: T2saTracker, peer: T2saPeer
) -> None:
    places = iter([PLACE, PLACE + [0.02, 0.0, 0.0]])

    def measure(path: str) -> str:
        x, y, z = next(places)
        return f"ACK-300 Single Point Measurement {path} result {x},{y},{z} today"

    peer.answers["!MEAS_SINGLE_POINT"] = measure
    reading = tracker.measure(PLACE, SMR, 1)
    assert reading.samples == 2
    np.testing.assert_allclose(reading.xyz_mm, PLACE + [0.01, 0, 0], atol=1e-9)
    np.testing.assert_allclose(reading.std_mm, [0.02 / np.sqrt(2), 0, 0], atol=1e-9)
    assert peer.asked("!MEAS_SINGLE_POINT") == ["A;HILCELL;P1"] * 2


def test_repeats_that_spread_are_no_reading(tracker: T2saTracker, peer: T2saPeer) -> None:
    offs = iter([0.0, 0.2])

    peer.answers["!MEAS_SINGLE_POINT"] = lambda path: (
        f"ACK-300 Single Point Measurement {path} result {4010 + next(offs)},-2990,5 today"
    )
    with pytest.raises(NoReading, match="2 repeats spread by") as error:
        tracker.measure(PLACE, SMR, 1)
    assert error.value.code == "HC-T15"


def test_a_place_beside_every_point_is_refused_before_anything_is_sent(
    tracker: T2saTracker, peer: T2saPeer
) -> None:
    peer.requests.clear()
    words = r"aim at named point P4 is 4\d\d\.\d mm beside .*wanted <= 60.0 mm"
    with pytest.raises(DeviceError, match=words) as error:
        tracker.measure(np.array([1000.0, 2000.0, 0.0]), SMR, 1)
    assert error.value.code == "HC-T74"
    assert not isinstance(error.value, NoReading)
    assert not peer.requests


def test_another_reflector_is_looked_past_from_other_points(
    tracker: T2saTracker, peer: T2saPeer
) -> None:
    honest = peer.answers["!MEAS_SINGLE_POINT"]

    def measure(path: str) -> str | None:
        if path.endswith("P3"):
            return honest(path)
        return f"ACK-300 Single Point Measurement {path} result 4100,-2990,5 today"

    peer.answers["!MEAS_SINGLE_POINT"] = measure
    assert tracker.measure(PLACE, SMR, 1).samples == 2
    assert peer.asked("!MEAS_SINGLE_POINT") == [f"A;HILCELL;P{n}" for n in (1, 3, 3)]


def test_another_reflector_from_everywhere_is_no_reading(
    tracker: T2saTracker, peer: T2saPeer
) -> None:
    peer.at_mm = PLACE + [0.0, 5.1, 0.0]
    with pytest.raises(NoReading, match=r"5\.10 mm from its expected place") as error:
        tracker.measure(PLACE, SMR, 1)
    assert error.value.code == "HC-T16"
    assert peer.asked("!MEAS_SINGLE_POINT") == [f"A;HILCELL;P{n}" for n in (1, 3)]


def test_the_former_result_again_is_no_measurement(tracker: T2saTracker, peer: T2saPeer) -> None:
    peer.answers["!MEAS_SINGLE_POINT"] = lambda path: (
        f"ACK-300 Single Point Measurement {path} result 4010.1,-2990.1,5.1 today"
    )
    with pytest.raises(NoReading, match="is the former one to its last digit") as error:
        tracker.measure(PLACE, SMR, 1)
    assert error.value.code == "HC-T76"


@pytest.mark.parametrize(
    ("values", "form"),
    [
        (PLACE / 25.4, "in inches"),
        (PLACE / 1000, "in metres"),
        (PLACE - POINTS["P1"], "as a deviation from the named point"),
    ],
)
def test_results_in_another_form_are_named(
    tracker: T2saTracker, peer: T2saPeer, values: Any, form: str
) -> None:
    x, y, z = values
    peer.answers["!MEAS_SINGLE_POINT"] = lambda path: (
        f"ACK-300 Single Point Measurement {path} result {x},{y},{z} today"
    )
    with pytest.raises(DeviceError, match=form) as error:
        tracker.measure(PLACE, SMR, 1)
    assert error.value.code == "HC-T77"


@pytest.mark.parametrize("value", ["NaN", "inf", "-inf", "1,5"])
def test_a_result_that_is_no_number_is_no_reading(
    tracker: T2saTracker, peer: T2saPeer, value: str
) -> None:
    peer.answers["!MEAS_SINGLE_POINT"] = lambda path: (
        f"ACK-300 Measured single pt {path} result: X:4010.0;Y:{value};Z:5.0;today"
    )
    with pytest.raises(NoReading, match="is no position") as error:
        tracker.measure(PLACE, SMR, 1)
    assert error.value.code == "HC-T14"


@pytest.mark.parametrize(
    ("code", "alarm", "kind"),
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
    tracker: T2saTracker, peer: T2saPeer, code: int, alarm: str, kind: type
) -> None:
    peer.answers["!MEAS_SINGLE_POINT"] = lambda _: f"ERR-{code} Failed."
    with pytest.raises(DeviceError, match=rf"ERR-{code} \(.*\): Failed") as error:
        tracker.measure(PLACE, SMR, 1)
    assert type(error.value) is kind
    assert error.value.code == alarm
    assert error.value.act
    assert error.value.fields == {"status": code}


def test_a_busy_bridge_is_asked_again(tracker: T2saTracker, peer: T2saPeer) -> None:
    honest, busy = peer.answers["!MEAS_SINGLE_POINT"], iter([True, True, False, False])
    peer.answers["!MEAS_SINGLE_POINT"] = lambda path: "ERR-201 busy" if next(busy) else honest(path)
    tracker.measure(PLACE, SMR, 1)
    peer.answers["!MEAS_SINGLE_POINT"] = lambda _: "ERR-201 busy"
    with pytest.raises(NoReading, match="ERR-201"):
        tracker.measure(PLACE, SMR, 1)


@pytest.mark.parametrize(("near", "samples"), [(PLACE, 0), (PLACE[:2], 1), (PLACE * np.nan, 1)])
def test_impossible_orders(tracker: T2saTracker, near: Any, samples: int) -> None:
    with pytest.raises(DeviceError) as error:
        tracker.measure(near, SMR, samples)
    assert error.value.code == "HC-T35"


def test_another_reflector_than_the_cells_is_refused(tracker: T2saTracker) -> None:
    with pytest.raises(DeviceRefused, match=r"wanted 'SMR 0\.5in'") as error:
        tracker.measure(PLACE, "SMR 0.5in", 1)
    assert error.value.code == "HC-T07"


@pytest.mark.parametrize("group", ["", "A;B", "A\r\n!LST:2", "A:B"])
def test_a_group_that_is_no_name_is_refused_with_the_options(make: Make, group: str) -> None:
    with pytest.raises(msgspec.ValidationError, match="group"):
        make(group=group)


# -- the wire -----------------------------------------------------------------------------------


def test_letters_of_any_alphabet_in_a_date_are_read_over(
    tracker: T2saTracker, peer: T2saPeer
) -> None:
    honest = peer.answers["!MEAS_SINGLE_POINT"]
    peer.answers["!MEAS_SINGLE_POINT"] = lambda path: f"{honest(path)} 2026/1/5 \xcf\xc2\xce\xe7"
    assert tracker.measure(PLACE, SMR, 1).samples == 2


def lost(tracker: T2saTracker, words: str) -> None:
    with pytest.raises(DeviceError, match=words) as error:
        tracker.measure(PLACE, SMR, 1)
    assert error.value.code == "HC-T02"
    with pytest.raises(DeviceError, match="not connected"):
        tracker.measure(PLACE, SMR, 1)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("hello", "no reply of T2SA: 'hello'"),
        ("ACK-300 READY", "no position"),
        ("ACK-300 Single Point Measurement A;HILCELL;P4 result 1,2,3 today", "not of point P1"),
        ("x" * 5000, "a line without an end|no reply"),
    ],
)
def test_a_line_that_is_no_answer_ends_the_connection(
    tracker: T2saTracker, peer: T2saPeer, line: str, words: str
) -> None:
    peer.answers["!MEAS_SINGLE_POINT"] = lambda _: line
    lost(tracker, words)


def test_a_measurement_without_a_reply_is_halted(tracker: T2saTracker, peer: T2saPeer) -> None:
    honest = peer.answers["!MEAS_SINGLE_POINT"]
    peer.answers["!MEAS_SINGLE_POINT"] = lambda _: None
    with pytest.raises(NoReading, match=r"no answer to meas single point in 0\.3 s") as error:
        tracker.measure(PLACE, SMR, 1)
    assert error.value.code == "HC-T13"
    assert peer.requests[-2:] == ["!HALT", "?LSTA"]
    peer.answers["!MEAS_SINGLE_POINT"] = honest
    tracker.measure(PLACE, SMR, 1)


@pytest.mark.parametrize("asked", ["!HALT", "?LSTA"])
@pytest.mark.parametrize(
    "late",
    [
        "ERR-330 Error executing measure plan",
        "ACK-300 Single Point Measurement A;HILCELL;P1 result 4011.0,-2990.0,5.0 today",
    ],
)
def test_the_reply_of_a_halted_measurement_is_not_the_next_ones(
    tracker: T2saTracker, peer: T2saPeer, late: str, asked: str
) -> None:
    honest, said = peer.answers["!MEAS_SINGLE_POINT"], peer.answers[asked]("")
    peer.answers |= {"!MEAS_SINGLE_POINT": lambda _: None, asked: lambda _: f"{late}\r\n{said}"}
    with pytest.raises(NoReading):
        tracker.measure(PLACE, SMR, 1)
    peer.answers["!MEAS_SINGLE_POINT"] = honest
    np.testing.assert_allclose(tracker.measure(PLACE, SMR, 1).xyz_mm, PLACE, atol=1e-3)


@pytest.mark.parametrize("silent", ["!HALT", "?LSTA"])
def test_a_halt_that_is_not_confirmed_ends_the_connection(
    tracker: T2saTracker, peer: T2saPeer, silent: str
) -> None:
    peer.answers |= {"!MEAS_SINGLE_POINT": lambda _: None, silent: lambda _: None}
    lost(tracker, "no answer in time")


def test_a_result_of_a_program_that_ran_before_is_passed_over(peer: T2saPeer, make: Make) -> None:
    old = "ACK-300 Single Point Measurement A;HILCELL;P1 result 1.0,2.0,3.0 today"
    peer.answers["?STAT"] = lambda _: f"{old}\r\nACK-300 Instrument is connected"
    tracker = make()
    tracker.connect()
    assert tracker.measure(PLACE, SMR, 1).samples == 2


def test_a_connection_that_breaks_is_lost(tracker: T2saTracker, peer: T2saPeer) -> None:
    peer.drop()
    lost(tracker, "closed the connection|reset|Broken pipe")


def test_a_list_that_vanished_is_kept_and_compared(
    peer: T2saPeer, make: Make, points: Path
) -> None:
    tracker = make()
    tracker.connect()
    points.unlink()
    peer.requests.clear()
    tracker.connect()
    assert len(peer.asked("?POINT_POS")) == len(POINTS)


def test_a_stop_ends_a_wait_and_halts_the_measurement(peer: T2saPeer, make: Make) -> None:
    ended, measuring = threading.Event(), threading.Event()
    tracker = make(WallClock(ended))
    tracker.connect()
    peer.answers["!MEAS_SINGLE_POINT"] = lambda _: measuring.set()
    errors: list[BaseException] = []

    def measure() -> None:
        try:
            tracker.measure(PLACE, SMR, 1)
        except Stopped as stopped:
            errors.append(stopped)

    worker = threading.Thread(target=measure)
    worker.start()
    assert measuring.wait(10)
    ended.set()
    tracker.stop()
    worker.join(0.2)
    assert errors
    assert peer.halted.wait(10)
    ended.clear()
    with pytest.raises(DeviceError, match="use: stopped"):
        tracker.measure(PLACE, SMR, 1)
    tracker.close()
