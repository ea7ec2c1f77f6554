"""A cell whose devices are recordings of their wires: ``--set simulation.simulator=recorded``.

``simulation.data`` names the folder of a run that was made with ``--record-wire``. Waits of the
cell pass at once; its clock shows what it showed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from threading import Event

import msgspec

from fakes.replay.dialects import Dialect, dialects_of
from fakes.replay.event_time import EventTime, RecordedLooks
from fakes.replay.recorded_run import Recorded, check_run, folder_of, read_run, sessions
from fakes.replay.recorded_wire import RecordedWire
from fakes.time import PatientTime
from hilcell.cell.devices import TABLES, driver_options, stand_ins
from hilcell.cell.file import Cell
from hilcell.ports import RecordingEnded, Stopped
from hilcell.wire.channel import addressed
from hilcell.wire.recording import CLOCK, Piece, ended_with, looks


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
        self._resumed = len(sessions(folder_of(cell))) > session
        self.options: dict[str, dict[str, object]] = {}
        self.address = ""
        self._wires: list[RecordedWire] = []
        self._time, channels = EventTime(), dict[str, dict[str, str]]()
        clock = pieces.pop(CLOCK)
        self._looks = RecordedLooks(self._time, *looks(clock))
        self._expect_end(paths, clock, pieces)
        tables = {table: getattr(cell, table) for table, _group in TABLES}
        dialects = {table: dialects_of(one.driver, one.options) for table, one in tables.items()}
        for name, found in pieces.items():
            table, _dot, wire = name.partition(".")
            dialect = dialects[table].get(wire, Dialect())
            self._wires.append(RecordedWire(found, dialect, self._time, str(paths[name])))
            channels.setdefault(table, {})[wire] = self._wires[-1].channel
        for each in self._wires:
            each.start()
        self._address(cell, channels)

    def _expect_end(
        self, paths: Mapping[str, Path], clock: Sequence[Piece], wires: Recorded
    ) -> None:
        """Let the replay know where its recording ends, but for one that a fault has ended."""
        ended = ended_with(clock)
        exit_fault, exit_aborted = 3, 4  # of the recorded run
        if ended == exit_fault:
            return
        for name, found in wires.items():
            self._time.end_at(found[-1].t, f"{paths[name]}:{len(found)}")
        for line, piece in enumerate(clock, 1):
            if piece.e == "stopped" and ended == exit_aborted:
                self._time.stop_at(piece.t, f"{paths[CLOCK]}:{line}")

    def _address(self, cell: Cell, channels: Mapping[str, Mapping[str, str]]) -> None:
        """Let the drivers find the recorded wires."""
        anywhere = stand_ins(cell)
        for table, group in TABLES:
            if table in channels:
                _, options = driver_options(cell, table, group, anywhere[table])
                self.options[table] = addressed(msgspec.to_builtins(options), channels[table])

    @classmethod
    def check(cls, cell: Cell) -> None:
        """Refuse a folder that is not whole, or of another cell; raises `SettingsError`."""
        read_run(cell)

    @classmethod
    def check_run(cls, cell: Cell, procedure: str, seed: int) -> None:
        """Refuse another procedure or seed than was recorded; raises `SettingsError`."""
        check_run(cell, procedure, seed)

    def clock(self, stop: Event) -> RecordedClock:
        """Return the cell's clock."""
        act = "use the procedure, cell and settings of the recorded run, or record it again"
        again = "there the recorded run ended, and was resumed: `hilcell resume` this one, too"
        return RecordedClock(self._looks, self._time, stop, again if self._resumed else act)

    def close(self) -> None:
        """Stop serving."""
        for wire in self._wires:
            wire.close()


class RecordedClock:
    """The cell's clock as it was, in which every wait is over at once.

    Every wait on a wire looks here, so here a run learns that its recording goes no further.
    """

    def __init__(self, looks: RecordedLooks, time: EventTime, stop: Event, act: str) -> None:
        """``act`` is what to do where the recording ends."""
        self._looks, self._time, self._stop, self._act = looks, time, stop, act
        self.now_s, self.pc_s = looks.now_s, PatientTime().now_s

    def wait(self, duration_s: float) -> None:
        """Let cell time pass."""
        self._looks.wait(duration_s)
        self.check()

    def check(self) -> None:
        """Raise `Stopped` if a stop was asked for, `RecordingEnded`."""
        if self._stop.is_set():
            raise Stopped("a stop was asked for")
        if found := self._time.left():
            raise RecordingEnded(f"{found}; {self._act}", code="HC-C26")
