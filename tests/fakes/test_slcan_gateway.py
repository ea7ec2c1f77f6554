"""The gateway's lines, byte by byte, and python-can's handshake with it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import can
import pytest
from can.interfaces.slcan import slcanBus
from hypothesis import given
from hypothesis import strategies as st

from fakes.canopen import slcan_gateway
from fakes.canopen.slcan_gateway import SlcanGateway, decode, encode
from fakes.faults import Faults
from tests.fakes.rail_bench import PATIENT_S, Line, until


class Loopback:
    """A gateway whose bus gives every frame back with identifier + 1."""

    def __init__(self) -> None:
        self.faults = Faults()
        self.opened = 0
        self.frames: list[tuple[int, bytes]] = []
        self.gateway = SlcanGateway(self.faults, self._open, self._frame)

    def _open(self) -> None:
        self.opened += 1

    def _frame(self, cob_id: int, data: bytes) -> None:
        self.frames.append((cob_id, data))
        self.gateway.send(cob_id + 1, data)


@contextmanager
def running() -> Iterator[Loopback]:
    loop, ended = Loopback(), threading.Event()
    wake, waker = socket.socketpair()

    def serve() -> None:
        while not ended.is_set():
            loop.gateway.serve(1.0, wake)
            loop.gateway.flush()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield loop
    finally:
        ended.set()
        waker.send(b"\0")
        thread.join()
        loop.gateway.close()
        wake.close()
        waker.close()


def test_golden_line() -> None:
    data = bytes.fromhex("4064600000000000")
    assert encode(0x605, data) == b"t60584064600000000000\r"
    assert decode(b"t60584064600000000000") == (0x605, data)
    assert encode(0x080, b"") == b"t0800\r"


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_every_frame_survives_its_line(cob_id: int, data: bytes) -> None:
    assert decode(encode(cob_id, data)[:-1]) == (cob_id, data)


@pytest.mark.parametrize(
    "line",
    [b"t", b"t60", b"t6059", b"t605800", b"t0801", b"t08012", b"t0801zz", b"t0800 0", b"\xff"],
)
def test_broken_lines_are_no_frames(line: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - several parsers raise it
        decode(line)


def test_nothing_crosses_a_closed_channel() -> None:
    with running() as loop, Line(loop.gateway.port, opened=False) as line:
        line.send(b"t1230")
        assert line.reply() == b"\a"
        loop.gateway.send(0x123, b"")
        line.send(b"O")
        assert line.reply() == b"\r"
        assert loop.frames == []
        line.send(b"S6")
        assert line.reply() == b"\a", "the bitrate cannot change on an open channel"
        line.send(b"t1230")
        assert [line.reply(), line.reply()] == [b"z\r", b"t1240\r"]
        assert loop.opened == 1


def test_garbage_is_refused_and_forgotten() -> None:
    with running() as loop, Line(loop.gateway.port) as line:
        line.send(b"\xff\x00\x1b[2J")
        assert line.reply() == b"\a"
        line.send_bytes(b"x" * 100)
        assert line.reply() == b"\a"
        line.send(b"")
        assert line.reply() == b"\r"
        line.send(b"t1231AA")
        assert line.frame() == b"t1241AA"


def test_frames_may_come_in_pieces_and_together() -> None:
    with running() as loop, Line(loop.gateway.port) as line:
        for byte in b"t1231AA\r":  # one segment each
            line.send_bytes(bytes([byte]))
        line.send_bytes(b"t2230\rt3230\r")
        wanted = [(0x123, b"\xaa"), (0x223, b""), (0x323, b"")]
        until(lambda: loop.frames == wanted)


def test_python_can_opens_and_exchanges() -> None:
    with running() as loop:
        channel = f"socket://127.0.0.1:{loop.gateway.port}"
        bus = slcanBus(channel, bitrate=500_000, sleep_after_open=0)
        try:
            assert bus.get_version(PATIENT_S) == (10, 13)
            bus.send(can.Message(arbitration_id=0x605, data=b"\x40", is_extended_id=False))
            received = bus.recv(PATIENT_S)
            assert received is not None
            assert (received.arbitration_id, bytes(received.data)) == (0x606, b"\x40")
        finally:
            bus.shutdown()


def test_second_client_after_the_first_vanished_or_was_dropped() -> None:
    with running() as loop:
        Line(loop.gateway.port).__exit__()
        with Line(loop.gateway.port) as line:
            loop.faults.set("rail.eof")
            line.send(b"t1230")
            assert line.reply() == b""
        with Line(loop.gateway.port) as line:
            line.send(b"t1230")
            assert line.frame() == b"t1240"
        assert loop.opened == 3


def test_lines_come_in_pieces_and_late_and_none_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    pauses_s: list[float] = []
    monkeypatch.setattr(slcan_gateway, "time", SimpleNamespace(sleep=pauses_s.append))
    with running() as loop, socket.create_connection(("127.0.0.1", loop.gateway.port)) as client:
        client.sendall(b"O\r")
        whole = b""
        for number in range(200):
            client.sendall(b"t123101\rt123102\r")
            wanted = 1 + (number + 1) * len(b"z\rt124101\rz\rt124102\r")
            while len(whole) < wanted:
                whole += client.recv(4096)
    assert whole == b"\r" + b"z\rt124101\rz\rt124102\r" * 200
    assert 5 < len(pauses_s) < 50
    assert max(pauses_s) <= SlcanGateway.LATE_S
