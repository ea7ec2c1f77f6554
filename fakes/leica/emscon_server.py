"""emScon TPI server: one tracker's packets over TCP (protocols, section 3).

While something takes its time the client may still send: StopMeasurement is obeyed, all else is
answered with "busy". In stepped time nothing takes time, and results follow at once. Samples of a
stream are sent when their time has come: in stepped time by the thread that lets it pass.
"""

from __future__ import annotations

import socket
import struct
import threading

from fakes.faults import Faults
from fakes.leica.emscon_device import EmsconDevice, SampleStream
from fakes.leica.emscon_packets import COMMAND, HEAD, Change, Command, Status, reply, status_change
from fakes.site import Site
from fakes.time import PlantTime
from fakes.wires import HOST, Connection, Listener, Segments, Server


class EmsconServer(Server):
    """Serves one tracker on a port, 0 for one that the system chooses."""

    def __init__(
        self, device: EmsconDevice, faults: Faults, time: PlantTime, *, port: int = 0
    ) -> None:
        self._device, self._faults, self._time = device, faults, time
        listener = Listener("emscon", self._serve, port=port)
        self.port = listener.port
        super().__init__({"host": HOST, "port": self.port}, listener)

    def _serve(self, client: socket.socket) -> None:
        session = _Session(client)
        while True:
            packet = session.receive(None)
            if packet is not None:
                self._obey(session, packet)

    def _obey(self, session: _Session, packet: bytes) -> None:
        answer = self._device.handle(packet)
        if answer.stream is None:
            session.send(b"".join(answer.packets))
        while (later := answer.later) is not None:
            if not self._let_pass(session, later.duration_s):
                return
            answer = later.finish()
            data = b"".join(answer.packets)
            if later.measures:
                self._send_damaged(session, data)
            else:
                session.send(data)
        if answer.stream is not None:
            after = self._stream(session, answer.stream, b"".join(answer.packets))
            if after is not None:
                self._obey(session, after)

    def _stream(self, session: _Session, stream: SampleStream, head: bytes) -> bytes | None:
        """Send samples until the client stops it; return a packet that came after their end.

        The client lets time pass as soon as it has the reply, so the stream is followed before that
        reply, and no longer followed before the reply to the stop.
        """
        lock = threading.Lock()

        def send() -> None:
            with lock:
                try:
                    session.send(stream.due())
                except OSError:
                    stream.close()

        stream_look_s = 0.05  # plant time between two looks for samples that are due
        look_s = None if self._time.stepped else stream_look_s / self._time.speed
        self._time.follow(send)
        try:
            with lock:
                session.send(head)
            while True:
                packet = session.receive(look_s)
                if packet is None:
                    send()
                    continue
                _, _, command = COMMAND.unpack_from(packet)
                with lock:
                    stopped = command == Command.STOP_MEASUREMENT
                    if not stopped and not stream.ended:
                        session.send(reply(command, Status.BUSY))
                        continue
                    rest = stream.stop()
                    self._time.unfollow(send)
                    if not stopped:
                        return packet
                    session.send(rest + reply(command))
                    return None
        finally:
            self._time.unfollow(send)
            with lock:
                stream.close()

    def _let_pass(self, session: _Session, duration_s: float) -> bool:
        """Let plant time pass; return False where the client stopped the command meanwhile."""
        for left_s in self._time.passing(duration_s):
            packet = session.receive(left_s)
            if packet is None:
                continue
            _, _, command = COMMAND.unpack_from(packet)
            if command == Command.STOP_MEASUREMENT:
                session.send(reply(command))
                return False
            session.send(reply(command, Status.BUSY))
        return True

    def _send_damaged(self, session: _Session, data: bytes) -> None:
        """Send a result's bytes as the faults want them on the wire."""
        take = self._faults.take
        if take("tracker.eof") is not None:
            raise ConnectionAbortedError
        session.results += 1
        late_every, late_s = 5, 0.001  # results that come well after their acknowledgement
        if session.results % late_every == 0:
            self._closing.wait(late_s)
        weather_every = 7  # results with news of the air glued to them
        if session.results % weather_every == 0:
            data = status_change(Change.ENVIRONMENT) + data
        if take("tracker.length_zero") is not None:
            data = struct.pack("<iI", 0, 2)
        if take("tracker.length_huge") is not None:
            data = struct.pack("<II", 2**31, 2)
        if take("tracker.glued_packets") is not None:
            data = status_change(Change.ENVIRONMENT) + data + status_change(Change.ENVIRONMENT)
        if take("tracker.split_packet") is not None:
            session.segments.send_in_two(data, 5)
        else:
            session.send(data)


class _Session:
    def __init__(self, client: socket.socket) -> None:
        self._client, self.segments = Connection(client), Segments(client.sendall)
        self._pending = b""
        self.results = 0

    def send(self, data: bytes) -> None:
        if data:
            self.segments.send(data)

    def receive(self, timeout_s: float | None) -> bytes | None:
        """Return the next packet, None after the timeout; raises OSError at the end."""
        while (packet := self._take()) is None:
            if not (data := self._client.receive(timeout_s)):
                return None
            self._pending += data
        return packet

    def _take(self) -> bytes | None:
        if len(self._pending) < HEAD.size:
            return None
        size, _ = HEAD.unpack_from(self._pending)
        longest = 4096
        if not COMMAND.size <= size <= longest:
            raise ConnectionAbortedError
        if len(self._pending) < size:
            return None
        packet, self._pending = self._pending[:size], self._pending[size:]
        return packet


def serve(site: Site, port: int) -> EmsconServer:
    plant = site.plant
    streams = None if plant.streams is None else (plant.streams, site.time)
    device = EmsconDevice(site.cell, plant.tracker, site.faults, streams)
    return EmsconServer(device, site.faults, site.time, port=port)
