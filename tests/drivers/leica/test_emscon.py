"""Packets of emScon, and settings of its tracker that another program changes."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest
from CESAPI import packet as cesapi
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import supervision
from drivers.device_errors import Garbled
from drivers.leica import emscon
from drivers.leica.emscon import (
    Command,
    Failure,
    Layout,
    Multi,
    Packet,
    PacketReader,
    Reflector,
    Reply,
    Setting,
    Single,
    StatusChange,
    SystemStatus,
    Value,
)
from hilcell.ports import DeviceError, DeviceRefused, NoReading
from tests.drivers.leica.emscon_peer import READY, EmsconPeer, failure, reply, result
from tests.drivers.leica.test_emscon_stream import samples
from tests.drivers.leica.test_tracker_leica_emscon import POINT, SMR, Quick, tracker_at
from tests.drivers.peers import WireTime, refusal, wire_time

XYZ, STD, AIR = (1100.25, -2.5, 0.125), (0.004, 0.005, 0.006), (22.5, 1013.25, 45.0)
RESULT = bytes.fromhex("9c0000000200000000000000") + struct.pack(
    "<ii17d", 0, 0, *XYZ, *STD, 0.009, *[0.0] * 7, *AIR
)


@pytest.mark.parametrize(
    ("command", "body", "expected"),
    [
        (Command.INITIALIZE, b"", "0c0000000000000007000000"),
        (
            Command.FIND_REFLECTOR,
            Layout.DISTANCE.pack(3000.0),
            "14000000000000003f000000000000000070a740",
        ),
        (
            Setting.CONTINUOUS_TIME.write,
            Setting.CONTINUOUS_TIME.layout.pack(10, Value.UNTIL_STOPPED, 0, 0),
            "1c000000000000001e0000000a000000000000000000000000000000",
        ),
    ],
)
def test_commands_are_the_published_bytes(command: int, body: bytes, expected: str) -> None:
    assert emscon.encode(command, body).hex() == expected


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ("10000000000000003100000000000000", Reply(49, 0, b"")),
        ("1000000001000000310000001a000000", Failure(49, 26)),
        ("0c000000080000001b000000", StatusChange(27)),
    ],
)
def test_packets_are_the_published_bytes(data: str, expected: Packet) -> None:
    assert PacketReader().feed(bytes.fromhex(data)) == [expected]


def test_a_packet_of_another_type_is_passed_over() -> None:
    other, used = "0c000000630000001b000000", "0c000000080000001b000000"
    assert PacketReader().feed(bytes.fromhex(other + used)) == [StatusChange(27)]


def test_settings_are_read_and_written_by_the_published_commands() -> None:
    """ES_Command and ES_SystemStatusChange: what reads, what writes, and the news of a change."""
    assert {each.name: (each.read, each.write, *sorted(each.changes)) for each in Setting} == {
        "UNITS": (6, 5, 6),
        "COORDINATE_SYSTEM": (27, 26, 12),
        "MEASUREMENT_MODE": (25, 24, 17),
        "STATIONARY": (29, 28, 18),
        "CONTINUOUS_TIME": (31, 30, 19),
        "SEARCH": (44, 43, 4),
        "REFLECTOR": (41, 40, 7),
        "FACE": (98, 0, 30, 31),
        "SYSTEM_SETTINGS": (48, 0, 8),
        "ORIENTATION": (13, 0, 15),
        "TRANSFORMATION": (15, 0, 16),
    }
    assert emscon.spoken(Setting.MEASUREMENT_MODE.read) == "get measurement mode"
    assert emscon.spoken(Setting.UNITS.write) == "set units"
    assert emscon.spoken(Command.GO_POSITION) == "go position"


def test_a_result_is_the_published_bytes() -> None:
    assert len(RESULT) == 156
    assert RESULT[20:44].hex() == "000000000031914000000000000004c0000000000000c03f"
    assert RESULT[-24:].hex() == "00000000008036400000000000aa8f400000000000804640"
    assert PacketReader().feed(RESULT) == [Single(0, XYZ, STD, 0.009, AIR)]


MULTI = bytes.fromhex(  # two samples; the peer CESAPI knows no continuous measurement
    "780000000300000000000000020000000100000000000000"
    "00000000008036400000000000aa8f400000000000804640"
    "000000000500000090d00300000000000031914000000000000004c0000000000000c03f"
    "0000000005000000a0f70300000000000031914000000000000004c0000000000000c0bf"
)  # fmt: skip


@pytest.mark.parametrize("cut", [1, 5, 47, 48, 119])
def test_samples_are_read_from_packets_in_pieces(cut: int) -> None:
    reader = PacketReader()
    assert reader.feed(MULTI[:cut]) == []
    (packet,) = reader.feed(MULTI[cut:])
    assert isinstance(packet, Multi)
    assert packet.status == 0
    assert packet.device_s.tolist() == [5.25, 5.26]
    assert packet.xyz.tolist() == [[1100.25, -2.5, 0.125], [1100.25, -2.5, -0.125]]


@pytest.mark.parametrize("count", [0, 1, 3, -1, 2**31 - 1])
def test_a_wrong_number_of_samples_is_no_packet(count: int) -> None:
    with pytest.raises(Garbled, match=str(count)):
        PacketReader().feed(MULTI[:12] + struct.pack("<i", count) + MULTI[16:])


@pytest.mark.parametrize("at", [8, 48, 84])
def test_the_status_of_any_sample_is_that_of_all(at: int) -> None:
    (packet,) = PacketReader().feed(MULTI[:at] + struct.pack("<i", 10013) + MULTI[at + 4 :])
    assert isinstance(packet, Multi)
    assert packet.status == 10013


def test_an_independent_peer_reads_our_settings() -> None:
    millimetres, mode = Setting.UNITS, Setting.STATIONARY
    units = cesapi.SetUnitsCT()
    units.unpack(emscon.encode(millimetres.write, millimetres.layout.pack(*Value.MILLIMETRES)))
    assert units.unitsSettings.lenUnitType == cesapi.ES_LU_Millimeter
    assert units.unitsSettings.angUnitType == cesapi.ES_AU_Radian
    assert units.unitsSettings.pressUnitType == cesapi.ES_PU_Mbar
    stationary = cesapi.SetStationaryModeParamsCT()
    stationary.unpack(emscon.encode(mode.write, mode.layout.pack(500, 1)))
    assert stationary.stationaryModeData.lMeasTime == 500
    assert stationary.stationaryModeData.bUseADM == 1
    go = cesapi.GoPositionCT()
    go.unpack(emscon.encode(Command.GO_POSITION, Layout.POSITION.pack(1.5, -2.5, 3.5, 1)))
    assert (go.dVal1, go.dVal2, go.dVal3, go.bUseADM) == (1.5, -2.5, 3.5, 1)
    size = go._GoPositionCT__packet_size  # pyrefly: ignore[missing-attribute] # its name is mangled
    assert go.packetInfo.packetHeader.lPacketSize == size == 40


def test_an_independent_peers_replies_are_read() -> None:
    status = cesapi.GetSystemStatusRT()
    status.trackerProcessorStatus, status.lTrackerSerialNumber = 5, 390793
    status.esVersionNumber.iMajorVersionNumber, status.esVersionNumber.iBuildNumber = 3, 900
    status.weatherMonitorStatus = 1
    (reply,) = PacketReader().feed(status.pack())
    assert isinstance(reply, Reply)
    assert SystemStatus.decode(reply.body) == SystemStatus(5, "3.0.900", 1, 390793)
    reflector = cesapi.GetReflectorsRT()
    reflector.iTotalReflectors, reflector.iInternalReflectorId = 2, 7
    reflector.dSurfaceOffset = 19.05
    reflector.cReflectorName = "SMR 1.5in".encode("utf-16-le").ljust(64, b"\0")
    (reply,) = PacketReader().feed(reflector.pack())
    assert isinstance(reply, Reply)
    assert Reflector.decode(reply.body) == Reflector(2, 7, 19.05, "SMR 1.5in")


@pytest.mark.parametrize("size", [0, 4, 11, 65537, 2**31, 2**32 - 1])
def test_impossible_lengths_are_refused(size: int) -> None:
    with pytest.raises(Garbled, match=str(size)):
        PacketReader().feed(struct.pack("<II", size, 8))


@pytest.mark.parametrize(("kind", "size"), [(0, 12), (1, 12), (2, 152)])
def test_packets_too_short_for_their_type_are_refused(kind: int, size: int) -> None:
    with pytest.raises(Garbled, match=str(kind)):
        PacketReader().feed(struct.pack("<II", size, kind) + bytes(size - 8))


@settings(max_examples=40)
@given(st.data(), st.lists(st.sampled_from([RESULT, bytes.fromhex("0c000000080000001b000000")])))
def test_any_slicing_gives_the_same_packets(data: st.DataObject, packets: list[bytes]) -> None:
    stream = b"".join(packets)
    whole = PacketReader().feed(stream)
    reader, found = PacketReader(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += reader.feed(stream[:size])
        stream = stream[size:]
    assert found == whole
    assert len(found) == len(packets)


@given(st.binary(max_size=300))
def test_any_bytes_decode_or_are_refused(data: bytes) -> None:
    try:
        packets = PacketReader().feed(data)
    except Garbled:
        return
    assert 12 * len(packets) <= len(data)


def test_codes_have_words() -> None:
    assert emscon.status_text(14) == "status 14 (parameter 2 out of range)"
    assert emscon.status_text(777) == "status 777 (unknown)"


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


@pytest.mark.parametrize("command", [1, 6, 42, 98, 132])
def test_a_body_that_is_too_short_ends_the_connection(
    peer: EmsconPeer, tracker: Quick, command: int
) -> None:
    peer.answers[command] = lambda _: [reply(command, bytes(3))]
    found = refusal(tracker.connect)
    assert (found.code, found.operation) == ("HC-T02", "decode")
    assert "a reply of 3 bytes" in found.found


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
