"""When a motion has failed: it gets no further, or it takes far longer than was planned.

A fixed deadline would end a slow motion that is well, and none at all would let an arm creep for
ever. So the time that a motion may take follows from its plan, in the cell's time, and it passes
only as fast as the override lets the motion go: an override that is lowered on the way is no fault.
A simulated cell may run faster than any clock, so a motion is overdue only after the real time of a
stall as well: that is no pause of a busy PC.

The errors are a robot's; a drive has its own.
"""

from __future__ import annotations

import numpy as np

from drivers.device_errors import ROBOT
from drivers.supervision import Patience
from hilcell.ports import Array, DeviceError


class MotionLimits:
    """Progress and time of one motion of several axes."""

    PLANNED_TIMES = 3.0  # the plan knows no ramps, no blending and no limits of torque
    MARGIN_S = 10.0
    LOOK_S = 1.0  # progress is looked at once in several polls

    def __init__(self, planned_s: float, stall_s: float, progress: float) -> None:
        """``planned_s`` is the motion's duration at full override; ``progress`` in axis units."""
        self.limit_s = self.PLANNED_TIMES * planned_s + self.MARGIN_S
        self.spent_s = 0.0
        self._stall_s, self._progress = stall_s, progress
        self._patience = Patience(stall_s, self.LOOK_S)
        self._at_least = Patience(stall_s, self.LOOK_S)
        self._position: Array | None = None
        self._stands = False
        self._now_s: float | None = None
        self._share = 1.0

    def stalled(self, position: Array) -> bool:
        """Whether no axis has got further by ``progress`` for ``stall_s`` of real time."""
        self._stands = self._position is not None and bool(
            np.all(np.abs(position - self._position) <= self._progress)
        )
        if not self._stands:
            self._position, self._patience = position, Patience(self._stall_s, self.LOOK_S)
            return False
        return self._patience.over()

    def overdue(self, now_s: float, override_percent: float) -> bool:
        """Whether the motion has taken longer than it may; ``now_s`` is the cell's time.

        Between two looks the lower of their overrides counts. A robot that stands is stalled, not
        overdue.
        """
        share = override_percent / 100.0
        if self._now_s is not None:
            self.spent_s += (now_s - self._now_s) * min(share, self._share)
        self._now_s, self._share = now_s, share
        real = self._at_least.over()
        return real and not self._stands and not self.spent_s <= self.limit_s

    def stall_error(self, where: str, expected: str, axes_deg: Array) -> DeviceError:
        """Return the error of a motion that gets no further; ``where`` tells its axes."""
        waited_s = self._stall_s
        found = f"no axis moved for {waited_s:.0f} s {where}"
        return ROBOT.failed(
            "HC-B23", "move", found, expected=expected, waited_s=waited_s, axes_deg=axes_deg
        )

    def time_error(self, where: str, expected: str, axes_deg: Array) -> DeviceError:
        """Return the error of a motion that takes far longer than was planned."""
        return ROBOT.failed(
            "HC-B29",
            "move",
            f"still under way after {self.spent_s:.0f} s at full speed, {where}",
            expected=f"{expected} within {self.limit_s:.0f} s",
            spent_s=self.spent_s,
            limit_s=self.limit_s,
            axes_deg=axes_deg,
        )


def stopped_short(at: str, expected: str, axes_deg: Array, target_deg: Array) -> DeviceError:
    """Return the error of an arm that does not stand at its target after its acknowledgement."""
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


def unwell(code: str, variable: str, found: str, expected: str, *, moving: bool) -> DeviceError:
    """Return the error of a state that forbids to go on; ``moving`` makes it a fault."""
    error, operation = (ROBOT.failed, "move") if moving else (ROBOT.refused, "check")
    return error(code, operation, f"{variable} is {found}", expected=expected, variable=variable)


def joints_text(joints_deg: Array) -> str:
    """Return joints (6,), or all axes (7,) with a slide in mm, in words."""
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
