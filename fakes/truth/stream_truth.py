"""Samples of a reflector that a tracker follows, by the tracker's own clock.

The truth of a sample is where the reflector was at the sample's time, however late it is asked for.
Noise follows the sample's number in its stream. The tracker's clock began at another moment than
any other, and runs a little too fast or too slow.
"""

from __future__ import annotations

from collections.abc import Callable

from fakes.truth.noise import KeyedNoise
from fakes.truth.robot_motion import RobotMotion
from fakes.truth.tracker_truth import TrackerTruth
from fakes.truth.transforms import Array

PathInWorld = Callable[[str, Array], Array]  # name, times (N,) -> (N, 3) in {W}


class Followed:
    """A reflector that is followed from now on, until `end`."""

    def __init__(self, read: Callable[[Array], Array], end: Callable[[], None]) -> None:
        self.read, self.end = read, end


class StreamTruth:
    """The streams of one tracker."""

    def __init__(
        self, seed: int, robot: RobotMotion, tracker: TrackerTruth, path_in_world: PathInWorld
    ) -> None:
        self._robot, self._tracker, self._path = robot, tracker, path_in_world
        self._noise = KeyedNoise(seed, "stream")
        clock = KeyedNoise(seed).generator("tracker clock")
        power_on_s = (2_000.0, 400_000.0)  # how long the tracker may have been on
        self.offset_s = float(clock.uniform(*power_on_s))
        drift_ppm = 30.0
        self.drift = drift_ppm * 1e-6 * float(clock.uniform(-1.0, 1.0))

    def device_s(self, time_s: float) -> float:
        """Return the tracker's own time at a plant time."""
        return self.offset_s + (1.0 + self.drift) * time_s

    def plant_s(self, device_s: Array) -> Array:
        """Return the plant times at which the tracker's clock shows times (N,)."""
        return (device_s - self.offset_s) / (1.0 + self.drift)

    def follow(self, name: str) -> Followed:
        """Follow a reflector. ``read`` takes device times (N,), returns readings (M, 3).

        M < N where the beam is lost; each time is asked for once, in order.
        """
        noise = self._noise.next_generator(name)

        def read(device_s: Array) -> Array:
            at_mm = self._path(name, self.plant_s(device_s))
            draws = noise.standard_normal((len(device_s), 3))
            return self._tracker.read(at_mm, draws[: len(at_mm)])

        self._robot.remember(wanted=True)
        return Followed(read, lambda: self._robot.remember(wanted=False))
