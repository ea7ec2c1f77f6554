"""Recordings of a device's wire: JSON lines, one for each piece of bytes, with its time.

``{"t": 1.234567, "c": 1, "e": ">", "b": "0100000e..", "k": "9d3f0a51"}``: seconds since the
recording of all wires began, the number of the connection, what happened, the bytes in hex, and the
CRC-32 of all that. ``>`` went to the device, ``<`` came from it; ``open``, ``end`` (by the driver),
``lost`` (by the device) and ``refused`` carry no bytes. A recording may be packed by ``xz``.

A recording is named by its device and its wire: ``robot.wire.jsonl``, ``robot.rtde.wire.jsonl``.
The first line of a wire is ``began``, with its name; a wire that was never opened has no other.

The cell's clock is recorded like a wire: ``now`` is a look at it, with what it showed. Its first
line is ``run``, the recorded run's `Head` as JSON. ``stopped`` is when the run was to stop; all
later pieces are of its stop. ``over`` is the last line, with the run's exit code; a run that was
killed has none.
"""

from __future__ import annotations

import lzma
import struct
import threading
import time
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Literal, Self

import msgspec

from hilcell.cell.settings import SettingsError
from hilcell.decoding import Json, decoded
from hilcell.ports import Clock, Stopped

FORM = 1  # of all recordings of a run; to be raised whenever one changes
COPY_AGAIN = "copy it again from the PC that recorded it"
CLOCK = "clock"  # in the place of a wire's name
_SHOWN = struct.Struct(">d")
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
        """Return a piece with its check."""
        piece = cls(t, c, e, data.hex())
        return msgspec.structs.replace(piece, k=piece.check)

    @property
    def check(self) -> str:
        """Return what ``k`` has to be."""
        return f"{zlib.crc32(msgspec.json.encode((self.t, self.c, self.e, self.b))):08x}"

    @property
    def data(self) -> bytes:
        return bytes.fromhex(self.b)


class Head(msgspec.Struct, frozen=True):
    """The run that was recorded, and which of its sessions: a run that is resumed has several."""

    run: str
    procedure: str
    seed: int
    session: int
    cell: Json
    form: int = FORM


class Recorder:
    """Writes one recording; safe to use from several threads. A full disk ends it, no wire."""

    def __init__(self, file: IO[bytes], began_s: float) -> None:
        """``began_s`` (monotonic) is when the recording of all wires began."""
        self._file: IO[bytes] | None = file
        self._lock = threading.Lock()
        self._began_s = began_s

    def take(
        self, connection: int, event: Event, data: bytes = b"", at_s: float | None = None
    ) -> None:
        """Write what happened, now or at ``at_s`` (monotonic)."""
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
    """A stop that knows when it was asked for: the devices hear of it before the run does."""

    set_s: float | None = None  # monotonic

    def set(self) -> None:
        if self.set_s is None:
            self.set_s = time.monotonic()
        super().set()


class RecordedLooks:
    """Satisfies `hilcell.ports.Clock`: another clock, whose looks are recorded."""

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
                self._recorder.take(0, "stopped", at_s=self._stop.set_s)
            raise

    def now_s(self) -> float:
        """Return the cell's time, which never runs back."""
        now_s = self._clock.now_s()
        self._recorder.take(0, "now", _SHOWN.pack(now_s))
        return now_s


def looks(pieces: Iterable[Piece]) -> tuple[list[float], list[float]]:
    """Return when the cell's clock was looked at, by the recording, and what it showed, in s."""
    found = [(piece.t, _SHOWN.unpack(piece.data)[0]) for piece in pieces if piece.e == "now"]
    return [at_s for at_s, _ in found], [shown_s for _, shown_s in found]


def head_of(clock: Sequence[Piece], path: Path) -> Head:
    """Return the recorded run of a clock's recording; raises `SettingsError`."""
    stated = next((piece.data for piece in clock if piece.e == "run"), b"")
    if not stated:
        raise SettingsError(str(path), [f"does not state the recorded run; {COPY_AGAIN}"])
    form = decoded(stated, Json).get("form")
    if form != FORM:
        found = f"form {form or 'none'}, expected {FORM}; record the run again"
        raise SettingsError(str(path), [found])
    return decoded(stated, Head)


def ended_with(pieces: Iterable[Piece]) -> int | None:
    """Return the exit code of a recorded run; None for one that was killed."""
    stated = next((piece.data for piece in pieces if piece.e == "over"), None)
    return None if stated is None else int(stated)


def recordings(folder: Path) -> dict[str, Path]:
    """Return the recordings in a folder by the names of their wires."""
    paths = [path for end in ("", PACKED) for path in folder.glob(f"*{SUFFIX}{end}")]
    return {path.name.partition(SUFFIX)[0]: path for path in sorted(paths)}


def read_recording(path: Path) -> list[Piece]:
    """Return the pieces of a recording, all of which are as they were written.

    Raises `SettingsError`.
    """
    try:
        data = path.read_bytes()
        return list(_pieces(lzma.decompress(data) if path.suffix == PACKED else data, path))
    except (OSError, lzma.LZMAError, EOFError, ValueError) as error:
        found = f"no recording of a wire: {error}; {COPY_AGAIN}"
        raise SettingsError(str(path), [found]) from error


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
