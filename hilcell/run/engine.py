"""The engine: one run with its cell locked and its journal open, from order to end."""

from __future__ import annotations

import gc
import math
import platform
import signal
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import NamedTuple, Protocol, Self

import msgspec

from hilcell import __version__
from hilcell.atomic_files import NotWritten
from hilcell.calibration.file import write_calibration
from hilcell.calibration.from_run import calibration_after
from hilcell.cell.devices import build_devices, device_addresses, is_replay, start_simulation
from hilcell.cell.file import Cell, NotifyTable, load_cell
from hilcell.clock import WallClock
from hilcell.decoding import Json
from hilcell.errors import EXIT_STORAGE, exit_code
from hilcell.journal.index import clock_notes, next_order, read_index, row_of
from hilcell.journal.journal import Record, StorageError
from hilcell.journal.labels import offset_min
from hilcell.journal.log import RunJournal
from hilcell.journal.previous_reference import floor_before
from hilcell.journal.runs import CALIBRATION, JOURNAL, is_run, make_folder, remove_unbegun
from hilcell.model.events import ChangesAccepted, RemeasureRequested, SessionOrdered
from hilcell.model.plan import FolderOrder, PlanRecord
from hilcell.model.point import CONTROL
from hilcell.model.records import Ended
from hilcell.ports import Clock, HilcellError
from hilcell.run.cell_lock import CellLocked, lock_of_device, lock_of_name, locked, locks_folder
from hilcell.run.control import Control
from hilcell.run.notify import Notifier
from hilcell.run.order import Attendance, Order, Resume
from hilcell.run.run_plan import Changes, NewRun, ResumedRun, RunPlan, cell_file
from hilcell.run.runner import Runner, finish
from hilcell.run.signals import note_signals, stopped_by_signals
from hilcell.sanitize import encodable
from hilcell.wire.recording import Addresses, RunHeader, TimedStop, WireRecording

SWITCH_S = 0.0005  # for the heartbeat's thread; Python's default is 5 ms


class _Output(AbstractContextManager[object], Protocol):
    """Prints a run's records; entered while the run lives."""

    def take(self, record: Record) -> None: ...
    def skip_measured(self, keys: Iterable[str]) -> None: ...


class Ending(NamedTuple):
    """How a run ended; ``unclosed`` are the errors of devices not left at rest, by name."""

    code: int
    fault: Exception | None
    unclosed: Mapping[str, Exception] = MappingProxyType({})


class Engine:
    """Performs a run once: ``with NewEngine(order, plan, say) as engine: engine.run(output)``.

    Entering locks the cell and opens the journal; it raises `HilcellError`. ``say`` takes warnings.
    """

    journal: RunJournal

    def __init__(self, plan: RunPlan, attendance: Attendance, say: Callable[[str], object]) -> None:
        self.plan, self._attendance, self._say = plan, attendance, say
        self._opened = ExitStack()

    def __enter__(self) -> Self:
        folder, cell = self.plan.folder, self.plan.cell
        runs = folder.resolve().parent  # the same lock regardless of the path
        with ExitStack() as stack:
            lock = lock_of_name(runs, cell.name)
            stack.enter_context(locked(lock, f"cell {cell.name}", folder.name))
            self.journal = self._open(stack)
            self._opened = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._opened.__exit__(kind, error, trace)

    def _open(self, stack: ExitStack) -> RunJournal:
        """Return the journal, which ``stack`` closes."""
        raise NotImplementedError

    def _begin(self) -> None:
        raise NotImplementedError

    def _next_order(self) -> FolderOrder:
        """Return a new session's number in the folder of runs; warn of a clock that ran back."""
        rows = read_index(self.plan.folder.resolve().parent)
        for note in clock_notes(rows, datetime.now(UTC)):
            self._say(f"warning: {note}")
        return next_order(rows)

    def run(self, output: _Output) -> Ending:
        """Perform the run and write the calibration."""
        journal, log = self.journal, self.journal.log
        over = False

        def take(record: Record) -> None:
            """Print up to the end, which is the last line: a failed notification may follow."""
            nonlocal over
            if not over:
                output.take(record)
            over |= record.kind == "end"

        journal.listen(take)
        self._begin()
        output.skip_measured(key for key, at in log.points.items() if at.id.group != CONTROL)
        noted = note_signals()
        with ExitStack() as stack:
            stack.callback(journal.close)
            if log.state == "finished" and not log.retakes:
                stack.enter_context(output)
                ending = Ending(finish(self.plan.procedure, journal), None)
                return self._with_calibration(ending)
            notifier = self._notifier()
            if notifier is not None:
                stack.enter_context(notifier)
            stack.enter_context(output)
            ending = self._perform(noted)
            if notifier is not None:
                notifier.ended(ending.code, ending.fault)
            return ending

    def _notify_table(self) -> NotifyTable | None:
        """Return the command to run at events, as the cell file has it."""
        return self.plan.cell.notify

    def _notifier(self) -> Notifier | None:
        table = self._notify_table()
        if table is None:
            return None
        return Notifier(table, self.journal, self.plan.folder, self._say)

    def _perform(self, noted: list[signal.Signals]) -> Ending:
        """Connect and perform; failures before the runner exists are journalled here."""
        journal, log = self.journal, self.journal.log
        sys.setswitchinterval(SWITCH_S)
        try:
            with ExitStack() as stack:
                return self._live(noted, stack)
        except HilcellError as error:
            if isinstance(error, CellLocked) and not log.session:
                raise  # nothing to record
            code = exit_code(error)
            end = Ended(state=log.state, exit=code, reason=str(error), error=error.facts())
            try:
                journal.append("end", "", end)
            except StorageError as unwritten:  # the disk is full
                return Ending(EXIT_STORAGE, unwritten)
            return Ending(code, error)

    def _live(self, noted: list[signal.Signals], stack: ExitStack) -> Ending:
        """Perform on devices that ``stack`` closes."""
        cell, folder, journal = self.plan.cell, self.plan.folder, self.journal
        log, inputs, stop = journal.log, journal.log.inputs, TimedStop()
        with stopped_by_signals(noted):  # waits for another process
            simulated = start_simulation(
                cell,
                seed=inputs.machine_seed,
                run_seed=inputs.seed,
                speed=inputs.speed or math.inf,
                session=log.session + 1,
            )
            if simulated is not None:
                stack.callback(simulated.close)
        addresses: Addresses = simulated.options if simulated is not None else {}
        if simulated is None or (cell.simulation and cell.simulation.address):
            self._lock_devices(addresses, stack)  # a simulator of our own needs no lock
        clock: Clock = simulated.clock(stop) if simulated is not None else WallClock(stop)
        if self._attendance.record_wire:
            recording = self._recording(addresses)
            stack.callback(lambda: recording.close(None if log.end is None else log.end.exit))
            addresses, clock = recording.addresses, recording.clock(clock, stop)
        devices = build_devices(cell, addresses, clock)
        runner = Runner(
            self.plan, self._attendance, journal, devices=devices, clock=clock, stop=stop
        )
        try:
            stack.callback(Control(folder, runner).close)
        except StorageError:
            runner.dismiss()
            raise
        gc.freeze()  # keeps collections, which delay a stop, short
        # Before the engine ends: afterwards a missing file counts as lost.
        code = runner.run(noted)
        return self._with_calibration(Ending(code, runner.fault, runner.unclosed))

    def _lock_devices(self, addresses: Addresses, stack: ExitStack) -> None:
        """Lock the devices' addresses; raises `CellLocked`, `StorageError`."""
        for place, tables in device_addresses(self.plan.cell, addresses).items():
            what = f"device {' and '.join(tables)} at {place}"
            stack.enter_context(locked(lock_of_device(place), what, self.journal.run))
        if note := locks_folder()[1]:
            self._say(f"warning: {note}")

    def _recording(self, addresses: Addresses) -> WireRecording:
        """Return the relays that record the devices' wires; warn of those left out."""
        cell, folder, log = self.plan.cell, self.plan.folder, self.journal.log
        procedure, seed, stated = log.inputs.procedure, log.inputs.seed, msgspec.to_builtins(cell)
        head = RunHeader(folder.name, procedure, seed, log.session + 1, stated)
        recording = WireRecording(cell, addresses, folder, head)
        for table, why in recording.left_out.items():
            self._say(f"warning: the wire of the {table} is not recorded: {why}")
        return recording

    def _with_calibration(self, ending: Ending) -> Ending:
        """Write the run's calibration; a failure is the run's ending."""
        log, path = self.journal.log, self.plan.folder / CALIBRATION
        if log.calibrates:
            try:
                write_calibration(calibration_after(log, self.journal.run), path)
            except NotWritten as error:
                return Ending(EXIT_STORAGE, error, ending.unclosed)
        return ending


class NewEngine(Engine):
    """Performs a new run; leaves nothing behind where its cell is locked."""

    plan: NewRun

    def __init__(self, order: Order, plan: NewRun, say: Callable[[str], object]) -> None:
        super().__init__(plan, order.attendance, say)
        self._order = order
        self._before: Json = {}  # facts of earlier runs

    def _open(self, stack: ExitStack) -> RunJournal:
        folder, cell, runs = self.plan.folder, self.plan.cell, self.plan.folder.parent
        if is_run(folder):
            raise HilcellError(
                f"run {folder.name} exists already in {folder.parent}; choose another --name",
                code="HC-J09",
            )
        self._before = {
            "driven_by": finished_runs(runs, cell),
            "floor_before": floor_before(runs, cell, self.plan.machine_seed),
            "order": self._next_order(),
        }
        make_folder(folder)

        def forget_where_locked(kind: object, error: BaseException | None, trace: object) -> None:
            if isinstance(error, CellLocked):
                remove_unbegun(folder)

        stack.push(forget_where_locked)
        return stack.enter_context(closing(RunJournal(folder / JOURNAL, folder.name, create=True)))

    def _begin(self) -> None:
        order, plan, cell = self._order, self.plan, self.plan.cell
        speed = order.speed
        packages = ("numpy", "scipy", "canopen", "python-can", "transitions", "msgspec")
        own = {"hilcell": __version__, "python": platform.python_version()}
        record = PlanRecord(
            **plan.procedure.inputs(cell, plan.steps),
            **self._before,
            cell_file=cell_file(order.cell),
            seed=plan.seed,
            machine_seed=plan.machine_seed,
            replayed=is_replay(cell),
            speed=None if speed is None or math.isinf(speed) else speed,
            unattended=order.attendance.unattended,
            operator=order.operator,
            job=order.job,
            versions=own | {package: version(package) for package in packages},
            settings=dict(plan.settings),
            utc_offset_min=offset_min(),
            accepted=list(plan.accepted),
        )
        self.journal.append("plan", "", record)


class ResumedEngine(Engine):
    """Continues a run; its plan is checked again under the lock."""

    plan: ResumedRun

    def __init__(self, order: Resume, plan: ResumedRun, say: Callable[[str], object]) -> None:
        super().__init__(plan, order.attendance, say)
        self._order = order

    def _open(self, stack: ExitStack) -> RunJournal:
        """Open the journal; warn of another folder with the same run."""
        folder = self.plan.folder
        journal = stack.enter_context(
            closing(RunJournal(folder / JOURNAL, encodable(folder.name), create=False))
        )
        # Only now no other engine writes it.
        self.plan = self._order.check(
            folder, journal.log, operator_present=self.plan.operator_present
        )
        runs, origin = folder.resolve().parent, row_of(folder).origin
        same = sorted(row.name for row in read_index(runs) if row.origin == origin)
        if self.plan.continues and len(same) > 1:
            self._say(
                f"warning: {' and '.join(map(encodable, same))} in {runs} are one run; "
                f"only {encodable(folder.name)} continues, and the other becomes an older copy: "
                "move it elsewhere"
            )
        return journal

    def _notify_table(self) -> NotifyTable | None:
        """Return that of the cell file as it is now: a journal may come from anywhere."""
        inputs = self.journal.log.inputs
        try:
            return load_cell(inputs.cell_file, inputs.settings).notify
        except HilcellError as error:
            if self.plan.cell.notify is not None:
                self._say(f"warning: no notifications: {error}")
            return None

    def agree(self) -> None:
        """Journal that the operator agrees to all changes."""
        changes = self.plan.changes
        if changes.inputs:
            agreed = ChangesAccepted(changes=list(changes.inputs), by="the operator")
            self.journal.append("event", "", agreed)
        self.plan = replace(self.plan, changes=Changes(accepted=changes.accepted))

    def _begin(self) -> None:
        if self.plan.continues:
            place = msgspec.structs.asdict(self._next_order())
            self.journal.append("event", "", SessionOrdered(**place))
        for key in self.plan.retakes:
            self.journal.append("event", "", RemeasureRequested(key=key))


def finished_runs(runs: Path, cell: Cell) -> list[str]:
    """Return the newest five finished runs of a cell with volumes, whose poses are known.

    Simulated runs and replays count for simulated cells only.
    """
    if cell.surroundings is None:
        return []
    of_cell = cell.name, cell.serial, cell.simulation is not None
    rows = [row for row in read_index(runs) if row.state == "finished" and not row.replayed]
    same = [row.name for row in rows if (row.cell, row.serial, row.simulated) == of_cell]
    return same[:5]
