"""The rail of a cell that has none: a slide held at 0; no wire."""

from __future__ import annotations

import msgspec

from hilcell.ports import Clock, DeviceError, Identity, LinkStatistics, RailReading


class NoRail:
    """Satisfies `hilcell.ports.Rail`: readings are true, and no motion is possible."""

    SLACK_MM = 1e-9

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """None: there is nothing to reach."""

    def __init__(self, options: Options, clock: Clock) -> None:
        self._clock = clock

    def connect(self) -> list[Identity]:
        return []

    def home(self) -> None:
        """Do nothing: the reference is where the robot is."""

    def move_to(self, position_mm: float) -> None:
        """Refuse any target but 0; raises `DeviceError`."""
        if not abs(position_mm) <= self.SLACK_MM:
            raise DeviceError(
                "HC-R36",
                "Rail",
                "move",
                f"target {position_mm:.3f} mm",
                expected="0 mm: this cell has no rail",
                act="choose a procedure of robot and tracker alone",
                fields={"target_mm": position_mm, "lowest_mm": 0.0, "highest_mm": 0.0},
            )

    def settle(self) -> RailReading:
        return self.read()

    def read(self) -> RailReading:
        return RailReading(0.0, 0.0, 0.0, still=True, powered=False, taken_s=self._clock.pc_s())

    def hold(self) -> None:
        """Do nothing."""

    def statistics(self) -> LinkStatistics:
        return LinkStatistics()

    def stop(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""
