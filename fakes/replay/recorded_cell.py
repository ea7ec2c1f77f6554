"""A cell whose devices are recordings of their wires: ``--set simulation.simulator=recorded``.

``simulation.data`` names the folder of a run that was made with ``--record-wire``. Waits of the
cell pass at once; its clock shows what it showed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from threading import Event

import msgspec

from fakes.replay.dialects import Dialect, dialects_of
from fakes.replay.event_time import EventTime, RecordedLooks
from fakes.replay.recorded_wire import RecordedWire
from hilcell.cell.devices import TABLES, driver_options, stand_ins
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.ports import Stopped
from hilcell.wire.recording import CLOCK, SUFFIX, drivers_of, looks, read_recording, recordings
from hilcell.wire.wires import addressed, can_interfaces, joined, wires_of

NO_PORTS: Mapping[str, int] = {}


class RecordedCell:
    """Satisfies `hilcell.ports.SimulatedCell`."""

    def __init__(
        self,
        cell: Cell,
        *,
        seed: int | None = None,
        speed: float = math.inf,
        **_: object,
    ) -> None:
        self.check(cell)
        self.options: dict[str, dict[str, object]] = {}
        self.address = ""
        self._wires: list[RecordedWire] = []
        time, channels = EventTime(), dict[str, dict[str, str]]()
        paths = recordings(_folder(cell))
        clock = paths.pop(CLOCK, None)
        self._looks = RecordedLooks(time, *looks([] if clock is None else read_recording(clock)))
        tables = {table: getattr(cell, table) for table, _group in TABLES}
        dialects = {table: dialects_of(one.driver, one.options) for table, one in tables.items()}
        for name, path in paths.items():
            table, _dot, wire = name.partition(".")
            dialect = dialects[table].get(wire, Dialect())
            self._wires.append(RecordedWire(read_recording(path), dialect, time))
            channels.setdefault(table, {})[wire] = self._wires[-1].channel
        for each in self._wires:
            each.start()
        self._address(cell, channels)

    def _address(self, cell: Cell, channels: Mapping[str, Mapping[str, str]]) -> None:
        """Let the drivers find the recorded wires."""
        anywhere = stand_ins(cell)
        for table, group in TABLES:
            if table in channels:
                _, options = driver_options(cell, table, group, anywhere[table])
                self.options[table] = addressed(msgspec.to_builtins(options), channels[table])

    @classmethod
    def check(cls, cell: Cell) -> None:
        """Refuse a folder without a wire of the cell, or of other drivers; `SettingsError`."""
        folder = _folder(cell)
        found = recordings(folder)
        if not found:
            raise SettingsError(
                "simulation.data",
                [f"{folder}: no recording (*{SUFFIX}) there; make one with `run --record-wire`"],
            )
        missing = [f"{folder}: {problem}" for problem in _missing(cell, set(found))]
        if problems := _other_drivers(cell, folder) or missing:
            raise SettingsError("simulation.data", problems)

    def clock(self, stop: Event) -> RecordedClock:
        """Return the cell's clock."""
        return RecordedClock(self._looks, stop)

    def close(self) -> None:
        """Stop serving."""
        for wire in self._wires:
            wire.close()


class RecordedClock:
    """The cell's clock as it was, in which every wait is over at once."""

    def __init__(self, looks: RecordedLooks, stop: Event) -> None:
        self._looks, self._stop = looks, stop
        self.now_s = looks.now_s

    def wait(self, duration_s: float) -> None:
        """Let cell time pass."""
        self._looks.wait(duration_s)
        self.check()

    def check(self) -> None:
        """Raise `Stopped` if a stop was asked for."""
        if self._stop.is_set():
            raise Stopped("a stop was asked for")


def _other_drivers(cell: Cell, folder: Path) -> list[str]:
    """Return which devices were recorded with another driver than the cell's, where that is known.

    Raises `SettingsError` for what is no recording.
    """
    clock = recordings(folder).get(CLOCK)
    recorded = drivers_of([] if clock is None else read_recording(clock))
    return [
        f"{folder}: the {table} was recorded with driver {driver!r}, here it is "
        f"{getattr(cell, table).driver!r}; add --set {table}.driver={driver}"
        for table, driver in recorded.items()
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


def _folder(cell: Cell) -> Path:
    return Path("" if cell.simulation is None else cell.simulation.data)
