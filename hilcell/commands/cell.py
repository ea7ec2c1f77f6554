"""``check``, ``sim`` and ``diagram``."""

from __future__ import annotations

import math
import random
import signal
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from queue import Empty, SimpleQueue
from shlex import quote
from typing import Any

from hilcell.alarms.catalogue import entry_of
from hilcell.atomic_files import as_not_written, write_together
from hilcell.calibration.decision_rule import least_mean_mm
from hilcell.cell.devices import (
    abilities,
    check_options,
    draws_hall,
    load_entry,
    load_measured,
    start_simulation,
    unknown_drivers,
)
from hilcell.cell.differences import check_identity
from hilcell.cell.file import Cell, driver_names, load_cell, located
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import by_line
from hilcell.cell.undetectable_errors import undetectable_errors
from hilcell.commands.console import flush_data, print_answer, print_data, print_json, print_message
from hilcell.commands.signatures import Check, Diagram, Sim
from hilcell.compensation.programs import program_writer
from hilcell.decoding import Json
from hilcell.ports import Exercise, HasSheet, HilcellError, SetsTraps, Training
from hilcell.run.procedure import Procedure
from hilcell.run.run_plan import machine_seed, with_plan
from hilcell.run.states import CALIBRATION, RUN, mermaid

HELP = "A number injects that fault, Enter a random one; m lists the faults, q ends the cell."


class Trainer:
    """Injects one fault at a time, and afterwards explains it and the right reaction."""

    def __init__(self, cell: Training, rng: random.Random) -> None:
        self._cell, self._rng = cell, rng
        self._injected: Exercise | None = None

    def menu(self) -> None:
        rows = [f"{n:3d}  {each.title}" for n, each in enumerate(self._cell.exercises, start=1)]
        print_message("\n".join(["training:", *rows, HELP]))

    def take(self, line: str) -> bool:
        """Process one line of input; return whether to read another."""
        word, exercises = line.strip().lower(), self._cell.exercises
        if word == "q":
            return False
        if self._injected is not None:
            self._explain(self._injected)
        elif word == "m":
            self.menu()
        elif not word or (word.isdecimal() and 1 <= int(word) <= len(exercises)):
            self._injected = exercises[int(word) - 1] if word else self._rng.choice(exercises)
            self._cell.strike(self._injected)
            print_message(
                "The fault occurs at the next opportunity during the run. Diagnose it by screen "
                "and alarm, and decide what to do; then press Enter here."
            )
        else:
            print_message(HELP)
        return True

    def _explain(self, exercise: Exercise) -> None:
        entry = entry_of(exercise.alarm)
        lines = [
            f"The fault was: {exercise.title}.",
            f"The alarm is {entry.code}, {entry.title}: {entry.means}",
            "The right reaction:",
            *(f"  {number}. {step}" for number, step in enumerate(entry.do, start=1)),
            "The simulated cell is repaired; resume the run.",
        ]
        print_message("\n".join(lines))
        self._cell.heal()
        self._injected = None
        print_message(HELP)  # the menu would scroll the answer out of view


def train(cell: Training, ended: threading.Event) -> None:
    """Train until ``ended`` is set, "q" is entered or stdin ends."""
    trainer = Trainer(cell, random.Random())  # noqa: S311 - no cryptography
    lines: SimpleQueue[str | None] = SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        lines.put(None)

    threading.Thread(target=read, name="keyboard", daemon=True).start()
    trainer.menu()
    while not ended.is_set():
        try:
            line = lines.get(timeout=0.1)
        except Empty:
            continue
        if line is None or not trainer.take(line):
            return


def check(args: Check) -> int:
    procedure: Procedure = load_entry("procedures", "calibrate")
    cell = _load_checked(args.cell, with_plan(args.cell, dict(args.settings), procedure))
    if warning := check_identity(args.cell, cell):
        print_message(warning)
    program_writer(cell.robot.driver, cell.robot.program)
    for table in (cell.touch, cell.targets):
        if table is not None and table.station:
            cell.station_named(table.station)  # `calibrate` needs neither
    plan = procedure.plan(cell, seed=1)
    able = abilities(cell)
    two_faces = able["tracker_turns_over"] and not (cell.plan.quick or cell.layout.by_hand)
    notes = list(plan.notes)
    undetectable = undetectable_errors(cell, two_faces=two_faces)
    if cell.simulation is None and not cell.pauses_at_first_pass:
        notes.append("robot.first_pass_pause is false: no run pauses before the arm's first pass")
    facts: Json = able | {
        "cell": cell.name,
        "digest": cell.digest,
        "stations": [station.name for station in cell.station],
        "keep_out": [volume.name for volume in cell.keep_out],
        "points": plan.points,
        "duration_s": plan.duration_s,
        "notes": notes,
        "warnings": plan.warnings,
        "least_mean_tolerance_mm": round(least_mean_mm(cell), 4),
        "unseen": undetectable,
        "ok": True,
    }
    can = {name: "yes" if has else "no" for name, has in able.items()}
    text = (
        f"{args.cell}: cell {cell.name} is valid; calibrate measures {plan.points} points "
        f"in {plan.duration_s / 60:.0f} min; tracker streams: {can['tracker_streams']}, "
        f"robot sweeps an axis: {can['robot_sweeps']}; "
        f"keep-out volumes: {', '.join(facts['keep_out']) or 'none'}"
    )
    warnings = [f"warning: {each}" for each in plan.warnings]
    limits = [f"no run detects: {each}" for each in undetectable]
    print_answer(facts, "\n".join([text, *notes, *warnings, *limits]), as_json=args.json)
    return 0


def _load_checked(where: str, overrides: dict[str, str]) -> Cell:
    """Return a valid cell; raises `SettingsError` with all problems, sorted by line."""
    try:
        cell = load_measured(where, overrides)
    except SettingsError as error:
        unknown = unknown_drivers(driver_names(where, overrides))
        problems = [*error.problems, *located(where, unknown, overrides).problems]
        raise SettingsError(where, by_line(problems, where)) from None
    try:
        check_options(cell)
    except SettingsError as error:
        raise located(where, error.problems, overrides) from None
    return cell


def _print_traps(cell: Cell) -> None:
    for name, text in _with_traps(cell).traps.items():
        print_data(f"{name:20} {text}")


def _with_traps(cell: Cell) -> SetsTraps:
    simulator = load_entry("simulators", cell.simulation.simulator) if cell.simulation else None
    if not isinstance(simulator, SetsTraps):
        raise HilcellError(f"cell {cell.name} has no simulator that sets traps")
    return simulator


def sim(args: Sim) -> int:
    cell = load_cell(args.cell, dict(args.settings))
    if args.traps:
        _print_traps(cell)
        return 0
    drawn = draws_hall(cell)
    if args.sheet is not None and not drawn:
        raise HilcellError(f"cell {cell.name} has no sheet: its cell file states its places")
    more: dict[str, Any] = {"faults": args.faults, "truth": args.truth, "ports": args.ports or {}}
    if args.trap:
        _with_traps(cell)
        more["trap"] = args.trap
    seed = machine_seed(cell, args.seed, args.machine_seed)
    usual = math.inf if drawn else 1.0
    speed = usual if args.speed is None else args.speed
    simulated = start_simulation(cell, seed=seed, speed=speed, **more)
    if simulated is None:
        raise HilcellError(
            f"cell {cell.name} is real: it has no simulator; add --set simulation.simulator=paper",
            code="HC-C12",
        )
    training = simulated if isinstance(simulated, Training) else None
    if args.train and training is None:
        simulated.close()
        raise HilcellError(f"cell {cell.name}: its simulator has no training")
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    try:
        sheet = ""
        next_steps = f"run --cell {quote(args.cell)} --set simulation.address={simulated.address}"
        if isinstance(simulated, HasSheet) and simulated.sheet:
            sheet = _write_sheet(simulated.sheet, args.sheet or Path("hall"))
            next_steps = "commission mycell.toml"
        print_json(simulated.options | {"control": simulated.address})
        flush_data()
        print_message(
            f"{sheet}the simulated cell is running; in another terminal:\n  hilcell {next_steps}\n"
            "ctrl-C ends it"
        )
        if args.train and training is not None:
            train(training, ended)
        else:
            ended.wait()
    finally:
        simulated.close()
    return 0


def _write_sheet(sheet: Mapping[str, str], folder: Path) -> str:
    """Write the sheet of a hall, and return its text, which names the files."""
    with as_not_written(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_together({folder / file: text.encode() for file, text in sheet.items()})
    return f"{next(iter(sheet.values()))}\nthis sheet is in {folder}: {', '.join(sheet)}\n"


def diagram(args: Diagram) -> int:
    for table in (RUN, CALIBRATION):
        print_data(f"%% {table.name}\n{mermaid(table)}\n")
    return 0
