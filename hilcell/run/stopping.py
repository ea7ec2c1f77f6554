"""The safe stop: every device gets its stop frame at once, in any state of the engine.

Threads that send it wait ready from the start of a run; the thread that asks for the stop wakes
them and sends frames itself, so the order in which they get the processor does not matter. A stop
asks no queue, lock or file first: it would come late when it matters.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping

from hilcell.cell.devices import Devices
from hilcell.errors import DeviceError, HilcellError

STOP_S = 2.0  # each device may take this long to put its stop frame on the wire
CLOSE_S = 12.0  # of a rail: twice the time that its drive may take
AT_REST = {"Rail": "held", "Robot": "at rest"}  # how a run leaves what moves


class SafeStop:
    """Stops all devices, once. ``trigger`` may come from any thread but a signal's handler."""

    def __init__(self, devices: Devices) -> None:
        self._go = threading.Event()
        self._acts = Acts({name: device.stop for name, device in devices.named().items()}, self._go)

    def trigger(self) -> None:
        """Have the stop frames sent; a device that hangs keeps this thread, but no other frame."""
        self._go.set()
        self._acts.help()

    def wait(self) -> dict[str, Exception]:
        """Stop, wait until all frames are on their wires, and return the problems by device."""
        self._go.set()
        return self._acts.wait(STOP_S)

    def dismiss(self) -> None:
        """Let the threads end, where nothing was stopped; all devices are closed."""
        self._acts.dismiss()
        self._go.set()


def close_all(devices: Devices) -> dict[str, Exception]:
    """Close all devices at once, in bounded time; return the problems by device."""
    closes = {name: device.close for name, device in devices.named().items()}
    return Acts(closes).wait(CLOSE_S)


def not_at_rest(problems: Mapping[str, Exception]) -> DeviceError | None:
    """Return the error of devices that move and could not be left at rest; None without any."""
    found = [
        f"{device.lower()} could not be confirmed {AT_REST[device]}: "
        f"{error.summary if isinstance(error, DeviceError) else error}"
        for device, error in problems.items()
        if device in AT_REST
    ]
    if not found:
        return None
    act = "it may still move: look at it, and use the E-stop before anybody goes near"
    expected = "rail held, robot at rest"
    return DeviceError("HC-C32", "Cell", "close", "; ".join(found), expected=expected, act=act)


class Acts:
    """Acts that are done once each, as many at a time as there are, when ``go`` is set."""

    def __init__(
        self, acts: Mapping[str, Callable[[], None]], go: threading.Event | None = None
    ) -> None:
        self._go = go
        self._waiting = deque(acts.items())
        self._problems: dict[str, Exception] = {}
        self._done = {name: threading.Event() for name in acts}
        for name in acts:
            threading.Thread(target=self._work, name=f"act {name}", daemon=True).start()

    def help(self) -> None:
        """Do what nobody has begun yet."""
        while self._waiting:
            try:
                name, act = self._waiting.popleft()
            except IndexError:  # another thread was quicker
                return
            try:
                act()
            except Exception as error:  # noqa: BLE001 - one device's failure must not keep the others
                self._problems[name] = error
            self._done[name].set()

    def dismiss(self) -> None:
        """Leave undone what nobody has begun yet."""
        self._waiting.clear()

    def wait(self, limit_s: float) -> dict[str, Exception]:
        """Return the problems by name, among them the acts that take longer than ``limit_s``."""
        deadline_s = time.monotonic() + limit_s
        late: dict[str, Exception] = {}
        for name, done in self._done.items():
            if not done.wait(max(0.0, deadline_s - time.monotonic())):
                late[name] = HilcellError(f"no answer within {limit_s:g} s")
        return self._problems | late

    def _work(self) -> None:
        if self._go is not None:
            self._go.wait()
        self.help()
