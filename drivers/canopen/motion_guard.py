"""The guards of one motion, and how they name what they have seen."""

from __future__ import annotations

from drivers.canopen.limits import Limits
from drivers.canopen.process_image import DEVICE, Snapshot
from drivers.canopen.speed_guard import OVERSPEED, SpeedGuard
from drivers.scale_guard import ScaleGuard
from hilcell.ports import DeviceError

FROZEN = 0.01  # no unit of speed differs so far from another


class MotionGuard:
    """Positions, times and the strip beside the drive's own word."""

    def __init__(self, limits: Limits, before: Snapshot, now_s: float) -> None:
        """``before`` is a poll before the motion, which has ended at ``now_s`` of the cell."""
        self._limits = limits
        per_mm, strip_per_mm = limits.counts_per_mm, limits.strip_counts_per_mm
        self._speed = SpeedGuard(now_s, limits.speed, limits.acceleration, per_mm)
        still_mm = limits.windows.strip_spread / strip_per_mm
        together = limits.strip_at_sync
        self._scale = ScaleGuard(still_mm, limits.speed / per_mm, together=together)
        self._take_scale(before)

    def take(self, now: Snapshot, now_s: float) -> None:
        """Take a poll that has ended at ``now_s`` of the cell."""
        self._speed.take(now.position, now.velocity, now_s)
        self._take_scale(now)

    def _take_scale(self, now: Snapshot) -> None:
        limits = self._limits
        if not now.alarms:
            self._scale.take(
                now.position / limits.counts_per_mm, now.strip / limits.strip_counts_per_mm
            )

    def check_unit(self, operation: str, now: Snapshot) -> None:
        """Raise `DeviceError` where positions and time contradict the drive's speed."""
        limits = self._limits
        if (seen := self._speed.contradiction()) is None:
            return
        act = (
            "set the drive's unit of speed (6081h, 6099h, 606Ch) to counts/s and that of "
            "acceleration to counts/s^2, then resume"
        )
        if seen.factor < FROZEN:
            act = "the position (6064h) does not follow: check the drive's encoder; then resume"
        raise DeviceError(
            "HC-R46",
            DEVICE,
            operation,
            f"speed {limits.mm(seen.by_positions)}/s by positions (6064h) and time, "
            f"{limits.mm(seen.by_drive)}/s by the drive (606Ch): a factor of {seen.factor:.3g}",
            wanted="one speed by both",
            act=act,
            fields={
                "position_mm": now.position / limits.counts_per_mm,
                "speed_mm_s": seen.by_positions / limits.counts_per_mm,
                "drive_speed_mm_s": seen.by_drive / limits.counts_per_mm,
                "factor": seen.factor,
                "way_mm": seen.way / limits.counts_per_mm,
            },
        )

    def check(self, operation: str, now: Snapshot) -> None:
        """Raise `DeviceError` for too high a speed by positions, or a strip with another scale."""
        limits = self._limits
        if (seen := self._speed.overspeed()) is not None:
            allowed = OVERSPEED * limits.speed
            raise DeviceError(
                "HC-R33",
                DEVICE,
                operation,
                f"speed {limits.mm(seen.by_positions)}/s by positions (6064h) and time, "
                f"allowed {limits.mm(allowed)}/s",
                act="put the cause right, then resume",
                fields={
                    "position_mm": now.position / limits.counts_per_mm,
                    "speed_mm_s": seen.by_positions / limits.counts_per_mm,
                    "allowed_mm_s": allowed / limits.counts_per_mm,
                },
            )
        self._scale.check(operation)
