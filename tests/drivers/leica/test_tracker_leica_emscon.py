from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

from drivers import supervision
from drivers.leica.tracker_emscon import LeicaEmsconTracker
from hilcell.ports import Air, DeviceError, DeviceRefused, NoReading, Stopped, Tracker
from tests.drivers.leica.emscon_peer import (
    CLOSING,
    NOT_READY,
    READY,
    EmsconPeer,
    failure,
    reflector,
    reply,
    result,
)
from tests.drivers.peers import Server, WireTime, in_thread, refusal, wire_time

POINT = np.array([4321.5, -250.25, 300.0])
SMR = "SMR 1.5in"


class Quick(LeicaEmsconTracker):
    REPLY_S = 0.3
    MOVE_S = 0.3
    RESULT_S = 0.2
    INITIALIZE_S = 0.5


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> WireTime:
    return wire_time(monkeypatch, supervision)


def tracker_at(port: int, time: WireTime, **options: Any) -> Quick:
    values: dict[str, Any] = {
        "host": "127.0.0.1",
        "port": port,
        "reflector": SMR,
        "max_std_mm": 0.05,
        "find_radius_mm": 5.0,
        "reading_s": 0.1,
    }
    return Quick(Quick.Options(**(values | options)), time)


@pytest.fixture
def peer() -> Iterator[EmsconPeer]:
    with EmsconPeer() as peer:
        yield peer


def punctual(
    monkeypatch: pytest.MonkeyPatch, tracker: Quick, peer: EmsconPeer, time: WireTime
) -> None:
    """Let no look take time while the peer has not answered yet, on however slow a PC."""
    link, before, asked = tracker._wire(), peer.answered, list[str]()
    send = link.send

    def counted(data: bytes, operation: str) -> None:
        asked.append(operation)
        send(data, operation)

    monkeypatch.setattr(link, "send", counted)
    time.busy = lambda: peer.answered < before + len(asked)


@pytest.fixture
def tracker(peer: EmsconPeer, time: WireTime) -> Iterator[Quick]:
    tracker = tracker_at(peer.server.port, time)
    tracker.connect()
    yield tracker
    tracker.close()


def measuring(tracker: Quick, samples: int = 1) -> DeviceError:
    """Return the error of a measurement."""
    return refusal(lambda: tracker.measure(POINT, SMR, samples))


def test_connecting_sets_everything_and_tells_who_answered(
    peer: EmsconPeer, time: WireTime
) -> None:
    peer.initialized = 3
    tracker = tracker_at(peer.server.port, time, serial="390793", find_radius_mm=50.0)
    (identity,) = tracker.connect()
    tracker.close()
    assert (identity.serial, identity.model) == ("390793", "Leica, emScon 3.8.900")
    assert (identity.kind, identity.maker) == ("tracker", "Leica")
    assert (identity.firmware, identity.simulated) == ("emScon 3.8.900", False)
    assert 7 in peer.commands
    assert peer.settings[6] == struct.pack("<5I", 1, 0, 0, 0, 0)
    assert peer.settings[27] == peer.settings[25] == struct.pack("<i", 0)
    assert peer.settings[29] == struct.pack("<ii", 100, 1)
    assert peer.settings[41] == struct.pack("<i", 9)
    assert peer.settings[44].hex() == "000000000000494010270000"  # 50 mm, 10 s


@pytest.mark.parametrize("name", ["AT401", "AT401 (simulated)"])
def test_a_tracker_tells_its_name(peer: EmsconPeer, time: WireTime, name: str) -> None:
    field = name.encode("utf-16-le").ljust(64, b"\0")
    body = struct.pack("<I64s", 8, field) + bytes(80)
    peer.answers[132] = partial(lambda body, _: [reply(132, body)], body)
    tracker = tracker_at(peer.server.port, time)
    (identity,) = tracker.connect()
    assert identity.model == f"Leica {name}, emScon 3.8.900"
    assert identity.simulated is ("simulated" in name)
    peer.answers[132] = lambda _: [failure(132, 2)]  # it need not have one
    (identity,) = tracker.connect()
    tracker.close()
    assert identity.model == "Leica, emScon 3.8.900"


@pytest.mark.parametrize("found", [5.001, np.nan, np.inf])
def test_a_search_radius_that_reads_back_differently_is_refused(
    peer: EmsconPeer, time: WireTime, found: float
) -> None:
    peer.answers[44] = lambda _: [reply(44, struct.pack("<di", found, 10_000))]
    refused = refusal(tracker_at(peer.server.port, time).connect)
    assert (type(refused), refused.code) == (DeviceRefused, "HC-T06")


def test_a_search_radius_that_the_tracker_keeps_in_metres_is_the_same(
    peer: EmsconPeer, time: WireTime
) -> None:
    peer.answers[44] = lambda _: [reply(44, struct.pack("<di", 0.0499 / 3 * 3 * 1000, 10_000))]
    tracker = tracker_at(peer.server.port, time, find_radius_mm=49.9)
    tracker.connect()
    tracker.close()


def test_one_measurement(tracker: Quick, peer: EmsconPeer, time: WireTime) -> None:
    port: Tracker = tracker
    before = len(peer.commands)
    time.wait(1.0)
    reading = port.measure(POINT, SMR, 1)
    np.testing.assert_array_equal(reading.xyz_mm, POINT)
    np.testing.assert_array_equal(reading.std_mm, [0.0025] * 3)
    assert reading.air == Air(22.5, 1013.25, 45.0)
    assert (reading.samples, reading.taken_s) == (1, time.pc_s())
    assert peer.commands[before:] == [55, 49, 41]


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


def test_results_of_an_earlier_measurement_are_dropped(tracker: Quick, peer: EmsconPeer) -> None:
    late = result(POINT + [1.0, 0, 0])
    peer.server.send(late)
    peer.answers[49] = lambda _: [late, reply(49), result(POINT)]
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)


@pytest.mark.parametrize("at_once", [True, False])
def test_a_late_result_behind_the_acknowledgement_is_no_reading(
    tracker: Quick, peer: EmsconPeer, at_once: bool
) -> None:
    late, right = result(POINT + [0.003, 0, 0]), result(POINT)
    proof = iter([[reply(41, status=1)], [right, reply(41, peer.settings[41])]])
    peer.answers[49] = lambda _: [reply(49), late, READY, right] if at_once else [reply(49), late]
    if not at_once:
        peer.answers[41] = lambda _: next(proof)  # busy: it still measures
    found = measuring(tracker)
    assert (type(found), found.code, found.fields["results"]) == (NoReading, "HC-T31", 2)
    assert peer.commands[-1] == 52
    peer.answers[49] = lambda _: [reply(49), READY, right]
    peer.answers[41] = lambda _: [reply(41, peer.settings[41])]
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)


def test_a_late_result_of_another_point_is_refused(tracker: Quick, peer: EmsconPeer) -> None:
    peer.answers[49] = lambda _: [reply(49), result(POINT + [0, 5.1, 0])]
    found = measuring(tracker)
    assert isinstance(found, NoReading)
    assert found.fields["off_mm"] == pytest.approx(5.1)


def test_no_result_is_no_reading_and_the_next_one_is_good(
    monkeypatch: pytest.MonkeyPatch, tracker: Quick, peer: EmsconPeer, time: WireTime
) -> None:
    punctual(monkeypatch, tracker, peer, time)
    good = peer.answers[49]
    peer.answers[49] = lambda _: time.behind([reply(49)], 0.1)
    peer.answers[52] = lambda _: time.behind([result(POINT + [2, 0, 0]), reply(52)], 0.0)
    assert measuring(tracker).code == "HC-T13"
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
        [reply(49, status=94)],
    ],
)
def test_a_broken_beam_is_no_reading(tracker: Quick, peer: EmsconPeer, answer: list[bytes]) -> None:
    peer.answers[49] = lambda _: answer
    with pytest.raises(NoReading):
        tracker.measure(POINT, SMR, 1)
    assert peer.commands[-1] == 52


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        ([reply(49), result(POINT, std=0.051)], "HC-T15"),
        ([reply(49), result(POINT, std=-0.001)], "HC-T15"),
        ([reply(49), result(POINT, std=float("nan"))], "HC-T14"),
        ([reply(49), result((float("inf"), 0, 0))], "HC-T14"),
        ([reply(49), result(POINT, air=(22.5, 0.0, 45.0))], "HC-T05"),
        ([reply(49), result(POINT, air=(float("nan"), 1000.0, 45.0))], "HC-T05"),
        ([reply(49), result(POINT, air=(0.0, 1013.25, 0.0))], "HC-T05"),
    ],
)
def test_bad_results_are_no_readings(
    tracker: Quick, peer: EmsconPeer, answer: list[bytes], code: str
) -> None:
    peer.answers[49] = lambda _: answer
    found = measuring(tracker)
    assert (type(found), found.code) == (NoReading, code)


def test_repeats_that_spread_are_no_reading(tracker: Quick, peer: EmsconPeer) -> None:
    offsets = iter([-0.06, 0.06])
    peer.answers[49] = lambda _: [reply(49), result(POINT + [0, 0, next(offsets)])]
    assert measuring(tracker, 2).code == "HC-T15"


@pytest.mark.parametrize(
    ("unit", "unit_mm"),
    [
        ("metres", 1000.0),
        ("micrometres", 1e-3),
        ("feet", 304.8),
        ("yards", 914.4),
        ("inches", 25.4),
    ],
)
def test_a_result_in_other_units_is_the_devices_failure_and_names_them(
    tracker: Quick, peer: EmsconPeer, unit: str, unit_mm: float
) -> None:
    peer.answers[49] = lambda _: [reply(49), result(POINT / unit_mm)]
    found = measuring(tracker)
    assert (found.code, found.fields["unit"]) == ("HC-T18", unit)
    assert not isinstance(found, NoReading)
    assert f"in {unit}" in found.found


@pytest.mark.parametrize("monitor", [0, 1, 2])
def test_air_counts_as_measured_where_the_weather_monitor_corrects_by_it(
    peer: EmsconPeer, time: WireTime, monitor: int
) -> None:
    peer.weather_monitor = monitor
    tracker = tracker_at(peer.server.port, time)
    tracker.connect()
    reading = tracker.measure(POINT, SMR, 1)
    tracker.close()
    assert reading.air == (Air(22.5, 1013.25, 45.0) if monitor == 2 else None)


@pytest.mark.parametrize(
    "answer",
    [
        result((1e308, 1e308, 1e308)),
        result(POINT, std=1e308),
        result(POINT, std=-1e300),
        result((0.0, -1e200, 0.0)),
    ],
)
def test_figures_beyond_all_reach_are_no_reading_in_few_words(
    tracker: Quick, peer: EmsconPeer, answer: bytes
) -> None:
    peer.answers[49] = lambda _: [reply(49), answer]
    found = measuring(tracker)
    assert (type(found), found.code) == (NoReading, "HC-T14")
    assert len(str(found)) < 200


def test_a_reflector_out_of_the_beam_is_searched(tracker: Quick, peer: EmsconPeer) -> None:
    peer.xyz = tuple(POINT)
    peer.answers[55] = lambda _: [failure(55, 37)]
    tracker.measure(POINT, SMR, 1)
    assert peer.commands[-4:] == [55, 63, 49, 41]
    peer.answers[63] = lambda _: [failure(63, 10004)]
    found = measuring(tracker)
    assert isinstance(found, NoReading)
    assert "10004" in found.found
    assert "37" in found.found, "what was tried before"


def test_not_ready_is_searched_once(tracker: Quick, peer: EmsconPeer) -> None:
    answers = iter([[failure(49, 10004)], [reply(49), result(POINT)]])
    peer.answers[49] = lambda _: next(answers)
    tracker.measure(POINT, SMR, 1)
    assert peer.commands[-5:] == [55, 49, 63, 49, 41]


def test_a_busy_server_is_asked_again(tracker: Quick, peer: EmsconPeer) -> None:
    answers = iter([[failure(49, 1)], [failure(49, 1)], [reply(49), result(POINT)]])
    peer.answers[49] = lambda _: next(answers)
    np.testing.assert_array_equal(tracker.measure(POINT, SMR, 1).xyz_mm, POINT)
    peer.answers[49] = lambda _: [failure(49, 1)]
    with pytest.raises(NoReading):
        tracker.measure(POINT, SMR, 1)


@pytest.mark.parametrize(
    "data", [CLOSING, struct.pack("<II", 0, 8), struct.pack("<II", 2**31, 2), reply(40), None]
)
def test_a_lost_stream_is_the_devices_failure(
    tracker: Quick, peer: EmsconPeer, data: bytes | None
) -> None:
    if data is None:
        peer.server.drop()
    else:
        peer.answers[49] = lambda _: [data]
    assert not isinstance(measuring(tracker), NoReading)
    assert measuring(tracker).code == ("HC-T02" if data is None else "HC-T34")


@pytest.mark.parametrize("status", [39, 26, 2])
def test_a_lost_initialisation_is_the_devices_failure(
    tracker: Quick, peer: EmsconPeer, status: int
) -> None:
    peer.answers[49] = lambda _: [failure(49, status)]
    found = measuring(tracker)
    assert not isinstance(found, NoReading)
    assert found.fields["status"] == status


@pytest.mark.parametrize(
    ("command", "answer", "code"),
    [
        (6, [reply(6, struct.pack("<5I", 0, 1, 0, 0, 0))], "HC-T06"),
        (27, [reply(27, struct.pack("<i", 1))], "HC-T06"),
        (42, [reflector(1, 3, "Prism")], "HC-T07"),
        (21, [reply(21, struct.pack("<3d", 21.0, 0.0, 40.0))], "HC-T05"),
        (1, [reply(1, bytes(12))], "HC-T02"),
        (1, [failure(1, 38)], "HC-T22"),
    ],
)
def test_a_wrong_tracker_is_refused(
    peer: EmsconPeer, time: WireTime, command: int, answer: list[bytes], code: str
) -> None:
    peer.answers[command] = lambda _: answer
    assert refusal(tracker_at(peer.server.port, time).connect).code == code


def test_a_tracker_that_does_not_initialise_is_refused(peer: EmsconPeer, time: WireTime) -> None:
    peer.initialized = 3
    peer.answers[7] = lambda _: [reply(7)]
    found = refusal(tracker_at(peer.server.port, time).connect)
    assert (type(found), found.code) == (DeviceRefused, "HC-T04")


def test_a_stop_gets_through_while_a_call_hangs(
    tracker: Quick, peer: EmsconPeer, time: WireTime
) -> None:
    started = threading.Event()

    def hang(_body: bytes) -> list[bytes]:
        started.set()
        return [reply(49)]

    peer.answers[49] = hang
    with in_thread(lambda: tracker.measure(POINT, SMR, 1), DeviceError) as failures:
        started.wait()
        tracker.stop()
        peer.stopped.wait()
        time.silence(0.1)
    assert len(failures) == 1


def test_the_runs_stop_ends_a_measurement(tracker: Quick, peer: EmsconPeer, time: WireTime) -> None:

    def stop(_: bytes) -> list[bytes]:
        time.stop.set()
        return [reply(49)]

    peer.answers[49] = stop
    with pytest.raises(Stopped):
        tracker.measure(POINT, SMR, 1)


@pytest.mark.parametrize(("near", "samples"), [(POINT[:2], 1), (POINT * np.nan, 1), (POINT, 0)])
def test_nonsense_is_never_sent(tracker: Quick, peer: EmsconPeer, near: Any, samples: int) -> None:
    before = len(peer.commands)
    with pytest.raises(DeviceError):
        tracker.measure(near, SMR, samples)
    assert len(peer.commands) == before


def test_a_dead_server_is_noticed_at_connect(time: WireTime) -> None:
    silent = threading.Event()

    def serve(_: socket.socket) -> None:
        silent.wait()

    time.silence(0.1)
    with Server(serve) as server:
        assert refusal(tracker_at(server.port, time).connect).code == "HC-T02"
        silent.set()


def test_a_stop_that_is_refused_is_reported_beside_the_cause(
    tracker: Quick, peer: EmsconPeer
) -> None:
    peer.answers[49] = lambda _: [reply(49), NOT_READY]
    peer.answers[52] = lambda _: [failure(52, 10014)]
    found = measuring(tracker)
    assert isinstance(found, NoReading)
    assert "10014" in found.found
