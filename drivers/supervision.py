"""Supervision of a device and its motion: silence, a late PC, no progress, overtime.

A thread held up for a second misses every deadline, though the answer has arrived. So one poll
counts for at most ``step_s``, and a miss is declared only by a poll made after the time was up. A
late PC excuses the device, never the motion: a gap longer than `LATE_S` between two polls of a
moving device ends the run. An engine that hangs cannot report that: a heartbeat checks
`Watchdog.is_fed`, and pauses.

A fixed time limit would end a slow healthy motion, and none would let an arm creep. So the time
allowed follows from the plan, in cell time, scaled by the override. A simulated cell may run faster
than real time, so a motion is overdue only after the real time of a stall as well.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from drivers.device_errors import ROBOT, Device
from hilcell.ports import Array, Clock, DeviceError

STEP_S = 0.1  # several times the period of a wait on a wire
LATE_S = 1.0
HEARTBEAT_TIMEOUT_S = 1.5  # of a controller's program: the PC reports first that it is late


def ignore_stop() -> None:
    """Let a wait continue while the run stops: it is part of a stop, or has its own deadline."""


class Deadline:
    """The time that a device may still keep silent."""

    def __init__(self, limit_s: float, step_s: float = STEP_S) -> None:
        self._left_s, self._step_s = limit_s, step_s
        self._polled_s = time.monotonic()

    def expired(self) -> bool:
        """Subtract the time since the last poll; return whether none is left. The caller then polls
        once more before it reports the device as silent.
        """
        now_s = time.monotonic()
        self._left_s -= min(now_s - self._polled_s, self._step_s)
        self._polled_s = now_s
        return not self._left_s > 0


def polls(limit_s: float, step_s: float = STEP_S) -> Iterator[bool]:
    """Yield before each poll of a device, until it has kept silent for ``limit_s``.

    True marks the last poll, which is made after the time was up.
    """
    deadline = Deadline(limit_s, step_s)
    yield False
    while not deadline.expired():
        yield False
    yield True


class Watchdog:
    """Supervises that a moving device is polled; `feed` belongs into every wait."""

    FED_S = 0.4  # then the heartbeat pauses, so that the device stops an unsupervised motion

    def __init__(self, device: Device, code: str, clock: Clock, late_s: float = LATE_S) -> None:
        """``code`` is the alarm of a motion that was not polled in time."""
        self._device, self._code, self._clock, self._late_s = device, code, clock, late_s
        self._fed_s: float | None = None

    @property
    def active(self) -> bool:
        return self._fed_s is not None

    def start(self) -> None:
        self._fed_s = self._clock.pc_s()

    def stop(self) -> None:
        self._fed_s = None

    @contextmanager
    def motion(self) -> Iterator[None]:
        """Supervise a motion from before its start until it has ended, or was given up."""
        self.start()
        try:
            yield
        finally:
            self.stop()

    def feed(self) -> None:
        """Note a poll; raises `DeviceError` where the last one is too long ago."""
        if self._fed_s is None:
            return
        gap_s = self._clock.pc_s() - self._fed_s
        self._fed_s += gap_s
        self._check(gap_s)

    def check(self) -> None:
        """Raise `DeviceError` where the last poll is too long ago."""
        if self._fed_s is not None:
            self._check(self._clock.pc_s() - self._fed_s)

    def is_fed(self) -> bool:
        """Whether a heartbeat may continue: nothing moves, or it was polled just now."""
        fed_s = self._fed_s
        return fed_s is None or self._clock.pc_s() - fed_s <= self.FED_S

    def _check(self, gap_s: float) -> None:
        if not gap_s <= self._late_s:
            raise self._device.failed(
                self._code,
                "move",
                f"PC late: {gap_s:.2f} s without a look at the motion",
                expected=f"<= {self._late_s:.2f} s",
                gap_s=gap_s,
                limit_s=self._late_s,
            )


@contextmanager
def on_failure(undo: Callable[[], None]) -> Iterator[None]:
    """Call ``undo`` where the body raises, a stop included; the error propagates."""
    try:
        yield
    except BaseException:  # also a stop or Ctrl-C: no wire and no motion is left behind
        undo()
        raise


class MotionLimits:
    """Progress and time of one motion of several axes."""

    PLANNED_TIMES = 3.0  # the plan knows no ramps, no blending and no limits of torque
    MARGIN_S = 10.0
    STEP_S = 1.0  # progress is checked once in several polls

    def __init__(self, planned_s: float, stall_s: float, progress: float) -> None:
        """``planned_s`` is the motion's duration at full override; ``progress`` in axis units."""
        self.limit_s = self.PLANNED_TIMES * planned_s + self.MARGIN_S
        self.spent_s = 0.0
        self._stall_s, self._progress = stall_s, progress
        self._deadline = Deadline(stall_s, self.STEP_S)
        self._at_least = Deadline(stall_s, self.STEP_S)
        self._position: Array | None = None
        self._at_rest = False
        self._now_s: float | None = None
        self._share = 1.0

    def stalled(self, position: Array) -> bool:
        """Whether no axis has got further by ``progress`` for ``stall_s`` of real time."""
        self._at_rest = self._position is not None and bool(
            np.all(np.abs(position - self._position) <= self._progress)
        )
        if not self._at_rest:
            self._position, self._deadline = position, Deadline(self._stall_s, self.STEP_S)
            return False
        return self._deadline.expired()

    def overdue(self, now_s: float, override_percent: float) -> bool:
        """Whether the motion has taken longer than it may; ``now_s`` is the cell's time.

        Between two polls the lower of their overrides counts. A robot at standstill is stalled, not
        overdue.
        """
        share = override_percent / 100.0
        if self._now_s is not None:
            self.spent_s += (now_s - self._now_s) * min(share, self._share)
        self._now_s, self._share = now_s, share
        real = self._at_least.expired()
        return real and not self._at_rest and not self.spent_s <= self.limit_s

    def stall_error(self, where: str, expected: str, axes_deg: Array) -> DeviceError:
        """Return the error of a motion that gets no further; ``where`` has its axes."""
        waited_s = self._stall_s
        found = f"no axis moved for {waited_s:.0f} s {where}"
        return ROBOT.failed(
            "HC-B23", "move", found, expected=expected, waited_s=waited_s, axes_deg=axes_deg
        )

    def time_error(self, where: str, expected: str, axes_deg: Array) -> DeviceError:
        return ROBOT.failed(
            "HC-B29",
            "move",
            f"still under way after {self.spent_s:.0f} s at full speed, {where}",
            expected=f"{expected} within {self.limit_s:.0f} s",
            spent_s=self.spent_s,
            limit_s=self.limit_s,
            axes_deg=axes_deg,
        )


def not_at_target(at: str, expected: str, axes_deg: Array, target_deg: Array) -> DeviceError:
    """Return the error of an arm that is not at rest at its target after its acknowledgement."""
    return ROBOT.failed(
        "HC-B24",
        "move",
        f"stands or creeps at {at}",
        expected=f"{expected} deg, at rest",
        axes_deg=axes_deg,
        target_deg=target_deg,
    )


def checked_target(joints_rad: Array, speed_percent: float) -> Array:
    """Return a target (6,) in rad; raises `DeviceError` for impossible angles, or a speed."""
    target_rad = np.asarray(joints_rad, dtype=float)
    with np.errstate(over="ignore"):  # what is finite in rad need not be so in deg
        deg = np.degrees(target_rad)
    if deg.shape != (6,) or not bool(np.all(np.isfinite(deg))):
        raise ROBOT.failed(
            "HC-B28", "move", f"target {deg} deg", expected="six finite angles", target_deg=deg
        )
    if not 1.0 <= speed_percent <= 100.0:
        raise ROBOT.failed(
            "HC-B28",
            "move",
            f"speed {speed_percent} %",
            expected="1 to 100 %",
            speed_percent=speed_percent,
        )
    return target_rad


def check_sweep(axis: int, end_rad: float, speed_rad_s: float, full_rad_s: float) -> None:
    """Raise `DeviceError` for an impossible sweep; ``full_rad_s`` is the axis's speed at 100 %, NaN
    for a non-existent axis.
    """
    slowest_rad_s = 1e-4
    if not (np.isfinite(end_rad) and slowest_rad_s <= speed_rad_s <= full_rad_s):
        found = f"axis {axis + 1} to {end_rad} rad at {speed_rad_s} rad/s"
        expected = f"{slowest_rad_s} to {full_rad_s:.3f} rad/s"
        raise ROBOT.failed("HC-B28", "sweep", found, expected=expected)


def state_error(
    code: str, variable: str, found: str, expected: str, *, moving: bool
) -> DeviceError:
    """Return the error of a state that forbids to continue; ``moving`` makes it a fault."""
    error, operation = (ROBOT.failed, "move") if moving else (ROBOT.refused, "check")
    return error(code, operation, f"{variable} is {found}", expected=expected, variable=variable)


def joints_text(joints_deg: Array) -> str:
    """Return joints (6,), or all axes (7,) with a slide in mm, as text."""
    joints = ", ".join(f"A{n} {each:.3f}" for n, each in enumerate(joints_deg[:6], start=1))
    return f"{joints} deg" + "".join(f", E1 {slide_mm:.3f} mm" for slide_mm in joints_deg[6:])


def check_identity(model: str, fits_in: str, serial: str, expected: str) -> None:
    """Refuse a robot without ``fits_in`` in its model, or of another serial number than expected.

    Raises `DeviceRefused`. A ``expected`` of "" is any.
    """
    if fits_in not in model:
        raise ROBOT.refused(
            "HC-B05", "connect", f"model {model!r}", expected=f"{fits_in!r} in it", model=model
        )
    if expected not in ("", serial):
        raise ROBOT.refused(
            "HC-B05", "connect", f"serial {serial}", expected=expected, serial=serial
        )


def planned_s(distance_deg: Array, speed_deg_s: Array, speed_percent: float) -> float:
    """Return how long the slowest axis takes at full override, without ramps."""
    return float(np.max(np.abs(distance_deg) / speed_deg_s)) * 100.0 / speed_percent
