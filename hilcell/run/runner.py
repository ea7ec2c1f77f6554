"""The runner: one worker performs the procedure, the main thread owns the run's life.

The main thread takes messages from one queue: commands of the operator and the worker's words. A
stop sets the stop event, which ends every wait within 20 ms, and has each device's stop frame
sent by threads that wait for nothing else, so it works while the worker hangs in a call.
"""

from __future__ import annotations

import math
import queue
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import asdict, dataclass

from hilcell.cell.devices import Devices, connect_all
from hilcell.cell.file import Cell
from hilcell.errors import facts_of
from hilcell.journal.journal import Journal, StorageError
from hilcell.journal.log import Log
from hilcell.ports import Clock, DeviceError, HilcellError, Identity, NoReading, Stopped
from hilcell.run.cell_lock import lock_of_device, locked
from hilcell.run.cell_session import CellSession
from hilcell.run.device_status import CellMonitor
from hilcell.run.exits import (
    EXIT_FAULT,
    EXIT_OK,
    EXIT_OUT_OF_TOLERANCE,
    EXIT_REFUSED,
    EXIT_STORAGE,
    exit_code,
)
from hilcell.run.interlocks import Sight, overview
from hilcell.run.pause_gate import REST_S, PauseGate
from hilcell.run.procedure import Procedure
from hilcell.run.prompts import LOOK_S, Asking, Look, Prompt, passes, refusal, unanswered
from hilcell.run.protocol import Status
from hilcell.run.retake import retake_refusal
from hilcell.run.signals import signals_as_commands
from hilcell.run.states import RUN, StateMachine
from hilcell.run.stopping import SafeStop, close_all, facts_of_problems

SIGNAL_S = 0.05
ENDED = "the run has ended"
PARTS = ("device", "operation", "found", "wanted", "act")  # of a fault, for readers of schema 1
WORKER_S = 10.0  # the worker leaves a wire within this time after a stop
SCREEN_S = 10.0  # a screen looks for its engine twice a second: one not here by now is gone

Answers = list["Future[str]"]


@dataclass(frozen=True, slots=True)
class Ended:
    """How the worker ended: no error means that the procedure was performed."""

    error: Exception | None


@dataclass(frozen=True, slots=True)
class Asked:
    """The worker asks the operator, and waits; ``cause`` where an error made it ask."""

    prompt: Prompt
    cause: NoReading | None


Message = str | Ended | Asked


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
        ordered: bool = False,
    ) -> None:
        """``ordered``: by a screen, before whose eyes alone an attended run begins to move."""
        self.log = log
        self._cell, self._procedure = cell, procedure
        self._journal, self._clock = journal, clock
        self._stop, self._unattended = stop, unattended
        self._safe_stop = SafeStop(devices)
        self._monitor = CellMonitor(devices)
        self._devices = self._monitor.devices
        self._messages: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._gate = PauseGate(lambda: self._messages.put("rest"))
        self._why_paused = ""
        self._aborting = False
        self._asking = Asking()
        self._proven = threading.Event()
        self._bench: CellSession | None = None
        self._screens, self._screens_lock = 0, threading.Lock()
        self._unwatched = False
        self._screen_known = threading.Event()  # it has come, or it was lost
        if unattended or not ordered:
            self._screen_known.set()
        self._fault: Exception | None = None
        self._locks = ExitStack()
        self._life = StateMachine(
            RUN, log.states["run"], lambda body: journal.append("state", "", body)
        )

    def run(self) -> int:
        """Run to the end and return the exit code."""
        with self._locks:
            return self._run()

    def _run(self) -> int:
        try:
            begin = {"idle": "check", "finished": "reopen"}.get(self._life.state, "resume")
            self._life.fire(begin)
            worker = threading.Thread(target=self._work, name="worker", daemon=True)
            with signals_as_commands(self.post):
                worker.start()
                error = self._attend(worker)
            return self._end(error)
        except StorageError as error:
            self._stop.set()
            self._safe_stop.wait()
            close_all(self._devices)
            self._fault = error
            return EXIT_STORAGE

    @property
    def fault(self) -> Exception | None:
        """Return what ended the run, where something did."""
        return self._fault

    # -- any thread ---------------------------------------------------------------------------

    def post(self, command: str) -> None:
        """Queue a command of the operator; a signal's handler may do so, too."""
        self._messages.put(command)

    def stop(self) -> None:
        """Stop everything now: the frames are on their way before the main thread hears of it."""
        self._messages.put("stop")
        self._stop.set()
        self._safe_stop.trigger()

    def answer(self) -> str:
        """Say that the prompt is done; wait for the look that proves it, return why not."""
        return self._asking.answer().result()

    def retake(self, key: str) -> str:
        """Have a point re-measured, at the robot's next point; return why that is refused."""
        if refused := retake_refusal(self.log, key):
            return refused
        try:
            self._journal.append("event", "", {"what": "retake asked", "key": key})
        except StorageError as error:
            return str(error)
        return ""

    def watched(self, by: int) -> int:
        """Add ``by`` to the screens that attend; return how many do now."""
        with self._screens_lock:
            self._screens += by
            now = self._screens
        if by > 0:
            self.post("watched")
        return now

    def status(self) -> Status:
        """Return the run's state as every answer carries it."""
        return Status(
            run=self._journal.run,
            state=self._life.state,
            calibration=self.log.states["calibration"],
            points=len(self.log.points),
            unattended=self._unattended,
            screens=self._screens,
            pausing=self._pausing,
            devices=self._monitor.status(),
            link=self._link(),
            interlocks=overview(self._cell, self._sight()),
            prompt=self._asking.status(),
            retakes=list(self.log.retakes),
        )

    def _link(self) -> dict[str, int]:
        """Return what the rail's wire has carried."""
        return asdict(self._devices.rail.statistics())

    @property
    def _pausing(self) -> bool:
        """Whether a pause or an abort waits for the point in flight."""
        asked = self._aborting or self._gate.closed
        return asked and self._life.state in ("checking", "running")

    def _sight(self) -> Sight:
        monitor, bench = self._monitor, self._bench
        return Sight(
            monitor.rail_reading,
            monitor.robot_reading,
            monitor.rail.moving,
            monitor.robot.moving,
            None if bench is None else bench.held,
            time.monotonic(),
        )

    # -- the worker's thread ------------------------------------------------------------------

    def _work(self) -> None:
        error: Exception | None = None
        try:
            identities = connect_all(self._devices, self._claim)
            self._journal.append("event", "", {"what": "connected", "devices": identities})
            self._await_screen()
            self._messages.put("started")
            self._checkpoint()
            self._bench = CellSession(
                self._cell,
                self._devices,
                self._clock,
                self._journal,
                self.log,
                checkpoint=self._checkpoint,
                ask=self._ask,
            )
            self._procedure.perform(self._bench)
        except Exception as caught:  # noqa: BLE001 - whatever ends the worker is judged in _end
            error = caught
        self._asking.close(ENDED)
        self._messages.put(Ended(error))

    def _claim(self, identities: list[Identity]) -> None:
        """Lock what a device says it is: another run may reach it by another address.

        Raises `CellLocked`. A simulated device's numbers are those of many others.
        """
        known_by = {
            f"{each.device} ({each.model}, serial {each.serial})"
            for each in identities
            if each.serial.strip("0 ") and not each.simulated
        }
        for what in known_by:
            self._locks.enter_context(locked(lock_of_device(what), what, self._journal.run))

    def _await_screen(self) -> None:
        """Wait for the screen that ordered this run; one that does not come was lost."""
        missed_s = time.monotonic() + SCREEN_S
        while not self._screen_known.wait(REST_S):
            self._at_rest()
            if time.monotonic() > missed_s:
                self.post("lost")
                missed_s = math.inf

    def _checkpoint(self) -> None:
        """Wait here while the run is paused; the point in flight is always finished first."""
        self._check_end()
        self._gate.passage(self._at_rest)

    def _at_rest(self) -> None:
        """Keep the devices' readings fresh while the run waits."""
        self._check_end()
        self._monitor.refresh()

    def _check_end(self) -> None:
        """Leave here when a stop or an abort was asked for."""
        self._clock.check()
        if self._aborting:
            raise Stopped("aborted by the operator")

    def _ask(self, prompt: Prompt, look: Callable[[], Look], cause: NoReading | None) -> Look:
        """Suspend the run until the operator's answer is proven; return the look that proves it.

        Unattended it is a fault.
        """
        if self._unattended:
            raise unanswered(prompt, cause) from cause
        self._proven.clear()
        self._asking.open(prompt)
        self._messages.put(Asked(prompt, cause))
        looked_s = -LOOK_S
        while True:
            self._at_rest()
            answers = self._asking.waited(REST_S)
            if not answers and time.monotonic() - looked_s < LOOK_S:
                continue
            seen, proven = self._look(prompt, look, answers)
            looked_s = time.monotonic()
            if proven:
                self._asking.close("another answer came first")
                return seen

    def _look(
        self, prompt: Prompt, look: Callable[[], Look], answers: Answers
    ) -> tuple[Look, bool]:
        """Look, and judge by it the answers that came before; return whether to go on."""
        why = ENDED
        try:
            seen = look()
            self._asking.saw(seen)
            proven = bool(answers) and passes(prompt, seen)
            if proven:
                self._messages.put("proven")
                while not self._proven.wait(REST_S):
                    self._check_end()
                why = ""
            elif answers:
                why = refusal(prompt, seen)
                self._journal.append("event", "", {"what": "answer refused", "reason": why})
        finally:
            for answer in answers:
                answer.set_result(why)
        return seen, proven

    # -- the main thread ----------------------------------------------------------------------

    def _attend(self, worker: threading.Thread) -> Exception | None:
        """Take messages until the worker has ended; return what ended it."""
        while True:
            message = self._next()
            match message:
                case Ended():
                    return message.error
                case "stop" | "terminate":
                    return self._stop_worker(worker, message)
                case Asked():
                    self._suspend(message)
                case _:
                    self._obey(message)

    def _suspend(self, asked: Asked) -> None:
        error = {} if asked.cause is None else {"error": asked.cause.facts()}
        self._life.fire("suspend", reason=asked.prompt.reason, prompt=asked.prompt, **error)

    def _next(self) -> Message:
        """Wait for a message.

        In slices: a signal that comes just before a wait begins is handled when the wait ends.
        """
        while True:
            try:
                return self._messages.get(timeout=SIGNAL_S)
            except queue.Empty:
                continue

    def _obey(self, command: str) -> None:
        match command:
            case "started":
                self._life.fire("start")
            case "rest":
                if self._gate.closed and self._gate.resting and self._life.allows("pause"):
                    self._life.fire("pause", **self._reason())
            case "proven":
                self._life.fire("proceed")
                self._proven.set()
            case "interrupt":
                self._interrupt()
            case "lost" | "watched":
                self._look_for_screens(lost=command == "lost")
            case "pause" if self._may_pause():
                self._why_paused = ""
                self._gate.close()
            case "abort":
                self._aborting = True
            case "proceed":
                self._proceed()
            case _:
                self._refuse(command)

    def _interrupt(self) -> None:
        """Pause at the first ctrl-C, stop at the next, however fast it comes."""
        if self._may_pause():
            self._obey("pause")
        else:
            self.post("stop")

    def _may_pause(self) -> bool:
        return self._life.state in ("checking", "running") and not self._pausing

    def _reason(self) -> dict[str, str]:
        return {"reason": self._why_paused} if self._why_paused else {}

    def _look_for_screens(self, *, lost: bool) -> None:
        """Tell whether somebody watches now: meanwhile another screen may have come, or gone."""
        if lost and not self._screens:
            self._unwatched = True
            self._lose_screen()
        elif self._screens and self._unwatched:
            self._unwatched = False
            self._journal.append("event", "", {"what": "screen back"})
        self._screen_known.set()  # a run that has to pause has its gate closed by now

    def _lose_screen(self) -> None:
        """Pause where somebody should watch and nobody does."""
        self._journal.append("event", "", {"what": "screen lost"})
        if not self._unattended and self._may_pause():
            self._why_paused = "the screen was lost"
            self._gate.close()

    def _proceed(self) -> None:
        if self._life.state == "suspended":
            self._asking.answer()  # proven by a look as every answer
        elif self._life.state == "paused":
            self._life.fire("proceed")
            self._gate.open()
        elif self._pausing and not self._aborting:
            self._gate.open()
        else:
            self._refuse("proceed")

    def _refuse(self, command: str) -> None:
        what = {"what": "command refused", "command": command, "in": self._life.state}
        self._journal.append("event", "", what)

    def _stop_worker(self, worker: threading.Thread, command: str) -> Exception:
        self._stop.set()
        self._note("safe stop", self._safe_stop.wait())
        if self._life.allows("stop"):
            self._life.fire("stop")
        worker.join(WORKER_S)
        if worker.is_alive():
            return DeviceError(
                "HC-C01",
                "Cell",
                "stop",
                f"a device call hangs {WORKER_S:.0f} s after the stop",
                fields={"waited_s": WORKER_S},
            )
        return Stopped(f"stopped by {'the operator' if command == 'stop' else 'SIGTERM'}")

    def _end(self, error: Exception | None) -> int:
        self._fault = error
        if isinstance(error, StorageError):
            raise error
        if isinstance(error, Stopped) and self._life.allows("stop"):
            self._life.fire("stop", reason=str(error))  # aborted at a checkpoint: all is at rest
        elif error is not None and not self._stop.is_set():
            self._stop.set()
            self._note("safe stop", self._safe_stop.wait())
        self._note("closed", close_all(self._devices))
        self._journal.append("event", "", {"what": "link"} | self._link())
        if error is None:
            try:
                return self._finish()
            except Exception as caught:  # noqa: BLE001 - a result that cannot be computed is a fault
                self._fault = error = caught
        self._tell(error)
        code = exit_code(error)
        if code == EXIT_REFUSED and self.log.moved:
            code = EXIT_FAULT  # "refused" is said only before anything moved
        body = {"state": self._life.state, "exit": code, "result": {}, "reason": str(error)}
        self._journal.append("end", "", body | {"error": facts_of(error)})
        return code

    def _finish(self) -> int:
        self._procedure.result(self.log)  # what cannot be computed is a fault, not a finish
        self._life.fire("finish")
        return finish(self._procedure, self._journal, self.log)

    def _tell(self, error: Exception) -> None:
        """Enter the state that the error means."""
        if isinstance(error, Stopped):
            self._life.fire("abort")
            return
        parts = {name: str(getattr(error, name, "")) for name in PARTS}
        self._life.fire("fault", reason=str(error), **parts, error=facts_of(error))
        if not isinstance(error, HilcellError):
            trace = "".join(traceback.format_exception(error))
            self._journal.append("event", "", {"what": "internal error", "trace": trace})

    def _note(self, what: str, problems: dict[str, Exception]) -> None:
        try:
            self._journal.append("event", "", {"what": what} | facts_of_problems(problems))
        except StorageError as error:
            self._fault = self._fault or error


def finish(procedure: Procedure, journal: Journal, log: Log) -> int:
    """Write the end of a finished run, unless the journal holds it; return the exit code."""
    in_tolerance = all(verdict["holds"] for verdict in log.verdicts.values())
    code = EXIT_OK if in_tolerance else EXIT_OUT_OF_TOLERANCE
    if log.end is None:
        result = procedure.result(log)
        journal.append("end", "", {"state": "finished", "exit": code, "result": result})
    return code
