"""The simulated cell's time: paced (real time times a speed) or stepped (as fast as it goes).

In stepped time nothing passes by itself. Time advances by the waits that the engine asks for on the
control channel, and by the polls of a moving device: each poll lets a third of the motion pass,
never beyond its end. So a whole run takes the same simulated time on any machine. While somebody
follows a motion (a tracker that streams), a poll lets only the time of an exchange with a
controller pass, and all that happened meanwhile is handed out before the poll is answered.

Heartbeats, watchdogs and timers of a controller run in real time, whatever the cell's pace: a PC
that lives speaks in real time.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from itertools import count

PAUSE_S = 0.1


class CountedTime:
    """The PC's time in a cell that waits for its PC: a count, so that no PC is ever late."""

    def __init__(self) -> None:
        self._looks = count()

    def now_s(self) -> float:
        """Return a time behind all earlier ones."""
        tick_s = 1e-6
        return next(self._looks) * tick_s


class DeviceTime:
    """Real seconds, of which a pause of this PC counts as `PAUSE_S` at most.

    Heartbeats and watchdogs of simulated devices run in it: their PC shares a processor with the
    one that they watch.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._passed_s, self._looked_s = 0.0, time.monotonic()

    def now_s(self) -> float:
        """Return the time; to be called at least every `PAUSE_S`."""
        with self._lock:
            now_s = time.monotonic()
            self._passed_s += min(now_s - self._looked_s, PAUSE_S)
            self._looked_s = now_s
            return self._passed_s


class CellTime:
    """Seconds since power-on, of one simulated cell; safe to use from several threads."""

    EXCHANGE_S = 0.008  # one question to a robot's controller and its answer

    def __init__(self, speed: float = math.inf) -> None:
        self.speed = speed
        self.stepped = math.isinf(speed)  # time passes only when it is made to
        self._lock = threading.Lock()
        self._stepped_s = 0.0
        self._start_s = time.monotonic()
        self._followers: tuple[Callable[[], None], ...] = ()

    def now_s(self) -> float:
        """Return simulated seconds since power-on."""
        if self.stepped:
            return self._stepped_s
        return (time.monotonic() - self._start_s) * self.speed

    def advance(self, duration_s: float) -> None:
        """Let ``duration_s`` pass at once, in stepped time; paced time passes by itself."""
        if self.stepped:
            with self._lock:
                self._stepped_s += duration_s

    def passing(self, duration_s: float) -> Iterator[float]:
        """Let ``duration_s`` pass; in paced time yield the real seconds left, until it has."""
        self.advance(duration_s)
        ends_s = -math.inf if self.stepped else time.monotonic() + duration_s / self.speed
        while (left_s := ends_s - time.monotonic()) > 0:
            yield left_s

    def poll(self, start_s: float, end_s: float) -> float:
        """Return now, after a poll of something that moves from ``start_s`` to ``end_s``."""
        if self.stepped:
            with self._lock:
                step_s = self.EXCHANGE_S if self._followers else (end_s - start_s) / 3.0
                self._stepped_s = max(self._stepped_s, min(end_s, self._stepped_s + step_s))
        return self.now_s()

    def spend(self, duration_s: float) -> None:
        """Let the rest of a slow exchange pass, while somebody follows a motion."""
        if self._followers:
            self.advance(duration_s)

    def follow(self, follower: Callable[[], None]) -> None:
        """Have ``follower`` called by `catch_up` from now on."""
        with self._lock:
            self._followers = (*self._followers, follower)

    @property
    def followed(self) -> bool:
        """Whether somebody follows a motion in stepped time."""
        return self.stepped and bool(self._followers)

    def unfollow(self, follower: Callable[[], None]) -> None:
        with self._lock:
            self._followers = tuple(each for each in self._followers if each != follower)

    def catch_up(self) -> None:
        """Have all followers do due work; to be called with no lock held, before an answer."""
        if self.stepped:
            for follower in self._followers:
                follower()


class WatchdogTimer:
    """$TIMER[10] of a controller: it counts milliseconds, and reaches zero or is set back.

    Calls ``act``, in a thread that lives while the timer runs, when it has reached zero.
    """

    def __init__(self, act: Callable[[], None]) -> None:
        self._act = act
        self._changed = threading.Condition()
        self._time = DeviceTime()
        self._zero_s = 0.0
        self._running = self._watched = False

    def start(self, value_ms: int) -> None:
        """Run from a value, which is below zero."""
        with self._changed:
            self._zero_s, self._running = self._time.now_s() - value_ms / 1000.0, True
            if not self._watched:
                self._watched = True
                threading.Thread(target=self._watch, name="timer 10", daemon=True).start()
            self._changed.notify()

    def set_ms(self, value_ms: int) -> None:
        """Set the value; whether the timer runs does not change."""
        with self._changed:
            self._zero_s = self._time.now_s() - value_ms / 1000.0

    def stop(self) -> None:
        with self._changed:
            self._running = False
            self._changed.notify()

    @property
    def expired(self) -> bool:
        """Whether it runs and has reached zero."""
        with self._changed:
            return self._running and self._time.now_s() >= self._zero_s

    def _watch(self) -> None:
        while self._await_zero():
            self._act()
            with self._changed:
                self._running &= self._time.now_s() < self._zero_s  # it acts once

    def _await_zero(self) -> bool:
        """Wait until the timer has reached zero, or runs no longer; return whether it runs."""
        with self._changed:
            while self._running and (left_s := self._zero_s - self._time.now_s()) > 0:
                self._changed.wait(min(left_s, PAUSE_S))
            self._watched = self._running
            return self._running
