"""A folder of recordings: whether it is whole, and whether this run is the recorded one."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import Any

import msgspec

from fakes.replay.dialects import dialects_of
from hilcell.cell.devices import TABLES, driver_options, stand_ins
from hilcell.cell.differences import differences
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError, convert
from hilcell.wire.channel import can_interfaces, joined, wires_of
from hilcell.wire.recording import (
    CLOCK,
    SUFFIX,
    Head,
    Piece,
    head_of,
    read_recording,
    recordings,
)

DATA = "simulation.data"
_RESUMED = re.compile(r"wires-(\d+)")
_TEXT = re.compile(rb"[\t\r\n\x20-\xff]*")
_LINE_END = re.compile(rb"[\r\n]")
Recorded = Mapping[str, Sequence[Piece]]


def sessions(folder: Path) -> list[Path]:
    """Return the folders of a run's recorded sessions, from its beginning on."""
    numbers = {
        int(found[1]): path
        for path in folder.glob("wires-*")
        if (found := _RESUMED.fullmatch(path.name)) and recordings(path)
    }
    return [folder, *(path for _, path in sorted(numbers.items()))]


def read_run(cell: Cell, session: int = 1) -> tuple[dict[str, Path], dict[str, Sequence[Piece]]]:
    """Return the files and the pieces of a cell's recorded wires, and of its clock, by their names.

    Raises `SettingsError` where one is missing or not whole, and for those of another cell.
    """
    found = sessions(folder_of(cell))
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
    if not problems:
        head = head_of(pieces[CLOCK], paths[CLOCK])
        problems += [found for name in paths for found in _renamed(name, paths[name], pieces[name])]
        problems += [] if session > 1 else _resumed(folder, head)
        problems = problems or _other_name(cell, folder, head)
        problems = problems or _other_drivers(cell, folder, head)
        problems = problems or [f"{folder}: {each}" for each in _missing(cell, set(pieces))]
        problems = problems or [*_other_settings(cell, folder, head)]
        problems = problems or [*without_dialect(cell, paths, pieces)]
    if problems:
        raise SettingsError(DATA, problems)
    return paths, pieces


def check_run(cell: Cell, procedure: str, seed: int) -> None:
    """Refuse another procedure or seed than was recorded."""
    folder = folder_of(cell)
    path = recordings(folder)[CLOCK]
    head = head_of(read_recording(path), path)
    if (head.procedure, head.seed) != (procedure, seed):
        recorded, asked = (
            f"{p} --seed {s}" for p, s in ((head.procedure, head.seed), (procedure, seed))
        )
        act = f"replay with `hilcell run {recorded}`, or record {procedure}"
        raise SettingsError(DATA, [f"{folder}: recorded was {recorded}, asked was {asked}; {act}"])


def folder_of(cell: Cell) -> Path:
    """Return the folder that a cell names."""
    return Path("" if cell.simulation is None else cell.simulation.data)


def _renamed(name: str, path: Path, pieces: Sequence[Piece]) -> list[str]:
    began = name if name == CLOCK else pieces[0].data.decode()
    return [] if began == name else [f"{path}: it was recorded as {began}{SUFFIX}; rename it back"]


def _resumed(folder: Path, head: Head) -> list[str]:
    """Return why a session that was resumed is no beginning of a run."""
    if head.session == 1:
        return []
    what = f"the wires of run {head.run} after it was resumed, and no beginning"
    act = "name the run's own folder, and resume the replay where it ends"
    return [f"{folder}: {what}; {act}"]


def _other_drivers(cell: Cell, folder: Path, head: Head) -> list[str]:
    """Return which devices were recorded with another driver than the cell's."""
    drivers = {table: head.cell[table]["driver"] for table, _group in TABLES}
    return [
        f"{folder}: the {table} was recorded with driver {driver!r}, here it is "
        f"{getattr(cell, table).driver!r}; add --set {table}.driver={driver}"
        for table, driver in drivers.items()
        if driver != getattr(cell, table).driver
    ]


def _missing(cell: Cell, found: Set[str]) -> Iterator[str]:
    """Return, in words, the wires of a cell of which there is no recording."""
    anywhere = stand_ins(cell)
    for table, group in TABLES:
        if table not in anywhere:
            continue  # its driver is not installed, which the check of the cell states
        _, options = driver_options(cell, table, group, anywhere[table])
        stated = msgspec.to_builtins(options)
        for channel in can_interfaces(stated):
            yield f"{table}: {channel} is a CAN interface, of which no recording can be played"
        for wire in wires_of(stated):
            if (name := joined(table, wire)) not in found:
                yield f"no {name}{SUFFIX}; use the whole folder, with the cell of the recorded run"


def without_dialect(cell: Cell, paths: Mapping[str, Path], wires: Recorded) -> Iterator[str]:
    """Return, in words, the wires that are no plain lines, and of which no dialect is stated."""
    shown = 24  # bytes
    for name, found in wires.items():
        table = name.partition(".")[0]
        if name == CLOCK or dialects_of((one := getattr(cell, table)).driver, one.options):
            continue
        for way, whose in ((">", "the driver"), ("<", "the device")):
            sent = b"".join(piece.data for piece in found if piece.e == way)
            if sent and not (_TEXT.fullmatch(sent) and _LINE_END.search(sent)):
                yield (
                    f"{paths[name]}: the bytes of {whose} are no plain lines ({sent[:shown]!r}), "
                    f"and driver {one.driver!r} has no dialect among the entry points "
                    "hilcell.wire_dialects: see docs/drivers-guide.md"
                )
                break


def _other_name(cell: Cell, folder: Path, head: Head) -> list[str]:
    name = head.cell["name"]
    if name == cell.name:
        return []
    return [f"{folder}: recorded was cell {name!r}, asked was {cell.name!r}; name that one's file"]


def _other_settings(cell: Cell, folder: Path, head: Head) -> Iterator[str]:
    """Return, in words, what was recorded with other settings."""
    recorded = convert(head.cell, Cell, DATA)
    if changed := differences(_common(recorded), _common(cell)):
        act = f"use the cell file and settings of run {head.run}"
        yield f"{folder}: recorded with other settings: {changed}; {act}"


def _common(cell: Cell) -> Cell:
    """Return a cell without what another PC may have otherwise: texts of options are addresses,
    paths and what a device says of itself when it connects.
    """
    tables = {
        table: msgspec.structs.replace(one, options=_figures(one.options))
        for table, one in ((table, getattr(cell, table)) for table, _group in TABLES)
    }
    return msgspec.structs.replace(cell, simulation=None, **tables)


def _figures(options: Mapping[str, Any]) -> dict[str, Any]:
    plain = {key: each for key, each in options.items() if not isinstance(each, str)}
    return {
        key: _figures(each) if isinstance(each, Mapping) else each
        for key, each in plain.items()
        if not (key == "port" or key.endswith("_port"))
    }
