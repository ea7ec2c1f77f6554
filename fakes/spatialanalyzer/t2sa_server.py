"""T2SA's lines over TCP: one measurement at a time, and a halt that overtakes it.

While a measurement is under way all else is answered by "busy", on every connection; a halt ends
it, and the measurement is then answered by an error of its own before the halt is.
"""

from __future__ import annotations

import socket
import tempfile
import threading
import time as real_time
from pathlib import Path

from fakes.faults import Faults, Vanished
from fakes.site import Site
from fakes.spatialanalyzer.t2sa_device import BUSY, HALTED, Answer, T2saDevice, refusal
from fakes.spatialanalyzer.t2sa_points import fan, imported, write
from fakes.time import PlantTime
from fakes.wires.line_session import Connection, LineSession
from fakes.wires.listener import HOST, Listener

LOOK_S = 0.02
HALT = b"!HALT"
COLLECTION, GROUP = "A", "HILCELL"


class T2saServer:
    """Serves one bridge on a port, 0 for one that the system chooses."""

    def __init__(
        self,
        device: T2saDevice,
        faults: Faults,
        time: PlantTime,
        *,
        port: int = 0,
        folder: tempfile.TemporaryDirectory[str] | None = None,
        points: str = "",
    ) -> None:
        """``folder`` is removed at the end; ``points`` in it is the list that was imported."""
        self._device, self._faults, self._time = device, faults, time
        self._folder, self._points = folder, points
        self._turn = threading.Lock()
        self._measuring, self._halted = threading.Lock(), threading.Event()
        self._listener = Listener("t2sa", self._serve_client, port=port)

    @property
    def address(self) -> dict[str, object]:
        """Return where it listens, as options of the driver, and the list of its points."""
        found: dict[str, object] = {"host": HOST, "port": self._listener.port}
        return found | ({"points": self._points} if self._points else {})

    def start(self) -> None:
        """Begin to serve."""
        self._listener.start()

    def restore(self) -> None:
        """Leave the bridge as it is: its faults pass by themselves."""

    def close(self) -> None:
        """Stop serving."""
        self._listener.close()
        if self._folder is not None:
            self._folder.cleanup()

    def _serve_client(self, client: socket.socket) -> None:
        session = LineSession(Connection(client))
        try:
            while True:
                line = session.line(None)
                if line is not None:
                    self._obey(session, line)
        except Vanished:
            self._listener.hang_up()

    def _obey(self, session: LineSession, line: bytes) -> None:
        if line == HALT:
            self._halted.set()
            with self._measuring:  # another client's measurement has ended
                self._reply(session, Answer())
        elif (answer := self._begin(line)).finish is None:
            self._reply(session, answer)
        else:
            try:
                halted = self._answer(session, answer)
            finally:
                self._measuring.release()
            if halted:
                self._reply(session, Answer())

    def _begin(self, line: bytes) -> Answer:
        """Return the first answer to a line; a measurement reserves the bridge."""
        with self._turn:
            if self._measuring.locked():
                return refusal(BUSY)
            answer = self._device.handle(line.decode("ascii", "replace"))
            if answer.finish is not None:
                self._measuring.acquire()
                self._halted.clear()
            return answer

    def _answer(self, session: LineSession, answer: Answer) -> bool:
        """Reply, after plant time where that is due; return whether this client has halted it."""
        while answer.finish is not None:
            by_this = self._let_pass(session, answer.after_s)
            if self._halted.is_set():
                self._reply(session, refusal(HALTED))
                return by_this
            answer = answer.finish()
        self._reply(session, answer)
        return False

    def _let_pass(self, session: LineSession, duration_s: float) -> bool:
        """Let plant time pass until a halt; return whether that came from this client."""
        if self._time.stepped:
            self._time.advance(duration_s)
            return False
        ends_s = real_time.monotonic() + duration_s / self._time.speed
        while not self._halted.is_set() and (left_s := ends_s - real_time.monotonic()) > 0:
            line = session.line(min(left_s, LOOK_S))
            if line == HALT:
                self._halted.set()
                return True
            if line is not None:
                self._reply(session, refusal(BUSY))
        return False

    def _reply(self, session: LineSession, answer: Answer) -> None:
        """Send a reply as the faults want it on the wire."""
        reply, take = answer.line.encode("ascii"), self._faults.take
        if answer.measured:
            if take("tracker.eof") is not None:
                raise ConnectionAbortedError
            if take("tracker.no_result") is not None:
                return
            if take("tracker.late_result") is not None:
                session.late.append(reply)
                return
        for late in session.late:
            session.say(late)
        session.late.clear()
        if answer.measured and take("tracker.split_packet") is not None:
            session.raw(reply[:5])
            real_time.sleep(0.02)  # so that both halves are segments of their own
            reply = reply[5:]
        session.say(reply)


def serve(site: Site, port: int) -> T2saServer:
    """Return the bridge of a simulated cell, with the points of its file or a fan of its own."""
    options = site.cell.tracker.options
    folder, listed = None, str(options.get("points", ""))
    if listed:
        points = imported(Path(listed))
    else:
        folder = tempfile.TemporaryDirectory(prefix="t2sa-")
        listed = str(Path(folder.name) / "points.csv")
        points = fan(site.cell)
        write(Path(listed), points)
    group = f"{options.get('collection', COLLECTION)};{options.get('group', GROUP)}"
    device = T2saDevice(site.plant.tracker, site.faults, site.time, points, group)
    return T2saServer(
        device,
        site.faults,
        site.time,
        port=port,
        folder=folder,
        points="" if folder is None else listed,
    )
