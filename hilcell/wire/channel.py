"""Where a device is reached: ``socket://HOST:PORT``, or a serial line as ``PATH[@BAUD]``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlsplit

from msgspec import Meta

BAUD = 115_200
_HOST = r"^([^\s/@:?#]+|[0-9A-Fa-f.]*:[0-9A-Fa-f.]*:[0-9A-Fa-f:.]*(%\w+)?)$"

Host = Annotated[
    str, Meta(pattern=_HOST, description="letters of a host name or of an IP address, no port,")
]
Port = Annotated[int, Meta(ge=1, le=65535)]


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
        url = urlsplit(channel)
        try:
            port = url.port
        except ValueError:  # none that could be one
            port = None
        host, more = url.hostname or "", url.username or url.path or url.query or url.fragment
        if url.scheme != "socket" or more or not re.match(_HOST, host) or not port:
            raise ValueError(
                f"channel: socket://HOST:PORT is wanted, found {channel!r}; "
                "allowed ports: 1 to 65535"
            )
        return Socket(host, port)
    path, at, baud = channel.partition("@")
    if not path.strip() or (at and not (baud.isascii() and baud.isdecimal() and len(baud) < 9)):
        raise ValueError(f"channel: socket://HOST:PORT or PATH[@BAUD] is wanted, found {channel!r}")
    slowest_baud, fastest_baud = 50, 4_000_000
    if at and not slowest_baud <= int(baud) <= fastest_baud:
        raise ValueError(
            f"channel: a baud rate is wanted behind @, found {channel!r}; "
            f"allowed: {slowest_baud} to {fastest_baud}, without @ it is {BAUD}"
        )
    return SerialLine(path, int(baud) if at else BAUD)
