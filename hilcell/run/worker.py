"""The worker: the thread that performs the procedure. It reports progress by messages."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import NamedTuple

import msgspec

from hilcell import __version__
from hilcell.cell.devices import Devices, connect_all
from hilcell.journal.log import RunJournal
from hilcell.model.events import AnswerRefused, ChangesAccepted, Connected, DeviceBack, DeviceLost
from hilcell.ports import Clock, DeviceError, Identity, NoReading, Stopped
from hilcell.run.cell_lock import lock_of_device, locked
from hilcell.run.cell_session import CellSession
from hilcell.run.control import HERE, RELEASE, PromptStatus
from hilcell.run.device_status import CellMonitor
from hilcell.run.prompts import NO_CHOICES, POLL_S, Answer, PendingPrompt, Prompt, Verification
from hilcell.run.run_plan import RunPlan, changed_assets

REST_S = 0.02


class PauseGate:
    """Open at first. ``reached`` is called once the worker waits at the closed gate (``resting``).

    A gate that opens and closes at once must find the worker either resting or past it, and an
    open gate is never reported as reached; so both change under the lock. ``reached`` must not
    wait.
    """

    def __init__(self, reached: Callable[[], None]) -> None:
        self._reached = reached
        self._lock = threading.Lock()
        self._open = threading.Event()
        self._open.set()
        self.resting = False

    @property
    def closed(self) -> bool:
        return not self._open.is_set()

    def close(self) -> None:
        """Make the worker wait at its next checkpoint."""
        with self._lock:
            self._open.clear()
            if self.resting:
                self._reached()

    def open(self) -> None:
        with self._lock:
            self._open.set()

    def pass_through(self, at_rest: Callable[[], None]) -> None:
        """Wait while the gate is closed, calling ``at_rest`` repeatedly; it may raise."""
        while not self._passed():
            at_rest()
            self._open.wait(REST_S)

    def _passed(self) -> bool:
        with self._lock:
            if self._open.is_set():
                self.resting = False
            elif not self.resting:
                self.resting = True
                self._reached()
            return not self.resting


# A person who walks through the beam is gone in seconds, a lamp that dazzles the tracker in an
# hour. So polls come after 10 s, 20 s, 40 s and so on; when the time is over, the run ends with a
# fault. A cause that is back soon after a passed poll keeps the long interval: the poll of a frozen
# strip verifies nothing before the slide has moved.


class UnattendedPolling:
    """All waits of one session: together at most ``limit_s`` of the cell's time."""

    FIRST_POLL_S = 10.0

    def __init__(self, clock: Clock, limit_s: float) -> None:
        self._clock, self._left_s = clock, limit_s
        self._apart_s = self._due_s = self.FIRST_POLL_S
        self._polled_s = -math.inf

    @property
    def over(self) -> bool:
        return not self._left_s > 0.0

    def begin(self) -> None:
        """Begin a wait: the first poll comes soon, unless the same cause may be back at once."""
        if not self._clock.now_s() - self._polled_s <= self._apart_s:
            self._apart_s = self._due_s = self.FIRST_POLL_S

    def poll_due(self) -> bool:
        """Wait for a slice of time; return whether to poll now."""
        slice_s = min(0.5, self._left_s)  # answers are handled in between
        self._clock.wait(slice_s)
        self._left_s -= slice_s
        self._due_s -= slice_s
        if self._due_s > 0.0 and not self.over:
            return False
        self._apart_s = min(2.0 * self._apart_s, 300.0)
        self._due_s = self._apart_s
        self._polled_s = self._clock.now_s()
        return True


ENDED = "the run has ended"


class Started(NamedTuple):
    """All devices are connected, and a screen attends where one ordered the run."""


class AtRest(NamedTuple):
    """The worker waits at the closed gate."""


class PauseRequested(NamedTuple):
    """The worker has closed the gate: the operator must watch from here."""

    reason: str


class Asked(NamedTuple):
    """The worker prompts the operator and waits; ``cause`` is the error, if any."""

    prompt: Prompt
    cause: NoReading | None


class Verified(NamedTuple):
    """The operator's answer, or the end of an unattended wait, is verified.

    The worker waits for `Worker.may_proceed`.
    """

    by: str


class Ended(NamedTuple):
    """The worker ended; without an error the procedure was performed."""

    error: Exception | None


Message = Started | AtRest | PauseRequested | Asked | Verified | Ended


class Worker:
    """Performs one procedure on one cell; ``send`` takes its messages and must not wait.

    Other threads close and open ``gate``, answer through ``pending``, set ``may_proceed`` after
    `Verified`, and set ``screen_known`` once the screen that ordered the run attends or is lost.
    """

    SCREEN_S = 10.0  # a screen polls for its engine twice a second

    def __init__(
        self,
        plan: RunPlan,
        journal: RunJournal,
        devices: Devices,
        clock: Clock,
        send: Callable[[Message | str], None],
        *,
        unattended: bool,
    ) -> None:
        self.monitor = CellMonitor(devices, clock, plan.cell)
        self.devices = self.monitor.devices
        self.gate = PauseGate(lambda: send(AtRest()))
        self.pending = PendingPrompt(clock)
        self.may_proceed, self.screen_known = threading.Event(), threading.Event()
        self.session: CellSession | None = None
        self._plan, self._journal, self._clock = plan, journal, clock
        self._send, self._unattended = send, unattended
        self._wait = UnattendedPolling(clock, plan.cell.plan.unattended_wait_s)
        can_ask = plan.changes.can_ask and not unattended
        self._changes = replace(plan.changes, can_ask=can_ask)
        self._lost: dict[str, DeviceError] = {}  # as the journal has it
        self._locks = ExitStack()
        self._thread = threading.Thread(target=self._work, name="worker", daemon=True)

    def prompt(self) -> PromptStatus | None:
        """Return the prompt; it is not ready while a device is lost."""
        status = self.pending.status()
        if status is None or not self.monitor.lost:
            return status
        return msgspec.structs.replace(status, ready=False)

    def start(self) -> None:
        self._thread.start()

    def ended_within(self, limit_s: float) -> bool:
        self._thread.join(limit_s)
        return not self._thread.is_alive()

    def release(self) -> None:
        self._locks.close()

    # -- the thread ---------------------------------------------------------------------------

    def _work(self) -> None:
        error: Exception | None = None
        try:
            self._perform()
        except Exception as caught:  # noqa: BLE001 - any error ends the worker; the runner judges it
            error = caught
        self.pending.close(ENDED)
        self._send(Ended(error))

    def _perform(self) -> None:
        identities = connect_all(self.devices, self._lock_devices)
        changes = [*self._changes.inputs, *changed_assets(self._journal.log.assets, identities)]
        connected = Connected(devices=identities, hilcell=__version__)
        self._changes.check(changes)
        if not changes:
            self._journal.append("event", "", connected)
        self._await_screen()
        self._send(Started())
        if changes:
            if not self._changes.accepted:  # the operator sees what has changed
                self._pause(f"not as before: {'; '.join(changes)}")
            by = "--accept-changes" if self._changes.accepted else "the operator"
            self._journal.append("event", "", ChangesAccepted(changes=changes, by=by))
            self._journal.append("event", "", connected)  # the next resume compares with these
        self._checkpoint()
        self.session = CellSession(
            self._plan.cell,
            self.devices,
            self._clock,
            self._journal,
            checkpoint=self._checkpoint,
            ask=self._ask,
            pause=self._pause,
        )
        self._plan.procedure.perform(self.session)

    def _lock_devices(self, identities: list[Identity]) -> None:
        """Lock each real device by its serial number: it may have a second address.

        Raises `CellLocked`.
        """
        names = {
            f"{each.device} ({each.model}, serial {each.serial})"
            for each in identities
            if each.serial.strip("0 ") and not each.simulated
        }
        for what in names:
            self._locks.enter_context(locked(lock_of_device(what), what, self._journal.run))

    def _await_screen(self) -> None:
        """Wait for the screen that ordered this run; report it as lost after `SCREEN_S`."""
        missed_s = time.monotonic() + self.SCREEN_S
        while not self.screen_known.wait(REST_S):
            self._at_rest()
            if time.monotonic() > missed_s:
                self._send("lost")
                missed_s = math.inf

    def _checkpoint(self) -> None:
        """Wait here while the run is paused; the point in progress is always finished first."""
        self._check_end()
        self.gate.pass_through(self._at_rest)

    def _pause(self, reason: str) -> None:
        """Pause an attended run before something that the operator must watch."""
        if not self._unattended:
            self.gate.close()
            self._send(PauseRequested(reason))
            self._checkpoint()

    def _at_rest(self) -> None:
        """Keep the devices' readings fresh while the run waits."""
        self._check_end()
        self.monitor.refresh()
        self._note_lost()

    def _note_lost(self) -> None:
        """Journal which devices are lost while the run waits, and which are back."""
        before, self._lost = self._lost, self.monitor.lost
        for name in before.keys() - self._lost.keys():
            self._journal.append("event", "", DeviceBack(device=name))
        for name, error in self._lost.items():
            if name not in before:
                lost = DeviceLost(device=name, reason=str(error), error=error.facts())
                self._journal.append("event", "", lost)

    def _check_end(self) -> None:
        """Raise `Stopped` after a stop or an abort."""
        self._clock.check()
        if self._journal.log.state == "aborting":
            raise Stopped("aborted by the operator")

    # -- prompts ------------------------------------------------------------------------------

    def _ask(
        self,
        prompt: Prompt,
        verify: Callable[[], Verification],
        cause: NoReading | None,
        choices: Mapping[str, Callable[[], Verification]] = NO_CHOICES,
    ) -> Verification:
        """Prompt the operator until the answer is verified; return that verification.

        ``choices`` verify the other answers of the prompt, by their names. Unattended, only a
        failed reading waits for a verification; without one it is a fault.
        """
        if self._unattended and (cause is None or prompt.unproven or self._wait.over):
            raise prompt.unanswered(cause) from cause
        self.may_proceed.clear()
        self.pending.open(prompt)
        self._send(Asked(prompt, cause))
        self._wait.begin()
        polled_s, aimed_by_hand = -POLL_S, False
        while True:
            self._at_rest()
            if self._unattended:
                answers, due = self.pending.take_answers(0.0), self._wait.poll_due()
            else:
                answers = self.pending.take_answers(REST_S)
                due = not aimed_by_hand and time.monotonic() - polled_s >= POLL_S
            if not (answers or due):
                continue
            chosen = next((each.choice for each in answers if each.choice), "")
            aimed_by_hand = chosen == RELEASE or (aimed_by_hand and chosen == HERE)
            result, verified = self._verify(prompt, choices.get(chosen, verify), answers)
            polled_s = time.monotonic()
            if verified:
                self.pending.close("another answer came first")
                return result
            if self._unattended and self._wait.over:
                for error in self._lost.values():
                    raise error
                raise prompt.unanswered(cause) from cause

    def _verify(
        self, prompt: Prompt, verify: Callable[[], Verification], answers: list[Answer]
    ) -> tuple[Verification, bool]:
        """Verify, and judge the answers that came before; return whether the run continues.

        An unattended run needs no answer.
        """
        why, alone = ENDED, self._unattended or prompt.by_itself
        try:
            result = verify()
            self.pending.show(result)
            self.monitor.refresh(at_once=bool(answers))
            self._note_lost()
            verified = bool(answers or alone) and prompt.passed_by(result) and not self._lost
            if verified:
                self._send(Verified("answer" if answers else "look"))
                while not self.may_proceed.wait(REST_S):
                    self._check_end()
                why = ""
            elif result.released:
                why = ""
            elif answers:
                why = prompt.refusal(result, self._lost)
                self._journal.append("event", "", AnswerRefused(reason=why))
        finally:
            for answer in answers:
                answer.refusal.set_result(why)
        return result, verified
