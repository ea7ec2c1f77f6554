"""A cell whose devices are recordings of their wires: ``--set simulation.simulator=recorded``.

``simulation.data`` names the folder of a run that was made with ``--record-wire``. Waits of the
cell pass at once; otherwise its time is real.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from threading import Event

from fakes.dialects import DIALECTS, Dialect
from fakes.recorded_wire import RecordedWire
from hilcell.cell.devices import TABLES, load_entry
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.ports import Stopped
from hilcell.wire.recording import SUFFIX, read_recording

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
        for table, group in TABLES:
            path = _folder(cell) / f"{table}{SUFFIX}"
            if not path.exists():
                continue
            driver = getattr(cell, table).driver
            wire = RecordedWire(read_recording(path), DIALECTS.get(driver, Dialect()))
            wire.start()
            self._wires.append(wire)
            host, port = wire.host_and_port
            known = load_entry(group, driver).Options.__struct_fields__
            place: dict[str, object] = {"host": host, "port": port}
            if "host" not in known:
                place = {"channel": f"socket://{host}:{port}"}
            self.options[table] = place

    @classmethod
    def check(cls, cell: Cell) -> None:
        """Refuse a folder without recordings; raises `SettingsError`."""
        folder = _folder(cell)
        if not any(folder.glob(f"*{SUFFIX}")):
            raise SettingsError(
                "simulation.data",
                [f"{folder}: no recording (*{SUFFIX}) there; make one with `run --record-wire`"],
            )

    def clock(self, stop: Event) -> RecordedClock:
        """Return the cell's clock."""
        return RecordedClock(stop)

    def close(self) -> None:
        """Stop serving."""
        for wire in self._wires:
            wire.close()


class RecordedClock:
    """Real time, in which every wait is over at once."""

    def __init__(self, stop: Event) -> None:
        self._stop = stop
        self._waited_s = 0.0

    def now_s(self) -> float:
        """Return seconds, those of all waits among them."""
        return time.monotonic() + self._waited_s

    def wait(self, duration_s: float) -> None:
        """Let cell time pass."""
        self._waited_s += duration_s
        self.check()

    def check(self) -> None:
        """Raise `Stopped` if a stop was asked for."""
        if self._stop.is_set():
            raise Stopped("a stop was asked for")


def _folder(cell: Cell) -> Path:
    return Path("" if cell.simulation is None else cell.simulation.data)
