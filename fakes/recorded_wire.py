"""A recorded wire as a device: a question gets the answer that was recorded for it, in order.

The driver may ask more or less often than when it was recorded: how often a motion is polled is a
matter of time. So questions that were asked once only (a motion, a command) part the recording
(`fakes.event_time`). In each part a question gets the answers to its name in their order, and at
last the last one again; one that is asked on and on has come to the part's end. A question that was
never recorded gets no answer, as from a device that hangs: there this run has left the recorded
one.
"""

from __future__ import annotations

import select
import socket
import threading
from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from fakes.dialects import Dialect
from fakes.event_time import EventTime
from fakes.listener import HOST, Listener
from hilcell.wire.recording import Piece

RECEIVE = 65536
STUCK = 200  # times that a part's last answer is repeated
FLOW_S = 0.001  # between two messages that come by themselves


@dataclass(slots=True)
class Exchange:
    """A question and everything that came before the next one; the first asks nothing."""

    asked: bytes
    answers: list[bytes] = field(default_factory=list)
    time_s: float = 0.0


def exchanges(pieces: Sequence[Piece], dialect: Dialect) -> list[Exchange]:
    """Return the exchanges of one connection."""
    found, asking, answering = [Exchange(b"")], b"", b""
    for piece in pieces:
        if piece.e == ">":
            messages, asking = dialect.split_questions(asking + piece.data)
            found += [
                Exchange(each, time_s=piece.t) for each in messages if not dialect.unheard(each)
            ]
        elif piece.e == "<":
            answers, answering = dialect.split(answering + piece.data)
            for answer in answers:
                of = (each for each in reversed(found) if dialect.belongs(answer, each.asked))
                next(of, found[-1]).answers.append(answer)
    if answering and not dialect.flows:
        found[-1].answers.append(answering)
    return found


def connections(pieces: Sequence[Piece], dialect: Dialect) -> list[list[Exchange]]:
    """Return the exchanges of each connection of a recording, in their order."""
    opened = sorted({piece.c for piece in pieces if piece.e == "open"})
    each_of = [[piece for piece in pieces if piece.c == number] for number in opened]
    found = [exchanges(each, dialect) for each in each_of]
    return [_merged(each, dialect) for each in found] if dialect.flows else found


def _merged(recorded: Sequence[Exchange], dialect: Dialect) -> list[Exchange]:
    """Return exchanges in which questions in a row that ask the same are one."""
    found, name = [recorded[0]], b""
    for each in recorded[1:]:
        if (asked := dialect.name(each.asked)) == name:
            found[-1].answers.extend(each.answers)
        else:
            found.append(each)
            name = asked
    return found


def landmarks(recorded: Sequence[Exchange], dialect: Dialect) -> list[Exchange]:
    """Return the exchanges whose question was asked once only."""
    counts = Counter(dialect.name(each.asked) for each in recorded[1:])
    return [each for each in recorded[1:] if counts[dialect.name(each.asked)] == 1]


class Script:
    """The recorded exchanges of one connection, and how far the driver has got."""

    def __init__(self, recorded: Sequence[Exchange], dialect: Dialect, time: EventTime) -> None:
        self._dialect, self._time = dialect, time
        self.greeting = recorded[0].answers
        self._landmarks = {dialect.name(each.asked) for each in landmarks(recorded, dialect)}
        self._named: dict[bytes, list[Exchange]] = {}
        for each in recorded[1:]:
            self._named.setdefault(dialect.name(each.asked), []).append(each)
        self._next: Counter[bytes] = Counter()
        self._repeated = 0

    def reply(self, asked: bytes) -> list[bytes]:
        """Return the answers to a question, in their pieces."""
        name = self._dialect.name(asked)
        found = self._named.get(name)
        if found is None:
            return []
        if name in self._landmarks:
            self._time.pass_landmark(found[0].time_s)
        taken = self._taken(name, found)
        if taken is None:
            return []
        self._dialect.heard(asked, taken.asked)
        return [self._dialect.answer(asked, taken.asked, each) for each in taken.answers]

    def _taken(self, name: bytes, found: list[Exchange]) -> Exchange | None:
        begin_s, end_s = self._time.part()
        first = bisect_left(found, begin_s, key=_time_s)
        end = bisect_left(found, end_s, key=_time_s)
        at = max(self._next[name], first)
        if at < end:
            self._next[name], self._repeated = at + 1, 0
            return found[at]
        self._repeated += 1
        if self._repeated >= STUCK and end_s < float("inf"):
            self._repeated = 0
            self._time.pass_landmark(end_s)
        return found[end - 1] if end > 0 else None


def _time_s(exchange: Exchange) -> float:
    return exchange.time_s


class Flow:
    """A connection whose messages come by themselves: those of the last question, in their order.

    At their end the last one comes again and again.
    """

    def __init__(self, recorded: Sequence[Exchange], dialect: Dialect, time: EventTime) -> None:
        self._dialect, self._time, self._recorded = dialect, time, recorded
        self._names = [b"", *(dialect.name(each.asked) for each in recorded[1:])]
        self._at = self._taken = 0
        self._asked = b""
        self._silent = False

    def ask(self, asked: bytes) -> None:
        """Go on with the messages that came after a question; with none if it was never asked."""
        name = self._dialect.name(asked)
        if name == self._names[self._at]:
            return
        self._silent = name not in self._names[self._at :]
        if not self._silent:
            self._at, self._taken = self._names.index(name, self._at), 0
            self._asked, recorded = asked, self._recorded[self._at]
            self._time.pass_landmark(recorded.time_s)
            self._dialect.heard(asked, recorded.asked)

    def next(self) -> bytes:
        """Return the next message, b"" where none comes."""
        recorded = self._recorded[self._at]
        if self._silent or not recorded.answers:
            return b""
        message = recorded.answers[min(self._taken, len(recorded.answers) - 1)]
        self._taken += 1
        if self._taken > len(recorded.answers) and not self._dialect.repeats(message):
            return b""
        return self._dialect.answer(self._asked, recorded.asked, message)


class RecordedWire:
    """Serves the recorded connections of one wire in their order; a further one gets the last's."""

    def __init__(self, pieces: Sequence[Piece], dialect: Dialect, time: EventTime) -> None:
        self._recorded = connections(pieces, dialect)
        self._dialect, self._time = dialect, time
        for each in self._recorded:
            time.expect(landmark.time_s for landmark in landmarks(each, dialect))
        self._lock = threading.Lock()
        self._served = 0
        serve = self._serve_flow if dialect.flows else self._serve
        self._listener = Listener("recorded wire", serve, limit=100)

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

    def _next(self) -> Sequence[Exchange]:
        with self._lock:
            number = min(self._served, len(self._recorded) - 1)
            self._served += 1
        return self._recorded[number] if number >= 0 else [Exchange(b"")]

    def _serve(self, client: socket.socket) -> None:
        script, rest = Script(self._next(), self._dialect, self._time), b""
        for answer in script.greeting:
            client.sendall(answer)
        while data := client.recv(RECEIVE):
            messages, rest = self._dialect.split_questions(rest + data)
            for message in messages:
                if not self._dialect.unheard(message):
                    for answer in script.reply(message):
                        client.sendall(answer)

    def _serve_flow(self, client: socket.socket) -> None:
        flow, rest = Flow(self._next(), self._dialect, self._time), b""
        while True:
            if select.select([client], [], [], FLOW_S)[0]:
                if not (data := client.recv(RECEIVE)):
                    return
                messages, rest = self._dialect.split_questions(rest + data)
                for message in messages:
                    flow.ask(message)
            client.sendall(flow.next())
