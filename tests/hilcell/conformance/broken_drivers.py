"""Drivers broken on purpose: each breaks one promise of its port, and keeps all others.

What a promise checks is the same at every port, so those of all ports are broken at the robot's.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from drivers.canopen.rail import CanopenRail
from drivers.kuka.robot_c3 import REPLY_S, KukaC3Robot, decode_header
from drivers.leica.tracker_emscon import LeicaEmsconTracker
from drivers.supervision import Deadline
from hilcell.conformance.exercise import Port
from hilcell.errors import DeviceError, DeviceRefused, NoReading, Stopped
from hilcell.ports import Array, StreamBlock

Call = Callable[[], Any]
LIMIT_S = 0.1
GOOD_VISITS = 4
TORN, LATELY = 3, 9  # receptions of one byte, among the last ones
C3_HEADER = 4  # bytes: tag and length

BROKEN: dict[Port, dict[str, type[Any]]] = {"robot": {}, "rail": {}, "tracker": {}}


class Broken:
    """A driver of ``port`` that is listed in `BROKEN` by the promise that it breaks."""

    port: Port

    def __init_subclass__(cls, *, breaks: str = "") -> None:
        if breaks:
            BROKEN[cls.port][breaks] = cls


# -- the robot: the promises of all ports, and its own --------------------------------------------


class Robot(Broken, KukaC3Robot):
    """The shipped driver; ``asked`` is a question, ``visited`` a motion and its reading."""

    port = "robot"
    takes_anything = False
    up = failed = False
    last: Any = None

    def __init__(self, options: Any, clock: Any) -> None:
        self.visits = 0
        self.missed = self.stopped = self.connecting = self.was_closed = False
        self.options = options
        super().__init__(options, clock)

    def connect(self) -> Any:
        self.connecting = True
        try:
            found = super().connect()
        finally:
            self.connecting = False
        self.missed = self.stopped = self.was_closed = self.failed = False
        self.up = True
        return found

    def close(self) -> None:
        super().close()
        self.up = False

    def read(self) -> Any:
        return self.asked(super().read)

    def move_to(self, joints_rad: Any, speed_percent: float) -> Any:
        if self.takes_anything and not np.all(np.isfinite(joints_rad)):
            return self.read()
        go = super().move_to
        return self.visited(lambda: go(joints_rad, speed_percent))

    def asked(self, call: Call) -> Any:
        return self._noted(call)

    def visited(self, call: Call) -> Any:
        return self._noted(call)

    def cause(self, error: DeviceError) -> str:
        """Return how the wire failed: silent, noise, cut, or "" where it did not."""
        if "no answer within" in error.found:
            return "silent"
        if "announced" in error.found:
            return "noise"
        words = ("Broken pipe", "closed", "Connection reset")
        return "cut" if any(each in error.found for each in words) else ""

    def _noted(self, call: Call) -> Any:
        try:
            reading = call()
        except DeviceError:
            self.failed = True
            raise
        if reading is not None:
            self.last = reading
        return reading


def replaced(reading: Any, **changed: Any) -> Any:
    """Return a frozen reading with other values."""
    names = reading.__dataclass_fields__
    return type(reading)(**{name: getattr(reading, name) for name in names} | changed)


class IdentitySame(Robot, breaks="identity-same"):
    connects = 0

    def connect(self) -> Any:
        type(self).connects += 1
        return [
            msgspec.structs.replace(each, serial=f"{each.serial}{self.connects}")
            for each in super().connect()
        ]


class IdentityClean(Robot, breaks="identity-clean"):
    def connect(self) -> Any:
        return [
            msgspec.structs.replace(each, model=f"{each.model}\x1b[2J")
            for each in super().connect()
        ]


class IdentityWrong(Robot, breaks="identity-wrong"):
    def __init__(self, options: Any, clock: Any) -> None:
        serials = [key for key in options.__struct_fields__ if key.endswith("serial")]
        anyone = {key: type(getattr(options, key))() for key in serials}
        super().__init__(msgspec.structs.replace(options, **anyone), clock)


class Unreachable(Robot, breaks="unreachable"):
    def connect(self) -> Any:
        try:
            return super().connect()
        except DeviceError as error:
            if "Connection refused" in error.found:
                raise ConnectionRefusedError(error.found) from error
            raise


class NotConnected(Robot, breaks="not-connected"):
    def asked(self, call: Call) -> Any:
        if not (self.up or self.failed):
            raise AttributeError("'NoneType' object has no attribute 'send'")
        return super().asked(call)


class ConnectTwice(Robot, breaks="connect-twice"):
    def connect(self) -> Any:
        if self.up and not self.failed:
            raise DeviceRefused("HC-C99", "Device", "connect", "connected already")
        return super().connect()


class CloseTwice(Robot, breaks="close-twice"):
    def close(self) -> None:
        if self.was_closed and not self.connecting:
            raise RuntimeError("closed already")
        self.was_closed = self.up
        super().close()


class StopTwice(Robot, breaks="stop-twice"):
    def stop(self) -> None:
        if self.was_closed:
            raise DeviceError("HC-C99", "Device", "stop", "not connected")
        super().stop()

    def close(self) -> None:
        super().close()
        self.was_closed = True


class Taken(Robot, breaks="taken"):
    def asked(self, call: Call) -> Any:
        reading = super().asked(call)
        return replaced(reading, taken_s=reading.taken_s + 10.0)


class NoNumber(Robot, breaks="no-number"):
    takes_anything = True


class ReadsBack(Robot, breaks="reads-back"):
    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        self.visits += 1
        if self.visits <= GOOD_VISITS:
            return reading
        return replaced(reading, joints_rad=reading.joints_rad + np.radians(0.05))


class AtRest(Robot, breaks="at-rest"):
    def asked(self, call: Call) -> Any:
        return replaced(super().asked(call), still=False)


class Ended(Robot, breaks="ended"):
    def asked(self, call: Call) -> Any:
        return replaced(super().asked(call), ended_s=None)


class Silent(Robot, breaks="silent"):
    def asked(self, call: Call) -> Any:
        try:
            return super().asked(call)
        except DeviceError as error:
            if self.cause(error) == "silent" and self.last is not None:
                return self.last
            raise


class Late(Robot, breaks="late"):
    def asked(self, call: Call) -> Any:
        if self.missed:
            return self.last
        try:
            return super().asked(call)
        except DeviceError as error:
            self.missed = self.cause(error) == "silent"
            raise

    def visited(self, call: Call) -> Any:
        return self.last if self.missed else super().visited(call)


class LateByTag(KukaC3Robot):
    """Takes any reply for the one to its request."""

    def connect(self) -> Any:
        found = super().connect()
        controller: Any = self._controller
        line = controller._line
        receive = line._receive

        def received(operation: str, tag: int) -> Any:
            line._await(C3_HEADER, operation, Deadline(REPLY_S))
            came, _ = decode_header(line._received[:C3_HEADER])
            return receive(operation, came)

        line._receive = received
        return found


class Slow(Robot, breaks="slow"):
    def asked(self, call: Call) -> Any:
        began_s = time.monotonic()
        reading = super().asked(call)
        if time.monotonic() - began_s > LIMIT_S:
            raise DeviceError("HC-C99", "Device", "read", "too slow")
        return reading


class Pieces(Robot, breaks="pieces"):
    """Does not take answers of which one byte came alone again and again."""

    def connect(self) -> Any:
        found = super().connect()
        sizes = deque[int](maxlen=LATELY)
        controller: Any = self._controller
        link = controller._line._link
        receive = link.receive

        def whole(size: int, deadline: Any) -> Any:
            data = receive(size, deadline)
            if data:
                sizes.append(len(data))
            if sizes.count(1) >= TORN:
                raise DeviceError("HC-C99", "Device", "receive", "answers of one byte")
            return data

        link.receive = whole
        return found


class Garbage(Robot, breaks="garbage"):
    def asked(self, call: Call) -> Any:
        try:
            return super().asked(call)
        except DeviceError as error:
            if self.cause(error) == "noise":
                raise ValueError(error.found) from error
            raise


class DeviceKilled(Robot, breaks="device-killed"):
    def asked(self, call: Call) -> Any:
        try:
            return super().asked(call)
        except DeviceError as error:
            if self.cause(error) == "cut":
                raise ConnectionResetError(error.found) from error
            raise


class ClientKilled(Robot, breaks="client-killed"):
    """Gives the controller ten minutes in which the PC may keep silent."""

    def begin(self, start: Any) -> int:
        number = super().begin(start)
        controller: Any = self._controller
        controller._line.write("$TIMER[10]", "-600000")
        controller._due_s = math.inf
        return number


class StopAtOnce(Robot, breaks="stop-at-once"):
    def stop(self) -> None:
        time.sleep(0.1)
        super().stop()


class StopRests(Robot, breaks="stop-rests"):
    """Notes a stop, and lets the device move on."""

    def stop(self) -> None:
        self.stopped = True

    def visited(self, call: Call) -> Any:
        self._check()
        return super().visited(call)

    def _check(self) -> None:
        if self.stopped:
            raise DeviceError("HC-C99", "Device", "move", "it was stopped")


class StopHolds(Robot, breaks="stop-holds"):
    def stop(self) -> None:
        self.stopped = True
        super().stop()

    def visited(self, call: Call) -> Any:
        self._again()
        return super().visited(call)

    def _again(self) -> None:
        if self.stopped:
            self.connect()


class DeafClock:
    def __init__(self, clock: Any) -> None:
        self._clock = clock

    def now_s(self) -> float:
        return float(self._clock.now_s())

    def pc_s(self) -> float:
        return float(self._clock.pc_s())

    def wait(self, duration_s: float) -> None:
        with suppress(Stopped):
            self._clock.wait(duration_s)

    def check(self) -> None:
        pass


class Checked(Robot, breaks="checked"):
    def __init__(self, options: Any, clock: Any) -> None:
        super().__init__(options, DeafClock(clock))


class RobotUnits(Robot, breaks="units"):
    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        pose = reading.pose.copy()
        pose[:3, 3] /= 1000.0
        return replaced(reading, pose=pose)


class RobotHandedness(Robot, breaks="handedness"):
    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        pose = reading.pose.copy()
        pose[1, 3] *= -1.0
        return replaced(reading, pose=pose)


class RobotSpeed(Robot, breaks="speed"):
    def move_to(self, joints_rad: Any, speed_percent: float) -> Any:
        return super().move_to(joints_rad, speed_percent if 1 <= speed_percent <= 100 else 10.0)


class RobotSweep(Robot, breaks="sweep"):
    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> Any:
        return super().sweep(axis, end_rad, 3.0 * speed_rad_s)


class RobotMoving(Robot, breaks="moving"):
    def asked(self, call: Call) -> Any:
        return replaced(super().asked(call), still=True)


# -- the rail's own --------------------------------------------------------------------------------


class Rail(Broken, CanopenRail):
    port = "rail"

    def read(self) -> Any:
        return self.told(super().read())

    def settle(self) -> Any:
        return self.told(super().settle())

    def told(self, reading: Any) -> Any:
        return reading


class RailUnits(Rail, breaks="units"):
    def told(self, reading: Any) -> Any:
        return replaced(reading, strip_mm=1.05 * reading.strip_mm)


class RailHandedness(Rail, breaks="handedness"):
    def told(self, reading: Any) -> Any:
        return replaced(reading, strip_mm=-reading.strip_mm)


class RailHeld(Rail, breaks="held"):
    def hold(self) -> None:
        pass


class RailTravel(Rail, breaks="travel"):
    def move_to(self, position_mm: float) -> None:
        options = self._options
        if np.isfinite(position_mm):
            position_mm = min(max(position_mm, options.travel_min_mm), options.travel_max_mm)
        super().move_to(position_mm)


class RailCounts(Rail, breaks="counts"):
    def close(self) -> None:
        super().close()
        self._statistics = type(self._statistics)()


# -- the tracker's own -----------------------------------------------------------------------------


class Tracker(Broken, LeicaEmsconTracker):
    port = "tracker"
    REPLY_S = MOVE_S = RESULT_S = 0.5


class TrackerUnits(Tracker, breaks="units"):
    def measure(self, near_mm: Array, reflector: str, samples: int) -> Any:
        reading = super().measure(near_mm, reflector, samples)
        return replaced(reading, xyz_mm=1.009 * reading.xyz_mm)


class TrackerHandedness(Tracker, breaks="handedness"):
    """Has the third nest on the other side of the plane of tracker and the two before."""

    def __init__(self, options: Any, clock: Any) -> None:
        self.seen: list[Any] = []
        super().__init__(options, clock)

    def measure(self, near_mm: Array, reflector: str, samples: int) -> Any:
        reading = super().measure(near_mm, reflector, samples)
        at_mm = reading.xyz_mm
        if all(np.linalg.norm(at_mm - each) > 100.0 for each in self.seen):
            self.seen.append(at_mm)
        if len(self.seen) < 3 or np.linalg.norm(at_mm - self.seen[2]) > 100.0:
            return reading
        normal = np.cross(self.seen[0], self.seen[1])
        normal /= np.linalg.norm(normal)
        return replaced(reading, xyz_mm=at_mm - 2.0 * float(normal @ at_mm) * normal)


class TrackerSamples(Tracker, breaks="samples"):
    def measure(self, near_mm: Array, reflector: str, samples: int) -> Any:
        return replaced(super().measure(near_mm, reflector, samples), samples=1)


class TrackerNothingThere(Tracker, breaks="nothing-there"):
    last: Any = "a reading that nobody took"

    def measure(self, near_mm: Any, reflector: str, samples: int) -> Any:
        try:
            self.last = super().measure(near_mm, reflector, samples)
        except NoReading as error:
            if "expected place" in error.found:
                raise  # an old result came
        return self.last


class TrackerReflector(Tracker, breaks="reflector"):
    def measure(self, near_mm: Any, reflector: str, samples: int) -> Any:
        return super().measure(near_mm, self._options.reflector, samples)


class Streamed:
    """A stream whose blocks are changed."""

    def __init__(self, stream: Any, tracker: Any) -> None:
        self.rate_hz, self._stream, self._tracker = stream.rate_hz, stream, tracker

    def kickoff(self) -> None:
        self._stream.kickoff()

    def collect(self) -> list[StreamBlock]:
        return [found for each in self._stream.collect() if (found := self._tracker.block(each))]

    def complete(self) -> list[StreamBlock]:
        return [found for each in self._stream.complete() if (found := self._tracker.block(each))]


class Streaming(Tracker):
    def stream(self, near_mm: Any, reflector: str, rate_hz: float) -> Any:
        return self._changed(super().stream(near_mm, reflector, rate_hz))

    @contextmanager
    def _changed(self, streaming: Any) -> Any:
        self.blocks = 0
        with streaming as stream:
            yield Streamed(stream, self)

    def block(self, block: StreamBlock) -> StreamBlock | None:
        raise NotImplementedError


class TrackerStreamTimes(Streaming, breaks="stream-times"):
    def block(self, block: StreamBlock) -> StreamBlock:
        return replace(block, device_s=1.1 * block.device_s)


class TrackerStreamGaps(Streaming, breaks="stream-gaps"):
    def block(self, block: StreamBlock) -> StreamBlock | None:
        self.blocks += 1
        return None if self.blocks == 3 else block


class TrackerStreamPlace(Streaming, breaks="stream-place"):
    def block(self, block: StreamBlock) -> StreamBlock:
        return replace(block, xyz_mm=block.xyz_mm + 100.0)


class TrackerStreamEnds(Tracker, breaks="stream-ends"):
    def stream(self, near_mm: Any, reflector: str, rate_hz: float) -> Any:
        """Leave the tracker in the mode of its stream."""
        return nullcontext(super().stream(near_mm, reflector, rate_hz).__enter__())
