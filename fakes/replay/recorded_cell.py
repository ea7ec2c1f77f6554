"""A cell whose devices are recordings of their wires: ``--set simulation.simulator=recorded``.

``simulation.data`` names the folder of a run made with ``--record-wire``, which must be complete
and of this run. Waits of the cell pass at once; its clock returns what it returned.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence, Set
from pathlib import Path
from threading import Event
from typing import Any

import msgspec

from fakes.replay.dialects import Dialect, dialects_of
from fakes.replay.player import ClockReadings, EventTime, RecordedWire
from fakes.time import CountedTime
from hilcell.cell.devices import GROUPS, checked_options, placeholder_addresses
from hilcell.cell.differences import differences
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError, convert
from hilcell.ports import RecordingEnded, Stopped
from hilcell.wire.channel import can_interfaces, wire_places, with_addresses
from hilcell.wire.recording import (
    CLOCK,
    SUFFIX,
    Piece,
    RunHeader,
    clock_readings,
    read_recording,
    recorded_exit_code,
    recordings,
    run_header,
)

DATA = "simulation.data"
Recorded = Mapping[str, Sequence[Piece]]


def sessions(folder: Path) -> list[Path]:
    numbers = {
        int(found[1]): path
        for path in folder.glob("wires-*")
        if (found := re.fullmatch(r"wires-(\d+)", path.name)) and recordings(path)
    }
    return [folder, *(path for _, path in sorted(numbers.items()))]


def read_run(cell: Cell, session: int = 1) -> tuple[dict[str, Path], dict[str, Sequence[Piece]]]:
    """Files and pieces of a cell's recorded wires, and of its clock, by name. Raises
    `SettingsError` where one is missing or incomplete, and for those of another cell.
    """
    found = sessions(recordings_folder(cell))
    if session > len(found):
        what = f"the recorded run was resumed {len(found) - 1} times"
        raise SettingsError(DATA, [f"{found[0]}: {what}; its replay goes no further"])
    folder = found[session - 1]
    paths, pieces, problems = recordings(folder), dict[str, Sequence[Piece]](), list[str]()
    if not paths:
        what = f"no recording (*{SUFFIX}) there" if folder.is_dir() else "no such folder"
        problems = [f"{folder}: {what}; make one with `run --record-wire`"]
    for name, path in paths.items():
        try:
            pieces[name] = read_recording(path)
        except SettingsError as error:
            problems += [f"{path.name}: {problem}" for problem in error.problems]
    if not (problems or CLOCK in pieces):
        what = f"no {CLOCK}{SUFFIX}, which states the recorded run; use the whole folder"
        problems = [f"{folder}: {what}"]
    problems = problems or _unlike(cell, session, paths, pieces)
    if problems:
        raise SettingsError(DATA, problems)
    return paths, pieces


def _unlike(cell: Cell, session: int, paths: Mapping[str, Path], wires: Recorded) -> list[str]:
    """Return why recordings are not those of this run; later checks need what earlier ones hold."""
    head, folder = run_header(wires[CLOCK], paths[CLOCK]), paths[CLOCK].parent
    first = [
        f"{path}: it was recorded as {began}{SUFFIX}; rename it back"
        for name, path in paths.items()
        if name != CLOCK and (began := wires[name][0].data.decode()) != name
    ]
    if session == 1 != head.session:
        what = f"the wires of run {head.run} after it was resumed, and no beginning"
        act = "name the run's own folder, and resume the replay where it ends"
        first.append(f"{folder}: {what}; {act}")
    return (
        first
        or _other_cell(cell, folder, head)
        or [f"{folder}: {each}" for each in _missing(cell, set(wires))]
        or [*_other_settings(cell, folder, head)]
        or [*without_dialect(cell, paths, wires)]
    )


def recordings_folder(cell: Cell) -> Path:
    return Path("" if cell.simulation is None else cell.simulation.data)


def _other_cell(cell: Cell, folder: Path, head: RunHeader) -> list[str]:
    if (name := head.cell["name"]) != cell.name:
        what = f"recorded was cell {name!r}, asked was {cell.name!r}"
        return [f"{folder}: {what}; name that one's file"]
    drivers = {table: head.cell[table]["driver"] for table in GROUPS}
    return [
        f"{folder}: the {table} was recorded with driver {driver!r}, here it is "
        f"{getattr(cell, table).driver!r}; add --set {table}.driver={driver}"
        for table, driver in drivers.items()
        if driver != getattr(cell, table).driver
    ]


def _missing(cell: Cell, found: Set[str]) -> Iterator[str]:
    """Return as text the wires of a cell of which there is no recording."""
    anywhere = placeholder_addresses(cell)  # missing drivers are reported elsewhere
    stated = checked_options(cell, anywhere, anywhere)
    for table, options in stated.items():
        for channel in can_interfaces(options):
            yield f"{table}: {channel} is a CAN interface, of which no recording can be played"
    for name in wire_places(stated):
        if name not in found:
            yield f"no {name}{SUFFIX}; use the whole folder, with the cell of the recorded run"


def without_dialect(cell: Cell, paths: Mapping[str, Path], wires: Recorded) -> Iterator[str]:
    """Return as text the wires that are no plain lines, and of which no dialect is stated."""
    plain, shown = re.compile(rb"[\t\r\n\x20-\xff]*"), 24  # bytes
    for name, found in wires.items():
        table = name.partition(".")[0]
        if name == CLOCK or dialects_of((one := getattr(cell, table)).driver, one.options):
            continue
        for way, whose in ((">", "the driver"), ("<", "the device")):
            sent = b"".join(piece.data for piece in found if piece.e == way)
            if sent and not (plain.fullmatch(sent) and re.search(rb"[\r\n]", sent)):
                yield (
                    f"{paths[name]}: the bytes of {whose} are no plain lines ({sent[:shown]!r}), "
                    f"and driver {one.driver!r} has no dialect among the entry points "
                    "hilcell.wire_dialects: see docs/drivers-guide.md"
                )
                break


def _other_settings(cell: Cell, folder: Path, head: RunHeader) -> Iterator[str]:
    recorded = convert(head.cell, Cell, DATA)
    if changed := differences(_common(recorded), _common(cell)):
        act = f"use the cell file and settings of run {head.run}"
        yield f"{folder}: recorded with other settings: {changed}; {act}"


def _common(cell: Cell) -> Cell:
    """A cell without what may differ on another PC. Texts of options are addresses, paths and what
    a device reports of itself at connect.
    """
    tables = {
        table: msgspec.structs.replace(one, options=_figures(one.options))
        for table, one in ((table, getattr(cell, table)) for table in GROUPS)
    }
    return msgspec.structs.replace(cell, simulation=None, **tables)


def _figures(options: Mapping[str, Any]) -> dict[str, Any]:
    plain = {key: each for key, each in options.items() if not isinstance(each, str)}
    return {
        key: _figures(each) if isinstance(each, Mapping) else each
        for key, each in plain.items()
        if not (key == "port" or key.endswith("_port"))
    }


class RecordedCell:
    """Satisfies `hilcell.ports.SimulatedCell` and `hilcell.ports.RepeatsRun`."""

    def __init__(
        self,
        cell: Cell,
        *,
        seed: int | None = None,
        speed: float = math.inf,
        session: int = 1,
        **_: object,
    ) -> None:
        paths, pieces = read_run(cell, session)
        self._resumed = len(sessions(recordings_folder(cell))) > session
        self.address = ""
        self._wires: list[RecordedWire] = []
        self._time, channels = EventTime(), dict[str, str]()
        clock = pieces.pop(CLOCK)
        self._looks = ClockReadings(self._time, *clock_readings(clock))
        self._expect_end(paths, clock, pieces)
        tables = {table: getattr(cell, table) for table in GROUPS}
        dialects = {table: dialects_of(one.driver, one.options) for table, one in tables.items()}
        for name, found in pieces.items():
            table, _dot, wire = name.partition(".")
            dialect = dialects[table].get(wire, Dialect())
            self._wires.append(RecordedWire(found, dialect, self._time, str(paths[name])))
            channels[name] = self._wires[-1].channel
        for each in self._wires:
            each.start()
        anywhere = placeholder_addresses(cell)
        recorded = {name.partition(".")[0] for name in channels}
        self.options = with_addresses(checked_options(cell, anywhere, recorded), channels)

    def _expect_end(
        self, paths: Mapping[str, Path], clock: Sequence[Piece], wires: Recorded
    ) -> None:
        """Let the replay know where its recording ends, but for one that a fault has ended."""
        ended = recorded_exit_code(clock)
        exit_fault, exit_aborted = 3, 4  # of the recorded run
        if ended == exit_fault:
            return
        for name, found in wires.items():
            self._time.end_at(found[-1].t, f"{paths[name]}:{len(found)}")
        for line, piece in enumerate(clock, 1):
            if piece.e == "stopped" and ended == exit_aborted:
                self._time.stop_at(piece.t, f"{paths[CLOCK]}:{line}")

    @classmethod
    def check(cls, cell: Cell) -> None:
        """Refuse a folder that is not whole, or of another cell; raises `SettingsError`."""
        read_run(cell)

    @classmethod
    def check_run(cls, cell: Cell, procedure: str, seed: int) -> None:
        folder = recordings_folder(cell)
        path = recordings(folder)[CLOCK]
        head = run_header(read_recording(path), path)
        if (head.procedure, head.seed) != (procedure, seed):
            recorded, asked = (
                f"{p} --seed {s}" for p, s in ((head.procedure, head.seed), (procedure, seed))
            )
            what = f"{folder}: recorded was {recorded}, asked was {asked}"
            act = f"replay with `hilcell run {recorded}`, or record {procedure}"
            raise SettingsError(DATA, [f"{what}; {act}"])

    def clock(self, stop: Event) -> RecordedClock:
        act = "use the procedure, cell and settings of the recorded run, or record it again"
        again = "there the recorded run ended, and was resumed: `hilcell resume` this one, too"
        return RecordedClock(self._looks, self._time, stop, again if self._resumed else act)

    def close(self) -> None:
        for wire in self._wires:
            wire.close()


class RecordedClock:
    """The cell's clock as it was, in which every wait is over at once.

    Every wait on a wire calls `check`, so here a run is ended with its recording.
    """

    def __init__(self, looks: ClockReadings, time: EventTime, stop: Event, act: str) -> None:
        """``act`` is the advice at the end of the recording."""
        self._looks, self._time, self._stop, self._act = looks, time, stop, act
        self.now_s, self.pc_s = looks.now_s, CountedTime().now_s

    def wait(self, duration_s: float) -> None:
        self._looks.wait(duration_s)
        self.check()

    def check(self) -> None:
        """Raise `Stopped` if a stop was asked for, `RecordingEnded`."""
        if self._stop.is_set():
            raise Stopped("a stop was asked for")
        if found := self._time.left():
            raise RecordingEnded(f"{found}; {self._act}")
