"""Where a device is reached: ``socket://HOST:PORT``, or a serial line as ``PATH[@BAUD]``."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import urlsplit

BAUD = 115_200


@dataclass(frozen=True, slots=True)
class Socket:
    """A TCP server."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class SerialLine:
    """A serial line, 8 data bits, no parity, 1 stop bit: best by ``/dev/serial/by-id/...``."""

    path: str
    baud: int = BAUD


def parse_channel(channel: str) -> Socket | SerialLine:
    """Return where a channel leads; raises `ValueError` for one of neither form."""
    if "://" in channel:
        return _socket(channel)
    path, at, baud = channel.partition("@")
    if not path or (at and not (baud.isascii() and baud.isdecimal() and len(baud) < 9)):
        raise ValueError(f"channel: socket://HOST:PORT or PATH[@BAUD] is wanted, found {channel!r}")
    return SerialLine(path, int(baud) if at else BAUD)


def _socket(channel: str) -> Socket:
    url = urlsplit(channel)
    try:
        port = url.port
    except ValueError:  # none that could be one
        port = None
    if url.scheme != "socket" or not url.hostname or not port:
        raise ValueError(f"channel: socket://HOST:PORT is wanted, found {channel!r}")
    return Socket(url.hostname, port)
