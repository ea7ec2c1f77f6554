"""A recorded wire as a device: it listens, and answers as `fakes.replay.recorded_script` says."""

from __future__ import annotations

import itertools
import re
import select
import socket
import threading
import time
from bisect import bisect_right
from collections.abc import Sequence

from fakes.replay.dialects import Dialect
from fakes.replay.event_time import EventTime
from fakes.replay.recorded_script import (
    Exchange,
    Flow,
    Pulse,
    Script,
    connections,
    cut_connections,
    first_of_each,
    landmarks,
)
from fakes.wires import HOST, Listener
from hilcell.wire.recording import Piece

LONGEST, SHOWN = 60, 24  # bytes of a question in a message, as text and in hex
_WORDS = re.compile(rb"[ -~]{3,}")


def shown(asked: bytes) -> str:
    """Return the words of a question, or its bytes in hex where it is mostly no text."""
    words = b" ".join(_WORDS.findall(asked))
    if 2 * len(words) < len(asked.strip(b"\0")):
        return f"{asked[:SHOWN].hex(' ')}{' ..' if len(asked) > SHOWN else ''} (hex)"
    return repr(words[:LONGEST].decode())


class RecordedWire:
    """Serves the recorded connections of one wire in their order; a further one gets the last's."""

    RECEIVE = 65536

    def __init__(
        self,
        pieces: Sequence[Piece],
        dialect: Dialect,
        time: EventTime,
        place: str,
    ) -> None:
        """``place`` names the recording. A connection without an end was cut."""
        self._place, self._came_s = place, [piece.t for piece in pieces]
        self._recorded = connections(pieces, dialect)
        self._dialect, self._time = dialect, time
        self._landmarks = landmarks(self._recorded, dialect)
        self._elsewhere = first_of_each(self._recorded, dialect)
        asked = [each for one in self._recorded for each in one[1:]]
        once = [
            each
            for each in asked
            if dialect.name(each.asked) in self._landmarks or dialect.is_command(each.asked)
        ]
        self._cut = cut_connections(pieces)
        if any(self._cut):
            asked_s = max((each.time_s for each in asked), default=self._came_s[-1])
            time.cut_at(self._came_s[-1] if dialect.flows else asked_s, f"{place}:{len(pieces)}")
        self._unopened = not self._recorded
        if self._unopened:
            self._recorded, self._cut = [[Exchange(b"")]], [True]
        time.expect((each.time_s for each in asked), (each.time_s for each in once))
        self._count = itertools.count()
        self._numbers: dict[socket.socket, int] = {}
        serve = self._serve_flow if dialect.flows else self._serve
        self._listener = Listener("recorded wire", serve, limit=100, accepted=self._take_note)

    @property
    def channel(self) -> str:
        """Return where it listens."""
        return f"socket://{HOST}:{self._listener.port}"

    def start(self) -> None:
        """Begin to serve."""
        self._listener.start()

    def close(self) -> None:
        """Stop serving."""
        self._listener.close()

    def _leave(self, found: str) -> None:
        line, count = bisect_right(self._came_s, self._time.now_s), len(self._came_s)
        where = "ends at" if line == count else "has no answer behind"
        self._time.leave(f"the recording {where} {self._place}:{line}: this run {found}")

    def _look_up(self, script: Script | Flow, asked: bytes) -> None:
        """Let the replay end where the driver asks what was never recorded."""
        if script.knows(asked):
            return
        self._leave(f"asks {shown(asked)}")

    def _take_note(self, client: socket.socket) -> None:
        self._numbers[client] = next(self._count)

    def _recorded_for(self, client: socket.socket) -> tuple[Sequence[Exchange], bool]:
        """Return the exchanges of a connection, and whether the rest of them is missing."""
        number = min(self._numbers.pop(client), len(self._recorded) - 1)
        recorded, cut = self._recorded[number], self._cut[number]
        if cut and self._unopened:
            self._leave("opens that wire")
        return recorded, cut

    def _serve(self, client: socket.socket) -> None:
        (recorded, cut), sending = self._recorded_for(client), threading.Lock()
        script = Script(
            recorded, self._dialect, self._time, self._landmarks, self._elsewhere, cut=cut
        )
        pulse = Pulse(recorded, self._dialect, self._time, cut=cut)

        def send_due(now_s: float) -> None:
            with sending:
                while script.samples and script.samples[0][0] <= now_s:
                    client.sendall(script.samples.popleft()[1])

        def send(answers: Sequence[bytes]) -> None:
            pulse.take(answers)
            with sending:
                client.sendall(b"".join(answers))

        send(script.greeting)
        self._time.follow(send_due)
        beat_s = 0.2  # between two signs of life
        try:
            rest, due_s = b"", 0.0
            while True:
                if (now_s := time.monotonic()) >= due_s:
                    due_s = now_s + beat_s
                    send([pulse.due()])
                if not select.select([client], [], [], due_s - now_s)[0]:
                    continue
                if not (data := client.recv(self.RECEIVE)):
                    return
                messages, rest = self._dialect.split_questions(rest + data)
                for message in messages:
                    if not self._dialect.unheard(message):
                        send_due(float("inf"))  # they had come before it was asked
                        send(script.reply(message))
                        self._look_up(script, message)
        finally:
            self._time.unfollow(send_due)

    def _serve_flow(self, client: socket.socket) -> None:
        flow = Flow(self._recorded_for(client)[0], self._dialect, self._time)
        rest = b""
        flow_s = 0.001  # between two messages that come by themselves
        while True:
            if select.select([client], [], [], flow_s)[0]:
                if not (data := client.recv(self.RECEIVE)):
                    return
                messages, rest = self._dialect.split_questions(rest + data)
                for message in messages:
                    if self._dialect.unheard(message):
                        self._dialect.passed(message)
                        flow.passed()
                    else:
                        self._look_up(flow, message)
                        flow.ask(message)
            client.sendall(b"".join(flow.next()))
