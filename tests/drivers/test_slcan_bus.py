from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable

import can
import pytest

from drivers.slcan_bus import SlcanBus
from tests.drivers.peers import Server

GOOD = b"t58584064600015CD5B07\r"


def received(data: list[bytes]) -> tuple[list[tuple[int, bytes]], SlcanBus]:
    """Return the frames that a bus makes of ``data`` before the marker frame 7FF."""
    with Server(_says([*data, b"t7FF0\r"])) as server:
        bus = SlcanBus(f"socket://127.0.0.1:{server.port}", 500_000)
        frames = []
        while (message := bus.recv(5.0)) is not None and message.arbitration_id != 0x7FF:
            frames.append((message.arbitration_id, bytes(message.data)))
        assert message is not None
        bus.shutdown()
    return frames, bus


def _says(pieces: list[bytes]) -> Callable[[socket.socket], None]:
    def handle(connection: socket.socket) -> None:
        opened = b""
        while not opened.endswith(b"O\rO\r"):  # python-can opens twice
            opened += connection.recv(100)
        for piece in pieces:
            connection.sendall(piece)
            threading.Event().wait(0.005)
        while connection.recv(100):
            pass

    return handle


FRAME = (0x585, bytes.fromhex("4064600015CD5B07"))


def test_the_channel_is_opened_and_a_frame_is_sent_as_published() -> None:
    heard: list[bytes] = []
    done = threading.Event()

    def listen(connection: socket.socket) -> None:
        while data := connection.recv(100):
            heard.append(data)
            if b"".join(heard).endswith(b"C\r"):
                done.set()

    with Server(listen) as server:
        bus = SlcanBus(f"socket://127.0.0.1:{server.port}", 500_000)
        data = bytes.fromhex("4064600000000000")
        bus.send(can.Message(arbitration_id=0x605, data=data, is_extended_id=False))
        bus.shutdown()
        assert done.wait(5)
    text = b"".join(heard)
    assert text.startswith(b"C\rS6\r")
    assert b"O\rt60584064600000000000\r" in text


@pytest.mark.parametrize(
    "pieces",
    [[GOOD], [GOOD[:7], GOOD[7:]], [bytes([byte]) for byte in GOOD], [b"z\r\r" + GOOD + b"Z\r"]],
)
def test_frames_arrive_whole(pieces: list[bytes]) -> None:
    frames, bus = received(pieces)
    assert frames == [FRAME]
    assert bus.bad_lines == 0


def test_two_frames_may_come_at_once_and_a_time_stamp_is_cut() -> None:
    frames, _ = received([GOOD + b"t70510512AB\r"])
    assert frames == [FRAME, (0x705, b"\x05")]


@pytest.mark.parametrize(
    "bad",
    [
        b"\x80\xff\r",
        b"t58\xb584064600015CD5B07\r",
        b"t5858406460\r",
        b"t585940646000\r",
        b"t58X84064600015CD5B07\r",
        b"hello\r",
        b"T0000058510\r",
        b"x" * 200 + b"\r",
    ],
)
def test_bad_lines_are_dropped_and_counted(bad: bytes) -> None:
    frames, bus = received([bad, GOOD])
    assert frames == [FRAME]
    assert bus.bad_lines >= 1


def test_a_garbage_byte_costs_one_line_only() -> None:
    frames, bus = received([b"\xfe" + GOOD + GOOD])
    assert frames == [FRAME]
    assert bus.bad_lines == 1


def test_a_refusal_is_counted() -> None:
    _, bus = received([b"\a", GOOD])
    assert bus.refused == 1


def test_the_end_of_the_stream_is_an_error_and_leaks_nothing() -> None:
    opened = threading.Event()

    def hang_up(connection: socket.socket) -> None:
        while b"O\r" not in connection.recv(100):
            pass
        opened.wait(5)
        connection.shutdown(socket.SHUT_RDWR)

    with Server(hang_up) as server:
        bus = SlcanBus(f"socket://127.0.0.1:{server.port}", 500_000)
        opened.set()
        with pytest.raises(can.CanOperationError, match=r"closed the connection|failed"):
            bus.recv(5.0)
        with contextlib.suppress(can.CanError):
            bus.shutdown()
        assert not bus.serialPortOrig.is_open


def test_nothing_to_receive_ends_in_time() -> None:
    with Server(_says([])) as server:
        bus = SlcanBus(f"socket://127.0.0.1:{server.port}", 500_000)
        assert bus.recv(0.05) is None
        bus.shutdown()
