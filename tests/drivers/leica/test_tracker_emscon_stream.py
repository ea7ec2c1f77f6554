from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hilcell.ports import Array, DeviceError, NoReading, Stopped, Stream, StreamBlock, Streams
from tests.drivers.leica.emscon_bed import POINT, SMR, EmsconBed, Quick, punctual
from tests.drivers.leica.emscon_peer import NOT_READY, READY, EmsconPeer, failure, reply, result
from tests.drivers.peers import kind, refusal, soon

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
def peer(peer: EmsconPeer) -> EmsconPeer:
    peer.answers[START] = lambda _: [reply(START), READY, FIRST]
    peer.answers[STOP] = lambda _: [SECOND, reply(STOP)]
    return peer


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


def test_a_stream_sets_its_mode_collects_and_restores(tracker: Quick) -> None:
    peer = tracker.peer
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
    assert all(block.arrived_after_s <= block.arrived_by_s for block in blocks)
    first, second = blocks
    assert first.arrived_by_s >= second.arrived_after_s >= first.arrived_after_s
    peer.answers[START] = lambda _: [reply(START), READY, result(POINT)]
    peer.answers[STOP] = lambda _: [reply(STOP)]
    assert tracker.measure(POINT, SMR, 1).samples == 1  # at rest, afterwards


def test_packets_in_slices_are_the_same(tracker: Quick) -> None:
    tracker.peer.slice = 5
    assert sum(len(block.device_s) for block in fly(tracker)) == 8


@pytest.mark.parametrize(
    ("packet", "code"),
    [
        (NOT_READY, "HC-T10"),
        (failure(START, 10004), "HC-T11"),
        (samples(np.array([6.0])), "HC-T41"),
        (samples(np.array([7.03])), "HC-T41"),
        (samples(np.array([8.0, 8.01]), POINT * np.nan), "HC-T14"),
        (samples(np.array([8.0, 8.01]), POINT * 1e300), "HC-T14"),
        (samples(np.array([8.0]), status=10013), "HC-T15"),
    ],
    ids=["beam", "refused", "back", "twice", "nan", "absurd", "status"],
)
def test_a_stream_that_fails_is_no_reading_and_restores(
    tracker: Quick, packet: bytes, code: str
) -> None:
    tracker.peer.answers[START] = lambda _: [reply(START), READY, FIRST + packet]
    assert kind(refusal(lambda: fly(tracker))) == (NoReading, code)
    assert tracker.peer.settings[25] == STATIONARY
    assert tracker.peer.commands[-3:] == [STOP, SET_MODE, 25]


def test_another_reflector_is_no_reading(tracker: Quick) -> None:
    tracker.peer.answers[START] = lambda _: [reply(START), samples(np.array([7.0]), POINT + 6.0)]
    error = refusal(lambda: fly(tracker))
    assert isinstance(error, NoReading)
    assert error.fields["off_mm"] == pytest.approx(6.0 * np.sqrt(3))


@pytest.mark.parametrize("unit", [1000.0, 0.001, 3.0])
def test_times_in_other_units_are_found_out(tracker: Quick, unit: float) -> None:
    packet = samples(7.0 + unit * np.arange(5) / 100.0)
    tracker.peer.answers[START] = lambda _: [reply(START), packet]
    assert refusal(lambda: fly(tracker)).code == "HC-T41"


def test_a_gap_is_survived(tracker: Quick) -> None:
    tracker.peer.answers[STOP] = lambda _: [samples(np.array([8.5, 8.51])), reply(STOP)]
    assert fly(tracker)[-1].device_s.tolist() == [8.5, 8.51]


@pytest.mark.parametrize("collected", [True, False])
def test_a_stream_without_a_sample_is_no_reading(
    monkeypatch: pytest.MonkeyPatch, tracker: Quick, collected: bool
) -> None:
    punctual(monkeypatch, tracker)
    tracker.peer.answers[START] = lambda _: tracker.time.behind([reply(START)], 0.1)
    tracker.peer.answers[STOP] = lambda _: tracker.time.behind([reply(STOP)], 0.0)
    assert isinstance(refusal(lambda: fly(tracker, collected=collected)), NoReading)


def test_parameters_that_read_back_differently_restore_the_mode(tracker: Quick) -> None:
    found = struct.pack("<4i", 20, 0, 0, 0)
    tracker.peer.answers[GET_PARAMETERS] = lambda _: [reply(GET_PARAMETERS, found)]
    assert refusal(lambda: fly(tracker)).code == "HC-T06"
    assert tracker.peer.settings[25] == STATIONARY


def test_a_stop_is_not_waited_for_but_restores(tracker: Quick) -> None:
    with pytest.raises(Stopped):
        fly(tracker, tracker.time.stop.set)
    soon(lambda: tracker.peer.settings[25] == STATIONARY)
    assert STOP in tracker.peer.commands


def test_a_stop_while_a_failed_stream_ends_does_not_hide_the_failure(tracker: Quick) -> None:
    def fail_and_stop() -> None:
        tracker.time.stop.set()
        raise KeyError

    with pytest.raises(KeyError) as caught:
        fly(tracker, fail_and_stop)
    assert len(caught.value.__notes__) == 1


def test_a_stream_left_behind_is_ended_by_connect(bed: EmsconBed) -> None:
    bed.peer.settings[25] = CONTINUOUS
    bed.connect()
    assert bed.peer.commands.index(STOP) < bed.peer.commands.index(SET_MODE)
    assert bed.peer.settings[25] == STATIONARY


def test_a_mode_that_cannot_be_restored_is_noted(tracker: Quick) -> None:
    def fail() -> None:
        tracker.peer.answers[SET_MODE] = lambda _: [failure(SET_MODE, 26)]
        raise KeyError

    with pytest.raises(KeyError) as caught:
        fly(tracker, fail)
    assert len(caught.value.__notes__) == 1


@pytest.mark.parametrize(
    ("near_mm", "rate_hz"),
    [(POINT, 0.0), (POINT, np.nan), (POINT, 1001.0), (POINT, 0.05), (POINT * np.nan, 100.0)],
)
def test_an_impossible_stream_is_refused(tracker: Quick, near_mm: Array, rate_hz: float) -> None:
    with pytest.raises(DeviceError):
        tracker.stream(near_mm, SMR, rate_hz)


def test_the_rate_is_one_that_the_tracker_has(tracker: Quick) -> None:
    assert tracker.stream(POINT, SMR, 300.0).rate_hz == pytest.approx(1000.0 / 3)


def test_a_stream_of_another_reflector_is_refused(tracker: Quick) -> None:
    times_s = 7.0 + np.arange(4) / 100.0

    def start(_: bytes) -> list[bytes]:
        tracker.peer.settings[41] = struct.pack("<i", 4)
        return [reply(49), READY, struct.pack("<III", 12, 8, 7), samples(times_s)]

    tracker.peer.answers[49] = start

    assert refusal(lambda: fly(tracker, collected=False)).code == "HC-T06"
    assert tracker.peer.settings[25] == struct.pack("<i", 0)
