"""Settings of an emScon tracker that another program changes, and the news of it."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest

from drivers import supervision
from hilcell.ports import DeviceError, DeviceRefused, NoReading
from tests.drivers.emscon_peer import READY, EmsconPeer, failure, reply, result
from tests.drivers.peers import WireTime, wire_time
from tests.drivers.rail_bed import refusal
from tests.drivers.test_emscon_stream import samples
from tests.drivers.test_tracker_leica_emscon import POINT, SMR, Quick, tracker_at

COMPENSATION, SERVER_STARTED = 11, 999
FRAME = [0.0] * 6
OTHERS = {  # what another program sets: the news of it, the command that reads it, its bytes
    "search": (4, 44, struct.pack("<di", 12.0, 10_000)),
    "units": (6, 6, struct.pack("<5I", 5, 0, 0, 0, 0)),
    "reflector": (7, 41, struct.pack("<i", 4)),
    "weather": (8, 48, struct.pack("<9i", 0, 0, 0, 0, 1, 0, 0, 0, 0)),
    "transforms": (8, 48, struct.pack("<9i", 2, 1, 0, 0, 1, 0, 0, 0, 0)),
    "axes": (12, 27, struct.pack("<i", 1)),
    "orientation": (15, 13, struct.pack("<6d", 0.1, *FRAME[1:])),
    "transformation": (16, 15, struct.pack("<7d", *FRAME, 1.0002)),
    "mode": (17, 25, struct.pack("<i", 1)),
    "stationary": (18, 29, struct.pack("<ii", 2000, 1)),
    "face": (31, 98, struct.pack("<i", 2)),
    "restarted": (SERVER_STARTED, 6, struct.pack("<5I", 0, 0, 0, 0, 0)),
}


def news(change: int) -> bytes:
    return struct.pack("<III", 12, 8, change)


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> WireTime:
    return wire_time(monkeypatch, supervision)


@pytest.fixture
def peer() -> Iterator[EmsconPeer]:
    with EmsconPeer() as peer:
        peer.settings[98] = struct.pack("<i", 1)
        yield peer


@pytest.fixture
def tracker(peer: EmsconPeer, time: WireTime) -> Iterator[Quick]:
    tracker = tracker_at(peer.server.port, time, find_radius_mm=20.0)
    tracker.connect()
    yield tracker
    tracker.close()


def measuring(tracker: Quick) -> DeviceError:
    return refusal(lambda: tracker.measure(POINT, SMR, 1))


def changed(found: DeviceError) -> bool:
    return found.code == "HC-T06" and not isinstance(found, NoReading | DeviceRefused)


@pytest.mark.parametrize("other", OTHERS)
@pytest.mark.parametrize("while_it", ["rests", "aims", "measures"])
def test_what_another_program_sets_is_read_back_and_refused_until_it_is_set_again(
    peer: EmsconPeer, tracker: Quick, other: str, while_it: str
) -> None:
    change, read, body = OTHERS[other]
    ours, go = peer.settings[read], peer.answers[55]

    def set_by_another() -> bytes:
        peer.settings[read] = body
        return news(change)

    if while_it == "rests":
        peer.server.send(set_by_another())
    if while_it == "aims":
        peer.answers[55] = lambda body: [set_by_another(), *go(body)]
    if while_it == "measures":
        peer.answers[49] = lambda _: [reply(49), set_by_another(), READY, result(peer.xyz)]
    assert changed(measuring(tracker))
    peer.answers[49] = lambda _: [reply(49), READY, result(peer.xyz)]
    peer.answers[55] = go
    assert changed(measuring(tracker)), "until a new connect"
    peer.settings[read] = ours
    tracker.connect()
    assert tracker.measure(POINT, SMR, 1).samples == 1


@pytest.mark.parametrize("other", OTHERS)
def test_news_of_a_setting_that_is_still_ours_costs_one_question_more(
    peer: EmsconPeer, tracker: Quick, other: str
) -> None:
    change, read, _ = OTHERS[other]
    tracker.measure(POINT, SMR, 1)
    counts = [peer.commands.count(read)]
    for data in (news(change), b""):
        peer.server.send(data)
        tracker.measure(POINT, SMR, 1)
        counts.append(peer.commands.count(read))
    each = int(read == 41)  # the reflector is read after each reading
    assert np.diff(counts).tolist() == [each + 1, each]


def test_a_compensation_by_another_program_is_refused_until_a_new_connect(
    peer: EmsconPeer, tracker: Quick
) -> None:
    peer.server.send(news(COMPENSATION))
    assert changed(measuring(tracker))
    assert changed(measuring(tracker))
    tracker.connect()
    assert tracker.measure(POINT, SMR, 1).samples == 1


def test_a_stream_of_another_reflector_is_refused(peer: EmsconPeer, tracker: Quick) -> None:
    times_s = 7.0 + np.arange(4) / 100.0

    def start(_: bytes) -> list[bytes]:
        peer.settings[41] = struct.pack("<i", 4)
        return [reply(49), READY, news(7), samples(times_s)]

    peer.answers[49] = start

    def fly() -> None:
        with tracker.stream(POINT, SMR, 100.0) as stream:
            stream.kickoff()
            stream.complete()

    assert changed(refusal(fly))
    assert peer.settings[25] == struct.pack("<i", 0)


@pytest.mark.parametrize("scale", [1.0002, 0.9999999, float("nan")])
def test_a_transformation_that_stretches_lengths_is_refused_while_it_is_in_use(
    peer: EmsconPeer, time: WireTime, scale: float
) -> None:
    peer.settings[15] = struct.pack("<7d", *FRAME, scale)
    tracker = tracker_at(peer.server.port, time)
    tracker.connect()
    peer.settings[48] = struct.pack("<9i", 2, 1, 0, 0, 1, 0, 0, 0, 0)
    found = refusal(tracker.connect)
    assert (type(found), found.code) == (DeviceRefused, "HC-T06")
    assert "scale" in found.found
    tracker.close()


@pytest.mark.parametrize("answer", [failure(48, 2), reply(48, status=2), reply(48)])
def test_an_older_controller_does_not_tell_its_frame(
    peer: EmsconPeer, time: WireTime, answer: bytes
) -> None:
    peer.answers[48] = lambda _: [answer]
    del peer.settings[13], peer.settings[15]
    tracker = tracker_at(peer.server.port, time)
    tracker.connect()
    np.testing.assert_allclose(tracker.measure(POINT, SMR, 1).xyz_mm, POINT, atol=1e-6)
    tracker.close()
