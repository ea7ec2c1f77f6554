"""The simulated cell's time: paced (real time times a speed) or stepped (as fast as possible).

Stepped time advances by the waits of the engine on the control channel, and by the polls of a
moving device: each advances by a third of the motion, at most to its end. So a run takes the same
simulated time on any PC. While a motion is followed (by a streaming tracker), a poll advances by
the time of an exchange with a controller, and the followers work before the poll is answered. So
does a poll of a PC that has waited no longer than that since the motion's start: it guards a small
motion closely.

Heartbeats, watchdogs and timers of a controller run in real time at any pace, as the PC's do.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from itertools import count

PAUSE_S = 0.1


class CountedTime:
    """The PC's time in a stepped cell: a count of readings, so that no PC is ever late."""

    def __init__(self) -> None:
        self._looks = count()

    def now_s(self) -> float:
        """Return a time after all earlier ones."""
        tick_s = 1e-6
        return next(self._looks) * tick_s


class DeviceTime:
    """Real seconds for heartbeats and watchdogs of simulated devices; a pause of the process counts
    as `PAUSE_S` at most, for the devices share the PC that they monitor.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._passed_s, self._looked_s = 0.0, time.monotonic()

    def now_s(self) -> float:
        """Return the time; call at least every `PAUSE_S`."""
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
        self.stepped = math.isinf(speed)  # time passes only when advanced explicitly
        self._lock = threading.Lock()
        self._stepped_s = 0.0
        self._start_s = time.monotonic()
        self._followers: tuple[Callable[[], None], ...] = ()
        self._short_wait_s = -math.inf  # end of the PC's last wait, if it was a short one

    def now_s(self) -> float:
        if self.stepped:
            return self._stepped_s
        return (time.monotonic() - self._start_s) * self.speed

    def advance(self, duration_s: float) -> None:
        """Advance stepped time; paced time passes by itself."""
        if self.stepped:
            with self._lock:
                self._stepped_s += duration_s

    def wait(self, duration_s: float) -> None:
        """Advance stepped time by a wait of the PC."""
        self.advance(duration_s)
        short = 0.001 <= duration_s <= self.EXCHANGE_S  # not the rest of a long one
        self._short_wait_s = self.now_s() if short else -math.inf

    def passing(self, duration_s: float) -> Iterator[float]:
        """Let ``duration_s`` pass; in paced time yield the remaining real seconds until then."""
        self.advance(duration_s)
        ends_s = -math.inf if self.stepped else time.monotonic() + duration_s / self.speed
        while (left_s := ends_s - time.monotonic()) > 0:
            yield left_s

    def poll(self, start_s: float, end_s: float) -> float:
        """Return the time after a poll of a motion from ``start_s`` to ``end_s``."""
        if self.stepped:
            with self._lock:
                closely = bool(self._followers) or self._short_wait_s >= start_s
                step_s = self.EXCHANGE_S if closely else (end_s - start_s) / 3.0
                self._stepped_s = max(self._stepped_s, min(end_s, self._stepped_s + step_s))
        return self.now_s()

    def spend(self, duration_s: float) -> None:
        """Advance by the rest of a slow exchange, while a motion is followed."""
        if self._followers:
            self.advance(duration_s)

    def follow(self, follower: Callable[[], None]) -> None:
        """Let `catch_up` call ``follower`` from now on."""
        with self._lock:
            self._followers = (*self._followers, follower)

    @property
    def followed(self) -> bool:
        """Whether a motion is followed in stepped time."""
        return self.stepped and bool(self._followers)

    def unfollow(self, follower: Callable[[], None]) -> None:
        with self._lock:
            self._followers = tuple(each for each in self._followers if each != follower)

    def catch_up(self) -> None:
        """Call all followers, before an answer is sent and without a lock."""
        if self.stepped:
            for follower in self._followers:
                follower()


class WatchdogTimer:
    """$TIMER[10] of a controller: counts milliseconds up to zero unless it is reset.

    Calls ``act`` at zero, in a thread that lives while the timer runs.
    """

    def __init__(self, act: Callable[[], None]) -> None:
        self._act = act
        self._changed = threading.Condition()
        self._time = DeviceTime()
        self._zero_s = 0.0
        self._running = self._watched = False

    def start(self, value_ms: int) -> None:
        """Start at a value below zero."""
        with self._changed:
            self._zero_s, self._running = self._time.now_s() - value_ms / 1000.0, True
            if not self._watched:
                self._watched = True
                threading.Thread(target=self._watch, name="timer 10", daemon=True).start()
            self._changed.notify()

    @property
    def value_ms(self) -> int:
        """The value of a timer that runs; of one that was stopped, as if it ran."""
        with self._changed:
            return round(1000.0 * (self._time.now_s() - self._zero_s))

    def set_ms(self, value_ms: int) -> None:
        with self._changed:
            self._zero_s = self._time.now_s() - value_ms / 1000.0

    def stop(self) -> None:
        with self._changed:
            self._running = False
            self._changed.notify()

    @property
    def expired(self) -> bool:
        with self._changed:
            return self._running and self._time.now_s() >= self._zero_s

    def _watch(self) -> None:
        while self._await_zero():
            self._act()
            with self._changed:
                self._running &= self._time.now_s() < self._zero_s  # it acts once

    def _await_zero(self) -> bool:
        """Wait until the timer reaches zero or stops; return whether it runs."""
        with self._changed:
            while self._running and (left_s := self._zero_s - self._time.now_s()) > 0:
                self._changed.wait(min(left_s, PAUSE_S))
            self._watched = self._running
            return self._running
