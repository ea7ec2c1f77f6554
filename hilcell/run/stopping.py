"""The safe stop: every device gets its stop frame at once, in any state of the engine.

Threads that send it are ready from the start of a run; the thread that requests the stop wakes them
and sends frames itself, so scheduling does not matter. A stop waits for no queue, file or other
device; a driver may wait for the lock of its wire: of CAN for 0.1 s, of RTDE until a packet is out.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping

from hilcell.cell.devices import Devices
from hilcell.errors import DeviceError, HilcellError

CLOSE_S = 12.0  # of a rail: twice the time that its drive may take


class SafeStop:
    """Stops all devices, once. ``trigger`` may come from any thread but a signal's handler."""

    def __init__(self, devices: Devices) -> None:
        self._go = threading.Event()
        self._calls = ParallelCalls(
            {name: device.stop for name, device in devices.named().items()}, self._go
        )

    def trigger(self) -> None:
        """Send the stop frames; a device that hangs blocks this thread only."""
        self._go.set()
        self._calls.run_pending()

    def stop_and_wait(self) -> dict[str, Exception]:
        """Stop, wait until all frames are sent, and return the problems by device."""
        self._go.set()
        return self._calls.wait(2.0)  # s to put its stop frame on the wire

    def dismiss(self) -> None:
        """End the threads without a stop."""
        self._calls.dismiss()
        self._go.set()


def close_all(devices: Devices) -> dict[str, Exception]:
    """Close all devices at once, in bounded time; return the problems by device."""
    closes = {name: device.close for name, device in devices.named().items()}
    return ParallelCalls(closes).wait(CLOSE_S)


def not_at_rest(problems: Mapping[str, Exception]) -> DeviceError | None:
    """Return the error of rail or robot not left at rest, or None."""
    states = {"Rail": "held", "Robot": "at rest"}
    found = [
        f"{device.lower()} could not be confirmed {states[device]}: "
        f"{error.summary if isinstance(error, DeviceError) else error}"
        for device, error in problems.items()
        if device in states
    ]
    if not found:
        return None
    act = "it may still move: watch it, and press the E-stop before anyone enters the cell"
    expected = "rail held, robot at rest"
    return DeviceError("HC-C32", "Cell", "close", "; ".join(found), expected=expected, act=act)


class ParallelCalls:
    """Calls that run once each, all at the same time, when ``go`` is set, or at once without one.

    A thread waits for each call, and any other thread may run those not begun yet.
    """

    def __init__(
        self, calls: Mapping[str, Callable[[], None]], go: threading.Event | None = None
    ) -> None:
        self._go = go
        self._waiting = deque(calls.items())
        self._problems: dict[str, Exception] = {}
        self._done = {name: threading.Event() for name in calls}
        for name in calls:
            threading.Thread(target=self._work, name=f"call {name}", daemon=True).start()

    def run_pending(self) -> None:
        """Run, in this thread, the calls that no thread has begun; each is begun once."""
        while self._waiting:
            try:
                name, call = self._waiting.popleft()
            except IndexError:  # taken by another thread
                return
            try:
                call()
            except Exception as error:  # noqa: BLE001 - one device's failure must not keep the others
                self._problems[name] = error
            self._done[name].set()

    def dismiss(self) -> None:
        """Drop the calls that no thread has begun."""
        self._waiting.clear()

    def wait(self, limit_s: float) -> dict[str, Exception]:
        """Return the problems by name; a call that exceeds ``limit_s`` is one."""
        deadline_s = time.monotonic() + limit_s
        late: dict[str, Exception] = {}
        for name, done in self._done.items():
            if not done.wait(max(0.0, deadline_s - time.monotonic())):
                late[name] = HilcellError(f"no answer within {limit_s:g} s")
        return self._problems | late

    def _work(self) -> None:
        if self._go is not None:
            self._go.wait()
        self.run_pending()
