"""A stream of an emScon tracker: continuous time mode, samples by the tracker's own clock.

Packets come late, cut and together, so a sample's time is only the one inside it. The mode belongs
to the tracker, not to the connection: it is put back to stationary on every way out, and by the
next connect after a kill.
"""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np

from drivers.leica import emscon
from drivers.leica.emscon import Change, Command, Failure, Multi, Packet, Reply, StatusChange, Value
from drivers.leica.emscon_settings import EmsconSettings
from drivers.supervision import Patience
from drivers.tracker_readings import DEVICE
from hilcell.ports import Array, Clock, DeviceError, HilcellError, NoReading, Stopped, StreamBlock

SLOWEST_HZ, FASTEST_HZ = 0.1, 1000.0
SILENT_S = 3.0  # wire deadline: from one packet to the next, on top of a packet's own time
END_S = 5.0  # wire deadline: from the stop to its reply
SEPARATION_SHARE = 0.5  # by which the samples' times may miss the separation that was set
ENOUGH = 3  # steps that say how the tracker counts; fewer may be a gap


class StreamingTracker(Protocol):
    """The tracker, as its stream uses it."""

    settings: EmsconSettings

    def point_at(self, near_mm: Array, reflector: str) -> None:
        """Choose a reflector and catch it near (3,) mm."""

    def start(self, near_mm: Array) -> None:
        """Start to measure."""

    def next_packet(self, patience: Patience) -> Packet | None:
        """Return the next packet, or nothing when ``patience`` is over."""

    def stop(self) -> None:
        """Stop measuring, without waiting for an answer."""

    def leave_stream(self) -> None:
        """Stop and put the mode back, without waiting for answers."""


class EmsconStream:
    """Satisfies `hilcell.ports.Stream`."""

    def __init__(
        self,
        tracker: StreamingTracker,
        clock: Clock,
        near_mm: Array,
        reflector: str,
        rate_hz: float,
        find_radius_mm: float,
    ) -> None:
        near_mm = np.asarray(near_mm, dtype=float)
        if near_mm.shape != (3,) or not bool(np.all(np.isfinite(near_mm))):
            raise DeviceError(
                "HC-T35",
                DEVICE,
                "stream",
                f"a reflector at {near_mm} mm",
                wanted="three finite coordinates",
            )
        if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise DeviceError(
                "HC-T35",
                DEVICE,
                "stream",
                f"{rate_hz} samples/s",
                wanted=f"{SLOWEST_HZ} to {FASTEST_HZ:g}",
                fields={"rate_hz": rate_hz},
            )
        self._separation_ms = round(1000.0 / rate_hz)
        self.rate_hz = 1000.0 / self._separation_ms
        self._tracker, self._clock = tracker, clock
        self._near_mm, self._reflector, self._radius_mm = near_mm, reflector, find_radius_mm
        self._silence = Patience(SILENT_S)
        self._emptied_s = 0.0
        self._last_s: float | None = None
        self._running = False

    def __enter__(self) -> Self:
        """Catch the reflector and set the mode."""
        self._tracker.point_at(self._near_mm, self._reflector)
        try:
            settings = self._tracker.settings
            settings.write(EmsconSettings.MODE, Value.CONTINUOUS_TIME)
            parameters = (self._separation_ms, Value.UNTIL_STOPPED, 0, 0)
            settings.write(EmsconSettings.CONTINUOUS, *parameters)
        except BaseException as error:
            self._restore(error)
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """End the stream; the tracker measures at rest again."""
        self._restore(error)

    def kickoff(self) -> None:
        """Start; returns when the tracker has acknowledged."""
        self._emptied_s = self._clock.now_s()
        self._tracker.start(self._near_mm)
        self._running = True
        self._silence = Patience(SILENT_S + self._separation_ms / 1000.0)

    def collect(self) -> list[StreamBlock]:
        """Return arrived blocks, without waiting; raises `NoReading` when the beam broke."""
        looked_s = self._clock.now_s()
        over = self._silence.over()
        samples = []
        while (packet := self._tracker.next_packet(Patience(0.0))) is not None:
            samples += self._samples(packet)
        if samples:
            self._silence = Patience(SILENT_S + self._separation_ms / 1000.0)
        elif over:
            raise NoReading(
                "HC-T40",
                DEVICE,
                "stream",
                f"no samples for {SILENT_S + self._separation_ms / 1000.0:.1f} s",
                act="look at the tracker's state",
            )
        return self._blocks(samples, looked_s)

    def complete(self) -> list[StreamBlock]:
        """End the stream and return the rest of it; raises `NoReading` where nothing ever came."""
        looked_s = self._clock.now_s()
        samples = [each for packet in self._stop() for each in self._samples(packet)]
        self._tracker.settings.prove()  # those that were changed while it measured
        if self._last_s is None and not samples:
            raise NoReading(
                "HC-T40", DEVICE, "stream", "no sample came", act="look at the tracker's state"
            )
        return self._blocks(samples, looked_s)

    def _stop(self) -> list[Packet]:
        """Stop measuring; return the blocks that came before the tracker's answer."""
        packets: list[Packet] = []
        self._tracker.stop()
        patience = Patience(END_S)
        while (packet := self._tracker.next_packet(patience)) is not None:
            if isinstance(packet, Reply | Failure) and packet.command == Command.STOP_MEASUREMENT:
                self._running = False
                if packet.status != 0:
                    raise Command.STOP_MEASUREMENT.failed(packet.status)
                return packets
            packets.append(packet)
        raise DeviceError(
            "HC-T42",
            DEVICE,
            "stream",
            f"not stopped within {END_S:.0f} s",
            act="look at the tracker, resume",
            fields={"waited_s": END_S},
        )

    def _samples(self, packet: Packet) -> list[Multi]:
        """Return the packet's samples; raises the error of any other packet."""
        if isinstance(packet, Failure):
            raise Command.START_MEASUREMENT.failed(packet.status)
        if packet == StatusChange(Change.NOT_READY):
            raise NoReading(
                "HC-T10", DEVICE, "stream", "the beam broke", act="clear the line of sight"
            )
        if not isinstance(packet, Multi) or not len(packet.device_s):
            return []
        if packet.status != 0:
            raise Command.START_MEASUREMENT.failed(packet.status)
        self._check(packet)
        return [packet]

    def _check(self, packet: Multi) -> None:
        if not emscon.possible(*packet.xyz.flat):
            raise NoReading(
                "HC-T14",
                DEVICE,
                "stream",
                f"a sample at {packet.xyz} mm",
                wanted="a position in mm",
            )
        if self._last_s is None:
            off_mm = float(np.linalg.norm(packet.xyz[0] - self._near_mm))
            if not off_mm <= self._radius_mm:
                raise NoReading(
                    "HC-T16",
                    DEVICE,
                    "stream",
                    f"the reflector is {off_mm:.2f} mm from its expected place",
                    wanted=f"<= {self._radius_mm:.2f} mm",
                    act="another reflector was caught, or units or axes differ; clear the view",
                    fields={"off_mm": off_mm, "limit_mm": self._radius_mm},
                )
        before_s = [] if self._last_s is None else [self._last_s]
        steps_ms = 1000.0 * np.diff([*before_s, *packet.device_s])
        self._last_s = float(packet.device_s[-1])
        if not bool(np.all(steps_ms > 0)):
            raise NoReading(
                "HC-T41",
                DEVICE,
                "stream",
                f"the samples' times run back by {-float(steps_ms.min()):.3f} ms",
                wanted="later than the sample before",
                act="the tracker's clock was set; stream again",
            )
        typical_ms = float(np.median(steps_ms)) if len(steps_ms) >= ENOUGH else self._separation_ms
        if not abs(typical_ms / self._separation_ms - 1.0) <= SEPARATION_SHARE:
            raise DeviceError(
                "HC-T41",
                DEVICE,
                "stream",
                f"samples {typical_ms:.3f} ms apart",
                wanted=f"{self._separation_ms} ms",
                act="the tracker counts its time in other units, or lost samples; report it",
                fields={"separation_ms": typical_ms, "wanted_ms": self._separation_ms},
            )

    def _blocks(self, samples: list[Multi], looked_s: float) -> list[StreamBlock]:
        """Return the packets since a look before ``looked_s`` that found nothing left."""
        after_s, by_s, self._emptied_s = self._emptied_s, self._clock.now_s(), looked_s
        return [StreamBlock(each.device_s, each.xyz, after_s, by_s) for each in samples]

    def _restore(self, error: BaseException | None) -> None:
        """Put the mode back; a stop is not waited for, and the next connect reads it back."""
        try:
            if isinstance(error, Stopped):
                self._tracker.leave_stream()
                return
            if self._running:
                self._stop()
            self._tracker.settings.write(EmsconSettings.MODE, Value.STATIONARY)
        except HilcellError as failure:  # a stop, too, would hide the error
            if error is None:
                raise
            error.add_note(f"the stream was not ended: {failure}; the next connect ends it")
