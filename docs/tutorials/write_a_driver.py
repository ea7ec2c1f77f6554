"""Try a driver.

    python docs/tutorials/write_a_driver.py

The device is a laser tracker that answers lines of text over TCP; here a small server simulates it.
How a driver is installed, selected in a cell file, given alarms and tested: `docs/first-driver.md`.
"""

# %%
from __future__ import annotations

import socket
import threading

import msgspec
import numpy as np

import hilcell as hc
from drivers.device_errors import TRACKER
from drivers.supervision import Deadline
from drivers.wires import TcpLink
from hilcell.clock import WallClock
from hilcell.ports import Array, Clock, Identity, TrackerReading

# %% [markdown]
# The device: `ID` is answered by model and serial number, `MEASURE x y z` by the mean and the
# standard deviation in mm. It has one reflector at (1000, 200, 50), and answers nothing when asked
# far from it.

# %%
SMR_MM = np.array([1000.0, 200.0, 50.0])


def serve(server: socket.socket) -> None:
    with server, server.accept()[0] as link, link.makefile("rw") as lines:
        for line in lines:
            word, *numbers = line.split()
            if word == "ID":
                lines.write("LINES 4711\n")
            elif word == "MEASURE":
                near_mm = np.array(list(map(float, numbers)))
                if np.linalg.norm(SMR_MM - near_mm) < 500.0:
                    lines.write("1000.02 199.99 50.01 0.005 0.006 0.006\n")
            lines.flush()


server = socket.create_server(("127.0.0.1", 0))
port = server.getsockname()[1]
device = threading.Thread(target=serve, args=(server,))
device.start()

# %% [markdown]
# The driver: a plain class with the four methods of `hilcell.ports.Tracker`. Every wait is one of
# `TcpLink.receive`, which ends within 20 ms of a stop; `Deadline` is its deadline.


# %%
class LineTracker:
    """Satisfies `hilcell.ports.Tracker`."""

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Keys of `[tracker.options]`; ``find_radius_mm`` is passed on from `[tracker]`."""

        host: str
        port: int
        find_radius_mm: float

    ANSWER_S = 1.0

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._link: TcpLink | None = None

    def connect(self) -> list[Identity]:
        """Open the wire and ask for the identity; nothing moves."""
        options = self._options
        self._link = TcpLink(TRACKER, options.host, options.port, self._clock.check)
        model, serial = self._ask("identify", "ID").split()
        return [Identity(TRACKER.name, model, serial, self._link.address)]

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        """Measure the reflector near (3,) mm, tracker's frame; raises `NoReading`."""
        x, y, z = near_mm
        words = self._ask("measure", f"MEASURE {x:.3f} {y:.3f} {z:.3f}").split()
        taken_s = self._clock.pc_s()  # when the bytes of the reading arrived
        values = np.array(list(map(float, words)))
        off_mm = float(np.linalg.norm(values[:3] - near_mm))
        limit_mm = self._options.find_radius_mm
        if not off_mm <= limit_mm:  # NaN fails it, too
            raise TRACKER.no_reading(
                "HC-T11", "measure", f"reflector {off_mm:.2f} mm from its expected place",
                expected=f"<= {limit_mm:.1f} mm", act="seat the reflector, then resume",
                off_mm=off_mm, limit_mm=limit_mm,
            )  # fmt: skip
        return TrackerReading(values[:3], values[3:6], samples, reflector, None, taken_s)

    def stop(self) -> None:
        """End the measurement; from any thread, without waiting for an answer."""
        if self._link is not None:
            self._link.send(b"STOP\n", "stop")

    def close(self) -> None:
        """Close the wire."""
        if self._link is not None:
            self._link.close()
        self._link = None

    def _ask(self, operation: str, request: str) -> str:
        """Send a line and return the line that answers it; raises `DeviceError`."""
        if self._link is None:
            raise TRACKER.failed("HC-T34", operation, "not connected")
        self._link.send(f"{request}\n".encode(), operation)
        deadline, answer = Deadline(self.ANSWER_S), b""
        while not answer.endswith(b"\n"):
            received = self._link.receive(4096, deadline)
            if not received:
                raise self._link.broken(operation, f"no answer within {self.ANSWER_S:g} s")
            answer += received
        return answer.decode("ascii", "replace")


# %% [markdown]
# A driver is built of its options and the cell's clock. The core knows it by its port alone.

# %%
stopped = threading.Event()
options = LineTracker.Options(host="127.0.0.1", port=port, find_radius_mm=5.0)
tracker: hc.ports.Tracker = LineTracker(options, WallClock(stopped))
identity = tracker.connect()[0]
print(f"connected: {identity.model}, serial {identity.serial}")
reading = tracker.measure(np.array([1001.0, 200.0, 50.0]), "SMR 1.5in", 3)
print(f"measured: {reading.xyz_mm} mm, 1 sigma {reading.std_mm} mm")

# %% [markdown]
# Three things that go wrong. The reflector is not where it is expected; the device does not answer;
# a stop comes while the driver waits.

# %%
for near_mm in ([1020.0, 200.0, 50.0], [3000.0, 0.0, 0.0]):
    try:
        tracker.measure(np.array(near_mm), "SMR 1.5in", 3)
    except hc.HilcellError as error:
        print(f"{error.code}: {type(error).__name__}: {error}")

# %%
timer = threading.Timer(0.1, stopped.set)
timer.start()
try:
    tracker.measure(np.array([3000.0, 0.0, 0.0]), "SMR 1.5in", 3)
except hc.ports.Stopped as error:
    tracker.stop()
    print(f"Stopped: {error}")

# %%
tracker.close()
device.join()
timer.join()
