"""Whether drive and strip measure one way: with a wrong scale of either, they part as it goes on.

A scale that is wrong shows in every step of a motion. All else that parts the two does so at once,
and is judged where the slide stands: a reference that homing has set, a strip that has jumped, a
slide that has slipped at its start. So the largest step does not count, nor does
the next one of a strip that is read at another moment than the drive. Where one of the two does not
move at all, or the strip is in alarm, nothing is said of scales; the next step has all that was
missed.
"""

from __future__ import annotations

from heapq import nlargest

from drivers.device_errors import RAIL


class ScaleGuard:
    """The polls of one motion."""

    SHARE = 0.05  # of the way; scales of real slides differ by far less
    APART_MM = 5.0
    LAG_S = 0.1  # between the two readings of a strip on a wire of its own

    def __init__(self, still_mm: float, speed_mm_s: float, *, together: bool) -> None:
        """``still_mm``: either flickers so far at rest; ``together``: both are read at one SYNC."""
        self._still_mm = still_mm
        self._apart_mm = self.APART_MM + self.LAG_S * speed_mm_s
        self._last: tuple[float, float] | None = None
        self._drive_mm = self._strip_mm = 0.0
        self._uncounted, self._parted_mm = 1 if together else 2, [0.0]

    def take(self, drive_mm: float, strip_mm: float) -> None:
        """Take a poll of a strip that is well."""
        last = self._last
        if last is None:
            self._last = drive_mm, strip_mm
            return
        drive_step_mm, strip_step_mm = drive_mm - last[0], strip_mm - last[1]
        if min(abs(drive_step_mm), abs(strip_step_mm)) > self._still_mm:
            self._drive_mm += drive_step_mm
            self._strip_mm += strip_step_mm
            self._parted_mm.append(abs(strip_step_mm - drive_step_mm))
            self._last = drive_mm, strip_mm

    def contradiction(self) -> tuple[float, float] | None:
        """Return the ways by drive and strip, in mm, where they are too far apart to be one."""
        drive_mm, strip_mm = self._drive_mm, self._strip_mm
        apart_mm = abs(strip_mm - drive_mm) - sum(nlargest(self._uncounted, self._parted_mm))
        allowed_mm = self._apart_mm + self.SHARE * max(abs(strip_mm), abs(drive_mm))
        return None if apart_mm <= allowed_mm else (drive_mm, strip_mm)

    def check(self, operation: str) -> None:
        """Raise `DeviceError` where the ways are too far apart to be one."""
        if (ways := self.contradiction()) is None:
            return
        drive_mm, strip_mm = ways
        ratio = strip_mm / drive_mm if drive_mm else float("inf")
        act = (
            "correct counts_per_mm of the drive or of the strip by that ratio, or check coupling "
            "and strip head; then home the rail"
        )
        if ratio < 0:
            act = (
                "drive and strip count in opposite directions: change the polarity of the drive "
                "(607Eh of CiA 402) or the strip's direction of counting; then home the rail"
            )
        raise RAIL.failed(
            "HC-R47",
            operation,
            f"the slide went {drive_mm:.1f} mm by the drive and {strip_mm:.1f} mm by "
            f"the strip: a ratio of {ratio:.4g}",
            expected=f"one way within {self.SHARE:.0%}",
            act=act,
            drive_mm=drive_mm,
            strip_mm=strip_mm,
            ratio=ratio,
        )
