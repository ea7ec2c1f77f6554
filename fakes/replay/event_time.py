"""The time of a recording that is replayed: it passes by what is asked, never by itself.

Questions that were asked once only are landmarks, on whatever wire: a driver that asks one is as
far as the recorded one was then. So devices of one motion keep in step, as a strip and its drive.
Between two landmarks the time is that of the last answer, on any wire, or of the last look at the
cell's clock, which shows what it showed. Samples of a stream, which nobody asks for one by one,
come when their time has passed. So wires that are paired by the clock are paired as they were.

A device that sends by itself leads the time, but not the clock, which goes by what the driver has
done (``heard_s``): the thread that sends is not in step with the one that asks.
"""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager


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
        self._looked_s, self._idle_s = time.monotonic(), 0.0  # real time
        self.now_s = self.heard_s = 0.0  # of all, and of what the driver did

    def expect(self, asked_s: Iterable[float], landmarks_s: Iterable[float]) -> None:
        """Take the times at which a wire was asked, and those of what it was asked once only."""
        self._asked_s = sorted([*self._asked_s, *asked_s])
        self._landmarks_s = sorted([*self._landmarks_s, *landmarks_s])

    def end_at(self, time_s: float, place: str) -> None:
        """Take the end of a wire's recording, and where that is written: nobody waits behind it."""
        self._end_s, self._end = max((self._end_s, self._end), (time_s, place))

    def cut_at(self, time_s: float, place: str) -> None:
        """Take when a wire was used last, of which the rest of the recording is missing."""
        self._cuts.append((time_s, place))

    def stop_at(self, time_s: float, place: str) -> None:
        """Take when the recorded run was to stop. All later times are of its stop."""
        self.stop_s, self._stop = time_s, place

    def leave(self, found: str) -> None:
        """A question was asked that the recording has no answer to; the first one counts."""
        self._left = self._left or found

    def left(self) -> str:
        """Return where and why the replay goes no further; "" while it may.

        The recording is over where all that was asked was asked, on all wires or on one that was
        cut, and a wait on the wires brings nothing more. A silence at its end belongs to it: a
        device that did not answer.
        """
        if self._end or self._cuts:
            self._look()
        return self._left

    def _look(self) -> None:
        now_s = time.monotonic()
        look_s = 0.1  # at most between two looks of one wait
        with self._lock:
            between_s, self._looked_s = now_s - self._looked_s, now_s
            if between_s < look_s:  # else nobody was waiting
                self._idle_s += between_s
        silent_s = max(0.0, self._end_s - self.now_s)
        silence_s = 1.5  # of waiting, after the end of a recording
        over = self._end if self.next_asked_s() == float("inf") and silent_s < silence_s else ""
        over = next((place for time_s, place in self._cuts if self.now_s >= time_s), over)
        if over and self._idle_s > silence_s:
            self.leave(f"the recording ends at {over}, and this run goes on")

    def went_on(self) -> None:
        """Something was answered that had not been before."""
        self._idle_s = 0.0

    def part(self) -> tuple[float, float]:
        """Return the times of the landmarks between which the replay is."""
        return self._landmark_s, following(self._landmarks_s, self._landmark_s)

    def next_asked_s(self) -> float:
        return following(self._asked_s, self.now_s)

    def is_next(self, time_s: float) -> bool:
        """Whether nothing was asked between what the driver did last and ``time_s``.

        What was asked while a device was at work was another thread's, which asks when it wants to.
        """
        return time_s < following(self._asked_s, max(self.heard_s, self._worked_s))

    def pass_landmark(self, time_s: float) -> None:
        """A question was asked that was asked once only, at ``time_s``."""
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


class RecordedLooks:
    """The cell's clock as it showed. Looks that were not recorded show what the one before them
    did, and the waits since: nothing passes by itself, so that a replay is the same at any pace.
    Behind waits that were not recorded all later looks are later, as far apart as they were.
    """

    def __init__(self, time_: EventTime, at_s: Sequence[float], shown_s: Sequence[float]) -> None:
        self._time, self._at_s, self._shown_s = time_, at_s, shown_s
        self._lock = threading.Lock()
        self._shown = self._since_s = self._latest_s = 0.0
        self._ahead_s = 0.0  # by waits that were not recorded

    def wait(self, duration_s: float) -> None:
        """Let cell time pass at once."""
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
