"""How a fault is brought about: by the fakes, network, signals, disk, clock or a file."""

from __future__ import annotations

import os
import signal
import sqlite3
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, tzinfo
from functools import partial
from pathlib import Path
from typing import Any

from campaigns.faults.bed import Bed
from hilcell.journal import journal as journal_module
from tests.whole.bench import hilcell

FOR_EVER = 0
PERSISTENT = FOR_EVER
APART_S = 0.05  # two signals of one kind that are pending together are one


class Injection:
    """Strikes a run in a phase; ``heal`` puts right what a person would before the resume.

    ``apart``: the engine is a process of its own. ``proxied``: the devices are behind proxies.
    ``cell_file``: the run has a cell file of its own. ``lasts``: nothing here can put it right.
    """

    apart = proxied = attended = cell_file = False
    lasts: bool = False
    text: str

    def prepare(self, bed: Bed) -> Callable[[], None]:
        """Prepare before the run starts; return what undoes that."""
        return lambda: None

    def between(self, bed: Bed) -> None:
        """Strike between a stop and the resume."""

    def strike(self, bed: Bed) -> None:
        """Strike at the phase's begin."""

    def heal(self, bed: Bed) -> None:
        """Put the cause right."""
        bed.cell.simulation.ask(do="clear")


@dataclass(frozen=True)
class Knob(Injection):
    """A fault of the fakes."""

    name: str
    value: bool | float | str = True
    count: int = PERSISTENT
    lasts: bool = False  # pyrefly: ignore[bad-override] # read only here
    after: int = 0  # so many occasions pass first
    wait_s: float = 0.0  # of real time in which the run stands still, so that the fault shows

    @property
    def text(self) -> str:  # type: ignore[override] # read only here
        return f"`{self.name}`" if self.value is True else f"`{self.name} = {self.value}`"

    def strike(self, bed: Bed) -> None:
        answer = bed.cell.simulation.ask(
            do="fault",
            name=self.name,
            value=self.value,
            count=self.count,
            after=self.after,
            at_rest=True,
        )
        assert answer["ok"], answer
        time.sleep(self.wait_s)


@dataclass(frozen=True)
class Wire(Injection):
    """The network before a device: ``mode`` of its proxy, or ``reset``."""

    device: str
    mode: str
    delay_s: float = 0.0
    proxied = True

    @property
    def text(self) -> str:  # type: ignore[override] # read only here
        return f"proxy before the {self.device}: {self.mode}"

    def strike(self, bed: Bed) -> None:
        proxy = bed.cell.proxies[self.device]
        if self.mode == "reset":
            proxy.reset()
        else:
            proxy.delay_s, proxy.mode = self.delay_s, self.mode

    def heal(self, bed: Bed) -> None:
        bed.cell.proxies[self.device].mode = "pass"


class _Jumped(datetime):
    hours = 0.0

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override] # no subclass is made
        return datetime.now(tz or UTC) + timedelta(hours=cls.hours)


@dataclass(frozen=True)
class Clock(Injection):
    """The PC's wall clock jumps."""

    hours: float

    @property
    def text(self) -> str:  # type: ignore[override] # read only here
        return f"wall clock {self.hours:+g} h"

    def prepare(self, bed: Bed) -> Callable[[], None]:
        _Jumped.hours = 0.0
        return _patched(journal_module, "datetime", _Jumped)

    def strike(self, bed: Bed) -> None:
        _Jumped.hours = self.hours


class _Connection(sqlite3.Connection):
    full = False

    def execute(self, sql: str, parameters: Any = (), /) -> sqlite3.Cursor:
        if _Connection.full and sql.startswith("INSERT INTO record"):
            raise sqlite3.OperationalError("database or disk is full")
        return super().execute(sql, parameters)


@dataclass(frozen=True)
class FullDisk(Injection):
    """No record can be written any more."""

    text = "each insert fails as on a full disk"

    def prepare(self, bed: Bed) -> Callable[[], None]:
        _Connection.full = False
        connect = partial(sqlite3.connect, factory=_Connection)
        return _patched(sqlite3, "connect", connect)

    def strike(self, bed: Bed) -> None:
        _Connection.full = True

    def heal(self, bed: Bed) -> None:
        _Connection.full = False


@dataclass(frozen=True)
class Kill(Injection):
    """kill -9 of the engine; ``torn`` bytes of the write-ahead log's end are lost with it."""

    torn: int = 0
    apart = True

    @property
    def text(self) -> str:  # type: ignore[override] # read only here
        return f"kill -9, {self.torn} bytes of the WAL cut off" if self.torn else "kill -9"

    def strike(self, bed: Bed) -> None:
        assert bed.process is not None
        bed.process.kill()

    def heal(self, bed: Bed) -> None:
        wal = bed.journal.with_name(f"{bed.journal.name}-wal")
        if self.torn and wal.exists():
            os.truncate(wal, max(0, wal.stat().st_size - self.torn))


@dataclass(frozen=True)
class Corrupted(Injection):
    """Bits of the journal's file are flipped, while its engine writes it."""

    text = "bits of the journal flipped"
    lasts = True

    def strike(self, bed: Bed) -> None:
        """Overwrite the newest record where it lies: in the log, or in the file."""
        for file in (bed.journal.with_name(f"{bed.journal.name}-wal"), bed.journal):
            if file.exists() and file.stat().st_size:
                data = bytearray(file.read_bytes())
                at = data.rfind(b'"machine"')
                data[at : at + 4] = b"\xff\xfe\x00\x81"
                with file.open("r+b") as stream:
                    stream.write(data)
                return


@dataclass(frozen=True)
class SecondEngine(Injection):
    """Another process wants the same run."""

    text = "`hilcell run` of the same cell, from another process"

    def strike(self, bed: Bed) -> None:
        words = ("run", "home", "--runs", str(bed.folder), "--cell", bed.cell_file)
        done = hilcell(*words, "--set", f"simulation.address={bed.cell.address}")
        if done.returncode != 6:
            bed.notes.append(f"the second engine ended with {done.returncode}: {done.stderr}")


@dataclass(frozen=True)
class Signals(Injection):
    """Signals to the engine, one soon after the other."""

    numbers: tuple[signal.Signals, ...]
    apart = True

    @property
    def text(self) -> str:  # type: ignore[override] # read only here
        return ", ".join(number.name for number in self.numbers)

    def strike(self, bed: Bed) -> None:
        assert bed.process is not None
        for number in self.numbers:
            bed.process.send_signal(number)
            time.sleep(APART_S)


@dataclass(frozen=True)
class EditedCell(Injection):
    """The cell's file is edited between a stop and the resume."""

    old: str
    new: str
    cell_file = True

    @property
    def text(self) -> str:  # type: ignore[override] # read only here
        return f"cell file: `{self.old}` becomes `{self.new}`"

    def between(self, bed: Bed) -> None:
        self._write(bed, self.old, self.new)

    def heal(self, bed: Bed) -> None:
        self._write(bed, self.new, self.old)

    def _write(self, bed: Bed, old: str, new: str) -> None:
        file = Path(bed.cell_file)
        text = file.read_text("utf-8")
        assert old in text
        file.write_text(text.replace(old, new, 1), "utf-8")


@dataclass(frozen=True)
class NothingDone(Injection):
    """The beam is blocked; the operator says that it is clear, and it is not."""

    text = "the beam stays blocked, and the prompt is answered"
    attended = True

    def strike(self, bed: Bed) -> None:
        bed.cell.simulation.ask(do="fault", name="tracker.no_reflector", count=FOR_EVER)
        bed.on_suspended = lambda: threading.Thread(target=self._answer, args=(bed,)).start()

    def _answer(self, bed: Bed) -> None:
        if not bed.order("answer"):
            bed.notes.append("an answer was taken that nothing had been done for")
        bed.cell.simulation.ask(do="clear")
        if refused := bed.order("answer"):
            bed.notes.append(f"refused although the beam is clear: {refused}")


def _patched(place: Any, name: str, value: object) -> Callable[[], None]:
    before = getattr(place, name)
    setattr(place, name, value)
    return lambda: setattr(place, name, before)
