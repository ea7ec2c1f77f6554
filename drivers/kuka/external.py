"""A KUKA robot whose controller moves the slide, too: as external axis E1, over the same wires.

The program moves E1 alone (HC_CMD 2), and only while HC_HELD is FALSE; motions of the arm carry the
place at which E1 is held. So one sequence of commands, one sign of life and one stop serve both,
and the program's timer brakes the slide as it brakes the arm when the PC dies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from drivers.device_errors import RAIL
from drivers.kuka.controller import PROGRESS, SLIDE, SlidingController
from drivers.kuka.robot import POLL_S, STALL_S, KukaOptions, KukaRobot
from drivers.motion_limits import MotionLimits
from hilcell.ports import AxisReading, Clock, Identity


class SlidingKukaRobot(KukaRobot):
    """Satisfies `hilcell.ports.ExternalAxis` where its controller has an axis E1."""

    PROGRESS_MM = 0.01
    OVERSPEED = 1.2
    SPEED_OVER_S = 0.3  # many cycles of the controller

    def __init__(
        self,
        options: KukaOptions,
        clock: Clock,
        wires: Callable[[SlidingKukaRobot], SlidingController],
    ) -> None:
        super().__init__(options, clock, lambda _: self._open(wires))
        self._slides: SlidingController | None = None
        self._free = False  # E1 may move
        self._identity = Identity(RAIL.name, "", "", "")
        self._seen: tuple[float, float] | None = None  # where it was, and when

    # -- the ports ----------------------------------------------------------------------------

    def connect(self) -> list[Identity]:
        """Connect the robot; an axis E1 is held where it stands."""
        self.slide_mm = None
        identities = super().connect()
        (self._identity,) = identities
        self._find_slide()
        return identities

    def close(self) -> None:
        """Leave the slide held as well; a stop has done so."""
        try:
            if self._free and not self._stopped and not self._under_way:
                self.hold_axis()
        finally:
            super().close()

    def verify_axis(self) -> Identity:
        """Return axis E1, found mastered; raises `DeviceError`."""
        if self.slide_mm is None:
            found = "the controller has no external axis: $EX_AX_NUM is 0"
            raise RAIL.refused("HC-R50", "connect", found)
        if not self.slides().mastered():
            raise RAIL.refused("HC-R51", "connect", "$AXIS_JUS[7] is FALSE")
        of = self._identity
        return replace(of, device=RAIL.name, model=f"E1 of {of.model}", kind="drive")

    def read_axis(self) -> AxisReading:
        """Return a reading; its time is that of the question."""
        taken_s = self._clock.pc_s()
        self.wire().check()
        self.wire().look()
        return AxisReading(*self.slides().slide(), taken_s)

    def move_axis(
        self,
        position_mm: float,
        speed_mm_s: float,
        full_mm_s: float,
        attend: Callable[[float], object],
    ) -> None:
        """Move E1 alone; return when all axes stand."""
        controller = self.slides()
        percent = max(1, min(100, int(100.0 * speed_mm_s / full_mm_s)))
        controller.check()
        way_mm = abs(position_mm - self.read_axis().position_mm)
        limits = MotionLimits(100.0 * way_mm / (percent * full_mm_s), STALL_S, self.PROGRESS_MM)
        self._free, self._seen = True, None
        try:
            controller.hold_slide(held=False)
            number = self.begin(lambda n: controller.start_slide(n, position_mm, percent))
            self.slide_mm = position_mm
            while not self.acknowledged(number):
                self.check_round(next(self._round), limits, number)
                attend(self._judged_speed(self.OVERSPEED * speed_mm_s))
                self._clock.wait(POLL_S)
            self.rest(self.stands_at())
        finally:
            self.unwatch()

    def hold_axis(self) -> None:
        """Have the program refuse every motion of E1 until the next `move_axis`."""
        self.slides().hold_slide(held=True)
        self._free = False

    # -- inside -------------------------------------------------------------------------------

    def _judged_speed(self, allowed_mm_s: float) -> float:
        """Return where the slide is; judge the least speed that two looks on its way allow for.

        From before the earlier question to after the later answer, so a late answer is no speed.
        """
        before_s, (place_mm, _) = self._clock.now_s(), self.slides().slide()
        seen, after_s = self._seen, self._clock.now_s()
        if seen is not None and after_s - seen[1] < self.SPEED_OVER_S:
            return place_mm
        self._seen = (place_mm, before_s)
        if seen is None:
            return place_mm
        speed_mm_s = abs(place_mm - seen[0]) / (after_s - seen[1])
        if not speed_mm_s <= allowed_mm_s:
            raise RAIL.failed(
                "HC-R33",
                "move",
                f"speed {speed_mm_s:.1f} mm/s, allowed {allowed_mm_s:.1f} mm/s",
                act="compare rail.options.full_mm_s with the speed of E1, then resume",
                speed_mm_s=speed_mm_s,
                position_mm=place_mm,
            )
        return place_mm

    def slides(self) -> SlidingController:
        """Return the controller as that of the slide."""
        if self._slides is None or self.wire() is not self._slides:
            raise RAIL.failed("HC-R38", "use", "not connected")
        return self._slides

    def _open(self, wires: Callable[[SlidingKukaRobot], SlidingController]) -> SlidingController:
        self._slides = wires(self)
        return self._slides

    def _find_slide(self) -> None:
        controller = self.slides()
        if not controller.has_slide():
            return
        self.hold_axis()
        (self.slide_mm,) = controller.numbers(PROGRESS, (SLIDE,))
