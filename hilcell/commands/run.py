"""``run`` and ``resume``: build a runner from the arguments, and print its journal."""

from __future__ import annotations

import gc
import math
import platform
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec

from hilcell import __version__
from hilcell.alarms.catalogue import catalogue
from hilcell.calibration.derived import calibration_after
from hilcell.calibration.file import write_calibration
from hilcell.calibration.in_use import Accepts, calibrated_machine, with_calibration
from hilcell.cell.copied import check_copied
from hilcell.cell.devices import (
    build_devices,
    check_options,
    check_repeated,
    device_places,
    is_replay,
    load_entry,
    start_simulation,
)
from hilcell.cell.file import Cell, load_cell, located
from hilcell.cell.settings import SettingsError
from hilcell.clean import encodable
from hilcell.clock import WallClock
from hilcell.commands.going_on import (
    agrees,
    asks,
    awaited_motion,
    check_unasked,
    check_word,
    say_under_way,
)
from hilcell.commands.orders import Resume
from hilcell.commands.output import print_message
from hilcell.commands.run_output import (
    JsonOutput,
    ProgressOutput,
    RunOutput,
    print_dry_run,
    print_end,
    print_lost,
    print_unclosed,
    print_warnings,
)
from hilcell.journal.disk_space import check_space
from hilcell.journal.engine_file import live_engine
from hilcell.journal.find_run import find_run
from hilcell.journal.floor_before import floor_before
from hilcell.journal.folder_order import clock_notes, next_order
from hilcell.journal.index import read_index, row_of
from hilcell.journal.journal import StorageError
from hilcell.journal.log import Log
from hilcell.journal.run_journal import RunJournal
from hilcell.journal.runs import (
    CALIBRATION,
    JOURNAL,
    forget,
    is_run,
    make_folder,
    new_run,
    read_log,
)
from hilcell.journal.runs_folder import runs_option
from hilcell.journal.times import offset_min
from hilcell.model.events import SessionOrdered
from hilcell.model.plan import FolderOrder
from hilcell.model.point import CONTROL
from hilcell.ports import Clock, HilcellError
from hilcell.run.cell_lock import (
    CellLocked,
    lock_of_device,
    lock_of_name,
    locked,
    locks_folder,
)
from hilcell.run.client import order
from hilcell.run.control import Control
from hilcell.run.exits import DONE, EXIT_ABORTED, EXIT_STORAGE, RESUMABLE, exit_code
from hilcell.run.order import Attendance, Order
from hilcell.run.procedure import Plan, Procedure
from hilcell.run.remeasure import retake_refusal
from hilcell.run.runner import Runner, finish
from hilcell.run.same_cell import NONE, Changes, accepted, cell_file, changed_inputs
from hilcell.run.signals import note_signals, stopped_by_signals
from hilcell.wire.record import Addresses, WireRecording
from hilcell.wire.recording import Head, TimedStop
from hilcell.writing import NotWritten

RUNS_LOOKED_AT = 5  # for poses that were driven before
SWITCH_S = 0.0005  # the heartbeat's thread must not wait behind busy ones (5 ms is the default)


class Ending(NamedTuple):
    """How a run ended; ``unclosed`` says, by device, why it could not be left at rest."""

    code: int
    fault: Exception | None
    unclosed: Mapping[str, Exception] = MappingProxyType({})


def run(args: Order) -> int:
    """Perform a procedure on a cell."""
    cell = load_cell(args.cell, dict(args.settings))
    _check_of_simulator(cell, "--speed", args.speed)
    _check_of_simulator(cell, "--machine-seed", args.machine_seed)
    check_attended(cell, unattended=args.attendance.unattended)
    if warning := check_copied(args.cell, cell):
        print_message(warning)
    procedure: Procedure = load_entry("procedures", args.procedure)
    procedure.check(cell)
    accepted: list[str] = []
    if uses := procedure.used_in(cell):
        accepts = Accepts(args.accept_out_of_tolerance, args.accept_not_current)
        asked: int | None = args.machine_seed
        cell, accepted, used = with_calibration(cell, uses, args.runs, accepts, asked)
        for words in (used, *(f"accepted although {reason}" for reason in accepted)):
            print_message(words)
        args = args.replace(machine_seed=_machine_of(asked, calibrated_machine(cell, uses)))
    plan = procedure.plan(cell, args.seed)
    try:
        check_options(cell)
    except SettingsError as error:
        raise located(args.cell, error.problems, dict(args.settings)) from None
    check_repeated(cell, args.procedure, args.seed)
    if args.dry_run:
        print_dry_run(cell, procedure, plan, as_json=args.json)
        return 0
    print_warnings(plan)
    check_space(args.runs, plan.points)
    earlier = {
        "driven_by": _finished_runs(args.runs, cell),
        "accepted": accepted,
        "floor_before": msgspec.to_builtins(
            floor_before(args.runs, cell, machine_seed(cell, args.seed, args.machine_seed))
        ),
    }
    name = args.name or new_run(procedure.name)
    folder: Path = args.runs / name
    with locked(lock_of_name(args.runs, cell.name), f"cell {cell.name}", name):
        if is_run(folder):
            raise HilcellError(
                f"run {name} exists already in {args.runs}; choose another --name", code="HC-J09"
            )
        earlier["order"] = msgspec.to_builtins(_next_order(args.runs))
        make_folder(folder)
        try:
            with closing(RunJournal(folder / JOURNAL, name, create=True)) as journal:
                output = _output(args.json, name, plan.points, journal)
                journal.append("plan", "", _plan_record(cell, procedure, plan, args) | earlier)
                return _perform(cell, procedure, journal, output, folder, args.attendance)
        except CellLocked:
            forget(folder)
            raise


def resume(args: Resume) -> int:
    """Let a paused run go on, or continue one that ended early."""
    folder = find_run(args.runs, args.run)
    if live_engine(folder) is not None:
        return _resume_live(folder, args)
    log = read_log(folder)
    _open_retakes(log, folder, args.retake)
    cell, inputs = log.cell, log.inputs
    check_attended(cell, unattended=args.attendance.unattended)
    procedure: Procedure = load_entry("procedures", inputs.procedure)
    runs = folder.resolve().parent  # by whatever path the run was named, it has one lock
    with (
        locked(lock_of_name(runs, cell.name), f"cell {cell.name}", folder.name),
        closing(RunJournal(folder / JOURNAL, encodable(folder.name), create=False)) as journal,
    ):
        log = journal.log  # only now nobody else writes it: another engine may have gone on
        asked = _open_retakes(log, folder, args.retake)
        changes = NONE
        goes_on = bool(asked or log.retakes) or log.state != "finished"  # else all is measured
        if goes_on:
            _say_copies(folder)
            _check_here(cell, folder)
            found, somebody = changed_inputs(log, procedure.used_in(cell)), asks(args.attendance)
            askable = somebody or (args.attendance.screen and not args.attendance.unattended)
            changes = Changes(found, args.accept_changes, askable)
            changes.check(found)
            if somebody:
                if not agrees(folder.name, log, procedure, found):
                    return EXIT_ABORTED
                accepted(journal, found, "the operator")
                changes = Changes(accepted=args.accept_changes)
            else:
                check_unasked(folder.name, log, procedure, args.attendance)
        output = _output(args.json, journal.run, inputs.points, journal)
        if goes_on:
            journal.append("event", "", SessionOrdered(**msgspec.structs.asdict(_next_order(runs))))
        for key in asked:
            journal.append("event", "", {"what": "retake asked", "key": key})
        points = log.points.items()
        output.skip_measured(key for key, at in points if at.id.group != CONTROL)
        return _perform(cell, procedure, journal, output, folder, args.attendance, changes)


def _next_order(runs: Path) -> FolderOrder:
    """Return the order of a session that begins now, and say where the clock ran back."""
    rows = read_index(runs)
    for note in clock_notes(rows, datetime.now(UTC)):
        print_message(f"warning: {note}")
    return next_order(rows)


def _say_copies(folder: Path) -> None:
    """Say where another folder beside it holds this run as well: their journals will differ."""
    runs, origin = folder.resolve().parent, row_of(folder).origin
    same = sorted(row.name for row in read_index(runs) if row.origin == origin)
    if len(same) > 1:
        print_message(
            f"warning: {' and '.join(map(encodable, same))} in {runs} are one run; "
            f"only {encodable(folder.name)} goes on, and the other is then an older copy of it: "
            "move it elsewhere"
        )


def _check_here(cell: Cell, folder: Path) -> None:
    """Refuse a cell that this PC cannot run, before the journal is written to."""
    try:
        check_options(cell)
    except SettingsError as error:
        again = f"hilcell resume {folder.name}{runs_option(folder.parent)}"
        raise HilcellError(
            f"run {folder.name} cannot go on here; it is as it was. {error}\n"
            f"  it keeps the cell that it began with: install here what is missing, then `{again}`",
            code=error.code,
        ) from error


def _open_retakes(log: Log, folder: Path, retakes: Sequence[str]) -> list[str]:
    """Return the retakes that the journal does not ask for yet; refuse a run that is finished."""
    asked = [key for key in retakes if key not in log.retakes]
    if refusals := [why for key in asked if (why := retake_refusal(log, key))]:
        raise HilcellError("\n".join(refusals))
    written = not log.calibrates or (folder / CALIBRATION).is_file()
    over = log.state == "finished" and log.end is not None and written
    if over and not (asked or log.retakes):
        raise HilcellError(
            f"run {folder.name} is finished; start a new one with `hilcell run`", code="HC-J09"
        )
    return asked


def machine_seed(cell: Cell, seed: int, own: int | None) -> int | None:
    """Return the seed of the machine that is started: its own, or else the run's.

    None where no simulator is started: it is unknown.
    """
    if cell.simulation is None or cell.simulation.address:
        return None
    return seed if own is None else own


def _machine_of(asked: int | None, calibrated: int | None) -> int | None:
    """Return the simulated machine of a run that uses a calibration: the one calibrated.

    None is one that is not asked for, or not known. Raises `SettingsError` where they differ.
    """
    if None not in (asked, calibrated) and asked != calibrated:
        problem = f"{asked}: the calibration is of simulated machine {calibrated}; name another"
        raise SettingsError("--machine-seed", [problem])
    return calibrated if asked is None else asked


def _check_of_simulator(cell: Cell, option: str, value: float | None) -> None:
    """Refuse an option of the simulator where this run starts none."""
    if value is None:
        return
    if cell.simulation is None:
        raise HilcellError(
            f"{option} is for simulated cells; cell {cell.name} is real", code="HC-C12"
        )
    if cell.simulation.address:
        raise HilcellError(
            f"{option}: the simulated cell at {cell.simulation.address} runs already; "
            f"give {option} to its `hilcell sim`",
            code="HC-C17",
        )


def _finished_runs(runs: Path, cell: Cell) -> list[str]:
    """Return the newest finished runs of a cell that states its volumes: poses known from them.

    Where a simulated cell or a replay went, nothing is known of the real one.
    """
    if cell.surroundings is None:
        return []
    of_cell = cell.name, cell.serial, cell.simulation is not None
    rows = [row for row in read_index(runs) if row.state == "finished" and not row.replayed]
    same = [row.name for row in rows if (row.cell, row.serial, row.simulated) == of_cell]
    return same[:RUNS_LOOKED_AT]


def check_attended(cell: Cell, *, unattended: bool) -> None:
    """Refuse to leave a cell alone whose reflector is carried by hand."""
    if unattended and cell.layout.by_hand:
        raise HilcellError(
            f"cell {cell.name}: layout.reflectors is by_hand: somebody must be there to carry the "
            "reflector; leave out --unattended, or mount reflectors in all nests",
            code="HC-C16",
        )


def _resume_live(folder: Path, args: Resume) -> int:
    """Let a live run go on; one that nobody attends, or that a screen shows, asks nobody here.

    A motion that was announced waits for a typed word, also where a screen is open.
    """
    somebody, status = asks(args.attendance), order(folder, "status")
    log, under_way = read_log(folder), status.state == "running" and not status.pausing
    procedure: Procedure = load_entry("procedures", log.inputs.procedure)
    if not somebody:
        check_word(folder.name, awaited_motion(log), log)
    if somebody or not (status.unattended or status.screens):
        waits_for = log.life[-1].change.reason if log.life else ""
        if not somebody:
            check_unasked(folder.name, log, procedure, args.attendance)
        elif not under_way and not agrees(folder.name, log, procedure, [], waits_for):
            return EXIT_ABORTED
    if under_way:
        _order_retakes(folder, args)
        say_under_way(folder.name, log, procedure)
        return 0
    seen = log.newest.seq if log.newest is not None else 0
    _order_retakes(folder, args)
    answer = order(folder, "proceed", until=seen)
    print_message(f"run {folder.name}: asked to go on; it was {answer.state}")
    return 0


def _order_retakes(folder: Path, args: Resume) -> None:
    for key in args.retake:
        order(folder, "retake", key=key)


def _perform(
    cell: Cell,
    procedure: Procedure,
    journal: RunJournal,
    output: RunOutput,
    folder: Path,
    attendance: Attendance,
    changes: Changes = NONE,
) -> int:
    """Run to an end, write the calibration, and print the outcome."""
    log = journal.log
    noted = note_signals()
    with ExitStack() as stack:
        stack.callback(journal.close)
        stack.enter_context(output)
        if log.state == "finished" and not log.retakes:
            ending = Ending(finish(procedure, journal), None)
            ending = _with_calibration(ending, journal, folder)
        else:
            ending = _run(cell, procedure, journal, folder, attendance, noted, changes)
        code, fault, unclosed = ending
    output.close(code, log, fault)
    print_end(folder, log, procedure, output, fault)
    print_unclosed(unclosed, fault)
    print_lost(folder, output)
    if code in RESUMABLE and not _wants_new_run(fault):
        print_message(f"resume with: hilcell resume {folder.name}{runs_option(folder.parent)}")
    return EXIT_STORAGE if output.lost is not None and code in DONE else code


def _wants_new_run(fault: Exception | None) -> bool:
    """Whether what ended a run leaves nothing to resume."""
    entry = catalogue().get(fault.code) if isinstance(fault, HilcellError) else None
    return entry is not None and entry.then == "new run"


def _run(
    cell: Cell,
    procedure: Procedure,
    journal: RunJournal,
    folder: Path,
    attendance: Attendance,
    noted: list[signal.Signals],
    changes: Changes,
) -> Ending:
    """Bring up devices and perform; failures before the runner lives are journalled here."""
    log, inputs, stop = journal.log, journal.log.inputs, TimedStop()
    sys.setswitchinterval(SWITCH_S)
    try:
        with ExitStack() as stack:
            speed = inputs.speed or math.inf
            with stopped_by_signals(noted):  # it waits for another process
                simulated = start_simulation(
                    cell, seed=inputs.machine_seed, speed=speed, session=log.session + 1
                )
                if simulated is not None:
                    stack.callback(simulated.close)
            addresses: Addresses = simulated.options if simulated is not None else {}
            if simulated is None or (cell.simulation and cell.simulation.address):
                _lock_devices(cell, addresses, journal.run, stack)  # nobody else has our own ones
            clock: Clock = simulated.clock(stop) if simulated is not None else WallClock(stop)
            if attendance.record_wire:
                head = _head(cell, log, folder)
                recording = _recording(cell, addresses, folder, head)
                stack.callback(lambda: recording.close(None if log.end is None else log.end.exit))
                addresses, clock = recording.addresses, recording.clock(clock, stop)
            devices = build_devices(cell, addresses, clock)
            runner = Runner(
                cell,
                procedure,
                journal,
                devices=devices,
                clock=clock,
                stop=stop,
                unattended=attendance.unattended,
                ordered=attendance.screen,
                changes=changes,
            )
            try:
                stack.callback(Control(folder, runner).close)
            except StorageError:
                runner.dismiss()
                raise
            gc.freeze()  # what was loaded stays: a collection, which holds up a stop, is short
            # While its engine is there: afterwards a file that is missing is a lost one.
            code = runner.run(noted)
            ending = Ending(code, runner.fault, runner.unclosed)
            return _with_calibration(ending, journal, folder)
    except HilcellError as error:
        if isinstance(error, CellLocked) and not log.session:
            raise  # there is nothing to keep
        code = exit_code(error)
        body: dict[str, Any] = {
            "state": log.state,
            "exit": code,
            "result": {},
            "reason": str(error),
        }
        body["error"] = error.facts()
        try:
            journal.append("end", "", body)
        except StorageError as unwritten:  # a disk that takes no engine takes no end either
            return Ending(EXIT_STORAGE, unwritten)
        return Ending(code, error)


def _head(cell: Cell, log: Log, folder: Path) -> Head:
    """Return what a recording states of its run."""
    inputs, stated = log.inputs, msgspec.to_builtins(cell)
    return Head(folder.name, inputs.procedure, inputs.seed, log.session + 1, stated)


def _recording(cell: Cell, addresses: Addresses, folder: Path, head: Head) -> WireRecording:
    """Return the relays that record the devices' wires, and say which are left out."""
    recording = WireRecording(cell, addresses, folder, head)
    for table, why in recording.left_out.items():
        print_message(f"warning: the wire of the {table} is not recorded: {why}")
    return recording


def _lock_devices(cell: Cell, addresses: Addresses, run: str, stack: ExitStack) -> None:
    """Lock the places at which the devices are reached; raises `CellLocked`, `StorageError`."""
    for place, tables in device_places(cell, addresses).items():
        what = f"device {' and '.join(tables)} at {place}"
        stack.enter_context(locked(lock_of_device(place), what, run))
    if note := locks_folder()[1]:
        print_message(f"warning: {note}")


def _with_calibration(ending: Ending, journal: RunJournal, folder: Path) -> Ending:
    """Write the calibration that a run has ended with; report a file that cannot be written."""
    if journal.log.calibrates:
        try:
            write_calibration(calibration_after(journal.log, journal.run), folder / CALIBRATION)
        except NotWritten as error:
            return Ending(EXIT_STORAGE, error, ending.unclosed)
    return ending


def _output(as_json: bool, run: str, points: int, journal: RunJournal) -> RunOutput:
    output = JsonOutput(run) if as_json else ProgressOutput(run, points)
    journal.listen(output.take)
    return output


def _plan_record(cell: Cell, procedure: Procedure, plan: Plan, args: Order) -> dict[str, Any]:
    speed = None if args.speed is None or math.isinf(args.speed) else args.speed
    packages = ("numpy", "scipy", "canopen", "python-can", "transitions", "msgspec")
    versions = {package: version(package) for package in packages}
    return procedure.inputs(cell, plan) | {
        "cell_file": cell_file(args.cell),
        "seed": args.seed,
        "machine_seed": machine_seed(cell, args.seed, args.machine_seed),
        "replayed": is_replay(cell),
        "speed": speed,
        "unattended": args.attendance.unattended,
        "operator": args.operator,
        "job": args.job,
        "versions": {"hilcell": __version__, "python": platform.python_version()} | versions,
        "settings": dict(args.settings),
        "utc_offset_min": offset_min(),
    }
