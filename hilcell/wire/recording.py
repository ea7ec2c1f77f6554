"""Recordings of a device's wire: JSON lines, one for each piece of bytes, with its time.

``{"t": 1.234567, "c": 1, "e": ">", "b": "0100000e.."}``: seconds since the recording began, the
number of the connection, what happened, and the bytes in hex. ``>`` went to the device, ``<`` came
from it; ``open``, ``end`` (by the driver), ``lost`` (by the device) and ``refused`` carry none.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Literal

import msgspec

from hilcell.cell.settings import SettingsError

SUFFIX = ".wire.jsonl"
Event = Literal["open", ">", "<", "end", "lost", "refused"]


class Piece(msgspec.Struct, frozen=True, omit_defaults=True):
    """Something that happened on a wire."""

    t: float
    c: int
    e: Event
    b: str = ""

    @property
    def data(self) -> bytes:
        """Return the bytes."""
        return bytes.fromhex(self.b)


class Recorder:
    """Writes one recording; safe to use from several threads. A full disk ends it, no wire."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file: IO[bytes] | None = file
        self._lock = threading.Lock()
        self._began_s = time.monotonic()

    def take(self, connection: int, event: Event, data: bytes = b"") -> None:
        """Write what happened."""
        with self._lock:
            if self._file is None:
                return
            piece = Piece(round(time.monotonic() - self._began_s, 6), connection, event, data.hex())
            try:
                self._file.write(msgspec.json.encode(piece) + b"\n")
                self._file.flush()
            except OSError:
                self._file = None

    def close(self) -> None:
        """End the recording."""
        with self._lock:
            self._file = None


def read_recording(path: Path) -> list[Piece]:
    """Return the pieces of a recording; a last line that was cut off is left out.

    Raises `SettingsError`.
    """
    try:
        return list(_pieces(path.read_bytes()))
    except (OSError, msgspec.DecodeError, ValueError) as error:
        raise SettingsError(str(path), [f"no recording of a wire: {error}"]) from error


def _pieces(text: bytes) -> Iterator[Piece]:
    whole, _, _ = text.rpartition(b"\n")
    for line in whole.splitlines():
        yield msgspec.json.decode(line, type=Piece)
