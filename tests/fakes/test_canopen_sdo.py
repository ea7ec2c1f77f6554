"""The SDO server, frame by frame: transfers, toggles and the standard's abort codes."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.canopen.slave import Entry, ObjectDictionary, SdoAbortError, SdoServer


def server() -> tuple[SdoServer, ObjectDictionary]:
    objects = ObjectDictionary()
    objects.add(0x2000, 0, Entry("I", 7))
    objects.add(0x2001, 0, Entry("h", 0, allowed=range(-5, 6)))
    objects.add(0x2002, 0, Entry("s", "a name longer than four bytes", "ro"))
    objects.add(0x2003, 0, Entry("s", ""))
    objects.add(0x2004, 0, Entry("B", 1, "wo"))
    objects.add(0x2005, 0, Entry("H", 1, "ro"))
    objects.add(0x2006, 0, Entry("B", 0, write=refuse))
    objects.add_array(0x2010, Entry("H", 1), Entry("H", 2))
    return SdoServer(objects), objects


def refuse(_value: int) -> None:
    raise SdoAbortError(0x08000022)


def ask(sdo: SdoServer, request: str) -> str:
    reply = sdo.answer(bytes.fromhex(request))
    return "" if reply is None else reply.hex().upper()


def test_expedited() -> None:
    sdo, objects = server()
    assert ask(sdo, "4000200000000000") == "4300200007000000"
    assert ask(sdo, "23002000FFFFFFFF") == "6000200000000000"
    assert objects.number(0x2000) == 0xFFFFFFFF
    assert ask(sdo, "2B012000FBFF0000") == "6001200000000000"
    assert objects.number(0x2001) == -5
    assert ask(sdo, "4001200000000000") == "4B012000FBFF0000"
    assert ask(sdo, "22002000AABBCCDD") == "6000200000000000", "size not stated: the object's own"


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("4000300000000000", "00000206"),  # no such object
        ("4010200900000000", "11000906"),  # no such sub-index
        ("2B05200001000000", "02000106"),  # read only
        ("4004200000000000", "01000106"),  # write only
        ("2F00200001000000", "10000706"),  # length
        ("2B01200006000000", "30000906"),  # value range
        ("2F06200001000000", "22000008"),  # device state
        ("2102200010000000", "02000106"),  # segmented download to a read-only object
    ],
)
def test_abort_codes(request_: str, code: str) -> None:
    sdo, _ = server()
    assert ask(sdo, request_) == "80" + request_[2:8] + code


def test_unknown_command_and_stray_segment() -> None:
    sdo, _ = server()
    assert ask(sdo, "E000200000000000") == "8000200001000405"
    assert ask(sdo, "6000000000000000") == "8000000001000405", "no transfer is under way"


def test_segmented_upload() -> None:
    sdo, _ = server()
    text = "a name longer than four bytes"
    first = bytes.fromhex(ask(sdo, "4002200000000000"))
    assert first == bytes([0x41, 0x02, 0x20, 0x00]) + struct.pack("<I", len(text))
    data, toggle = b"", 0
    while True:
        reply = bytes.fromhex(ask(sdo, f"{0x60 | toggle:02X}00000000000000"))
        assert reply[0] & 0x10 == toggle
        data += reply[1 : 8 - (reply[0] >> 1 & 7)]
        toggle ^= 0x10
        if reply[0] & 1:
            break
    assert data.decode() == text
    assert ask(sdo, "7000000000000000")[:2] == "80", "the transfer has ended"


def test_toggle_must_alternate() -> None:
    sdo, _ = server()
    ask(sdo, "4002200000000000")
    ask(sdo, "6000000000000000")
    assert ask(sdo, "6000000000000000") == "8002200000000305"
    assert ask(sdo, "4000200000000000") == "4300200007000000", "the channel works again"


@given(st.text(st.characters(codec="ascii"), max_size=60))
def test_segmented_download(text: str) -> None:
    sdo, objects = server()
    data = text.encode()
    ask(sdo, "21032000" + struct.pack("<I", len(data)).hex())
    pieces = [data[i : i + 7] for i in range(0, len(data), 7)] or [b""]
    for number, piece in enumerate(pieces):
        last = number == len(pieces) - 1
        command = (number & 1) << 4 | (7 - len(piece)) << 1 | last
        reply = sdo.answer(bytes([command]) + piece.ljust(7, b"\0"))
        assert reply is not None
        assert reply[0] == 0x20 | (number & 1) << 4
    assert objects.upload(0x2003, 0) == data


def test_announced_length_must_be_kept() -> None:
    sdo, _ = server()
    ask(sdo, "2103200008000000")
    assert ask(sdo, "0141424344454647") == "8003200010000706"


def test_clients_abort_is_not_answered() -> None:
    sdo, _ = server()
    ask(sdo, "4002200000000000")
    assert ask(sdo, "8002200000000405") == ""
    assert ask(sdo, "6000000000000000")[:2] == "80"
    assert ask(sdo, "40") == "", "a frame that is too short"
