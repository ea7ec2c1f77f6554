"""The runner: the main thread owns the run's state while one worker performs the procedure.

The main thread takes commands of the operator and messages of the worker from one queue. A stop
sets the stop event, which ends every wait within 20 ms, and sends each device's stop frame from
threads reserved for it, so it works while the worker hangs in a call.
"""

from __future__ import annotations

import queue
import signal
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial

from hilcell.cell.devices import Devices
from hilcell.decoding import Json
from hilcell.errors import (
    EXIT_FAULT,
    EXIT_OK,
    EXIT_OUT_OF_TOLERANCE,
    EXIT_REFUSED,
    EXIT_STORAGE,
    DriverDefect,
    exit_code,
    facts_of,
)
from hilcell.journal.journal import StorageError
from hilcell.journal.log import RunJournal
from hilcell.model.events import (
    AlarmsAcknowledged,
    Announced,
    Closed,
    Closing,
    CommandRefused,
    InternalError,
    LinkCounted,
    RemeasureRequested,
    SafeStopSent,
    ScreenBack,
    ScreenLost,
)
from hilcell.model.records import PASSING
from hilcell.model.verdicts import blamed
from hilcell.ports import Clock, DeviceError, HilcellError, RecordingEnded, Stopped
from hilcell.run.control import Status
from hilcell.run.order import Attendance
from hilcell.run.procedure import Procedure
from hilcell.run.run_plan import RunPlan
from hilcell.run.signals import COMMANDS, signals_as_commands
from hilcell.run.states import RUN, StateMachine, retake_refusal
from hilcell.run.stopping import SafeStop, close_all, not_at_rest
from hilcell.run.worker import (
    Asked,
    AtRest,
    Ended,
    Message,
    PauseRequested,
    Started,
    Verified,
    Worker,
)

WORKER_S = 10.0  # the worker ends within this time after a stop


class Runner:
    """Performs one procedure on one cell, once, from idle to finished, aborted or faulted.

    ``fault`` is the error that has ended the run, if any.
    """

    def __init__(
        self,
        plan: RunPlan,
        attendance: Attendance,
        journal: RunJournal,
        *,
        devices: Devices,
        clock: Clock,
        stop: threading.Event,
    ) -> None:
        """An attended run that a screen has ordered moves only once the screen attends."""
        self.log, self._unattended = journal.log, attendance.unattended
        self._plan, self._journal, self._clock, self._stop = plan, journal, clock, stop
        self._safe_stop = SafeStop(devices)
        self._messages: queue.SimpleQueue[Message | AlarmsAcknowledged | str] = queue.SimpleQueue()
        self._worker = Worker(
            plan, journal, devices, clock, self._messages.put, unattended=self._unattended
        )
        self._pause_gate, self._pending = self._worker.gate, self._worker.pending
        self._why_paused = ""
        self._screens, self._screens_lock = 0, threading.Lock()
        self._unwatched = False
        if attendance.unattended or not attendance.screen:
            self._worker.screen_known.set()
        self.fault: Exception | None = None
        self._unclosed: dict[str, Exception] | None = None  # None: the devices are still open
        self._life = StateMachine(RUN, journal)

    def dismiss(self) -> None:
        """End its threads without a run."""
        self._safe_stop.dismiss()

    def run(self, noted: Sequence[signal.Signals] = ()) -> int:
        """Run to the end and return the exit code; earlier signals ``noted`` become commands.

        During this call signals only queue commands, so none interrupts the teardown.
        """
        with signals_as_commands(self.post):
            for number in noted:
                self.post(COMMANDS[number])
            try:
                return self._end(self._perform())
            except StorageError as error:
                self._stop.set()
                self._safe_stop.stop_and_wait()
                self._close_devices()
                self.fault = error
                return EXIT_STORAGE
            finally:
                self._worker.release()
                if self._unclosed is not None:
                    self._safe_stop.dismiss()

    @property
    def unclosed(self) -> dict[str, Exception]:
        """Return, by device, the errors of devices not left held and closed."""
        return self._left_moving(self._unclosed or {})

    # -- any thread ---------------------------------------------------------------------------

    def post(self, command: str) -> None:
        """Queue a command of the operator; also callable from a signal handler."""
        self._messages.put(command)

    def stop(self) -> None:
        """Stop everything now, before the main thread handles it."""
        self._messages.put("stop")
        self._stop.set()
        self._safe_stop.trigger()

    def proceed_refusal(self, since: int) -> str:
        """Return the refusal of an agreement to the question of record ``since``, else ""."""
        if any(each.seq > since and each.to == "running" for each in self.log.life):
            return "the run has continued since you were asked; nothing was done, ask again"
        if any(each.seq > since and isinstance(each.fact, Announced) for each in self.log.events):
            return "a motion was announced since you were asked; nothing was done, ask again"
        return ""

    def answer(self, choice: str = "") -> str:
        """Answer the prompt by "done" or a choice; wait for its verification; return the refusal,
        else "".
        """
        return self._pending.answer(choice).result()

    def retake(self, key: str) -> str:
        """Request that a point is re-measured next; return the refusal, else ""."""
        if refused := retake_refusal(self.log, key):
            return refused
        try:
            self._journal.append("event", "", RemeasureRequested(key=key))
        except StorageError as error:
            return str(error)
        return ""

    def acknowledge(self, made: AlarmsAcknowledged) -> str:
        """Journal that alarms were acknowledged; return the refusal, else ""."""
        newest = self.log.newest
        refused = made.refusal(0 if newest is None else newest.seq)
        if not refused:
            self._messages.put(made)  # journalled by the main thread, before the end
        return refused

    def watched(self, by: int) -> int:
        """Add ``by`` to the attending screens; return their number."""
        with self._screens_lock:
            self._screens += by
            now = self._screens
        if by > 0:
            self.post("watched")
        return now

    def status(self) -> Status:
        state, asked = self._known_state(), self._pause_gate.closed or self.log.state in PASSING
        monitor, session = self._worker.monitor, self._worker.session
        return Status(
            run=self._journal.run,
            state=state,
            calibration=self.log.calibration,
            points=len(self.log.points),
            unattended=self._unattended,
            screens=self._screens,
            pausing=asked and state in ("checking", "running"),
            devices=monitor.status(),
            link=asdict(self._worker.devices.rail.statistics()),
            interlocks=monitor.interlocks(None if session is None else session.held),
            prompt=self._worker.prompt(),
            retakes=list(self.log.retakes),
        )

    def _known_state(self) -> str:
        """Return the state for clients, who have ``pausing`` as a flag."""
        life = (change.to for change in reversed(self.log.life))
        return next((state for state in life if state not in PASSING), "idle")

    # -- the main thread: messages ------------------------------------------------------------

    def _perform(self) -> Exception | None:
        """Let the worker perform the procedure; return the error that ended it."""
        begin = {"idle": "check", "finished": "reopen"}.get(self.log.state, "resume")
        self._life.fire(begin)
        self._worker.start()
        try:
            return self._attend()
        except StorageError:
            raise
        except Exception as defect:  # noqa: BLE001 - of this thread; the devices are stopped all the same
            return defect

    def _attend(self) -> Exception | None:
        """Handle messages until the worker has ended; return the error that ended it."""
        while True:
            match self._next():
                case Ended(error):
                    return error
                case "stop" | "terminate" as command:
                    return self._stop_worker(command)
                case str(command):
                    self._obey(command)
                case AlarmsAcknowledged() as made:
                    self._journal.append("event", "", made)
                case message if self.log.state != "aborting":  # else the worker is about to leave
                    self._follow(message)

    def _next(self) -> Message | AlarmsAcknowledged | str:
        """Wait for a message.

        In slices, since a signal just before a wait is handled when the wait ends.
        """
        while True:
            try:
                return self._messages.get(timeout=0.05)
            except queue.Empty:
                continue

    def _follow(self, message: Message) -> None:
        match message:
            case Started():
                self._go_on("start")
            case AtRest() if self._pause_gate.resting and self._life.may_trigger("rest"):
                self._life.fire("rest", reason=self._why_paused)
            case PauseRequested(reason):
                self._pause(reason)
            case Asked(prompt, cause):
                error = {} if cause is None else {"error": cause.facts()}
                self._life.fire("suspend", reason=prompt.reason, prompt=prompt, **error)
            case Verified(by):
                self._go_on("proceed", by=by)
                self._worker.may_proceed.set()

    def _go_on(self, trigger: str, **facts: object) -> None:
        """Run; an earlier request to pause is kept."""
        self._life.fire(trigger, **facts)
        if self._pause_gate.closed:
            self._life.fire("pause")

    def _obey(self, command: str) -> None:
        match command:
            case "interrupt" | "pause" if self._may_pause():
                self._pause("as the operator asked")
            case "interrupt":  # the second, however fast it comes
                self.post("stop")
            case "lost" | "watched":
                self._look_for_screens(lost=command == "lost")
            case "proceed" if self.log.state == "suspended":
                self._pending.answer()  # verified as every answer
            case "proceed" if self._pause_gate.closed and self.log.state != "aborting":
                if self._life.may_trigger("proceed"):  # not yet where the worker still connects
                    self._life.fire("proceed", by="command")
                self._pause_gate.open()
            case "abort":
                if self._life.may_trigger("abort"):  # else already requested
                    self._life.fire("abort")
            case _:
                refused = CommandRefused(command=command, state=self._known_state())
                self._journal.append("event", "", refused)

    def _may_pause(self) -> bool:
        return self.log.state in ("checking", "running") and not self._pause_gate.closed

    def _pause(self, reason: str) -> None:
        self._why_paused = reason
        self._pause_gate.close()
        if self._life.may_trigger("pause"):  # not yet while devices are connected: see `_go_on`
            self._life.fire("pause")

    def _look_for_screens(self, *, lost: bool) -> None:
        if lost and not self._screens:
            self._unwatched = True
            self._journal.append("event", "", ScreenLost())
            if not self._unattended and self._may_pause():
                self._pause("the screen was lost")
        elif self._screens and self._unwatched:
            self._unwatched = False
            self._journal.append("event", "", ScreenBack())
        self._worker.screen_known.set()  # a run that has to pause has its gate closed by now

    # -- the main thread: the end -------------------------------------------------------------

    def _stop_worker(self, command: str) -> Exception:
        self._stop.set()
        self._note(SafeStopSent, self._safe_stop.stop_and_wait())
        if self._life.may_trigger("stop"):
            self._life.fire("stop")
        if self._worker.ended_within(WORKER_S):
            return Stopped(f"stopped by {'the operator' if command == 'stop' else 'SIGTERM'}")
        return DeviceError(
            "HC-C01",
            "Cell",
            "stop",
            f"a device call hangs {WORKER_S:.0f} s after the stop",
            fields={"waited_s": WORKER_S},
        )

    def _end(self, error: Exception | None) -> int:
        self.fault = error
        if isinstance(error, StorageError):
            raise error
        if isinstance(error, Stopped) and self._life.may_trigger("stop"):
            self._life.fire("stop", reason=str(error))  # aborted at a checkpoint: all at rest
        elif error is not None and not self._stop.is_set():
            self._stop.set()
            self._note(partial(SafeStopSent, cause=str(error)), self._safe_stop.stop_and_wait())
            self._worker.ended_within(WORKER_S)
        began_s = time.monotonic()
        problems = self._close_devices()
        self._note(partial(Closed, took_s=time.monotonic() - began_s), problems)
        self._journal.append(
            "event", "", LinkCounted(**asdict(self._worker.devices.rail.statistics()))
        )
        self._journal.read_back()  # results are computed from durable records only
        if error is None or isinstance(error, Stopped):
            # After "finished" or an abort the operator enters the cell.
            self.fault = error = not_at_rest(self.unclosed) or error
        if error is None:
            try:
                return self._finish()
            except StorageError:  # of a run that has finished: there is no fault to enter
                raise
            except Exception as caught:  # noqa: BLE001 - a result that cannot be computed is a fault
                self.fault = error = caught
        self._fail(error)
        code = exit_code(error)
        if code == EXIT_REFUSED and self.log.moved:
            code = EXIT_FAULT  # "refused" is said only before anything moved
        facts = facts_of(error)
        body = {"exit": code, "result": blamed(facts), "reason": str(error), "error": facts}
        self._journal.append("end", "", {"state": self.log.state} | body)
        return code

    def _left_moving(self, problems: dict[str, Exception]) -> dict[str, Exception]:
        """Return problems of stopping and closing, except of a recording that has ended."""
        ended = isinstance(self.fault, RecordingEnded)
        if problems and not ended:
            try:
                self._clock.check()
            except RecordingEnded:
                ended = True
            except Stopped:
                pass
        return {} if ended else problems

    def _close_devices(self) -> dict[str, Exception]:
        """Close all devices, once; return the problems by device."""
        if self._unclosed is None:
            self._unclosed = close_all(self._worker.devices)
        return self._unclosed

    def _finish(self) -> int:
        result = self._plan.procedure.result(self.log)  # an error here is a fault
        self._life.fire("finish")
        return finish(self._plan.procedure, self._journal, result)

    def _fail(self, error: Exception) -> None:
        if isinstance(error, Stopped):
            self._life.fire("abort")
            return
        self._life.fire("fault", reason=str(error), error=facts_of(error))
        if isinstance(error, DriverDefect) or not isinstance(error, HilcellError):
            trace = "".join(traceback.format_exception(error))
            self._journal.append("event", "", InternalError(trace=trace))

    def _note(self, kind: Callable[..., Closing], problems: dict[str, Exception]) -> None:
        left = self._left_moving(problems)
        words = {name: str(error) for name, error in left.items()}
        errors = {name: facts_of(error) for name, error in left.items()}
        try:
            self._journal.append("event", "", kind(problems=words, errors=errors))
        except StorageError as error:
            self.fault = self.fault or error


def finish(procedure: Procedure, journal: RunJournal, result: Json | None = None) -> int:
    """Write the end of a finished run, unless the journal has it; return the exit code.

    ``result`` is the procedure's, if it is computed already.
    """
    log = journal.log
    in_tolerance = all(verdict.holds for verdict in log.verdicts.values())
    code = EXIT_OK if in_tolerance else EXIT_OUT_OF_TOLERANCE
    if log.end is None:
        found = procedure.result(log) if result is None else result
        journal.append("end", "", {"state": "finished", "exit": code, "result": found})
    return code
