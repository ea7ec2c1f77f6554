"""The process between drivers and devices that records: bytes pass it unchanged, in both ways.

``python -P -m hilcell.wire.relay`` reads its order, one line of JSON, prints where it listens, and
ends when its input does. It is a process of its own, so that no work of the engine delays a stop
frame. A device that does not answer, or hangs up, is handed on as such: the driver sees the wire
closed.
"""

from __future__ import annotations

import os
import pty
import select
import socket
import sys
import threading
import tty
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import msgspec
import serial

from hilcell.decoding import decoded
from hilcell.wire.channel import SerialLine, Socket
from hilcell.wire.recording import Recorder

READ = 65536


class WireOrder(msgspec.Struct, frozen=True):
    """One wire: its name, where it leads, and the file of its recording."""

    wire: str
    file: str
    began_s: float  # monotonic; of the recording of all wires
    place: Socket | SerialLine


class Door:
    """Listens in the place of a device, and hands each connection of a driver on at once."""

    def __init__(self, entered: Callable[[socket.socket], None], port: int = 0) -> None:
        loopback = "127.0.0.1"
        self._entered = entered
        self._listening = socket.create_server((loopback, port))
        self.port: int = self._listening.getsockname()[1]
        self.channel = f"socket://{loopback}:{self.port}"
        self._accepting = threading.Thread(target=self._accept, daemon=True)
        self._accepting.start()

    def close(self) -> None:
        """Take no connection any more; the last one has been handed on."""
        with suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self._accepting.join()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listening.accept()
            except OSError:
                return
            self._entered(near)


class SocketRelay:
    """Listens for a driver, and connects to its device for each connection of it."""

    def __init__(self, place: Socket, recorder: Recorder) -> None:
        self._place, self._recorder = place, recorder
        self._count = 0
        self._open: set[int] = set()
        self._door = Door(self._entered)
        self.channel = self._door.channel

    def close(self) -> None:
        """End the recording: without its end a connection would look cut off."""
        for number in sorted(self._open.copy()):
            self._recorder.take(number, "end")
        self._door.close()

    def _entered(self, near: socket.socket) -> None:
        self._count += 1
        threading.Thread(target=self._serve, args=(near, self._count), daemon=True).start()

    def _serve(self, near: socket.socket, number: int) -> None:
        connect_s = 3.0
        with near:
            try:
                far = socket.create_connection((self._place.host, self._place.port), connect_s)
            except OSError as error:
                self._recorder.take(number, "refused", str(error).encode())
                return
            far.settimeout(None)
            self._recorder.take(number, "open")
            self._open.add(number)
            with far:
                for end in (near, far):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                arguments = {"source": far, "sink": near, "number": number, "outward": False}
                back = threading.Thread(target=self._pump, kwargs=arguments, daemon=True)
                back.start()
                self._pump(near, far, number, outward=True)
                back.join()

    def _pump(
        self, source: socket.socket, sink: socket.socket, number: int, *, outward: bool
    ) -> None:
        """Carry bytes one way until that side ends."""
        with suppress(OSError):
            while data := source.recv(READ):
                self._recorder.take(number, ">" if outward else "<", data)
                sink.sendall(data)
        self._open.discard(number)
        self._recorder.take(number, "end" if outward else "lost")
        for each in (source, sink):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)


class SerialRelay:
    """A pseudo terminal in the place of a serial line; raises `OSError` where it cannot be opened.

    The line is one connection for as long as the relay lives.
    """

    def __init__(self, place: SerialLine, recorder: Recorder) -> None:
        self._recorder = recorder
        self._line = serial.Serial(place.path, place.baud, timeout=0, exclusive=True)
        self._near, inner = pty.openpty()
        tty.setraw(inner)
        self.channel = os.ttyname(inner)  # `inner` stays open: a driver may close and come again
        recorder.take(1, "open")
        threading.Thread(target=self._carry, daemon=True).start()

    def close(self) -> None:
        self._recorder.take(1, "end")

    def _carry(self) -> None:
        line: int = self._line.fileno()
        with suppress(OSError):
            while True:
                ready, _, _ = select.select([self._near, line], [], [])
                if self._near in ready:
                    data = os.read(self._near, READ)
                    self._recorder.take(1, ">", data)
                    self._line.write(data)
                if line in ready:
                    data = os.read(line, READ)
                    if not data:
                        break
                    self._recorder.take(1, "<", data)
                    os.write(self._near, data)
        self._recorder.take(1, "lost")
        os.close(self._near)


def main() -> None:
    """Read the order from stdin, print the channels by the names of their wires, and relay."""
    orders = decoded(sys.stdin.buffer.readline(), list[WireOrder])
    with ExitStack() as stack:
        channels: dict[str, str] = {}
        for order in orders:
            file = stack.enter_context(Path(order.file).open("ab"))
            place, recorder = order.place, Recorder(file, order.began_s)
            recorder.take(0, "began", order.wire.encode())
            relay = (
                SocketRelay(place, recorder)
                if isinstance(place, Socket)
                else SerialRelay(place, recorder)
            )
            channels[order.wire] = relay.channel
            stack.callback(relay.close)
        sys.stdout.buffer.write(msgspec.json.encode(channels) + b"\n")
        sys.stdout.buffer.flush()
        sys.stdin.buffer.read()


if __name__ == "__main__":
    main()
