"""The broken drivers of each port, by the promise that they break."""

from __future__ import annotations

import time
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.canopen.rail_setup import CONSUMER_HEARTBEAT
from drivers.kuka.c3 import REPLY_S, decode_header
from drivers.kuka.robot_c3 import KukaC3Robot
from drivers.kuka.robot_eki import KukaEkiRobot
from drivers.leica.geocom import Reply, Rpc
from drivers.leica.tracker_geocom import LeicaGeocomTracker
from drivers.supervision import Patience
from hilcell.conformance.verdicts import Port
from hilcell.errors import DeviceError, NoReading
from hilcell.ports import StreamBlock
from tests.hilcell.conformance.broken import COMMON, GOOD_VISITS, Base, Pieces, ReadsBack
from tests.hilcell.conformance.seams import (
    Call,
    RailSeams,
    RobotSeams,
    Seams,
    TrackerSeams,
    replaced,
)

RAIL_SOON_S = 0.04
C3_HEADER = 4  # bytes: tag and length

# -- the rail ---------------------------------------------------------------------------------


class RailPieces(Pieces, RailSeams):
    def patch(self) -> None:
        link: Any = self._link
        bus = link.network.bus
        fill = bus._fill

        def filled(timeout_s: float) -> bool:
            before = len(bus._bytes)
            found = bool(fill(timeout_s))
            if self.torn(bus._bytes[before:]):
                bus._bytes = b""
            return found

        bus._fill = filled


class RailReadsBack(ReadsBack, RailSeams):
    good_visits = GOOD_VISITS + 1  # one makes it ready


class RailSlow(Base, RailSeams):
    def connect(self) -> Any:
        found = super().connect()
        image: Any = self._image
        inbox = image._inbox
        arrive = inbox._await

        def soon(*words: Any) -> bool:
            began_s = time.monotonic()
            arrived = bool(arrive(*words))
            if arrived and time.monotonic() - began_s > RAIL_SOON_S:
                raise DeviceError("HC-C99", "Device", "read", "too slow")
            return arrived

        inbox._await = soon
        return found


class RailClientKilled(Base, RailSeams):
    """Has the drive listen to no heartbeat of the PC."""

    def connect(self) -> Any:
        found = super().connect()
        drive: Any = self._drive
        drive._sdo.write(CONSUMER_HEARTBEAT, 1, 0)
        return found


class RailUnits(Base, RailSeams):
    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        return replaced(reading, strip_mm=1.05 * reading.strip_mm)

    asked = visited


class RailHandedness(Base, RailSeams):
    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        return replaced(reading, strip_mm=-reading.strip_mm)

    asked = visited


class RailHeld(Base, RailSeams):
    def hold(self) -> None:
        pass


class RailTravel(Base, RailSeams):
    def move_to(self, position_mm: float) -> None:
        options = self._options
        if np.isfinite(position_mm):
            position_mm = min(max(position_mm, options.travel_min_mm), options.travel_max_mm)
        super().move_to(position_mm)


class RailCounts(Base, RailSeams):
    def close(self) -> None:
        super().close()
        self._statistics = type(self._statistics)()


# -- the robot --------------------------------------------------------------------------------


class RobotPieces(Pieces, RobotSeams):
    def patch(self) -> None:
        controller: Any = self._controller
        link = controller._line._link
        receive = link.receive
        link.receive = lambda size, patience: self.whole(receive(size, patience))


class RobotClientKilled(Base, RobotSeams):
    """Gives the controller ten minutes in which the PC may keep silent."""

    def begin(self, start: Any) -> int:
        number = super().begin(start)
        controller: Any = self._controller
        controller._line.write("$TIMER[10]", "-600000")
        controller._life.give = lambda line: None
        return number


class RobotUnits(Base, RobotSeams):
    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        pose = reading.pose.copy()
        pose[:3, 3] /= 1000.0
        return replaced(reading, pose=pose)


class RobotHandedness(Base, RobotSeams):
    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        pose = reading.pose.copy()
        pose[1, 3] *= -1.0
        return replaced(reading, pose=pose)


class RobotSpeed(Base, RobotSeams):
    def move_to(self, joints_rad: Any, speed_percent: float) -> Any:
        return super().move_to(joints_rad, speed_percent if 1 <= speed_percent <= 100 else 10.0)


class RobotSweep(Base, RobotSeams):
    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> Any:
        return super().sweep(axis, end_rad, 3.0 * speed_rad_s)


class RobotMoving(Base, RobotSeams):
    def asked(self, call: Call) -> Any:
        return replaced(super().asked(call), still=True)


# -- the tracker ------------------------------------------------------------------------------


class TrackerPieces(Pieces, TrackerSeams):
    def patch(self) -> None:
        link: Any = self._link
        receive = link.receive
        link.receive = lambda size, patience: self.whole(receive(size, patience))


class TrackerSlow(Base, TrackerSeams):
    REPLY_S = 0.04


class TrackerUnits(Base, TrackerSeams):
    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        return replaced(reading, xyz_mm=1.009 * reading.xyz_mm)


class TrackerHandedness(Base, TrackerSeams):
    """Has the third nest on the other side of the plane of tracker and the two before."""

    def __init__(self, options: Any, clock: Any) -> None:
        self.seen: list[Any] = []
        super().__init__(options, clock)

    def visited(self, call: Call) -> Any:
        reading = super().visited(call)
        at_mm = reading.xyz_mm
        if all(np.linalg.norm(at_mm - each) > 100.0 for each in self.seen):
            self.seen.append(at_mm)
        if len(self.seen) < 3 or np.linalg.norm(at_mm - self.seen[2]) > 100.0:
            return reading
        normal = np.cross(self.seen[0], self.seen[1])
        normal /= np.linalg.norm(normal)
        return replaced(reading, xyz_mm=at_mm - 2.0 * float(normal @ at_mm) * normal)


class TrackerSamples(Base, TrackerSeams):
    def visited(self, call: Call) -> Any:
        return replaced(super().visited(call), samples=1)


class TrackerNothingThere(Base, TrackerSeams):
    def visited(self, call: Call) -> Any:
        try:
            return super().visited(call)
        except NoReading as error:
            if "expected place" in error.found:
                raise  # an old result came
            return self.last or super().visited(call)

    def connect(self) -> Any:
        found = super().connect()
        self.last = self.last or "a reading that nobody took"
        return found


class TrackerReflector(Base, TrackerSeams):
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


class Streaming(Base, TrackerSeams):
    def stream(self, near_mm: Any, reflector: str, rate_hz: float) -> Any:
        return self._changed(super().stream(near_mm, reflector, rate_hz))

    @contextmanager
    def _changed(self, streaming: Any) -> Any:
        self.blocks = 0
        with streaming as stream:
            yield Streamed(stream, self)

    def block(self, block: StreamBlock) -> StreamBlock | None:
        raise NotImplementedError


class TrackerStreamTimes(Streaming):
    def block(self, block: StreamBlock) -> StreamBlock:
        return replace(block, device_s=1.1 * block.device_s)


class TrackerStreamGaps(Streaming):
    def block(self, block: StreamBlock) -> StreamBlock | None:
        self.blocks += 1
        return None if self.blocks == 3 else block


class TrackerStreamPlace(Streaming):
    def block(self, block: StreamBlock) -> StreamBlock:
        return replace(block, xyz_mm=block.xyz_mm + 100.0)


class TrackerStreamEnds(Base, TrackerSeams):
    def stream(self, near_mm: Any, reflector: str, rate_hz: float) -> Any:
        stream: Any = super().stream(near_mm, reflector, rate_hz)
        stream._restore = lambda error: None
        return stream


# -- of other makes ---------------------------------------------------------------------------


class C3WithoutTags(KukaC3Robot):
    """Takes any reply for the one to its request."""

    def connect(self) -> Any:
        found = super().connect()
        controller: Any = self._controller
        line = controller._line
        receive = line._receive

        def received(operation: str, tag: int) -> Any:
            line._await(C3_HEADER, operation, Patience(REPLY_S))
            came, _ = decode_header(line._received[:C3_HEADER])
            return receive(operation, came)

        line._receive = received
        return found


class EkiWithoutIds(KukaEkiRobot):
    """Takes any state for the answer to its command."""

    def connect(self) -> Any:
        found = super().connect()
        controller: Any = self._controller
        line = controller._line
        ask, documents, numbers = line.ask, line._documents, [0]

        def asked(number: int, document: bytes) -> Any:
            numbers[0] = number
            return ask(number, document)

        line.ask = asked
        line._documents = lambda operation: [(numbers[0], s) for _, s in documents(operation)]
        return found


class GeocomWithoutTransactions(LeicaGeocomTracker):
    """Takes any reply for the one to its request."""

    REPLY_S = MOVE_S = 0.5
    asked = 0

    def _send(self, rpc: Rpc, *parameters: float) -> int:
        self.asked = super()._send(rpc, *parameters)
        return self.asked

    def _parsed(self, line: str) -> Reply:
        return replace(super()._parsed(line), transaction=self.asked)


# Drivers that do not compare the numbers of answers, and how they are reached.
NUMBERLESS: list[tuple[Port, str, dict[str, str], type[Any]]] = [
    ("robot", "kuka-c3", {}, C3WithoutTags),
    ("robot", "kuka-eki", {}, EkiWithoutIds),
    ("tracker", "leica-geocom", {"tracker.options.channel": "/dev/ttyUSB0"},
     GeocomWithoutTransactions),
]  # fmt: skip

OWN: dict[str, dict[str, type[Base]]] = {
    "rail": {
        "pieces": RailPieces,
        "reads-back": RailReadsBack,
        "slow": RailSlow,
        "client-killed": RailClientKilled,
        "units": RailUnits,
        "handedness": RailHandedness,
        "held": RailHeld,
        "travel": RailTravel,
        "counts": RailCounts,
    },
    "robot": {
        "pieces": RobotPieces,
        "client-killed": RobotClientKilled,
        "units": RobotUnits,
        "handedness": RobotHandedness,
        "speed": RobotSpeed,
        "sweep": RobotSweep,
        "moving": RobotMoving,
    },
    "tracker": {
        "pieces": TrackerPieces,
        "slow": TrackerSlow,
        "units": TrackerUnits,
        "handedness": TrackerHandedness,
        "samples": TrackerSamples,
        "nothing-there": TrackerNothingThere,
        "reflector": TrackerReflector,
        "stream-times": TrackerStreamTimes,
        "stream-gaps": TrackerStreamGaps,
        "stream-place": TrackerStreamPlace,
        "stream-ends": TrackerStreamEnds,
    },
}
RESTS = {"at-rest", "ended", "stop-rests", "stop-holds"}  # of what moves by itself
SEAMS: dict[str, type[Seams]] = {"rail": RailSeams, "robot": RobotSeams, "tracker": TrackerSeams}


def _of(port: str, seams: type[Seams]) -> dict[str, type[Any]]:
    """Return the broken drivers of a port by promise; each stands in this module by its name."""
    found: dict[str, type[Any]] = {}
    for promise, broken in COMMON.items():
        if promise not in OWN[port] and not (port == "tracker" and promise in RESTS):
            name = f"{port}_{broken.__name__}"
            found[promise] = globals()[name] = type(
                name, (broken, seams), {"__module__": __name__, "__qualname__": name}
            )
    return found | OWN[port]


BROKEN = {port: _of(port, seams) for port, seams in SEAMS.items()}
