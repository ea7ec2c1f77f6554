from __future__ import annotations

import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.leica import emscon_stream
from drivers.leica.emscon_stream import EmsconStream
from hilcell.clock import WallClock
from hilcell.ports import Array, DeviceError, NoReading, Stopped, Stream, StreamBlock, Streams
from tests.drivers.emscon_peer import NOT_READY, READY, EmsconPeer, failure, reply, result
from tests.drivers.peers import WAIT_S
from tests.drivers.test_tracker_leica_emscon import POINT, SMR, Quick, tracker_at

STATIONARY, CONTINUOUS = struct.pack("<i", 0), struct.pack("<i", 1)
PARAMETERS = struct.pack("<4i", 10, 0, 0, 0)  # 10 ms, until stopped
START, STOP, SET_MODE, GET_PARAMETERS = 49, 52, 24, 31


def samples(times_s: NDArray[Any], xyz_mm: Array = POINT, status: int = 0) -> bytes:
    size, count = 48 + 36 * len(times_s), len(times_s)
    head = struct.pack("<IIiiii3d", size, 3, status, count, 1, 0, 22.5, 1013.25, 45.0)
    return head + b"".join(
        struct.pack("<iii3d", 0, *divmod(round(at_s * 1e6), 1_000_000), *xyz_mm) for at_s in times_s
    )


FIRST, SECOND = (samples(np.arange(n, n + 4) / 100.0 + 7.0) for n in (0, 4))


@pytest.fixture
def peer() -> Iterator[EmsconPeer]:
    with EmsconPeer() as peer:
        peer.answers[START] = lambda _: [reply(START), READY, FIRST]
        peer.answers[STOP] = lambda _: [SECOND, reply(STOP)]
        yield peer


@pytest.fixture
def tracker(peer: EmsconPeer) -> Iterator[Quick]:
    tracker = tracker_at(peer.server.port)
    tracker.connect()
    yield tracker
    tracker.close()


def flown(stream: Stream) -> list[StreamBlock]:
    stream.kickoff()
    blocks = stream.collect()
    while not blocks:
        blocks = stream.collect()
    return blocks


def fly(
    tracker: Quick, meanwhile: Callable[[], object] = lambda: None, *, collected: bool = True
) -> list[StreamBlock]:
    with tracker.stream(POINT, SMR, 100.0) as stream:
        if not collected:
            stream.kickoff()
            return stream.complete()
        blocks = flown(stream)
        meanwhile()
        return blocks + stream.collect() + stream.complete()


def test_a_stream_sets_its_mode_collects_and_restores(peer: EmsconPeer, tracker: Quick) -> None:
    assert isinstance(tracker, Streams)
    with tracker.stream(POINT, SMR, 100.0) as stream:
        assert stream.rate_hz == 100.0
        assert peer.settings[25] == CONTINUOUS
        assert peer.settings[31] == PARAMETERS
        assert START not in peer.commands
        blocks = flown(stream) + stream.complete()
    assert peer.settings[25] == STATIONARY
    np.testing.assert_allclose(
        np.concatenate([block.device_s for block in blocks]), 7.0 + np.arange(8) / 100.0
    )
    assert all(np.array_equal(block.xyz_mm, np.tile(POINT, (4, 1))) for block in blocks)
    assert all(block.after_s <= block.by_s for block in blocks)
    assert blocks[0].by_s >= blocks[1].after_s >= blocks[0].after_s


def test_after_a_stream_the_tracker_measures_at_rest(peer: EmsconPeer, tracker: Quick) -> None:
    with tracker.stream(POINT, SMR, 100.0) as stream:
        flown(stream)
        stream.complete()
    peer.answers[START] = lambda _: [reply(START), READY, result(POINT)]
    peer.answers[STOP] = lambda _: [reply(STOP)]
    assert tracker.measure(POINT, SMR, 1).samples == 1


def test_packets_in_slices_are_the_same(peer: EmsconPeer, tracker: Quick) -> None:
    peer.slice = 5
    with tracker.stream(POINT, SMR, 100.0) as stream:
        blocks = flown(stream) + stream.complete()
    assert sum(len(block.device_s) for block in blocks) == 8


@pytest.mark.parametrize(
    ("packet", "message"),
    [
        (NOT_READY, "the beam broke"),
        (failure(START, 10004), "status 10004"),
        (samples(np.array([6.0])), "run back"),
        (samples(np.array([7.03])), "run back"),
        (samples(np.array([8.0, 8.01]), POINT * np.nan), "not finite"),
        (samples(np.array([8.0]), status=10013), "status 10013"),
    ],
)
def test_what_ends_a_stream_is_no_reading_and_restores(
    peer: EmsconPeer, tracker: Quick, packet: bytes, message: str
) -> None:
    peer.answers[START] = lambda _: [reply(START), READY, FIRST + packet]
    with pytest.raises(NoReading, match=message):
        fly(tracker)
    assert peer.settings[25] == STATIONARY
    assert peer.commands[-3:] == [STOP, SET_MODE, 25]


def test_another_reflector_is_no_reading(peer: EmsconPeer, tracker: Quick) -> None:
    peer.answers[START] = lambda _: [reply(START), samples(np.array([7.0]), POINT + 6.0)]
    with pytest.raises(NoReading, match="from its expected"):
        fly(tracker)


@pytest.mark.parametrize("unit", [1000.0, 0.001, 3.0])
def test_times_in_other_units_are_found_out(peer: EmsconPeer, tracker: Quick, unit: float) -> None:
    packet = samples(7.0 + unit * np.arange(5) / 100.0)
    peer.answers[START] = lambda _: [reply(START), packet]
    with pytest.raises(DeviceError, match="wanted 10 ms"):
        fly(tracker)


def test_a_gap_is_survived(peer: EmsconPeer, tracker: Quick) -> None:
    peer.answers[STOP] = lambda _: [samples(np.array([8.5, 8.51])), reply(STOP)]
    with tracker.stream(POINT, SMR, 100.0) as stream:
        blocks = flown(stream) + stream.complete()
    assert blocks[-1].device_s.tolist() == [8.5, 8.51]


def test_silence_is_no_reading(
    peer: EmsconPeer, tracker: Quick, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(emscon_stream, "SILENT_S", 0.05)
    peer.answers[START] = lambda _: [reply(START)]
    with pytest.raises(NoReading, match="no samples for"):
        fly(tracker)


def test_a_stream_without_a_sample_is_no_reading(peer: EmsconPeer, tracker: Quick) -> None:
    peer.answers[START] = lambda _: [reply(START)]
    peer.answers[STOP] = lambda _: [reply(STOP)]
    with pytest.raises(NoReading, match="no sample came"):
        fly(tracker, collected=False)


def test_parameters_that_read_back_differently_restore_the_mode(
    peer: EmsconPeer, tracker: Quick
) -> None:
    found = struct.pack("<4i", 20, 0, 0, 0)
    peer.answers[GET_PARAMETERS] = lambda _: [reply(GET_PARAMETERS, found)]
    with pytest.raises(DeviceError, match="reads back"):
        fly(tracker)
    assert peer.settings[25] == STATIONARY


def test_a_stop_is_not_waited_for_but_restores(peer: EmsconPeer) -> None:
    stop, restored = threading.Event(), threading.Event()
    tracker = tracker_at(peer.server.port, WallClock(stop))
    tracker.connect()
    keep = peer._set(SET_MODE)

    def set_mode(body: bytes) -> Sequence[bytes]:
        answer = keep(body)
        if body == STATIONARY:
            restored.set()
        return answer

    peer.answers[SET_MODE] = set_mode
    with pytest.raises(Stopped):
        fly(tracker, stop.set)
    assert restored.wait(WAIT_S)
    assert peer.settings[25] == STATIONARY
    assert STOP in peer.commands
    tracker.close()


def test_a_stop_while_a_failed_stream_ends_does_not_hide_the_failure(peer: EmsconPeer) -> None:
    stop = threading.Event()
    tracker = tracker_at(peer.server.port, WallClock(stop))
    tracker.connect()

    def fail_and_stop() -> None:
        stop.set()
        raise KeyError

    with pytest.raises(KeyError) as caught:
        fly(tracker, fail_and_stop)
    assert "the next connect ends it" in caught.value.__notes__[0]
    tracker.close()


def test_a_stream_left_behind_is_ended_by_connect(peer: EmsconPeer) -> None:
    peer.settings[25] = CONTINUOUS
    tracker = tracker_at(peer.server.port)
    tracker.connect()
    tracker.close()
    assert peer.commands.index(STOP) < peer.commands.index(SET_MODE)
    assert peer.settings[25] == STATIONARY


def test_what_cannot_be_restored_is_noted(peer: EmsconPeer, tracker: Quick) -> None:
    def fail() -> None:
        peer.answers[SET_MODE] = lambda _: [failure(SET_MODE, 26)]
        raise KeyError

    with pytest.raises(KeyError) as caught:
        fly(tracker, fail)
    assert "the next connect ends it" in caught.value.__notes__[0]


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, np.nan, 1001.0, 0.05])
def test_an_impossible_rate_is_refused(peer: EmsconPeer, tracker: Quick, rate_hz: float) -> None:
    with pytest.raises(DeviceError, match="samples/s"):
        tracker.stream(POINT, SMR, rate_hz)


def test_an_impossible_place_is_refused(tracker: Quick) -> None:
    with pytest.raises(DeviceError, match="a reflector at"):
        tracker.stream(POINT * np.nan, SMR, 100.0)


def test_it_is_a_stream(tracker: Quick) -> None:
    stream: Stream = tracker.stream(POINT, SMR, 300.0)
    assert isinstance(stream, EmsconStream)
    assert stream.rate_hz == pytest.approx(1000.0 / 3)
