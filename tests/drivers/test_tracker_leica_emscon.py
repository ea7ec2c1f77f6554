from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from drivers.leica import tracker_emscon as tracker_leica_emscon
from drivers.leica.tracker_emscon import LeicaEmsconTracker
from hilcell.clock import WallClock
from hilcell.ports import Air, DeviceError, DeviceRefused, NoReading, Stopped, Tracker
from tests.drivers.cesapi_server import CesapiServer
from tests.drivers.emscon_peer import (
    CLOSING,
    NOT_READY,
    READY,
    EmsconPeer,
    failure,
    reflector,
    reply,
    result,
)
from tests.drivers.peers import Server, wall_clock

POINT = np.array([4321.5, -250.25, 300.0])
SMR = "SMR 1.5in"


class Quick(LeicaEmsconTracker):
    REPLY_S = 0.3
    MOVE_S = 0.3
    RESULT_S = 0.2
    INITIALIZE_S = 0.5


@pytest.fixture(autouse=True)
def short_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker_leica_emscon, "BUSY_PAUSE_S", 0.01)


def tracker_at(port: int, clock: WallClock | None = None, **options: Any) -> Quick:
    values: dict[str, Any] = {
        "host": "127.0.0.1",
        "port": port,
        "reflector": SMR,
        "max_std_mm": 0.05,
        "find_radius_mm": 5.0,
        "reading_s": 0.1,
    }
    return Quick(Quick.Options(**(values | options)), clock or wall_clock())


@pytest.fixture
def peer() -> Iterator[EmsconPeer]:
    with EmsconPeer() as peer:
        yield peer


@pytest.fixture
def tracker(peer: EmsconPeer) -> Iterator[Quick]:
    tracker = tracker_at(peer.server.port)
    tracker.connect()
    yield tracker
    tracker.close()


def test_it_is_a_tracker(tracker: Quick) -> None:
    port: Tracker = tracker
    assert port.measure(POINT, SMR, 1).samples == 1


def test_connecting_sets_everything_and_tells_who_answered(peer: EmsconPeer) -> None:
    peer.initialized = 3
    tracker = tracker_at(peer.server.port, serial="390793")
    (identity,) = tracker.connect()
    tracker.close()
    assert (identity.serial, identity.model) == ("390793", "Leica, emScon 3.8.900")
    assert (identity.kind, identity.maker) == ("tracker", "Leica")
    assert identity.firmware == "emScon 3.8.900"
    assert 7 in peer.commands
    assert peer.settings[6] == struct.pack("<5I", 1, 0, 0, 0, 0)
    assert peer.settings[27] == peer.settings[25] == struct.pack("<i", 0)
    assert peer.settings[29] == struct.pack("<ii", 100, 1)
    assert peer.settings[41] == struct.pack("<i", 9)


def test_the_cells_search_radius_is_set(peer: EmsconPeer) -> None:
    tracker = tracker_at(peer.server.port, find_radius_mm=50.0)
    tracker.connect()
    tracker.close()
    assert peer.settings[44].hex() == "000000000000494010270000"  # 50 mm, 10 s


@pytest.mark.parametrize("found", [5.001, np.nan, np.inf])
def test_a_search_radius_that_reads_back_differently_is_refused(
    peer: EmsconPeer, found: float
) -> None:
    peer.answers[44] = lambda _: [reply(44, struct.pack("<di", found, 10_000))]
    with pytest.raises(DeviceRefused, match=r"set search: reads back as .* wanted \(5\.0, 10000\)"):
        tracker_at(peer.server.port).connect()


def test_a_search_radius_that_the_tracker_keeps_in_metres_is_the_same(peer: EmsconPeer) -> None:
    peer.answers[44] = lambda _: [reply(44, struct.pack("<di", 0.0499 / 3 * 3 * 1000, 10_000))]
    tracker = tracker_at(peer.server.port, find_radius_mm=49.9)
    tracker.connect()
    tracker.close()


def test_one_measurement(tracker: Quick, peer: EmsconPeer) -> None:
    before = len(peer.commands)
    reading = tracker.measure(POINT, SMR, 1)
    np.testing.assert_array_equal(reading.xyz_mm, POINT)
    np.testing.assert_array_equal(reading.std_mm, [0.0025] * 3)
    assert reading.air == Air(22.5, 1013.25, 45.0)
    assert peer.commands[before:] == [55, 49]


def test_several_samples_give_mean_and_spread(tracker: Quick, peer: EmsconPeer) -> None:
    offsets = iter([-0.01, 0.0, 0.01])
    peer.answers[49] = lambda _: [reply(49), result(POINT + [next(offsets), 0, 0])]
    reading = tracker.measure(POINT, SMR, 3)
    np.testing.assert_allclose(reading.xyz_mm, POINT, atol=1e-12)
    np.testing.assert_allclose(reading.std_mm, [0.01, 0, 0], atol=1e-9)
    assert reading.samples == 3


def test_another_reflector_is_chosen_by_name(tracker: Quick, peer: EmsconPeer) -> None:
    tracker.measure(POINT, "SMR 0.5in", 1)
    assert peer.settings[41] == struct.pack("<i", 4)
    with pytest.raises(DeviceRefused, match=r"knows 'SMR 0\.5in', 'SMR 1\.5in', wanted 'Prism'"):
        tracker.measure(POINT, "Prism", 1)


@pytest.mark.parametrize("size", [1, 5])
def test_packets_may_come_in_slices(peer: EmsconPeer, size: int) -> None:
    peer.slice = size
    tracker = tracker_at(peer.server.port)
    tracker.connect()
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 2).xyz_mm, POINT)
    tracker.close()


def test_results_of_an_earlier_measurement_are_dropped(tracker: Quick, peer: EmsconPeer) -> None:
    late = result(POINT + [1.0, 0, 0])
    peer.send(late)
    peer.answers[49] = lambda _: [late, reply(49), result(POINT)]
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)


def test_a_late_result_of_another_point_is_refused(tracker: Quick, peer: EmsconPeer) -> None:
    peer.answers[49] = lambda _: [reply(49), result(POINT + [0, 5.1, 0]), result(POINT)]
    with pytest.raises(NoReading, match=r"5\.10 mm from its expected place"):
        tracker.measure(POINT, SMR, 1)


def test_no_result_is_no_reading_and_the_next_one_is_good(tracker: Quick, peer: EmsconPeer) -> None:
    good = peer.answers[49]
    peer.answers[49] = lambda _: [reply(49)]
    peer.answers[52] = lambda _: [result(POINT + [2, 0, 0]), reply(52)]
    with pytest.raises(NoReading, match=r"acknowledged, but no result came within 0\.3 s"):
        tracker.measure(POINT, SMR, 1)
    peer.answers[49] = good
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)


@pytest.mark.parametrize(
    "answer",
    [
        [failure(49, 10004)],
        [reply(49), NOT_READY],
        [reply(49), failure(49, 10009)],
        [reply(49), failure(64, 37)],
        [reply(49), result(POINT, status=10009)],
        [reply(49, status=10013)],
        [reply(49, status=94)],
    ],
)
def test_a_broken_beam_is_no_reading(tracker: Quick, peer: EmsconPeer, answer: list[bytes]) -> None:
    peer.answers[49] = lambda _: answer
    with pytest.raises(NoReading):
        tracker.measure(POINT, SMR, 1)
    assert peer.commands[-1] == 52


@pytest.mark.parametrize(
    ("answer", "code", "message"),
    [
        (
            [reply(49), result(POINT, std=0.051)],
            "HC-T15",
            r"standard deviation 0\.0510 mm, wanted <= 0\.0500",
        ),
        ([reply(49), result(POINT, std=float("nan"))], "HC-T14", "not finite"),
        ([reply(49), result((float("inf"), 0, 0))], "HC-T14", "not finite"),
        ([reply(49), result(POINT, air=(22.5, 0.0, 45.0))], "HC-T05", "pressure 0.0 mbar"),
        ([reply(49), result(POINT, air=(float("nan"), 1000.0, 45.0))], "HC-T05", "temperature nan"),
    ],
)
def test_bad_results_are_no_readings(
    tracker: Quick, peer: EmsconPeer, answer: list[bytes], code: str, message: str
) -> None:
    peer.answers[49] = lambda _: answer
    with pytest.raises(NoReading, match=message) as caught:
        tracker.measure(POINT, SMR, 1)
    assert caught.value.code == code


def test_repeats_that_spread_are_no_reading(tracker: Quick, peer: EmsconPeer) -> None:
    offsets = iter([-0.06, 0.06])
    peer.answers[49] = lambda _: [reply(49), result(POINT + [0, 0, next(offsets)])]
    with pytest.raises(NoReading, match=r"2 repeats spread by 0\.0849 mm"):
        tracker.measure(POINT, SMR, 2)


def test_metres_are_the_devices_failure(tracker: Quick, peer: EmsconPeer) -> None:
    peer.answers[49] = lambda _: [reply(49), result(POINT / 1000)]
    with pytest.raises(DeviceError, match="in metres, wanted mm") as caught:
        tracker.measure(POINT, SMR, 1)
    assert not isinstance(caught.value, NoReading)


def test_a_reflector_out_of_the_beam_is_searched(tracker: Quick, peer: EmsconPeer) -> None:
    peer.xyz = tuple(POINT)
    peer.answers[55] = lambda _: [failure(55, 37)]
    tracker.measure(POINT, SMR, 1)
    assert peer.commands[-3:] == [55, 63, 49]
    peer.answers[63] = lambda _: [failure(63, 37)]
    with pytest.raises(NoReading, match="find reflector: status 37"):
        tracker.measure(POINT, SMR, 1)


def test_not_ready_is_searched_once(tracker: Quick, peer: EmsconPeer) -> None:
    answers = iter([[failure(49, 10004)], [reply(49), result(POINT)]])
    peer.answers[49] = lambda _: next(answers)
    tracker.measure(POINT, SMR, 1)
    assert peer.commands[-4:] == [55, 49, 63, 49]


def test_a_busy_server_is_asked_again(tracker: Quick, peer: EmsconPeer) -> None:
    answers = iter([[failure(49, 1)], [failure(49, 1)], [reply(49), result(POINT)]])
    peer.answers[49] = lambda _: next(answers)
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)
    peer.answers[49] = lambda _: [failure(49, 1)]
    with pytest.raises(NoReading, match="server busy"):
        tracker.measure(POINT, SMR, 1)


def test_a_storm_of_status_changes_does_no_harm(tracker: Quick, peer: EmsconPeer) -> None:
    storm = READY * 2000
    peer.answers[49] = lambda _: [storm, reply(49), storm, result(POINT), storm]
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 3).xyz_mm, POINT)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (CLOSING, "server is closing"),
        (struct.pack("<II", 0, 8), "a packet of 0 bytes"),
        (struct.pack("<II", 2**31, 2), "a packet of 2147483648 bytes"),
        (reply(40), "a reply to command 40 came"),
    ],
)
def test_a_lost_stream_is_the_devices_failure(
    tracker: Quick, peer: EmsconPeer, data: bytes, message: str
) -> None:
    peer.answers[49] = lambda _: [data]
    with pytest.raises(DeviceError, match=message) as caught:
        tracker.measure(POINT, SMR, 1)
    assert not isinstance(caught.value, NoReading)
    with pytest.raises(DeviceError, match="not connected"):
        tracker.measure(POINT, SMR, 1)


def test_the_end_of_the_stream_is_the_devices_failure(tracker: Quick, peer: EmsconPeer) -> None:
    peer.server.drop()
    with pytest.raises(DeviceError, match=r"closed the connection|reset|Broken pipe"):
        tracker.measure(POINT, SMR, 1)


@pytest.mark.parametrize("status", [39, 26, 2])
def test_a_lost_initialisation_is_the_devices_failure(
    tracker: Quick, peer: EmsconPeer, status: int
) -> None:
    peer.answers[49] = lambda _: [failure(49, status)]
    with pytest.raises(DeviceError, match=f"status {status}") as caught:
        tracker.measure(POINT, SMR, 1)
    assert not isinstance(caught.value, NoReading)


@pytest.mark.parametrize(
    ("command", "answer", "message"),
    [
        (6, [reply(6, struct.pack("<5I", 0, 1, 0, 0, 0))], "set units: reads back"),
        (27, [reply(27, struct.pack("<i", 1))], "set coordinate system: reads back"),
        (42, [reflector(1, 3, "Prism")], "knows 'Prism', wanted 'SMR 1.5in'"),
        (21, [reply(21, struct.pack("<3d", 21.0, 0.0, 40.0))], "pressure 0.0 mbar"),
        (1, [reply(1, bytes(12))], "a reply of 12 bytes, 40 expected"),
        (1, [failure(1, 38)], "no tracker connected"),
        (5, [], "set units: .*no answer in time"),
    ],
)
def test_a_wrong_tracker_is_refused(
    peer: EmsconPeer, command: int, answer: list[bytes], message: str
) -> None:
    peer.answers[command] = lambda _: answer
    with pytest.raises(DeviceError, match=message):
        tracker_at(peer.server.port).connect()


def test_a_wrong_serial_is_refused(peer: EmsconPeer) -> None:
    with pytest.raises(DeviceRefused, match="serial 390793, wanted 12"):
        tracker_at(peer.server.port, serial="12").connect()


def test_a_tracker_that_does_not_initialise_is_refused(peer: EmsconPeer) -> None:
    peer.initialized = 3
    peer.answers[7] = lambda _: [reply(7)]
    with pytest.raises(DeviceRefused, match="processor status 3, wanted 5"):
        tracker_at(peer.server.port).connect()


def test_a_stop_gets_through_while_a_call_hangs(tracker: Quick, peer: EmsconPeer) -> None:
    started = threading.Event()
    failures: list[DeviceError] = []

    def hang(_body: bytes) -> list[bytes]:
        started.set()
        return [reply(49)]

    def measure() -> None:
        try:
            tracker.measure(POINT, SMR, 1)
        except DeviceError as error:
            failures.append(error)

    peer.answers[49] = hang
    worker = threading.Thread(target=measure)
    worker.start()
    assert started.wait(5)
    tracker.stop()
    assert peer.stopped.wait(5)
    worker.join(5)
    assert len(failures) == 1


def test_the_runs_stop_ends_a_measurement(peer: EmsconPeer) -> None:
    stop = threading.Event()
    tracker = tracker_at(peer.server.port, WallClock(stop))
    tracker.connect()
    peer.answers[49] = lambda _: [reply(49)]
    threading.Timer(0.05, stop.set).start()
    with pytest.raises(Stopped):
        tracker.measure(POINT, SMR, 1)
    tracker.close()


@pytest.mark.parametrize(("near", "samples"), [(POINT[:2], 1), (POINT * np.nan, 1), (POINT, 0)])
def test_nonsense_is_never_sent(tracker: Quick, peer: EmsconPeer, near: Any, samples: int) -> None:
    before = len(peer.commands)
    with pytest.raises(DeviceError):
        tracker.measure(near, SMR, samples)
    assert len(peer.commands) == before


def test_stop_and_close_before_connect_do_nothing() -> None:
    tracker = tracker_at(1)
    tracker.stop()
    tracker.close()


def test_a_dead_server_is_noticed_at_connect() -> None:
    silent = threading.Event()

    def serve(connection: socket.socket) -> None:
        silent.wait(5)

    with Server(serve) as server:
        with pytest.raises(DeviceError, match=r"get system status: .*no answer in time"):
            tracker_at(server.port).connect()
        silent.set()


def test_cesapis_simulator_acknowledges_and_never_sends_a_result() -> None:
    with CesapiServer() as server:
        tracker = tracker_at(server.port)
        (identity,) = tracker.connect()
        assert identity.serial == "390793"
        with pytest.raises(NoReading, match="acknowledged, but no result came"):
            tracker.measure(POINT, SMR, 1)
        tracker.close()


def test_a_search_that_fails_tells_what_was_tried_before(tracker: Quick, peer: EmsconPeer) -> None:
    peer.answers[55] = lambda _: [failure(55, 37)]
    peer.answers[63] = lambda _: [failure(63, 10004)]
    with pytest.raises(NoReading, match=r"status 10004 .*, after go position: status 37 "):
        tracker.measure(POINT, SMR, 1)


def test_a_stop_that_is_refused_is_reported_beside_the_cause(
    tracker: Quick, peer: EmsconPeer
) -> None:
    peer.answers[49] = lambda _: [reply(49), NOT_READY]
    peer.answers[52] = lambda _: [failure(52, 10014)]
    with pytest.raises(NoReading, match=r"beam broke, and it was not stopped: status 10014 "):
        tracker.measure(POINT, SMR, 1)


def test_a_negative_deviation_is_no_deviation(tracker: Quick, peer: EmsconPeer) -> None:
    peer.answers[49] = lambda _: [reply(49), result(POINT, std=-0.001)]
    with pytest.raises(NoReading, match="standard deviation"):
        tracker.measure(POINT, SMR, 1)
