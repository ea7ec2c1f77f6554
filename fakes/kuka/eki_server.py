"""EthernetKRL server of a KUKA controller: two channels of XML documents over TCP.

Each channel serves one client. States leave as `segments` says, and now and then the former
one comes once more, in one segment with the next.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable

from fakes.faults import Faults, Vanished
from fakes.kuka.c3_server import controller_of
from fakes.kuka.controller import KrlController
from fakes.kuka.eki_program import RECEIVED, STOP_RECEIVED, EkiProgram, Overflow, Queues
from fakes.kuka.krl import KrlError
from fakes.site import Site
from fakes.time import PlantTime
from fakes.wires.listener import HOST, Listener
from fakes.wires.segments import RECEIVE, Answers, Segments

TWICE_EVERY = 53
ENDLESS = b'<RobotState><Pos A1="' + b"0" * 20_000
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
        segments, former = Segments(client), b""

        def answer(values: dict[str, str]) -> bool:
            nonlocal former
            state = self._program.command(values)
            self._time.catch_up()
            sent, former = self._spoilt(former, state, segments), state
            return self._answers.send(client, segments, sent)

        self._serve(client, Queues(RECEIVED), b"</RobotCommand>", answer)

    def _serve_stops(self, client: socket.socket) -> None:
        def answer(values: dict[str, str]) -> bool:
            client.sendall(self._program.stop(values))
            return True

        self._serve(client, Queues(STOP_RECEIVED), b"</RobotStop>", answer)

    def _serve(
        self,
        client: socket.socket,
        queues: Queues,
        end: bytes,
        answer: Callable[[dict[str, str]], bool],
    ) -> None:
        pending = b""
        try:
            while data := client.recv(RECEIVE):
                *documents, pending = (pending + data).split(end)
                for document in documents:
                    queues.add(document + end)
                while queues.waiting():
                    with self._lock:
                        stays = answer(queues.take())
                    if not stays:
                        return
        except Vanished:
            self._commands.hang_up()
            self._stops.hang_up()
        except (Overflow, KrlError, ValueError):
            return  # the interface closes the connection

    def _spoilt(self, former: bytes, state: bytes, segments: Segments) -> bytes:
        """Return what is sent for a state."""
        if self._faults.take("robot.xml_bomb") is not None:
            return BOMB
        if self._faults.take("robot.no_end") is not None:
            return ENDLESS
        again = self._faults.take("robot.glued_reply") is not None
        return former + state if again or segments.sent % TWICE_EVERY == TWICE_EVERY - 1 else state


def serve(site: Site, port: int) -> EkiServer:
    """Return the robot of a simulated cell behind EthernetKRL."""
    return EkiServer(controller_of(site), site.faults, site.time, port=port)
