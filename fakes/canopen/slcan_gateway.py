"""A CAN gateway that speaks slcan (the Lawicel ASCII protocol), over TCP or on a serial line.

Every command ends with CR and is answered: CR for done, ``z`` CR for a frame sent, BELL for
refused. As on any gateway lines arrive joined, split, or slightly late. TCP serves one client
at a time. A client may discard what arrives before its ``O`` (open); so nothing is sent
unasked until the channel is open.
"""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np

from fakes.canopen.slave import CanopenSlave
from fakes.faults import Faults
from fakes.time import PAUSE_S, DeviceTime
from fakes.wires import HOST, RECEIVE, SerialEnd, Server, listen


def encode(cob_id: int, data: bytes) -> bytes:
    """Return the line of a frame with an 11-bit identifier."""
    return f"t{cob_id:03X}{len(data):d}{data.hex().upper()}\r".encode("ascii")


def decode(line: bytes) -> tuple[int, bytes]:
    """Return identifier and data of a ``t`` line without its CR; raises ValueError."""
    length = int(line[4:5])
    data = bytes.fromhex(line[5:].decode("ascii"))
    if line[:1] != b"t" or len(line) != 5 + 2 * length or length > 8 or len(data) != length:
        raise ValueError(f"not a frame: {line!r}")
    return int(line[1:4], 16), data


class SlcanGateway:
    """Listens on loopback, or has a ``serial`` line.

    ``on_open()`` and ``on_frame(cob_id, data)`` go to the bus.
    """

    SEND_DEADLINE_S = 0.2
    LATE_SHARE, LATE_S = 0.1, 0.001  # this share of sendings is late by up to this, whole or split
    OK, REFUSED = b"\r", b"\a"

    def __init__(
        self,
        faults: Faults,
        on_open: Callable[[], None],
        on_frame: Callable[[int, bytes], None],
        *,
        port: int = 0,
        serial: bool = False,
    ) -> None:
        self._faults = faults
        self._on_open, self._on_frame = on_open, on_frame
        self._line = SerialEnd(self.SEND_DEADLINE_S) if serial else None
        self._listener: socket.socket | None = None if serial else listen(port)
        self.port = 0 if self._listener is None else int(self._listener.getsockname()[1])
        self.channel = self._line.channel if self._line else f"socket://{HOST}:{self.port}"
        self._client: socket.socket | SerialEnd | None = self._line
        self._received = b""
        self._sending = b""
        self._opened = self._stalled = self._off = False
        self._held = b""  # a frame that changes places with the next one
        self._jitter_rng = np.random.default_rng(0)

    def serve(self, timeout_s: float, wake: socket.socket) -> None:
        """Handle clients' bytes for ``timeout_s``; bytes on ``wake`` end the wait early."""
        waiting = self._client or self._listener
        ready, _, _ = select.select([waiting, wake] if waiting else [wake], [], [], timeout_s)
        if self._client in ready:
            self._receive()
        elif self._listener in ready:
            self._accept()

    def send(self, cob_id: int, data: bytes) -> None:
        """Queue a frame for the client; without an open channel it is lost, as on a real bus."""
        if not self._opened or self._off:
            return
        garbage = self._faults.take("rail.garbage")
        if garbage is not None:
            self._put(bytes([0x80 | int(garbage) & 0x7F]))
        line, before = encode(cob_id, data), self._held
        self._held = b"" if before or not self._faults.take("rail.swapped_frames") else line
        if not self._held:
            self._put(line + before)
        if self._faults.strikes("rail.double_frame"):
            self._put(line)

    def flush(self) -> None:
        """Send the queue; a client that does not read it in time is disconnected."""
        if self._client is not None and self._sending:
            try:
                if self._jitter_rng.random() < self.LATE_SHARE:
                    cut = int(self._jitter_rng.integers(len(self._sending)))
                    self._client.sendall(self._sending[:cut])
                    self._sending = self._sending[cut:]
                    time.sleep(self._jitter_rng.uniform(0.0, self.LATE_S))
                self._client.sendall(self._sending)
            except OSError:
                self.drop()
        self._sending = b""

    def drop(self) -> None:
        """Close the client's connection; the next client may come. A line is only shut off."""
        if self._client is not None and self._client is not self._line:
            self._client.close()
        self._client, self._opened, self._stalled, self._off = self._line, False, False, False
        self._held = b""
        self._received = self._sending = b""

    def close(self) -> None:
        if self._listener is not None:
            self._listener.close()
        self._listener = None
        line, self._line = self._line, None
        self.drop()
        if line is not None:
            line.close()

    def _accept(self) -> None:
        if self._listener is not None:
            client, _ = self._listener.accept()
            client.settimeout(self.SEND_DEADLINE_S)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client

    def _receive(self) -> None:
        client = self._client
        if client is None:
            return
        try:
            data = client.recv(RECEIVE)
        except OSError:
            data = b""
        if not data:
            self.drop()
            return
        *lines, rest = (self._received + data).split(b"\r")
        self._received = rest
        for line in lines:
            self._obey(line)
            if self._client is None:
                return
        longest_line = 64
        if len(rest) > longest_line:
            self._received = b""
            self._put(self.REFUSED)

    def _put(self, data: bytes) -> None:
        if not self._stalled:
            self._sending += data

    def _obey(self, line: bytes) -> None:
        match line[:1]:
            case b"t":
                self._transmit(line)
            case b"T" | b"r" | b"R":
                # Extended and remote frames cross the bus; no node here listens to them.
                done = b"Z\r" if line[:1] in b"TR" else b"z\r"
                self._put(done if self._opened else self.REFUSED)
            case b"O" | b"L":
                self._put(self.OK)
                if not self._opened:
                    self._opened = True
                    self._on_open()
            case b"C":
                self._opened = False
                self._put(self.OK)
            case b"S" | b"s":
                self._put(self.REFUSED if self._opened else self.OK)
            case other:
                answers = {b"": self.OK, b"V": b"V1013\r", b"N": b"NHC01\r", b"F": b"F00\r"}
                self._put(answers.get(other, self.REFUSED))

    def _transmit(self, line: bytes) -> None:
        try:
            cob_id, data = decode(line)
        except ValueError:
            self._put(self.REFUSED)
            return
        if self._faults.strikes("rail.eof"):
            self.drop()
            return
        self._stalled = self._faults.strikes("rail.stalled")
        self._off = self._off or self._faults.strikes("rail.bus_off")
        if not self._opened or self._off or self._faults.strikes("rail.nack"):
            self._put(self.REFUSED)
            return
        self._put(b"z\r")
        self._on_frame(cob_id, data)


class BusServer(Server):
    """Serves the nodes of one bus behind a gateway, in one thread.

    Without a ``port`` the gateway is on the serial line that the ``stated`` channel names, if any.
    """

    IDLE_S = 0.5

    def __init__(self, name: str, faults: Faults, stated: Mapping[str, object], port: int) -> None:
        """``faults`` are the gateway's."""
        serial = str(stated.get("channel", "")).startswith("/") and not port
        self._gateway = SlcanGateway(faults, self._open, self._receive, port=port, serial=serial)
        self.port = self._gateway.port
        address: dict[str, object] = {"channel": self._gateway.channel}
        slcan = "slcan"
        if stated.get("interface", slcan) != slcan:  # of the kernel, which is served as well
            address["interface"] = slcan
        super().__init__(address)
        self._nodes: dict[int, CanopenSlave] = {}
        self._booted = False
        self.now_s = DeviceTime().now_s
        self._wake, self._waker = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name=name)

    def start(self) -> None:
        super().start()
        self._thread.start()

    def close(self) -> None:
        """Switch the bus off and return when the thread has ended."""
        super().close()
        with suppress(OSError):
            self._waker.send(b"\0")
        if self._thread.is_alive():
            self._thread.join()
        self._gateway.close()
        self._wake.close()
        self._waker.close()

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._gateway.serve(min(self._wait_s(), PAUSE_S), self._wake)
                self._tick(self.now_s())
                self._gateway.flush()
        finally:
            # Should a fault's value make no sense here, clients see the end, not silence.
            self._gateway.close()

    def _open(self) -> None:
        if not self._booted:
            self._booted = True
            for node in self._nodes.values():
                node.boot(self.now_s())

    def _receive(self, cob_id: int, data: bytes) -> None:
        now_s = self.now_s()
        for node in self._nodes.values():
            node.receive(cob_id, data, now_s)

    def _wait_s(self) -> float:
        due_s = min(node.next_s() for node in self._nodes.values())
        return min(max(0.0, due_s - self.now_s()), self.IDLE_S)

    def _tick(self, now_s: float) -> None:
        for node in self._nodes.values():
            node.tick(now_s)
