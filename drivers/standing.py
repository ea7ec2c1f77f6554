"""Readings of a slide that stands, by drive and strip, whichever they are.

Motions are the drive's and end by its standstill; only here the strip is asked for, so a strip that
is lost ends no motion and lets no reading through.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from drivers.standstill import READINGS, Poll, Rest, Standstill, Windows
from drivers.supervision import Patience
from hilcell.ports import Clock, DeviceError, RailReading, StripLost

DEVICE = "Rail"
POLL_S = 0.02
SETTLE_S = 10.0  # wire deadline, beside the dwell
STRIP_TRIES = 3  # dwells


class RailPoll(Poll, Protocol):
    """Drive and strip at one look, with its time."""

    @property
    def powered(self) -> bool:
        """Return whether the drive has the power to move."""

    @property
    def taken_s(self) -> float:
        """Return since when its oldest part may be true."""


P = TypeVar("P", bound=RailPoll)


class Standing(Generic[P]):
    """The polls of one slide, and what they say of its rest; used by one thread."""

    def __init__(
        self,
        poll: Callable[[str], P],
        clock: Clock,
        windows: Windows,
        *,
        units_per_mm: float,
        strip_counts_per_mm: float,
        alarm_text: Callable[[int], str],
    ) -> None:
        """``poll`` looks once, for an operation; its position is in units, ``windows`` as well."""
        self._poll, self._clock, self._windows = poll, clock, windows
        self._units_per_mm, self._strip_per_mm = units_per_mm, strip_counts_per_mm
        self._alarm_text = alarm_text
        self.standstill = Standstill(windows)
        self.now_s = 0.0  # of the cell, at the last poll

    @property
    def rest(self) -> Rest | None:
        """Return where the slide stands by the last polls; None while it is not known to stand."""
        return self.standstill.rest

    def poll(self, operation: str) -> P:
        """Look once."""
        now = self._poll(operation)
        self.now_s = self._clock.now_s()
        self.standstill.take(now, self.now_s)
        return now

    def pause(self) -> None:
        """Wait for the next poll; a slide that seems to stand is polled as its dwell needs it."""
        apart_s = self._windows.apart_s if self.standstill.begun else 0.0
        self._clock.wait(max(POLL_S, apart_s))

    def confirm(self, operation: str) -> P:
        """Poll once, or for a dwell where older polls do not prove that the slide stands."""
        now = self.poll(operation)
        for _ in range(self._windows.polls):
            if self.rest is not None or not self.standstill.begun:
                break
            self.pause()
            now = self.poll(operation)
        return now

    def check_strip(self, operation: str, now: P) -> P:
        """Return ``now``, or a later poll of a strip in alarm; raises `StripLost` if it stays so.

        Nothing else asks the strip: motions are the drive's, and end by the drive's standstill.
        """
        for _ in range(STRIP_TRIES * self._windows.polls):
            if not self._alarms(now):
                return now
            self.pause()
            now = self.poll(operation)
        if not (alarms := self._alarms(now)):
            return now
        raise StripLost(
            "HC-S01",
            DEVICE,
            operation,
            f"strip sensor: {self._alarm_text(alarms)}",
            act="check the strip and its head, then resume",
            fields={"alarms": alarms},
        )

    def settle(self) -> P:
        """Return the newest poll of a slide at rest whose strip reads; raises `DeviceError`."""
        limit_s = SETTLE_S + self._windows.dwell_s
        patience = Patience(limit_s)
        while True:
            over = patience.over()
            now = self.poll("settle")
            if self.rest is not None:
                now = self.check_strip("settle", now)
            if self.rest is not None:  # a strip that is back may show that the slide moves
                return now
            if over:
                raise self._restless(now, limit_s)
            self.pause()

    def reading(self, now: P, ended_s: float | None) -> RailReading:
        """Return the poll ``now``, or the medians of which it is the newest part."""
        rest = self.rest
        at: Poll | Rest = now if rest is None else rest
        return RailReading(
            position_mm=at.position / self._units_per_mm,
            strip_mm=at.strip / self._strip_per_mm,
            velocity_mm_s=now.velocity / self._units_per_mm,
            still=rest is not None,
            powered=now.powered,
            taken_s=now.taken_s,
            ended_s=ended_s,
        )

    def _alarms(self, now: P) -> int:
        """Return the strip's alarms in the polls that a reading is made of."""
        return now.alarms if self.rest is None else self.rest.alarms

    def _restless(self, now: P, limit_s: float) -> DeviceError:
        strip_mm, speed_mm_s = now.strip / self._strip_per_mm, now.velocity / self._units_per_mm
        windows = self._windows
        return DeviceError(
            "HC-S06",
            DEVICE,
            "settle",
            f"strip {strip_mm:.2f} mm, speed {speed_mm_s:.3f} mm/s",
            wanted=f"{READINGS} readings within +-1 count, the drive's within "
            f"{windows.spread / self._units_per_mm:.3f} mm, <= "
            f"{windows.speed / self._units_per_mm:.3f} mm/s, over {windows.dwell_s:.2f} s, "
            f"within {limit_s:.0f} s",
            act="the slide creeps or the strip's head is loose; check, then resume",
            fields={"strip_mm": strip_mm, "speed_mm_s": speed_mm_s, "waited_s": SETTLE_S},
        )


def check_travel(position_mm: float, lowest_mm: float, highest_mm: float) -> None:
    """Refuse a target outside the travel; raises `DeviceError`."""
    if not lowest_mm <= position_mm <= highest_mm:
        raise DeviceError(
            "HC-R36",
            DEVICE,
            "move",
            f"target {position_mm:.3f} mm",
            wanted=f"{lowest_mm:.1f} .. {highest_mm:.1f} mm",
            act="correct the station or the rail's travel",
            fields={
                "target_mm": position_mm,
                "lowest_mm": lowest_mm,
                "highest_mm": highest_mm,
            },
        )
