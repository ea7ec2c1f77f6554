from __future__ import annotations

import struct
import threading
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.kuka import c3
from drivers.kuka.c3 import C3Connection, C3Error
from hilcell.ports import DeviceError, Stopped
from tests.drivers.peers import Server, scripted

CHARGE_OK = bytes.fromhex("0100001000000a234348415247455f4f4b000101")


@pytest.fixture(autouse=True)
def short_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c3, "REPLY_S", 0.3)


def test_requests_are_the_published_bytes() -> None:
    assert c3.encode_read(0x0100, "$ACCU_STATE").hex() == "0100000e00000b24414343555f5354415445"
    assert c3.encode_write(0x0100, "$OV_PRO", "35").hex() == "0100000e010007244f565f50524f00023335"
    assert c3.encode_read(1, "$POS_ACT").hex() == "0001000b00000824504f535f414354"
    assert c3.encode_read(2, "$MODE_OP").hex() == "0002000b000008244d4f44455f4f50"


def decode(data: bytes) -> c3.Reply:
    tag, length = c3.decode_header(data[:4])
    assert length == len(data) - 4
    return c3.decode_body(tag, data[4:])


def test_replies_are_the_published_bytes() -> None:
    assert decode(CHARGE_OK) == c3.Reply(0x0100, 0, "#CHARGE_OK", 1, ok=True)
    written = decode(bytes.fromhex("010000080100023335000101"))
    assert written == c3.Reply(0x0100, 1, "35", 1, ok=True)
    assert decode(bytes.fromhex("00020009000003234558000101")).value == "#EX"


@pytest.mark.parametrize("footer", ["000100", "000000", "00ff00"])
def test_only_the_last_byte_says_success(footer: str) -> None:
    assert not decode(bytes.fromhex("00020006000000" + footer)).ok


def test_both_independent_peers_agree() -> None:
    import py_openshowvar

    peer = object.__new__(py_openshowvar.openshowvar)
    peer.msg_id, peer.varname, peer.value = 77, b"HC_TGT", b"{E6AXIS: A1 1.0}"
    assert peer._pack_read_req() == c3.encode_read(77, "HC_TGT")
    assert peer._pack_write_req() == c3.encode_write(77, "HC_TGT", "{E6AXIS: A1 1.0}")


@given(st.binary(max_size=40))
def test_any_bytes_decode_or_are_refused(data: bytes) -> None:
    try:
        reply = c3.decode_body(1, data) if len(data) >= 6 else None
    except C3Error:
        return
    assert reply is None or len(reply.value) == len(data) - 6


@given(st.text(st.characters(max_codepoint=255), max_size=60), st.integers(1, 0xFFFF))
def test_a_value_survives_the_trip(value: str, tag: int) -> None:
    request = c3.encode_write(tag, "X", value)
    (size,) = struct.unpack_from(">H", request, 8)
    assert request[10 : 10 + size].decode("latin-1") == value


@pytest.mark.parametrize("length", [0, 5, 4097, 0xFFFF])
def test_impossible_lengths_are_refused(length: int) -> None:
    with pytest.raises(C3Error, match="announced"):
        c3.decode_header(struct.pack(">HH", 1, length))


def ask(
    pieces: list[bytes], use: Callable[[C3Connection], object] = lambda c: c.read("$MODE_OP")
) -> object:
    """Return what ``use`` makes of a server that answers the first request with ``pieces``."""
    surprises: list[bytes] = []
    script = [(c3.encode_read(1, "$MODE_OP"), pieces)]
    with Server(scripted(script, surprises)) as server:
        connection = C3Connection("Robot", "127.0.0.1", server.port, lambda: None)
        try:
            return use(connection)
        finally:
            connection.close()
            assert surprises == []


MODE = bytes.fromhex("00010009000003234558000101")


def test_a_reply_in_single_bytes_is_put_together() -> None:
    assert ask([bytes([byte]) for byte in MODE]) == "#EX"


def test_a_reply_split_at_byte_five_is_put_together() -> None:
    assert ask([MODE[:5], MODE[5:]]) == "#EX"


@pytest.mark.parametrize(
    ("pieces", "message"),
    [
        ([b"\x00\x09" + MODE[2:]], "tag 9 came, 1 was asked"),
        ([b"\x00\x01\x00\x00"], "0 bytes is announced"),
        ([b"\x00\x01\xff\xff"], "65535 bytes is announced"),
        ([MODE[:4] + b"\x00\x00\x09" + MODE[7:]], "a value of 9 bytes"),
        ([MODE[:6]], "no answer within 0.3 s"),
        ([], "no answer within 0.3 s"),
        ([bytes.fromhex("00010009000003234558000100")], "refused with error 1"),
    ],
)
def test_a_bad_reply_is_an_error(pieces: list[bytes], message: str) -> None:
    with pytest.raises(DeviceError, match=message):
        ask(pieces)


def test_a_connection_that_missed_a_reply_is_never_used_again() -> None:
    def twice(connection: C3Connection) -> object:
        with pytest.raises(DeviceError, match="no answer"):
            connection.read("$MODE_OP")
        return connection.read("$MODE_OP")

    with pytest.raises(DeviceError, match="read \\$MODE_OP was never answered"):
        ask([], twice)


def test_a_stop_ends_the_wait_for_a_reply() -> None:
    stop = threading.Event()

    def check() -> None:
        if stop.is_set():
            raise Stopped("a stop was asked for")

    with Server(scripted([], [])) as server:
        connection = C3Connection("Robot", "127.0.0.1", server.port, check)
        stop.set()
        with pytest.raises(Stopped):
            connection.read("$MODE_OP")
        connection.close()


def test_a_closed_server_is_an_error() -> None:
    with Server(lambda connection: connection.close()) as server:
        connection = C3Connection("Robot", "127.0.0.1", server.port, lambda: None)
        with pytest.raises(DeviceError, match=r"closed the connection|reset|Broken pipe"):
            connection.read("$MODE_OP")
        connection.close()


def test_nobody_listening_is_named() -> None:
    with Server(lambda connection: None) as server:
        port = server.port
    with pytest.raises(DeviceError, match=f"Robot: connect: 127.0.0.1:{port}.*refused"):
        C3Connection("Robot", "127.0.0.1", port, lambda: None)
