"""A continuous measurement of an emScon tracker: samples by its clock, in packets, late and cut.

The samples that are due follow from plant time alone, never from when somebody asks. As with the
original a packet holds several samples and comes late; it may come in two pieces, or together with
the next; only the times inside it say when a sample was taken.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fakes.faults import Faults
from fakes.leica.emscon_packets import Change, status_change
from fakes.time import PlantTime
from fakes.truth.tracker_truth import Followed, StreamTruth
from fakes.truth.transforms import Array

Pack = Callable[[Array, Array], bytes]  # device times (N,), positions (N, 3) mm -> packet


class SampleStream:
    """One stream; its methods must not be called by two threads at once."""

    def __init__(
        self,
        truth: StreamTruth,
        time: PlantTime,
        faults: Faults,
        followed: Followed,
        pack: Pack,
        *,
        separation_s: float,
        points: int,
        lost: Callable[[], None],
    ) -> None:
        """``points`` 0 is until it is stopped; ``lost`` is called when the beam breaks."""
        self._truth, self._time, self._faults = truth, time, faults
        self._followed, self._pack, self._lost = followed, pack, lost
        self._separation_s, self._points = separation_s, points
        self._start_s = truth.device_s(time.now_s())
        self._taken = self._packets = 0
        self._times_s, self._xyz_mm = np.zeros(0), np.zeros((0, 3))
        self._kept = b""
        self.ended = False

    def due(self) -> bytes:
        """Return the packets that are due by now."""
        if self.ended:
            return b""
        broken = self._take()
        sent = b""
        packet_samples = (8, 3, 12, 5, 9)  # in turn
        while len(self._times_s) >= (size := packet_samples[self._packets % len(packet_samples)]):
            sent += self._packet(size)
        if broken or self._taken == self._points != 0:
            sent += self._end()
            if broken:
                self._lost()
                sent += status_change(Change.NOT_READY)
            else:
                sent += status_change(Change.READY)
        return sent

    def stop(self) -> bytes:
        """End at the client's wish; return all that was still under way."""
        return self.due() + (b"" if self.ended else self._end())

    def close(self) -> None:
        """End; may be called again."""
        if not self.ended:
            self._end()

    def _take(self) -> bool:
        """Take the samples that are due; return whether the beam broke."""
        now_s = self._truth.device_s(self._time.now_s())
        due = int((now_s - self._start_s) / self._separation_s)
        wanted = min(due, self._points) if self._points else due
        if wanted == self._taken:
            return False
        numbers = np.arange(self._taken + 1, wanted + 1)
        struck = next(
            (
                n
                for n in range(len(numbers))
                if self._faults.take("tracker.stream_break") is not None
            ),
            None,
        )
        times_s = np.asarray(self._start_s + self._separation_s * numbers[:struck], dtype=float)
        xyz_mm = self._followed.read(times_s) if len(times_s) else np.zeros((0, 3))
        self._taken += len(xyz_mm)
        self._times_s = np.append(self._times_s, times_s[: len(xyz_mm)])
        self._xyz_mm = np.vstack([self._xyz_mm, xyz_mm])
        return struck is not None or len(xyz_mm) < len(times_s)

    def _packet(self, size: int) -> bytes:
        """Return the bytes that go out with the next packet; the rest of it waits."""
        self._packets += 1
        data = self._kept + self._pack(self._times_s[:size], self._xyz_mm[:size])
        self._times_s, self._xyz_mm = self._times_s[size:], self._xyz_mm[size:]
        cut = len(data)
        late_every, cut_every = 5, 3  # packets that wait for the next, and whose second half does
        if self._packets % late_every == 0:
            cut = 0
        elif self._packets % cut_every == 0:
            cut //= 2
        self._kept = data[cut:]
        return data[:cut]

    def _end(self) -> bytes:
        self.ended = True
        self._followed.end()
        rest = self._pack(self._times_s, self._xyz_mm) if len(self._times_s) else b""
        return self._kept + rest
