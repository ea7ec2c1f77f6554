"""One CAN bus with its background threads: receiving, and the PC's heartbeat.

python-can's Notifier dies silently with the first error of its bus. Here the first error is stored,
the heartbeat ends with it (so that the drive stops itself), and every use of the link raises it. A
link is never repaired: connect builds a new one.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from collections.abc import Callable

import can
import canopen

from drivers.canopen.cia import NodeState
from drivers.canopen.slcan_bus import SlcanBus
from drivers.device_errors import RAIL
from drivers.wires import system_message
from hilcell.ports import Clock, DeviceError, LinkStatistics


class LinkTime:
    """The time of a link; written by the receiving thread only, read by any.

    A busy PC may pass its own deadline with the answer arrived but unread. So this time advances
    only when all that arrived was handed out, and a pause of the PC counts as `PAUSE_S` at most.
    """

    PAUSE_S = 0.1
    BEHIND_S = 1.0  # a bus that is never empty must not stop the time

    def __init__(self, clock: Clock) -> None:
        self.listened_s = 0.0
        self.emptied_s = clock.pc_s()  # the frames handed out next came after this moment
        self.counted_s = time.monotonic()

    def emptied(self, now_s: float, pc_s: float) -> None:
        """All that had arrived at ``now_s`` (monotonic), ``pc_s``, was handed out."""
        self._count(now_s)
        self.emptied_s = pc_s

    def behind(self, now_s: float) -> None:
        """More waits to be handed out; one second of that counts as a pause."""
        if now_s - self.counted_s > self.BEHIND_S:
            self._count(now_s)

    def _count(self, now_s: float) -> None:
        self.listened_s += min(now_s - self.counted_s, self.PAUSE_S)
        self.counted_s = now_s


def heartbeat_period_s(bitrate: int) -> float:
    """Return the period of the PC's and the nodes' heartbeats on a bus."""
    return max(0.05, 2500 / bitrate)  # s; on a slow bus, 65 of so many bits


def open_bus(interface: str, channel: str, bitrate: int) -> can.BusABC:
    """Open the bus; raises `DeviceError`."""
    try:
        if interface == "slcan":
            return SlcanBus(channel, bitrate)
        return can.Bus(interface=interface, channel=channel, bitrate=bitrate)
    except (can.CanError, OSError, ValueError) as error:
        raise RAIL.failed(
            "HC-R04",
            "connect",
            f"{interface} {channel}: {system_message(error)}",
            interface=interface,
            channel=channel,
            bitrate=bitrate,
        ) from error


class LinkLost(DeviceError):
    """The gateway or the bus of the link failed; the link cannot be used again."""


class _Network(canopen.Network):
    """canopen's network, whose SDO client fails as a device does."""

    def __init__(
        self, bus: can.BusABC, check: Callable[[], None], fail: Callable[[Exception], None]
    ) -> None:
        super().__init__(bus)
        self._check_link, self._fail_link = check, fail

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._check_link()
        try:
            super().send_message(can_id, data, remote)
        except (can.CanError, OSError, ValueError) as error:
            self._fail_link(error)
            self._check_link()


class CanLink:
    """A bus with its canopen network, receiving in a thread of its own."""

    RECEIVE_S = 0.02
    RECENT_S = 5.0  # a pause that ended before does not explain a node's report
    JOIN_S = 1.0

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        self.clock = clock
        self.network = _Network(bus, self.check, self._fail)
        self.time = LinkTime(clock)
        self._frames = self._malformed = 0
        self._bus = bus
        self._beat_s: float | None = None  # when the PC's last heartbeat went out
        self._pause_s, self._paused_s = 0.0, -math.inf  # the longest recent pause, and its end
        self._failure = ""
        self._end, self._silent = threading.Event(), threading.Event()
        self._threads = [threading.Thread(target=self._receive, name="CAN receive", daemon=True)]
        self._threads[0].start()

    def subscribe(self, cob_id: int, callback: Callable[[int, bytearray, float], None]) -> None:
        """Call ``callback(cob_id, data, time)`` in the receiving thread for frames ``cob_id``."""
        self.network.subscribe(cob_id, callback)

    def send(self, cob_id: int, data: bytes) -> None:
        self.network.send_message(cob_id, data)

    def check(self) -> None:
        if self._failure:
            raise LinkLost(
                "HC-R01",
                RAIL.name,
                "CAN",
                f"link lost: {self._failure}",
                fields={"reason": self._failure},
            )

    def start_heartbeat(self, node: int, attended: Callable[[], bool], period_s: float) -> None:
        """Produce the heartbeat of ``node`` (CiA 301, 7.2.8.3.2.2) until the link closes.

        It pauses while not ``attended``. The first heartbeat has been sent on return: a node that
        lost the last one starts only after it.
        """
        self._send_beat(0x700 + node)
        beat = threading.Thread(
            target=self._beat, args=(0x700 + node, attended, period_s), daemon=True
        )
        self._threads.append(beat)
        beat.start()

    def end_heartbeat(self) -> None:
        """Produce no more heartbeats: a node that watches them then stops by itself."""
        self._silent.set()

    def statistics(self) -> LinkStatistics:
        bus = self._bus
        bad, refused = (bus.bad_lines, bus.refused) if isinstance(bus, SlcanBus) else (0, 0)
        return LinkStatistics(self._frames, bad, refused, self._malformed)

    @property
    def bad_line(self) -> bytes:
        """Return the last bad line of its gateway; b"" for none."""
        return self._bus.bad_line if isinstance(self._bus, SlcanBus) else b""

    @property
    def pause_s(self) -> float:
        """Return the longest time without a heartbeat of the PC that ended at most 5 s ago."""
        now_s, beat_s = time.monotonic(), self._beat_s
        recent_s = self._pause_s if now_s - self._paused_s <= self.RECENT_S else 0.0
        return max(recent_s, 0.0 if beat_s is None else now_s - beat_s)

    def close(self) -> None:
        """End both threads and close the bus; an error of the bus is stored, not raised."""
        self._end.set()
        self._silent.set()
        for thread in self._threads:
            thread.join(self.JOIN_S)
        try:
            self._bus.shutdown()
        except (can.CanError, OSError, ValueError) as error:
            self._fail(error)

    def _receive(self) -> None:
        try:
            while not self._end.is_set():
                if (message := self._next()) is not None:
                    self._notify(message)
        except (can.CanError, OSError, ValueError) as error:
            self._fail(error)
        finally:
            self._fail(ConnectionError("closed"))  # nothing receives from here on

    def _next(self) -> can.Message | None:
        now_s, pc_s = time.monotonic(), self.clock.pc_s()
        message = self._bus.recv(0.0)
        if message is None:
            self.time.emptied(now_s, pc_s)
            message = self._bus.recv(self.RECEIVE_S)
        else:
            self.time.behind(now_s)
        self._frames += message is not None
        return message

    def _notify(self, message: can.Message) -> None:
        if message.is_error_frame or message.is_remote_frame or message.is_extended_id:
            return  # CANopen's frames have 11-bit identifiers
        try:
            self.network.notify(message.arbitration_id, message.data, message.timestamp)
        except (struct.error, IndexError, ValueError):
            self._malformed += 1  # a frame too short for its meaning; deadlines notice the loss

    def _beat(self, cob_id: int, attended: Callable[[], bool], period_s: float) -> None:
        while not self._silent.wait(period_s):
            try:
                if attended():
                    self._send_beat(cob_id)
            except DeviceError:
                return  # stored by `_fail`; the drive now stops itself

    def _send_beat(self, cob_id: int) -> None:
        self.send(cob_id, bytes((NodeState.OPERATIONAL,)))
        now_s, longest_s = time.monotonic(), self.pause_s
        if longest_s > self._pause_s or not now_s - self._paused_s <= self.RECENT_S:
            self._pause_s, self._paused_s = longest_s, now_s
        self._beat_s = now_s

    def _fail(self, error: Exception) -> None:
        self._failure = self._failure or str(error)
