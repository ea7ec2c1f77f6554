"""The strip alone on a serial line: SIKO's service commands over a pty, or TCP on a stated port.

A command is ``A0``, ``A1``, ``A2``, ``Z`` or ``X``, without an end of line; an answer ends with
``>`` and CR, and now and then it comes in two pieces. Anything else is answered with ``?`` and CR.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import tty
from collections.abc import Callable

from fakes.faults import Faults
from fakes.truth.noise import Dither
from fakes.truth.rail_truth import RailState, RailTruth
from fakes.wires.listener import HOST, Listener
from fakes.wires.segments import Segments

# A head without its magnet goes on with its last position; only its alarm shows it.


class StripSensor:
    """The head of one strip; ``strike`` before each look."""

    COUNTS_PER_MM = 100.0

    def __init__(self, slide: RailState, faults: Faults) -> None:
        self._faults = faults
        self.position = round(slide.strip_mm * self.COUNTS_PER_MM)
        self.velocity_mm_s = 0.0
        self.missing = False  # the magnet
        self._frozen = False
        self._jump_mm = 0.0
        flicker = 6
        self._flicker = Dither(1, flicker)
        self._jitter = 0

    def observe(self, slide: RailState) -> None:
        """Take the slide's state of now."""
        self.velocity_mm_s = slide.velocity_mm_s
        if not self._frozen and not self.missing:
            at_mm = slide.strip_mm + self._jump_mm
            self.position = round(at_mm * self.COUNTS_PER_MM) + self._jitter

    def strike(self) -> None:
        """Let the faults of a look come and go."""
        self._jump_mm += self._faults.number("rail.strip_jump") or 0.0
        self._frozen = self._faults.take("rail.strip_frozen") is not None
        jitter = int(self._faults.number("rail.strip_jitter") or 0)
        self._flicker.step()
        # Under the fault it alternates, so that any two looks show both sides.
        alternate = -jitter if self._jitter > 0 else jitter
        self._jitter = alternate if jitter else self._flicker.counts
        self.missing = self._faults.take("rail.missing_magnet") is not None


RECEIVE = 4096

ANSWERS = {b"A0": "MSAC501 simulated", b"A1": "V1.00-simulated", b"A2": "002014003"}


class StripLine:
    """Serves one strip on a line of its own."""

    def __init__(
        self, rail: RailTruth, faults: Faults, options: dict[str, object], *, port: int = 0
    ) -> None:
        self._rail, self._faults, self._options = rail, faults, options
        self._lock = threading.Lock()
        self._sensor = StripSensor(rail.poll(), faults)
        self._listener = Listener("strip", self._serve, port=port) if port else None
        self._pty = None if port else Pty(self.answers)

    @property
    def address(self) -> dict[str, object]:
        """Return the channel, as options of the driver."""
        channel = f"socket://{HOST}:{self._listener.port}" if self._listener else ""
        if self._pty is not None:
            channel = self._pty.path
        return {"strip": self._options | {"driver": "serial", "channel": channel}}

    def start(self) -> None:
        """Begin to serve."""
        for each in (self._listener, self._pty):
            if each is not None:
                each.start()

    def restore(self) -> None:
        """Leave the sensor as it is: it has nothing to put right."""

    def close(self) -> None:
        """Stop serving."""
        for each in (self._listener, self._pty):
            if each is not None:
                each.close()

    def answers(self, pending: bytes) -> tuple[list[bytes], bytes]:
        """Return the answers to commands, and the bytes of one that is not whole."""
        found: list[bytes] = []
        while pending:
            size = 2 if pending[:1] in b"Aa" else 1
            if len(pending) < size:
                break
            command, pending = pending[:size].upper(), pending[size:]
            with self._lock:
                answer = self._answer(command)
            if self._faults.take("rail.strip_silent") is None:
                found.append(answer.encode("ascii") + b"\r")
        return found, pending

    def _answer(self, command: bytes) -> str:
        if command in ANSWERS:
            return ANSWERS[command] + ">"
        if command == b"Z":
            self._sensor.strike()
            self._sensor.observe(self._rail.poll())
            return f"{self._sensor.position:+08d}>"
        gap = 1 << 0
        if command == b"X":
            return f"0x{gap if self._sensor.missing else 0:02x}>"
        return "?"

    def _serve(self, client: socket.socket) -> None:
        segments, pending = Segments(client), b""
        while data := client.recv(RECEIVE):
            answers, pending = self.answers(pending + data)
            for answer in answers:
                segments.send(answer)


class Pty:
    """One end of a pseudo-terminal, as a device at a serial line; opened again and again."""

    def __init__(self, answers: Callable[[bytes], tuple[list[bytes], bytes]]) -> None:
        self._answers = answers
        self._ours, self._theirs = os.openpty()  # kept open: a line does not end with its user
        tty.setraw(self._theirs)
        self.path = os.ttyname(self._theirs)
        self._wake, self._waker = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name="strip line")

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """Stop serving."""
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")
        if self._thread.is_alive():
            self._thread.join()
        for each in (self._ours, self._theirs):
            os.close(each)
        self._wake.close()
        self._waker.close()

    def _run(self) -> None:
        pending, sent = b"", 0
        split_every = 5
        while True:
            wake = self._wake.fileno()
            ready, _, _ = select.select([self._ours, wake], [], [])
            if wake in ready:
                return
            answers, pending = self._answers(pending + os.read(self._ours, RECEIVE))
            for answer in answers:
                sent += 1
                cut = 1 + sent % (len(answer) - 1) if sent % split_every == 0 else len(answer)
                for piece in filter(None, (answer[:cut], answer[cut:])):
                    os.write(self._ours, piece)
