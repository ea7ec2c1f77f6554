"""The second face of an emScon tracker: turned to, believed, and left again."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from drivers import supervision
from hilcell.ports import NoReading
from tests.drivers.leica.emscon_peer import NOT_READY, EmsconPeer, failure, reply, result
from tests.drivers.leica.test_tracker_leica_emscon import POINT, SMR, Quick, tracker_at
from tests.drivers.peers import WireTime, refusal, wire_time


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> WireTime:
    return wire_time(monkeypatch, supervision)


@pytest.fixture
def peer() -> Iterator[EmsconPeer]:
    with EmsconPeer() as peer:
        yield peer


@pytest.fixture
def tracker(peer: EmsconPeer, time: WireTime) -> Iterator[Quick]:
    tracker = tracker_at(peer.server.port, time)
    tracker.connect()
    yield tracker
    tracker.close()


class TurningPeer:
    """Lets a peer turn over; ``stuck`` keeps its face, whatever it answers."""

    def __init__(self, peer: EmsconPeer, *, face: int = 1, stuck: bool = False) -> None:
        self.face, self.stuck = face, stuck
        self.seen: list[int] = []  # faces in which it measured
        measure = peer.answers[49]

        def measured(body: bytes) -> Sequence[bytes]:
            self.seen.append(self.face)
            return measure(body)

        peer.answers[49] = measured
        peer.answers[53] = self._turn
        peer.answers[98] = lambda _: [reply(98, struct.pack("<i", self.face))]

    def _turn(self, _: bytes) -> list[bytes]:
        self.face = self.face if self.stuck else 3 - self.face
        return [NOT_READY, reply(53)]


def test_a_nest_is_measured_in_the_second_face_and_the_tracker_left_in_the_first(
    peer: EmsconPeer, tracker: Quick
) -> None:
    turning = TurningPeer(peer)
    reading = tracker.measure_back(POINT, SMR, 3)
    tracker.measure(POINT, SMR, 1)
    assert turning.seen == [2, 2, 2, 1]
    assert turning.face == 1
    assert (reading.samples, reading.reflector) == (3, SMR)
    np.testing.assert_allclose(reading.xyz_mm, POINT)


def test_it_is_left_in_the_first_face_where_the_beam_breaks_in_the_second(
    peer: EmsconPeer, tracker: Quick
) -> None:
    turning = TurningPeer(peer)
    peer.answers[49] = lambda _: [reply(49), NOT_READY]
    found = refusal(lambda: tracker.measure_back(POINT, SMR, 1))
    assert (type(found), found.code, turning.face) == (NoReading, "HC-T10", 1)


def test_it_is_left_in_the_first_face_where_the_readings_of_the_second_spread(
    peer: EmsconPeer, tracker: Quick
) -> None:
    turning, offs_mm = TurningPeer(peer), iter((-0.9, 0.9))
    peer.answers[49] = lambda _: [reply(49), result(POINT + [0.0, next(offs_mm), 0.0])]
    found = refusal(lambda: tracker.measure_back(POINT, SMR, 2))
    assert (type(found), found.code, turning.face) == (NoReading, "HC-T15", 1)


def test_a_face_that_reads_back_differently_is_refused(peer: EmsconPeer, tracker: Quick) -> None:
    TurningPeer(peer, stuck=True)
    found = refusal(lambda: tracker.measure_back(POINT, SMR, 1))
    assert (found.code, found.fields["setting"], found.fields["written"]) == (
        "HC-T06",
        "face",
        (2,),
    )


@pytest.mark.parametrize("face", [1, 2])
def test_a_tracker_that_was_left_in_its_second_face_is_turned_back(
    peer: EmsconPeer, time: WireTime, face: int
) -> None:
    turning = TurningPeer(peer, face=face)
    tracker = tracker_at(peer.server.port, time)
    tracker.connect()
    tracker.close()
    assert turning.face == 1
    assert peer.commands.count(53) == face - 1


def test_a_controller_that_does_not_tell_its_face_connects(
    peer: EmsconPeer, time: WireTime
) -> None:
    peer.answers[98] = lambda _: [failure(98, 2)]
    tracker = tracker_at(peer.server.port, time)
    tracker.connect()
    tracker.close()
    assert 53 not in peer.commands
