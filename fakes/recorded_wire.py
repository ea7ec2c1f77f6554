"""A recorded wire as a device: a question gets the answer that was recorded for it, in order.

The driver may ask more or less often than when it was recorded: how often a motion is polled is a
matter of time. So questions that were asked once only (a motion, a command) part the recording. In
each part a question gets the answers to its name in their order, and at last the last one again. A
question that was never recorded gets no answer, as from a device that hangs: there this run has
left the recorded one.
"""

from __future__ import annotations

import socket
import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from fakes.dialects import Dialect
from fakes.listener import HOST, Listener
from hilcell.wire.recording import Piece

RECEIVE = 65536


@dataclass(slots=True)
class Exchange:
    """A question and everything that came before the next one; the first asks nothing."""

    asked: bytes
    answers: list[bytes] = field(default_factory=list)


def exchanges(pieces: Sequence[Piece], dialect: Dialect) -> list[Exchange]:
    """Return the exchanges of one connection."""
    found, asking, answering = [Exchange(b"")], b"", b""
    for piece in pieces:
        if piece.e == ">":
            messages, asking = dialect.split(asking + piece.data)
            found += [Exchange(each) for each in messages if not dialect.unheard(each)]
        elif piece.e == "<":
            answers, answering = dialect.split(answering + piece.data)
            for answer in answers:
                of = (each for each in reversed(found) if dialect.belongs(answer, each.asked))
                next(of, found[-1]).answers.append(answer)
    found[-1].answers.append(answering)
    return found


class Script:
    """The recorded exchanges of one connection, and how far the driver has got."""

    def __init__(self, recorded: Sequence[Exchange], dialect: Dialect) -> None:
        self._dialect = dialect
        self._greeting, asked = recorded[0].answers, recorded[1:]
        counts = Counter(dialect.name(each.asked) for each in asked)
        self._parts: list[dict[bytes, list[Exchange]]] = [{}]  # each but the first has a landmark
        self._begins: dict[bytes, int] = {}  # by name of its landmark
        for each in asked:
            name = dialect.name(each.asked)
            if counts[name] == 1:
                self._begins[name] = len(self._parts)
                self._parts.append({})
            self._parts[-1].setdefault(name, []).append(each)
        self._part = 0
        self._taken: Counter[bytes] = Counter()  # in this part
        self._last: dict[bytes, Exchange] = {}

    def greeting(self) -> list[bytes]:
        """Return what the device said unasked."""
        return self._greeting

    def reply(self, asked: bytes) -> list[bytes]:
        """Return the answers to a question, in their pieces."""
        name = self._dialect.name(asked)
        begun = self._begins.get(name, 0)
        while self._part < begun:
            self._last |= {each: found[-1] for each, found in self._parts[self._part].items()}
            self._taken.clear()
            self._part += 1
        if found := self._parts[self._part].get(name):
            self._last[name] = found[min(self._taken[name], len(found) - 1)]
            self._taken[name] += 1
        taken = self._last.get(name)
        if taken is None:
            return []
        return [self._dialect.answer(asked, taken.asked, each) for each in taken.answers]


class RecordedWire:
    """Serves the recorded connections of one wire in their order; a further one gets the last's."""

    def __init__(self, pieces: Sequence[Piece], dialect: Dialect, *, port: int = 0) -> None:
        opened = sorted({piece.c for piece in pieces if piece.e == "open"})
        self._recorded = [
            exchanges([piece for piece in pieces if piece.c == number], dialect)
            for number in opened
        ]
        self._dialect = dialect
        self._lock = threading.Lock()
        self._served = 0
        self._listener = Listener("recorded wire", self._serve, limit=100, port=port)

    @property
    def host_and_port(self) -> tuple[str, int]:
        """Return where it listens."""
        return HOST, self._listener.port

    def start(self) -> None:
        """Begin to serve."""
        self._listener.start()

    def close(self) -> None:
        """Stop serving."""
        self._listener.close()

    def _serve(self, client: socket.socket) -> None:
        with self._lock:
            number = min(self._served, len(self._recorded) - 1)
            self._served += 1
        if number < 0:
            return
        script, rest = Script(self._recorded[number], self._dialect), b""
        for answer in script.greeting():
            client.sendall(answer)
        while data := client.recv(RECEIVE):
            messages, rest = self._dialect.split(rest + data)
            for message in messages:
                if not self._dialect.unheard(message):
                    for answer in script.reply(message):
                        client.sendall(answer)
