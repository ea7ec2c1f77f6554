from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import supervision
from drivers.device_errors import ProtocolError
from drivers.kuka import robot_c3 as c3
from drivers.kuka.robot_c3 import C3Connection
from hilcell.ports import DeviceError, Stopped
from tests.drivers.peers import Server, WireTime, scripted, wire_time

CHARGE_OK = bytes.fromhex("0100001000000a234348415247455f4f4b000101")


def test_requests_are_the_published_bytes() -> None:
    assert c3.encode(0x0100, "$ACCU_STATE").hex() == "0100000e00000b24414343555f5354415445"
    assert c3.encode(0x0100, "$OV_PRO", "35").hex() == "0100000e010007244f565f50524f00023335"
    assert c3.encode(1, "$POS_ACT").hex() == "0001000b00000824504f535f414354"
    assert c3.encode(2, "$MODE_OP").hex() == "0002000b000008244d4f44455f4f50"


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
    assert peer._pack_read_req() == c3.encode(77, "HC_TGT")
    assert peer._pack_write_req() == c3.encode(77, "HC_TGT", "{E6AXIS: A1 1.0}")


@given(st.binary(max_size=40))
def test_any_bytes_decode_or_are_refused(data: bytes) -> None:
    try:
        reply = c3.decode_body(1, data) if len(data) >= 6 else None
    except ProtocolError:
        return
    assert reply is None or len(reply.value) == len(data) - 6


@given(st.text(st.characters(max_codepoint=255), max_size=60), st.integers(1, 0xFFFF))
def test_a_value_survives_the_trip(value: str, tag: int) -> None:
    request = c3.encode(tag, "X", value)
    (size,) = struct.unpack_from(">H", request, 8)
    assert request[10 : 10 + size].decode("latin-1") == value


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> WireTime:
    return wire_time(monkeypatch, supervision)


@contextlib.contextmanager
def asked(*pieces: bytes, check: Callable[[], None] = lambda: None) -> Iterator[C3Connection]:
    """Yield a connection to a server that answers the first request with ``pieces``."""
    surprises: list[bytes] = []
    script = [(c3.encode(1, "$MODE_OP"), list(pieces))]
    with Server(scripted(script, surprises)) as server:
        connection = C3Connection("127.0.0.1", server.port, check)
        with contextlib.closing(connection):
            yield connection
    assert surprises == []


def code_of(act: Callable[[], object]) -> str:
    with pytest.raises(DeviceError) as error:
        act()
    return error.value.code


MODE = bytes.fromhex("00010009000003234558000101")


@pytest.mark.usefixtures("time")
@pytest.mark.parametrize("pieces", [[bytes([byte]) for byte in MODE], [MODE[:5], MODE[5:]]])
def test_a_reply_in_pieces_is_put_together(pieces: list[bytes]) -> None:
    with asked(*pieces) as connection:
        assert connection.read("$MODE_OP") == "#EX"


@pytest.mark.usefixtures("time")
@pytest.mark.parametrize(
    ("reply", "code"),
    [
        (b"\x00\x09" + MODE[2:], "HC-B02"),  # another tag
        (b"\x00\x01\x00\x05" + MODE[4:], "HC-B02"),  # impossible lengths
        (b"\x00\x01\x10\x01" + MODE[4:], "HC-B02"),
        (MODE[:4] + b"\x00\x00\x09" + MODE[7:], "HC-B02"),  # a value longer than its body
        (bytes.fromhex("00010009000003234558000100"), "HC-B03"),  # refused
    ],
)
def test_a_bad_reply_is_an_error(reply: bytes, code: str) -> None:
    with asked(reply) as connection:
        assert code_of(lambda: connection.read("$MODE_OP")) == code


@pytest.mark.parametrize("pieces", [[], [MODE[:6]]])
def test_a_connection_that_missed_a_reply_is_never_used_again(
    pieces: list[bytes], time: WireTime
) -> None:
    time.silence(0.1)
    with asked(*pieces) as connection:
        for _ in range(2):  # the server knows no second question
            assert code_of(lambda: connection.read("$MODE_OP")) == "HC-B02"


def test_a_stop_ends_the_wait_for_a_reply_and_the_connection_is_not_used_again(
    time: WireTime,
) -> None:
    with asked(check=time.check) as connection:
        time.stop.set()
        with pytest.raises(Stopped):
            connection.read("$MODE_OP")
        time.stop.clear()
        time.silence(0.1)
        assert code_of(lambda: connection.read("$MODE_OP")) == "HC-B02"  # nothing is asked


def test_a_stop_goes_out_though_a_request_is_in_flight() -> None:
    came, written = b"", c3.encode(2, "HC_STOP", "TRUE")
    asked_first, stopped, ended = threading.Event(), threading.Event(), threading.Event()
    seen = threading.Event()

    def hear(connection: socket.socket) -> None:
        nonlocal came
        while not came.endswith(written) and (piece := connection.recv(4096)):
            came += piece
            asked_first.set()
        stopped.set()
        seen.wait()  # the connection ends here

    def read() -> None:
        with contextlib.suppress(DeviceError):
            connection.read("$MODE_OP")
        ended.set()

    with Server(hear) as server:
        connection = C3Connection("127.0.0.1", server.port, lambda: None)
        thread = threading.Thread(target=read)
        thread.start()
        assert asked_first.wait(c3.REPLY_S)
        connection.write_without_reply("HC_STOP", "TRUE")
        came_while_waiting = stopped.wait(c3.REPLY_S) and not ended.is_set()
        seen.set()
        thread.join()
        assert came_while_waiting
        connection.close()


def test_a_closed_server_is_an_error(time: WireTime) -> None:
    with Server(lambda connection: connection.close()) as server:
        connection = C3Connection("127.0.0.1", server.port, time.check)
        assert code_of(lambda: connection.read("$MODE_OP")) == "HC-B02"
        connection.close()
    assert code_of(lambda: C3Connection("127.0.0.1", server.port, time.check)) == "HC-B01"
