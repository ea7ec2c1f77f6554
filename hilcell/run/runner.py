"""The runner: one worker performs the procedure, the main thread owns the run's life.

The main thread takes messages from one queue: commands of the operator and the worker's end. A
stop sets the stop event, which ends every wait within 20 ms, and sends each device its stop frame
from here, so it works while the worker hangs in a call.
"""

from __future__ import annotations

import queue
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

from hilcell.cell import Cell
from hilcell.devices import Devices, connect_all
from hilcell.exits import (
    EXIT_FAULT,
    EXIT_OK,
    EXIT_OUT_OF_TOLERANCE,
    EXIT_REFUSED,
    EXIT_STORAGE,
    exit_code,
)
from hilcell.ports import Clock, DeviceError, HilcellError, Stopped
from hilcell.run.bench import Bench
from hilcell.run.journal import Journal, StorageError
from hilcell.run.log import Log
from hilcell.run.machine import RUN, StateMachine
from hilcell.run.procedure import Procedure

STOP_S = 2.0  # each device may take this long to put its stop frame on the wire
WORKER_S = 10.0  # the worker leaves a wire within this time after a stop
CLOSE_S = 10.0


@dataclass(frozen=True, slots=True)
class Ended:
    """How the worker ended: no error means that the procedure was performed."""

    error: Exception | None


class Runner:
    """Performs one procedure on one cell, once, from idle to finished, aborted or faulted."""

    def __init__(
        self,
        cell: Cell,
        procedure: Procedure,
        journal: Journal,
        log: Log,
        *,
        devices: Devices,
        clock: Clock,
        stop: threading.Event,
        unattended: bool,
    ) -> None:
        self.log = log
        self._cell, self._procedure = cell, procedure
        self._journal, self._devices, self._clock = journal, devices, clock
        self._stop, self._unattended = stop, unattended
        self._messages: queue.SimpleQueue[str | Ended] = queue.SimpleQueue()
        self._go = threading.Event()
        self._go.set()
        self._fault: Exception | None = None
        self._life = StateMachine(
            RUN, log.states["run"], lambda body: journal.append("state", "", body)
        )

    def post(self, command: str) -> None:
        """Queue a command of the operator; may be called from any thread."""
        self._messages.put(command)

    def status(self) -> dict[str, object]:
        """Return the run's state for those who ask."""
        return {
            "run": self._journal.run,
            "state": self._life.state,
            "calibration": self.log.states["calibration"],
            "points": len(self.log.points),
        }

    def run(self) -> int:
        """Run to the end and return the exit code."""
        try:
            self._life.fire("check" if self._life.state == "idle" else "resume")
            worker = threading.Thread(target=self._work, name="worker", daemon=True)
            with self._signals():
                worker.start()
                error = self._attend(worker)
            return self._end(error)
        except StorageError as error:
            self._safe_stop()
            self._close_devices()
            self._fault = error
            return EXIT_STORAGE

    @property
    def fault(self) -> Exception | None:
        """Return what ended the run, where something did."""
        return self._fault

    # -- the worker's thread ------------------------------------------------------------------

    def _work(self) -> None:
        error: Exception | None = None
        try:
            identities = connect_all(self._devices)
            self._journal.append("event", "", {"what": "connected", "devices": identities})
            self._messages.put("started")
            self._checkpoint()
            bench = Bench(
                self._cell, self._devices, self._clock, self._journal, self.log,
                checkpoint=self._checkpoint, ask=self._ask,
            )  # fmt: skip
            self._procedure.perform(bench)
        except Exception as caught:  # noqa: BLE001 - whatever ends the worker is judged in _end
            error = caught
        self._messages.put(Ended(error))

    def _checkpoint(self) -> None:
        """Wait here while the run is paused; the point in flight is always finished first."""
        while not self._go.wait(0.02):
            self._clock.check()
        self._clock.check()

    def _ask(self, reason: str) -> None:
        """Suspend the run until the operator lets it go on; unattended, it is a fault."""
        if self._unattended:
            raise DeviceError(
                "Tracker", "measure", reason, act="clear the beam or seat the reflector, resume"
            )
        self._go.clear()
        self._messages.put(f"suspend {reason}")
        self._checkpoint()

    # -- the main thread ----------------------------------------------------------------------

    def _attend(self, worker: threading.Thread) -> Exception | None:
        """Take messages until the worker has ended; return what ended it."""
        while True:
            message = self._messages.get()
            if isinstance(message, Ended):
                return message.error
            if message == "stop":
                return self._stop_worker(worker)
            self._obey(message)

    def _obey(self, message: str) -> None:
        command, _, reason = message.partition(" ")
        if command == "interrupt":
            command = "pause" if self._life.allows("pause") else "stop"
            if command == "stop":
                self._messages.put("stop")
                return
        if command == "started":
            command = "start"
        if not self._life.allows(command):
            self._journal.append(
                "event", "", {"what": "command refused", "command": command, "in": self._life.state}
            )
            return
        if command == "pause":
            self._go.clear()
        self._life.fire(command, **({"reason": reason} if reason else {}))
        if command == "proceed":
            self._go.set()

    def _stop_worker(self, worker: threading.Thread) -> Exception:
        self._stop.set()
        self._safe_stop()
        if self._life.allows("stop"):
            self._life.fire("stop")
        worker.join(WORKER_S)
        if worker.is_alive():
            return DeviceError(
                "Cell", "stop", f"a device call hangs {WORKER_S:.0f} s after the stop"
            )
        return Stopped("stopped by the operator")

    def _end(self, error: Exception | None) -> int:
        self._fault = error
        if isinstance(error, StorageError):
            raise error
        if error is not None and not self._stop.is_set():
            self._stop.set()
            self._safe_stop()
        self._close_devices()
        if error is None:
            try:
                return self._finish()
            except Exception as caught:  # noqa: BLE001 - a result that cannot be computed is a fault
                self._fault = error = caught
        self._judge(error)
        code = exit_code(error)
        if code == EXIT_REFUSED and self.log.moved:
            code = EXIT_FAULT  # "refused" is said only before anything moved
        body = {"state": self._life.state, "exit": code, "result": {}, "reason": str(error)}
        self._journal.append("end", "", body)
        return code

    def _finish(self) -> int:
        if self._life.allows("proceed"):  # a pause that came after the last checkpoint
            self._life.fire("proceed")
        self._procedure.result(self.log)  # what cannot be computed is a fault, not a finish
        self._life.fire("finish")
        return finish(self._procedure, self._journal, self.log)

    def _judge(self, error: Exception) -> None:
        if isinstance(error, Stopped):
            self._life.fire("abort")
            return
        self._life.fire("fault", reason=str(error))
        if not isinstance(error, HilcellError):
            trace = "".join(traceback.format_exception(error))
            self._journal.append("event", "", {"what": "internal error", "trace": trace})

    # -- stopping -----------------------------------------------------------------------------

    def _safe_stop(self) -> None:
        """Send every device its stop, all at once, best effort; a failure is journalled."""
        problems = _each(
            {name: device.stop for name, device in self._devices.named().items()}, STOP_S
        )
        self._note("safe stop", problems)

    def _close_devices(self) -> None:
        """Leave the rail held and the robot at rest, once, in bounded time."""
        problems = _each(
            {name: device.close for name, device in self._devices.named().items()}, CLOSE_S
        )
        self._note("closed", problems)

    def _note(self, what: str, problems: dict[str, str]) -> None:
        try:
            self._journal.append("event", "", {"what": what, "problems": problems})
        except StorageError as error:
            self._fault = self._fault or error

    def _signals(self) -> AbstractContextManager[None]:
        """Ctrl-C pauses, a second one stops; SIGTERM stops; a lost terminal pauses if attended."""
        hangup = "stay" if self._unattended else "pause"
        commands = {signal.SIGINT: "interrupt", signal.SIGTERM: "stop", signal.SIGHUP: hangup}
        return handled(
            dict.fromkeys(commands, lambda number, _: self.post(commands[signal.Signals(number)]))
        )


def finish(procedure: Procedure, journal: Journal, log: Log) -> int:
    """Write the end of a finished run, unless the journal holds it; return the exit code."""
    in_tolerance = all(verdict["holds"] for verdict in log.verdicts.values())
    code = EXIT_OK if in_tolerance else EXIT_OUT_OF_TOLERANCE
    if log.end is None:
        result = procedure.result(log)
        journal.append("end", "", {"state": "finished", "exit": code, "result": result})
    return code


@contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Turn SIGTERM, SIGINT and SIGHUP into `Stopped` while nothing moves yet."""

    def stopped(number: int, _: object) -> None:
        raise Stopped(f"stopped by {signal.Signals(number).name} before anything moved")

    with handled(dict.fromkeys((signal.SIGINT, signal.SIGTERM, signal.SIGHUP), stopped)):
        yield


@contextmanager
def handled(handlers: Mapping[signal.Signals, Callable[[int, Any], None]]) -> Iterator[None]:
    """Install signal handlers for a while, where this is the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _each(acts: dict[str, Callable[[], None]], limit_s: float) -> dict[str, str]:
    """Do all acts at once, each in a thread; return the problems by name."""
    problems: dict[str, str] = {}

    def guarded(name: str, act: Callable[[], None]) -> None:
        try:
            act()
        except Exception as error:  # noqa: BLE001 - one device's failure must not keep the others
            problems[name] = str(error)

    threads = {
        name: threading.Thread(target=guarded, args=(name, act), daemon=True)
        for name, act in acts.items()
    }
    for thread in threads.values():
        thread.start()
    deadline_s = time.monotonic() + limit_s
    for name, thread in threads.items():
        thread.join(max(0.0, deadline_s - time.monotonic()))
        if thread.is_alive():
            problems[name] = f"no answer within {limit_s:.0f} s"
    return problems
