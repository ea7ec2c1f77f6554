"""Recordings of wires: JSON lines, one for each piece of bytes, with its time.

``{"t": 1.234567, "c": 1, "e": ">", "b": "0100000e..", "k": "9d3f0a51"}``: seconds since the
recording of all wires began, number of the connection, event, bytes in hex, CRC-32 of all that.
``>`` went to the device, ``<`` came from it; ``open``, ``end`` (by the driver), ``lost`` (by the
device) and ``refused`` carry no bytes; ``began``, with the wire's name, is the first line. Files
are named by device and wire, ``robot.rtde.wire.jsonl``, and may be packed by ``xz``.

The cell's clock is recorded like a wire: first ``run``, the run's `RunHeader`; ``now`` is a
reading; pieces after ``stopped`` belong to the stop of the run; ``over`` ends it, with the exit
code; a killed run has none.
"""

from __future__ import annotations

import lzma
import struct
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Literal, Self, cast

import msgspec

from hilcell.cell.devices import checked_options
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.decoding import Json, decoded
from hilcell.errors import HilcellError
from hilcell.ports import Clock, Stopped
from hilcell.wire.channel import SerialLine, Socket, can_interfaces, wire_places, with_addresses

FORM = 1  # of all recordings of a run; raise it whenever one changes
COPY_AGAIN = "copy it again from the PC that recorded it"
CLOCK = "clock"  # in the place of a wire's name
_TIME = struct.Struct(">d")
SUFFIX = ".wire.jsonl"
PACKED = ".xz"
Event = Literal[
    "open", ">", "<", "end", "lost", "refused", "now", "began", "run", "stopped", "over"
]  # fmt: skip


class Piece(msgspec.Struct, frozen=True, omit_defaults=True):
    """Something that happened on a wire."""

    t: float
    c: int
    e: Event
    b: str = ""
    k: str = ""

    @classmethod
    def of(cls, t: float, c: int, e: Event, data: bytes = b"") -> Self:
        piece = cls(t, c, e, data.hex())
        return msgspec.structs.replace(piece, k=piece.check)

    @property
    def check(self) -> str:
        """The expected ``k``."""
        return f"{zlib.crc32(msgspec.json.encode((self.t, self.c, self.e, self.b))):08x}"

    @property
    def data(self) -> bytes:
        return bytes.fromhex(self.b)


class RunHeader(msgspec.Struct, frozen=True):
    """The recorded run and its session: a resumed run has several."""

    run: str
    procedure: str
    seed: int
    session: int
    cell: Json
    form: int = FORM


class Recorder:
    """Writes one recording; thread-safe. A full disk ends the recording, not the wire."""

    def __init__(self, file: IO[bytes], began_s: float) -> None:
        """``began_s`` (monotonic): begin of the recording of all wires."""
        self._file: IO[bytes] | None = file
        self._lock = threading.Lock()
        self._began_s = began_s

    def record(
        self, connection: int, event: Event, data: bytes = b"", at_s: float | None = None
    ) -> None:
        """Write an event of now, or of ``at_s`` (monotonic)."""
        with self._lock:
            if self._file is None:
                return
            t = round((time.monotonic() if at_s is None else at_s) - self._began_s, 6)
            try:
                self._file.write(msgspec.json.encode(Piece.of(t, connection, event, data)) + b"\n")
                self._file.flush()
            except OSError:
                self._file = None

    def close(self) -> None:
        with self._lock:
            self._file = None


class TimedStop(threading.Event):
    """A stop with its time: the devices receive it before the run does."""

    set_s: float | None = None  # monotonic

    def set(self) -> None:
        if self.set_s is None:
            self.set_s = time.monotonic()
        super().set()


class RecordingClock:
    """Satisfies `hilcell.ports.Clock`: another clock, whose readings are recorded."""

    def __init__(self, clock: Clock, recorder: Recorder, stop: TimedStop) -> None:
        self._clock, self._recorder, self._stop = clock, recorder, stop
        self.pc_s = clock.pc_s
        self._stopped = False

    def wait(self, duration_s: float) -> None:
        with self._note_stop():
            self._clock.wait(duration_s)

    def check(self) -> None:
        with self._note_stop():
            self._clock.check()

    @contextmanager
    def _note_stop(self) -> Iterator[None]:
        try:
            yield
        except Stopped:
            if not self._stopped:
                self._stopped = True
                self._recorder.record(0, "stopped", at_s=self._stop.set_s)
            raise

    def now_s(self) -> float:
        """The cell's time, which never runs back."""
        now_s = self._clock.now_s()
        self._recorder.record(0, "now", _TIME.pack(now_s))
        return now_s


def clock_readings(pieces: Iterable[Piece]) -> tuple[list[float], list[float]]:
    readings = [(piece.t, _TIME.unpack(piece.data)[0]) for piece in pieces if piece.e == "now"]
    return [at_s for at_s, _ in readings], [cell_s for _, cell_s in readings]


def run_header(clock: Sequence[Piece], path: Path) -> RunHeader:
    """Header in a clock's recording; raises `SettingsError`."""
    stated = next((piece.data for piece in clock if piece.e == "run"), b"")
    if not stated:
        raise SettingsError(str(path), [f"does not state the recorded run; {COPY_AGAIN}"])
    form = decoded(stated, Json).get("form")
    if form != FORM:
        problem = f"form {form or 'none'}, expected {FORM}; record the run again"
        raise SettingsError(str(path), [problem])
    return decoded(stated, RunHeader)


def recorded_exit_code(pieces: Iterable[Piece]) -> int | None:
    stated = next((piece.data for piece in pieces if piece.e == "over"), None)
    return None if stated is None else int(stated)


def recordings(folder: Path) -> dict[str, Path]:
    paths = [path for end in ("", PACKED) for path in folder.glob(f"*{SUFFIX}{end}")]
    return {path.name.partition(SUFFIX)[0]: path for path in sorted(paths)}


def read_recording(path: Path) -> list[Piece]:
    """Read a recording; raises `SettingsError` for a changed one."""
    try:
        data = path.read_bytes()
        return list(_pieces(lzma.decompress(data) if path.suffix == PACKED else data, path))
    except (OSError, lzma.LZMAError, EOFError, ValueError) as error:
        problem = f"no recording of a wire: {error}; {COPY_AGAIN}"
        raise SettingsError(str(path), [problem]) from error


def _pieces(text: bytes, path: Path) -> Iterator[Piece]:
    *lines, rest = text.split(b"\n")
    if rest:
        at = f"{path}:{len(lines) + 1}"
        raise ValueError(f"the file ends within a line, {at}, or delete that line")
    if not lines:
        raise ValueError("the file is empty")
    for number, line in enumerate(lines, 1):
        try:
            piece = decoded(line, Piece)
        except msgspec.DecodeError as error:
            raise ValueError(f"{path}:{number} is no line of one: {error}") from error
        if piece.k != piece.check:
            sums = f"expected check sum {piece.check}, got {piece.k or 'none'}"
            raise ValueError(f"{path}:{number} was changed: {sums}")
        yield piece


Addresses = Mapping[str, Mapping[str, object]]


class RelayOrder(msgspec.Struct, frozen=True):
    """One wire: its name, address, and recording file."""

    wire: str
    file: str
    began_s: float  # monotonic; of the recording of all wires
    place: Socket | SerialLine


class WireRecording:
    """The relay process of one run; ``addresses`` replace those of the devices. ``left_out``:
    devices whose wires cannot be recorded here, with the reason.
    """

    def __init__(self, cell: Cell, addresses: Addresses, folder: Path, head: RunHeader) -> None:
        """Start the relay; raises `HilcellError` where it cannot open a serial line."""
        self.left_out: dict[str, str] = {}
        folder, began_s = self._unused(folder), time.monotonic()
        stated = checked_options(cell, addresses)
        orders = [
            RelayOrder(name, str(folder / f"{name}{SUFFIX}"), began_s, place)
            for name, place in wire_places(stated).items()
        ]
        for table, options in stated.items():
            if cans := can_interfaces(options):
                self.left_out[table] = "; ".join(
                    f"{channel} is a CAN interface: record it with `candump -l {channel}`"
                    for channel in cans
                )
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "hilcell.wire.relay"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        self.addresses: Addresses = with_addresses(stated, self._channels(orders))
        self._clock_file = (folder / f"{CLOCK}{SUFFIX}").open("ab")
        self._recorder = Recorder(self._clock_file, began_s)
        self._recorder.record(0, "run", msgspec.json.encode(head))

    def clock(self, clock: Clock, stop: TimedStop) -> Clock:
        """The cell's clock, recorded: its readings synchronize replayed wires."""
        return RecordingClock(clock, self._recorder, stop)

    def close(self, exit_code: int | None = None) -> None:
        if exit_code is not None:
            self._recorder.record(0, "over", b"%d" % exit_code)
        self._recorder.close()
        self._clock_file.close()
        end_s = 5.0
        try:
            self._process.communicate(timeout=end_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()

    def _channels(self, orders: list[RelayOrder]) -> dict[str, str]:
        stdin, stdout = cast("IO[bytes]", self._process.stdin), self._process.stdout
        stdin.write(msgspec.json.encode(orders) + b"\n")
        stdin.flush()
        line = cast("IO[bytes]", stdout).readline()
        if not line:
            _, errors = self._process.communicate()
            last = errors.decode(errors="replace").strip().rpartition("\n")[2]
            raise HilcellError(f"--record-wire: the relay did not start: {last}")
        return msgspec.json.decode(line, type=dict[str, str])

    @staticmethod
    def _unused(folder: Path) -> Path:
        """A folder without recordings: a resumed run has its own."""
        unused, number = folder, 1
        while recordings(unused):
            number += 1
            unused = folder / f"wires-{number}"
        unused.mkdir(exist_ok=True)
        return unused
