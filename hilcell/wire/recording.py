"""Recordings of a device's wire: JSON lines, one for each piece of bytes, with its time.

``{"t": 1.234567, "c": 1, "e": ">", "b": "0100000e..", "k": "9d3f0a51"}``: seconds since the
recording of all wires began, the number of the connection, what happened, the bytes in hex, and the
CRC-32 of all that. ``>`` went to the device, ``<`` came from it; ``open``, ``end`` (by the driver),
``lost`` (by the device) and ``refused`` carry no bytes. A recording may be packed by ``xz``.

The cell's clock is recorded like a wire: ``now`` is a look at it, with what it showed. Its first
line, ``drivers``, states the drivers of the recorded run by table, as JSON.
"""

from __future__ import annotations

import lzma
import struct
import threading
import time
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Literal, Self

import msgspec

from hilcell.cell.settings import SettingsError
from hilcell.ports import Clock

CLOCK = "clock"  # in the place of a wire's name
_SHOWN = struct.Struct(">d")
SUFFIX = ".wire.jsonl"
PACKED = ".xz"
Event = Literal["open", ">", "<", "end", "lost", "refused", "now", "drivers"]


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
        """Return the bytes."""
        return bytes.fromhex(self.b)


class Recorder:
    """Writes one recording; safe to use from several threads. A full disk ends it, no wire."""

    def __init__(self, file: IO[bytes], began_s: float) -> None:
        """``began_s`` (monotonic) is when the recording of all wires began."""
        self._file: IO[bytes] | None = file
        self._lock = threading.Lock()
        self._began_s = began_s

    def take(self, connection: int, event: Event, data: bytes = b"") -> None:
        """Write what happened."""
        with self._lock:
            if self._file is None:
                return
            t = round(time.monotonic() - self._began_s, 6)
            try:
                self._file.write(msgspec.json.encode(Piece.of(t, connection, event, data)) + b"\n")
                self._file.flush()
            except OSError:
                self._file = None

    def close(self) -> None:
        """End the recording."""
        with self._lock:
            self._file = None


class RecordedLooks:
    """Satisfies `hilcell.ports.Clock`: another clock, whose looks are recorded."""

    def __init__(self, clock: Clock, recorder: Recorder) -> None:
        self._clock, self._recorder = clock, recorder
        self.wait, self.check = clock.wait, clock.check

    def now_s(self) -> float:
        """Return the cell's time, which never runs back."""
        now_s = self._clock.now_s()
        self._recorder.take(0, "now", _SHOWN.pack(now_s))
        return now_s


def looks(pieces: Iterable[Piece]) -> tuple[list[float], list[float]]:
    """Return when the cell's clock was looked at, by the recording, and what it showed, in s."""
    found = [(piece.t, _SHOWN.unpack(piece.data)[0]) for piece in pieces if piece.e == "now"]
    return [at_s for at_s, _ in found], [shown_s for _, shown_s in found]


def drivers_of(pieces: Iterable[Piece]) -> dict[str, str]:
    """Return the drivers of a recorded run by table; none where its clock's recording has none."""
    stated = (piece.data for piece in pieces if piece.e == "drivers")
    return msgspec.json.decode(next(stated, b"{}"), type=dict[str, str])


def recordings(folder: Path) -> dict[str, Path]:
    """Return the recordings in a folder by the names of their wires."""
    paths = [path for end in ("", PACKED) for path in folder.glob(f"*{SUFFIX}{end}")]
    return {path.name.partition(SUFFIX)[0]: path for path in sorted(paths)}


def read_recording(path: Path) -> list[Piece]:
    """Return the pieces of a recording; a last line that was cut off is left out.

    Raises `SettingsError`.
    """
    try:
        data = path.read_bytes()
        return list(_pieces(lzma.decompress(data) if path.suffix == PACKED else data))
    except (OSError, lzma.LZMAError, msgspec.DecodeError, ValueError) as error:
        raise SettingsError(str(path), [f"no recording of a wire: {error}"]) from error


def _pieces(text: bytes) -> Iterator[Piece]:
    whole, _, _ = text.rpartition(b"\n")
    for number, line in enumerate(whole.splitlines(), 1):
        piece = msgspec.json.decode(line, type=Piece)
        if piece.k != piece.check:
            raise ValueError(f"line {number} was changed: its check is {piece.k or 'missing'}")
        yield piece
