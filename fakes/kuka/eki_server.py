"""EthernetKRL server of a KUKA controller: two channels of XML documents over TCP.

Each channel serves one client. That of the stop is looked at once in a cycle of the submit
interpreter, and all that came until then is heard, even where the client has gone. States leave as
`segments` says, and now and then the former one comes once more, in one segment with the next.
"""

from __future__ import annotations

import select
import socket
import threading
from contextlib import suppress

from fakes.faults import Faults, Vanished
from fakes.kuka.c3_server import controller_of
from fakes.kuka.controller import KrlController
from fakes.kuka.eki_program import RECEIVED, STOP_RECEIVED, EkiProgram, Overflow, Queues
from fakes.kuka.krl import KrlError
from fakes.site import Site
from fakes.time import PlantTime
from fakes.wires.listener import HOST, Listener
from fakes.wires.segments import RECEIVE, Answers, Segments

BOMB = (
    b'<!DOCTYPE RobotState [<!ENTITY a "1"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    b'<RobotState><Command Id="&b;"/></RobotState>'
)


class EkiServer:
    """Serves one controller on two ports, 0 for ones that the system chooses."""

    def __init__(
        self, controller: KrlController, faults: Faults, time: PlantTime, *, port: int = 0
    ) -> None:
        self._controller, self._faults, self._time = controller, faults, time
        self._program = EkiProgram(controller, faults, time)
        self._closing = threading.Event()
        self._answers = Answers(faults, self._closing)
        self._lock = threading.Lock()  # of the submit interpreter, which is one
        stop_port = port + 1 if port else 0
        self._commands = Listener("eki", self._serve_commands, limit=1, port=port)
        self._stops = Listener("eki stop", self._serve_stops, limit=1, port=stop_port)
        self.port, self.stop_port = self._commands.port, self._stops.port

    @property
    def address(self) -> dict[str, object]:
        """Return where it listens, as options of the driver."""
        return {"host": HOST, "port": self.port, "stop_port": self.stop_port}

    def restore(self) -> None:
        """Put the controller right, as an operator does."""
        self._controller.restore()

    def start(self) -> None:
        """Begin to serve."""
        self._commands.start()
        self._stops.start()

    def close(self) -> None:
        """Stop serving."""
        self._closing.set()
        self._commands.close()
        self._stops.close()

    def _serve_commands(self, client: socket.socket) -> None:
        try:
            self._hear_commands(client)
        except Vanished:
            self._hang_up()
            return
        except (OSError, Overflow, KrlError, ValueError):
            pass  # the client has gone, or the interface closes the connection
        self._lose()

    def _hear_commands(self, client: socket.socket) -> None:
        segments, former = Segments(client), b""
        queues, pending = Queues(RECEIVED), b""
        while data := client.recv(RECEIVE):
            pending = _add(queues, pending + data, b"</RobotCommand>")
            while queues.waiting():
                with self._lock:
                    state = self._program.command(queues.take())
                    self._time.catch_up()
                    sent, former = self._spoilt(former, state, segments), state
                    if not self._answers.send(client, segments, sent):
                        return

    def _lose(self) -> None:
        try:
            with self._lock:
                if not self._closing.is_set():
                    self._program.lose()
        except Vanished:
            self._hang_up()

    def _serve_stops(self, client: socket.socket) -> None:
        queues, pending, there = Queues(STOP_RECEIVED), b"", True
        cycle_s = 0.06  # of the submit interpreter, with a state in it
        try:
            while there:
                select.select([client], [], [])
                self._closing.wait(cycle_s)
                pending, there = _look(client, queues, pending, b"</RobotStop>")
                self._hear_stops(client, queues, there)
        except Vanished:
            self._hang_up()
        except (KrlError, ValueError):
            return

    def _hear_stops(self, client: socket.socket, queues: Queues, there: bool) -> None:
        while queues.waiting():
            with self._lock:
                answer = self._program.stop(queues.take())
            if there:
                with suppress(OSError):  # the next look finds that it has gone
                    client.sendall(answer)

    def _hang_up(self) -> None:
        self._commands.hang_up()
        self._stops.hang_up()

    def _spoilt(self, former: bytes, state: bytes, segments: Segments) -> bytes:
        """Return what is sent for a state."""
        if self._faults.take("robot.xml_bomb") is not None:
            return BOMB
        endless = b'<RobotState><Pos A1="' + b"0" * 20_000
        if self._faults.take("robot.no_end") is not None:
            return endless
        again = self._faults.take("robot.glued_reply") is not None
        twice_every = 53
        return former + state if again or segments.sent % twice_every == twice_every - 1 else state


def _look(client: socket.socket, queues: Queues, pending: bytes, end: bytes) -> tuple[bytes, bool]:
    """Take apart what has come; return the rest, and whether the client is still there."""
    try:
        while select.select([client], [], [], 0)[0]:
            data = client.recv(RECEIVE)
            if not data:
                return pending, False
            pending = _add(queues, pending + data, end)
    except (OSError, Overflow, KrlError):
        return pending, False  # the interface closes the connection, and keeps what came
    return pending, True


def _add(queues: Queues, received: bytes, end: bytes) -> bytes:
    """Take whole documents apart; return the rest."""
    *documents, rest = received.split(end)
    for document in documents:
        queues.add(document + end)
    return rest


def serve(site: Site, port: int) -> EkiServer:
    """Return the robot of a simulated cell behind EthernetKRL."""
    return EkiServer(controller_of(site), site.faults, site.time, port=port)
