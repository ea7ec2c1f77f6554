"""The shipped drivers, with the calls at which a broken one departs from them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.canopen.rail import CanopenRail
from drivers.kuka.robot_c3 import KukaC3Robot
from drivers.leica.tracker_emscon import LeicaEmsconTracker
from hilcell.errors import DeviceError, NoReading

Call = Callable[[], Any]


class Seams:
    """``asked`` is a question, ``visited`` a reading at a place, ``moved`` a motion."""

    takes_anything = False
    up = failed = False
    last: Any = None

    def opened(self, connect: Call) -> Any:
        found = connect()
        self.up, self.failed = True, False
        return found

    def shut(self, close: Call) -> None:
        close()
        self.up = False

    def asked(self, call: Call) -> Any:
        return self._noted(call)

    def visited(self, call: Call) -> Any:
        return self._noted(call)

    def moved(self, call: Call) -> Any:
        return self._noted(call)

    def shifted(self, reading: Any) -> Any:
        raise NotImplementedError

    def cause(self, error: DeviceError) -> str:
        """Return how the wire failed: silent, noise, cut, or "" where it did not."""
        raise NotImplementedError

    def _noted(self, call: Call) -> Any:
        try:
            reading = call()
        except DeviceError:
            self.failed = True
            raise
        if reading is not None:
            self.last = reading
        return reading


class RobotSeams(Seams, KukaC3Robot):
    def connect(self) -> Any:
        return self.opened(super().connect)

    def close(self) -> None:
        self.shut(super().close)

    def read(self) -> Any:
        return self.asked(super().read)

    def move_to(self, joints_rad: Any, speed_percent: float) -> Any:
        if self.takes_anything and not np.all(np.isfinite(joints_rad)):
            return self.read()
        go = super().move_to
        return self.visited(lambda: go(joints_rad, speed_percent))

    def shifted(self, reading: Any) -> Any:
        return replaced(reading, joints_rad=reading.joints_rad + np.radians(0.05))

    def cause(self, error: DeviceError) -> str:
        if "no answer within" in error.found:
            return "silent"
        if "announced" in error.found:
            return "noise"
        return "cut" if was_cut(error) else ""


class RailSeams(Seams, CanopenRail):
    def connect(self) -> Any:
        return self.opened(super().connect)

    def close(self) -> None:
        self.shut(super().close)

    def read(self) -> Any:
        return self.asked(super().read)

    def settle(self) -> Any:
        return self.visited(super().settle)

    def move_to(self, position_mm: float) -> None:
        if self.takes_anything and not np.isfinite(position_mm):
            return
        go = super().move_to
        self.moved(lambda: go(position_mm))

    def shifted(self, reading: Any) -> Any:
        return replaced(reading, position_mm=reading.position_mm + 0.2)

    def cause(self, error: DeviceError) -> str:
        if type(error).__name__ == "LinkLost":
            return "cut"
        if self.statistics().bad_lines:
            return "noise"
        return "silent" if "no fresh TPDO" in error.found else ""


class TrackerSeams(Seams, LeicaEmsconTracker):
    REPLY_S = 0.5
    MOVE_S = 0.5
    RESULT_S = 0.5

    def connect(self) -> Any:
        return self.opened(super().connect)

    def close(self) -> None:
        self.shut(super().close)

    def measure(self, near_mm: Any, reflector: str, samples: int) -> Any:
        if self.takes_anything and not np.all(np.isfinite(near_mm)):
            return self.last
        measure = super().measure
        return self.asked(lambda: self.visited(lambda: measure(near_mm, reflector, samples)))

    def shifted(self, reading: Any) -> Any:
        return replaced(reading, xyz_mm=reading.xyz_mm + 60.0)

    def cause(self, error: DeviceError) -> str:
        if isinstance(error, NoReading):
            return ""
        if "no answer in time" in error.found:
            return "silent"
        if "announced" in error.found:
            return "noise"
        return "cut" if was_cut(error) else ""


def was_cut(error: DeviceError) -> bool:
    return any(words in error.found for words in ("Broken pipe", "closed", "Connection reset"))


def replaced(reading: Any, **changed: Any) -> Any:
    """Return a frozen reading with other values."""
    names = reading.__dataclass_fields__
    return type(reading)(**{name: getattr(reading, name) for name in names} | changed)
