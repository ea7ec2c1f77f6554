"""Packets of emScon, and settings of its tracker that another program changes."""

from __future__ import annotations

import struct

import pytest
from CESAPI import packet as cesapi
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.device_errors import ProtocolError
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
        ("10000000000000003100000000000000", [Reply(49, 0, b"")]),
        ("1000000001000000310000001a000000", [Failure(49, 26)]),
        ("0c000000080000001b000000", [StatusChange(27)]),
        ("0c000000630000001b000000", []),  # of a type that is not used here
        (RESULT.hex(), [Single(0, XYZ, STD, 0.009, AIR)]),
    ],
)
def test_packets_are_the_published_bytes(data: str, expected: list[Packet]) -> None:
    ready = "0c0000000800000019000000"  # the next packet is read as well
    assert PacketReader().feed(bytes.fromhex(data + ready)) == [*expected, StatusChange(25)]


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
    assert emscon.command_name(Setting.MEASUREMENT_MODE.read) == "get measurement mode"
    assert emscon.command_name(Setting.UNITS.write) == "set units"
    assert emscon.command_name(Command.GO_POSITION) == "go position"


def test_a_result_is_the_published_bytes() -> None:
    assert len(RESULT) == 156
    assert RESULT[20:44].hex() == "000000000031914000000000000004c0000000000000c03f"
    assert RESULT[-24:].hex() == "00000000008036400000000000aa8f400000000000804640"


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
    with pytest.raises(ProtocolError, match=str(count)):
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
    status.weatherMonitorStatus, status.laserStatus, status.admStatus = 1, 3, 2
    (reply,) = PacketReader().feed(status.pack())
    assert isinstance(reply, Reply)
    assert SystemStatus.decode(reply.body) == SystemStatus(5, 3, 2, "3.0.900", 1, 390793)
    reflector = cesapi.GetReflectorsRT()
    reflector.iTotalReflectors, reflector.iInternalReflectorId = 2, 7
    reflector.dSurfaceOffset = 19.05
    reflector.cReflectorName = "SMR 1.5in".encode("utf-16-le").ljust(64, b"\0")
    (reply,) = PacketReader().feed(reflector.pack())
    assert isinstance(reply, Reply)
    assert Reflector.decode(reply.body) == Reflector(2, 7, 19.05, "SMR 1.5in")


@pytest.mark.parametrize(
    ("size", "kind", "named"),
    [
        *((size, 8, str(size)) for size in (0, 4, 11, 65537, 2**31, 2**32 - 1)),  # impossible ones
        *((size, kind, f"type {kind}") for kind, size in ((0, 12), (1, 12), (2, 152))),  # too short
    ],
)
def test_packets_of_another_size_are_refused(size: int, kind: int, named: str) -> None:
    with pytest.raises(ProtocolError, match=named):
        PacketReader().feed(struct.pack("<II", size, kind) + bytes(max(0, min(size, 200) - 8)))


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
    except ProtocolError:
        return
    assert 12 * len(packets) <= len(data)


def test_codes_have_texts() -> None:
    assert emscon.status_text(14) == "status 14 (parameter 2 out of range)"
    assert emscon.status_text(777) == "status 777 (unknown)"
