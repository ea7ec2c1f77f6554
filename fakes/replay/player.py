"""Plays recorded wires: each is a device that listens, and answers by its recorded exchanges.

The driver may poll more or less often than recorded. So questions that were asked once only (a
motion, a command) are landmarks, which divide the recording into parts. In each part a question
gets the answers to its name in order, and at last the last one again, or before its first part the
first one; a repeated one has reached the end of the part. A question that was never recorded gets
no answer: there this run has left the recorded one.

The recording's time passes by questions, never by itself. A driver that asks a landmark, on any
wire, is as far as the recorded one was then, so devices of one motion stay synchronous. Between two
landmarks the time is that of the last answer, on any wire, or of the last reading of the cell's
clock, which returns what it returned. Samples of a stream come at their time.

A device that sends by itself leads the time, but not the clock, which follows what the driver has
done (``heard_s``): the thread that sends is not synchronous with the one that asks.
"""

from __future__ import annotations

import itertools
import re
import select
import socket
import threading
import time
from bisect import bisect_left, bisect_right
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from operator import attrgetter, itemgetter

from fakes.replay.dialects import Dialect
from fakes.wires import Listener, Server
from hilcell.wire.recording import Piece


class EventTime:
    """Seconds of the recording, one for all wires; safe to use from several threads."""

    def __init__(self) -> None:
        self._landmarks_s: list[float] = []
        self._asked_s: list[float] = []
        self._lock = threading.Lock()
        self._followers: tuple[Callable[[float], None], ...] = ()
        self._landmark_s = 0.0  # that was passed last
        self._worked_s = 0.0  # until when a device was at work
        self._end_s, self._end = 0.0, ""  # of all wires
        self._cuts: list[tuple[float, str]] = []
        self._left = ""
        self.stop_s, self._stop = float("inf"), ""
        self._polled_s, self._idle_s = time.monotonic(), 0.0  # real time
        self.now_s = self.heard_s = 0.0  # of all, and of what the driver did

    def expect(self, asked_s: Iterable[float], landmarks_s: Iterable[float]) -> None:
        """Add the times of a wire's questions, and those of its landmarks."""
        self._asked_s = sorted([*self._asked_s, *asked_s])
        self._landmarks_s = sorted([*self._landmarks_s, *landmarks_s])

    def end_at(self, time_s: float, place: str) -> None:
        self._end_s, self._end = max((self._end_s, self._end), (time_s, place))

    def cut_at(self, time_s: float, place: str) -> None:
        """Set when a wire was used last whose recording was cut."""
        self._cuts.append((time_s, place))

    def stop_at(self, time_s: float, place: str) -> None:
        """Set when the recorded run had to stop. All later times belong to its stop."""
        self.stop_s, self._stop = time_s, place

    def leave(self, reason: str) -> None:
        """End the replay: the recording has no answer to a question; the first reason counts."""
        self._left = self._left or reason

    def left(self) -> str:
        """Where and why the replay ends; "" while it continues.

        It ends where all questions were asked, on all wires or on a cut one, and a wait on the
        wires brings nothing more. A silence at the end belongs to the recording: a device that did
        not answer.
        """
        if self._end or self._cuts:
            self._poll()
        return self._left

    def _poll(self) -> None:
        now_s = time.monotonic()
        poll_s = 0.1  # at most between two polls of one wait
        with self._lock:
            between_s, self._polled_s = now_s - self._polled_s, now_s
            if between_s < poll_s:  # else no wait was in progress
                self._idle_s += between_s
        silent_s = max(0.0, self._end_s - self.now_s)
        silence_s = 1.5  # of waiting, after the end of a recording
        over = self._end if self.next_asked_s() == float("inf") and silent_s < silence_s else ""
        over = next((place for time_s, place in self._cuts if self.now_s >= time_s), over)
        if over and self._idle_s > silence_s:
            self.leave(f"the recording ends at {over}, and this run goes on")

    def went_on(self) -> None:
        """Note an answer that had not been given before."""
        self._idle_s = 0.0

    def part(self) -> tuple[float, float]:
        return self._landmark_s, following(self._landmarks_s, self._landmark_s)

    def next_asked_s(self) -> float:
        return following(self._asked_s, self.now_s)

    def is_next(self, time_s: float) -> bool:
        """Whether no question lies between the driver's last action and ``time_s``.

        Questions while a device was at work came from another thread, at any time.
        """
        return time_s < following(self._asked_s, max(self.heard_s, self._worked_s))

    def pass_landmark(self, time_s: float) -> None:
        """Note that a landmark was asked, at ``time_s``."""
        with self._lock:
            self._landmark_s = max(self._landmark_s, time_s)
        self.reach(time_s)

    def reach(self, time_s: float) -> None:
        """Be at ``time_s``, as the driver is; all that had come by then is handed out before."""
        with self._lock:
            self.heard_s = max(self.heard_s, time_s)
        self.lead(time_s)

    def lead(self, time_s: float, *, at_work: bool = False) -> None:
        """Be at ``time_s`` by what a device sends by itself, ``at_work`` on what it was asked."""
        with self._lock:
            self._worked_s = time_s if at_work else self._worked_s
            if time_s > self.now_s:
                self.now_s, self._idle_s = time_s, 0.0
        if self.now_s >= self.stop_s:
            self.leave(f"the recording ends at {self._stop}, where its run was stopped")
        for follower in self._followers:
            follower(self.now_s)

    @contextmanager
    def followed_by(self, follower: Callable[[float], None]) -> Iterator[None]:
        """Have ``follower`` called with the time, whenever some has passed."""
        with self._lock:
            self._followers = (*self._followers, follower)
        try:
            yield
        finally:
            with self._lock:
                self._followers = tuple(each for each in self._followers if each != follower)


class ClockReadings:
    """The cell's clock as recorded.

    A reading that was not recorded returns the one before it plus the waits since, so that a replay
    is the same at any pace. After waits that were not recorded all later readings are shifted.
    """

    def __init__(self, time_: EventTime, at_s: Sequence[float], shown_s: Sequence[float]) -> None:
        self._time, self._at_s, self._shown_s = time_, at_s, shown_s
        self._lock = threading.Lock()
        self._shown = self._since_s = self._latest_s = 0.0
        self._ahead_s = 0.0  # by waits that were not recorded

    def wait(self, duration_s: float) -> None:
        with self._lock:
            self._since_s += duration_s

    def now_s(self) -> float:
        with self._lock:
            n = bisect_right(self._at_s, self._time.heard_s)
            if n < len(self._at_s) and self._time.is_next(self._at_s[n]):
                self._time.reach(self._at_s[n])
                self._ahead_s = max(self._ahead_s, self._latest_s - self._shown_s[n])
                self._shown, self._since_s = self._shown_s[n] + self._ahead_s, 0.0
            self._latest_s = max(self._latest_s, self._shown + self._since_s)
            return self._latest_s


def following(times_s: Sequence[float], time_s: float) -> float:
    """Return the next of some times in order; infinite behind the last."""
    at = bisect_right(times_s, time_s)
    return times_s[at] if at < len(times_s) else float("inf")


STUCK = 200  # times that a part's last answer is repeated


@dataclass(slots=True)
class Exchange:
    """A question and everything that came before the next one; the first asks nothing."""

    asked: bytes
    answers: list[bytes] = field(default_factory=list)
    time_s: float = 0.0
    came_s: list[float] = field(default_factory=list)  # the answers, each
    cut: bool = False  # the recording ends before the answer does
    passed_s: list[float] = field(default_factory=list)  # messages of no exchange, before the next

    def __post_init__(self) -> None:
        self.came_s = self.came_s or [self.time_s] * len(self.answers)

    def add(self, answer: bytes, came_s: float) -> None:
        self.answers.append(answer)
        self.came_s.append(came_s)

    def awaited(self, dialect: Dialect) -> int:
        """Return the number of answers up to the last one that is no sample of a stream."""
        samples = [dialect.is_sample(answer) for answer in self.answers]
        return len(samples) - next((n for n, each in enumerate(samples[::-1]) if not each), 0)


def exchanges(pieces: Sequence[Piece], dialect: Dialect) -> list[Exchange]:
    found, asking, answering = [Exchange(b"")], b"", b""
    apart_s = 1e-9  # of messages in one piece, so that what parts the recording has a before
    for piece in pieces:
        if piece.e == ">":
            messages, asking = dialect.split_questions(asking + piece.data)
            for n, each in enumerate(messages):
                asked_s = piece.t + n * apart_s
                if dialect.unheard(each):
                    found[-1].passed_s.append(asked_s)
                else:
                    found.append(Exchange(each, time_s=asked_s))
        elif piece.e == "<":
            answers, answering = dialect.split(answering + piece.data)
            for answer in answers:
                of = (each for each in reversed(found) if dialect.belongs(answer, each.asked))
                next(of, found[-1]).add(answer, piece.t)
    ended = any(piece.e in ("end", "lost") for piece in pieces)
    found[-1].cut = not ended and (bool(answering) or not found[-1].answers)
    if answering and not dialect.flows:
        found[-1].add(answering, pieces[-1].t)
    # A driver's signs of life are answered whenever they come: when is a matter of this PC.
    return [each for each in found if not (each.answers and dialect.alive(each.asked))]


def connections(pieces: Sequence[Piece], dialect: Dialect) -> list[list[Exchange]]:
    each_of = [[piece for piece in pieces if piece.c == number] for number in _opened(pieces)]
    found = [exchanges(each, dialect) for each in each_of]
    return [_merged(each, dialect) for each in found] if dialect.flows else found


def cut_connections(pieces: Sequence[Piece]) -> list[bool]:
    """Return for each connection whether its end is missing: the file was cut, or all died."""
    ended = {piece.c for piece in pieces if piece.e in ("end", "lost")}
    return [number not in ended for number in _opened(pieces)]


def _opened(pieces: Sequence[Piece]) -> list[int]:
    return sorted({piece.c for piece in pieces if piece.e == "open"})


def _merged(recorded: Sequence[Exchange], dialect: Dialect) -> list[Exchange]:
    """Return exchanges in which questions in a row that ask the same are one."""
    found, name = [recorded[0]], b""
    for each in recorded[1:]:
        if (asked := dialect.name(each.asked)) == name:
            for answer, came_s in zip(each.answers, each.came_s, strict=True):
                found[-1].add(answer, came_s)
            found[-1].passed_s += each.passed_s
        else:
            found.append(each)
            name = asked
    return found


def landmarks(opened: Sequence[Sequence[Exchange]], dialect: Dialect) -> set[bytes]:
    """Return the names of questions that were asked once only, on all connections of a wire.

    A keep-alive, too, may have asked once on its connection, but asks what others ask.
    """
    counts = Counter(dialect.name(each.asked) for one in opened for each in one[1:])
    return {name for name, count in counts.items() if count == 1}


class Names:
    """Names of questions; equal where their numbers are near. A target computed again from the same
    answers may differ in its last digits.
    """

    NUMBER = re.compile(rb"-?\d{1,9}\.\d{3,}")
    NEAR = 1e-4  # deg, mm or rad

    def __init__(self, names: Iterable[bytes]) -> None:
        self._names = set(names)
        self._alike: dict[bytes, list[bytes]] = {}
        for name in self._names:
            self._alike.setdefault(self.NUMBER.sub(b"#", name), []).append(name)

    def of(self, name: bytes) -> bytes:
        """Return the known name that is the same; this one where there is none."""
        if name in self._names:
            return name
        alike = self._alike.get(self.NUMBER.sub(b"#", name), [])
        near = ((self._apart(name, each), each) for each in alike)
        apart, nearest = min(near, default=(self.NEAR, name))
        return nearest if apart < self.NEAR else name

    def _apart(self, name: bytes, other: bytes) -> float:
        pairs = zip(self.NUMBER.findall(name), self.NUMBER.findall(other), strict=True)
        return max((abs(float(a) - float(b)) for a, b in pairs), default=self.NEAR)


class Script:
    """The recorded exchanges of one connection, and how far the driver has got."""

    due_every_s = 0.2

    def __init__(
        self,
        recorded: Sequence[Exchange],
        dialect: Dialect,
        time: EventTime,
        landmarks: Collection[bytes] = (),
        elsewhere: Mapping[bytes, Exchange] | None = None,
        *,
        cut: bool = False,
    ) -> None:
        """``landmarks``: names of questions that divide the recording.

        ``elsewhere``: questions of any connection of the wire, by which an idle one is kept alive.
        Behind the last question of one that was ``cut``, an earlier answer is not given again; its
        heartbeats continue.
        """
        self._recorded, self._dialect, self._time = recorded, dialect, time
        self._landmarks, self._elsewhere = landmarks, elsewhere or {}
        self._order = [b"", *(dialect.name(each.asked) for each in recorded[1:])]
        self._names = Names(self._order)
        self._named: dict[bytes, list[Exchange]] = {}
        for name, each in zip(self._order[1:], recorded[1:], strict=True):
            self._named.setdefault(name, []).append(each)
        self._next: Counter[bytes] = Counter()
        self._repeated = 0
        self._cut = False
        self._last_s = recorded[-1].time_s if cut else float("inf")
        before = [each for each in recorded[1:] if each.time_s < time.stop_s]
        self._last = before[-1] if before else None  # that was asked before the run was stopped
        self._samples: deque[tuple[float, bytes]] = deque()  # of a stream, and when they come
        self._beats: dict[bytes, bytes] = {}  # the last sign of life of each node
        self._beats_end_s: dict[bytes, float] = {}
        ends_s = max((each.came_s[-1] for each in recorded if each.came_s), default=0.0)
        alive_s = 0.5  # after the last sign of life that was recorded
        for each in recorded:
            for answer, came_s in zip(each.answers, each.came_s, strict=True):
                gives = cut and ends_s - came_s < alive_s
                last_s = float("inf") if gives else came_s + alive_s
                self._beats_end_s[dialect.beat(answer)] = last_s
        self._given(recorded[0].answers)  # the greeting

    def due(self) -> list[bytes]:
        """Return what the device sends by itself: signs of life, the last ones again."""
        now_s = self._time.now_s
        return [each for beat, each in self._beats.items() if now_s <= self._beats_end_s[beat]]

    def come(self, now_s: float) -> list[bytes]:
        count = bisect_right(self._samples, now_s, key=itemgetter(0))
        return [self._samples.popleft()[1] for _ in range(count)]

    def passed(self) -> None:
        """Take note of a message that has no part in any exchange."""

    def knows(self, asked: bytes) -> bool:
        """Whether a question was recorded, the last one with its answer."""
        name = self._name(asked)
        known = name in self._named or bool(self._beside(asked, name))
        return known and not self._cut

    def reply(self, asked: bytes) -> list[bytes]:
        """Return the answers to a question, in their pieces; samples behind them come later."""
        return self._given(self._answers(asked))

    def _name(self, asked: bytes) -> bytes:
        return self._names.of(self._dialect.name(asked))

    def _given(self, answers: list[bytes]) -> list[bytes]:
        """Return answers, of whose signs of life note was taken."""
        self._beats |= {beat: each for each in answers if (beat := self._dialect.beat(each))}
        return answers

    def _answers(self, asked: bytes) -> list[bytes]:
        name = self._name(asked)
        found = self._named.get(name)
        if found is None:
            return self._beside(asked, name)
        if name in self._landmarks:
            self._time.pass_landmark(found[0].time_s)
        elif self._dialect.is_command(asked):
            self._time.pass_landmark(found[min(self._next[name], len(found) - 1)].time_s)
        taken = self._taken(name, found)
        if taken is None:
            return []
        self._cut = taken.cut
        self._dialect.heard(asked, taken.asked)
        answers = [self._dialect.answer(asked, taken.asked, each) for each in taken.answers]
        count = taken.awaited(self._dialect)
        self._samples.extend(zip(taken.came_s[count:], answers[count:], strict=True))
        came_s = taken.came_s[0] if count else taken.time_s
        self._time.reach(came_s)
        if taken.time_s >= self._time.stop_s or self._time.stop_s == float("inf"):
            return answers[:count]
        before = bisect_left(taken.came_s, self._time.stop_s, hi=count)
        silent = taken is self._last and not taken.answers and not self._dialect.is_command(asked)
        if before < count or silent:  # the others answer the stop
            self._time.reach(self._time.stop_s)
        return answers[:before]

    def _beside(self, asked: bytes, name: bytes) -> list[bytes]:
        """Return the answers to a question that this connection was not asked; no time passes."""
        other = None if name in self._landmarks else self._elsewhere.get(name)
        if other is None:
            return self._dialect.alive(asked)
        return [self._dialect.answer(asked, other.asked, each) for each in other.answers]

    def _taken(self, name: bytes, found: list[Exchange]) -> Exchange | None:
        (begin_s, end_s), at_s = self._time.part(), attrgetter("time_s")
        first = bisect_left(found, begin_s, key=at_s)
        end = bisect_left(found, end_s, key=at_s)
        at = max(self._next[name], first)
        if at < end:
            self._next[name], self._repeated = at + 1, 0
            self._time.went_on()
            return found[at]
        if self._time.next_asked_s() >= self._time.stop_s < float("inf"):
            self._time.reach(self._time.stop_s)  # the stop came before this was asked
            return None
        if self._time.now_s >= self._last_s:
            self._cut = True
            return None
        self._repeated += 1
        if self._repeated >= STUCK and end_s < float("inf"):
            self._repeated = 0
            self._time.pass_landmark(end_s)
        return found[end - 1] if end > 0 else self._early(found[0])

    def _early(self, first: Exchange) -> Exchange | None:
        now_s = self._time.heard_s
        early = replace(first, time_s=now_s, came_s=[now_s] * len(first.answers))
        return early if first.time_s < self._time.stop_s else None


class Flow(Script):
    """A connection with unsolicited messages: those of the last question, in order.

    One that came only after the driver had asked elsewhere, or had noted an earlier one, waits for
    that, unless the device is at work. Meanwhile, and at the end, the last one is repeated. So the
    messages are as far as the driver, whichever thread runs first.
    """

    due_every_s = 0.001

    _at = _sent = 0
    _asked, _silent = b"", False

    def knows(self, asked: bytes) -> bool:
        later = self._later(asked)
        return later is not None and not self._recorded[later].cut

    def reply(self, asked: bytes) -> list[bytes]:
        """Go on with the messages that came after a question; with none if it was never asked."""
        later = self._later(asked)
        self._silent = later is None
        if later is not None and later != self._at:
            self._at, self._sent, self._asked = later, 0, asked
            self._time.pass_landmark(self._recorded[later].time_s)
            self._dialect.heard(asked, self._recorded[later].asked)
        return []

    def _later(self, asked: bytes) -> int | None:
        name = self._name(asked)
        return self._order.index(name, self._at) if name in self._order[self._at :] else None

    def passed(self) -> None:
        """Note a message that is part of no exchange, as a request for a fresh state.

        The driver is as far as with the recorded one. A driver that repeats it waits for what came
        behind the next question on another wire, which it does not ask.
        """
        next_s = following(self._recorded[self._at].passed_s, self._time.heard_s)
        self._repeated += 1
        if not (self._works() or self._time.is_next(next_s)):
            next_s = self._time.next_asked_s() if self._repeated >= STUCK else float("inf")
        if next_s < float("inf"):
            self._time.reach(next_s)
            self._repeated = 0

    def due(self) -> list[bytes]:
        """Return the messages that have come by now, or the next one; none where none comes."""
        recorded = self._recorded[self._at]
        count, first, now_s = len(recorded.answers), self._sent, self._time.now_s
        if self._silent or not count:
            return []
        while self._sent < count and recorded.came_s[self._sent] <= now_s:
            self._sent += 1
        if self._sent == first < count and not self._waits():
            self._time.lead(recorded.came_s[first], at_work=self._works())
            self._sent += 1
        messages = recorded.answers[first : self._sent]
        if not messages:
            last = recorded.answers[first - 1]
            messages = [last] if self._dialect.repeats(last) else []
        return [self._dialect.answer(self._asked, recorded.asked, each) for each in messages]

    def _waits(self) -> bool:
        """Whether the next message came after something that the driver has not done yet."""
        recorded, n = self._recorded[self._at], self._sent
        if n == 0 or not self._dialect.repeats(recorded.answers[n - 1]):
            return False
        came_s = recorded.came_s[n]
        if came_s > following(recorded.passed_s, self._time.heard_s):
            return True
        return came_s > self._time.next_asked_s() and not self._works()

    def _works(self) -> bool:
        """Whether the device is at work on what was asked, by the last message given."""
        recorded, n = self._recorded[self._at], self._sent
        return n > 0 and self._dialect.works(recorded.asked, recorded.answers[n - 1])


def shown(asked: bytes) -> str:
    """Return the text of a question, or its bytes in hex where it is mostly binary."""
    longest, longest_hex = 60, 24  # bytes of a question in a message
    text = b" ".join(re.findall(rb"[ -~]{3,}", asked))
    if 2 * len(text) < len(asked.strip(b"\0")):
        return f"{asked[:longest_hex].hex(' ')}{' ..' if len(asked) > longest_hex else ''} (hex)"
    return repr(text[:longest].decode())


class RecordedWire(Server):
    """Serves the recorded connections of one wire in their order; a further one gets the last's."""

    RECEIVE = 65536

    def __init__(
        self, pieces: Sequence[Piece], dialect: Dialect, time: EventTime, place: str
    ) -> None:
        """``place`` names the recording. A connection without an end was cut."""
        self._place, self._came_s = place, [piece.t for piece in pieces]
        self._recorded = connections(pieces, dialect)
        self._dialect, self._time = dialect, time
        self._landmarks = landmarks(self._recorded, dialect)
        asked = [each for one in self._recorded for each in one[1:]]
        asked.sort(key=attrgetter("time_s"))
        # of each name the first one that was answered
        self._elsewhere = {dialect.name(e.asked): e for e in reversed(asked) if e.answers}
        once = [
            each
            for each in asked
            if dialect.name(each.asked) in self._landmarks or dialect.is_command(each.asked)
        ]
        self._cut = cut_connections(pieces)
        if any(self._cut):
            asked_s = asked[-1].time_s if asked else self._came_s[-1]
            time.cut_at(self._came_s[-1] if dialect.flows else asked_s, f"{place}:{len(pieces)}")
        self._unopened = not self._recorded
        if self._unopened:
            self._recorded, self._cut = [[Exchange(b"")]], [True]
        time.expect((each.time_s for each in asked), (each.time_s for each in once))
        self._count = itertools.count()
        self._numbers: dict[socket.socket, int] = {}
        listener = Listener("recorded wire", self._serve, limit=100, accepted=self._take_note)
        self.channel = listener.channel
        super().__init__({"channel": self.channel}, listener)

    def _leave(self, found: str) -> None:
        line, count = bisect_right(self._came_s, self._time.now_s), len(self._came_s)
        where = "ends at" if line == count else "has no answer behind"
        self._time.leave(f"the recording {where} {self._place}:{line}: this run {found}")

    def _take_note(self, client: socket.socket) -> None:
        self._numbers[client] = next(self._count)

    def _player(self, client: socket.socket) -> tuple[Script, list[bytes]]:
        number = min(self._numbers.pop(client), len(self._recorded) - 1)
        recorded, cut = self._recorded[number], self._cut[number]
        if self._unopened:
            self._leave("opens that wire")
        flows = self._dialect.flows
        player = (Flow if flows else Script)(
            recorded, self._dialect, self._time, self._landmarks, self._elsewhere, cut=cut
        )
        return player, [] if flows else recorded[0].answers

    def _serve(self, client: socket.socket) -> None:
        (player, greeting), sending = self._player(client), threading.Lock()

        def send(messages: Sequence[bytes]) -> None:
            with sending:
                if messages:
                    client.sendall(b"".join(messages))

        def send_come(now_s: float) -> None:
            with sending:  # also in the thread of another wire, which a lost client must not end
                if come := player.come(now_s):
                    client.sendall(b"".join(come))

        send(greeting)
        with self._time.followed_by(send_come):
            for message in self._messages(client, player.due_every_s):
                if message is None:
                    send(player.due())
                elif self._dialect.unheard(message):
                    self._dialect.passed(message)
                    player.passed()
                else:
                    send_come(float("inf"))  # they had come before it was asked
                    send(player.reply(message))
                    if not player.knows(message):
                        self._leave(f"asks {shown(message)}")

    def _messages(self, client: socket.socket, due_every_s: float) -> Iterator[bytes | None]:
        """Yield a driver's messages until it leaves, and None every ``due_every_s``."""
        rest, due_s = b"", 0.0
        while True:
            if (now_s := time.monotonic()) >= due_s:
                due_s = now_s + due_every_s
                yield None
            if select.select([client], [], [], due_s - now_s)[0]:
                if not (data := client.recv(self.RECEIVE)):
                    return
                messages, rest = self._dialect.split_questions(rest + data)
                yield from messages
