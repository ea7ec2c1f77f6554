"""Addresses of devices: ``socket://HOST:PORT``, or a serial line as ``PATH[@BAUD]``.

A wire's name within its device: "" for ``channel``, or ``host`` with ``port``; ``rtde`` for
``rtde_port``; ``strip`` for that of a sub-table. Within the cell it begins with the device's name:
``rail``, ``rail.strip``, ``robot.rtde``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated
from urllib.parse import urlsplit

from msgspec import Meta, Struct

from hilcell.decoding import Json

BAUD = 115_200
PORT = "port"
_HOST = r"^([^\s/@:?#]+|[0-9A-Fa-f.]*:[0-9A-Fa-f.]*:[0-9A-Fa-f:.]*(%\w+)?)$"

Host = Annotated[
    str, Meta(pattern=_HOST, description="letters of a host name or of an IP address, no port,")
]
Port = Annotated[int, Meta(ge=1, le=65535)]


class Socket(Struct, frozen=True, tag=True):
    """A TCP server."""

    host: str
    port: int


class SerialLine(Struct, frozen=True, tag=True):
    """A serial line, 8 data bits, no parity, 1 stop bit: best by ``/dev/serial/by-id/...``."""

    path: str
    baud: int = BAUD


def parse_channel(channel: str) -> Socket | SerialLine:
    """Parse a channel; raises `ValueError`."""
    if "://" in channel:
        url = urlsplit(channel)
        try:
            port = url.port
        except ValueError:
            port = None
        host, more = url.hostname or "", url.username or url.path or url.query or url.fragment
        if url.scheme != "socket" or more or not re.match(_HOST, host) or not port:
            raise ValueError(
                f"channel: expected socket://HOST:PORT with a port of 1 to 65535, got {channel!r}"
            )
        return Socket(host, port)
    path, at, baud = channel.partition("@")
    if not path.strip() or (at and not (baud.isascii() and baud.isdecimal() and len(baud) < 9)):
        raise ValueError(f"channel: expected socket://HOST:PORT or PATH[@BAUD], got {channel!r}")
    slowest_baud, fastest_baud = 50, 4_000_000
    if at and not slowest_baud <= int(baud) <= fastest_baud:
        raise ValueError(
            f"channel: expected a baud rate of {slowest_baud} to {fastest_baud} behind @, "
            f"got {channel!r}; without @ it is {BAUD}"
        )
    return SerialLine(path, int(baud) if at else BAUD)


def wire_places(options: Mapping[str, object]) -> dict[str, Socket | SerialLine]:
    """Addresses of wires by name; a CAN interface of the kernel is left out."""
    places: dict[str, Socket | SerialLine] = {}
    host, channel = options.get("host"), options.get("channel")
    for key, value in options.items():
        if isinstance(value, Mapping):
            for name, place in wire_places(value).items():
                places[f"{key}.{name}".removesuffix(".")] = place
        elif isinstance(host, str) and isinstance(value, int) and _is_port(key):
            places[key.removesuffix(PORT).removesuffix("_")] = Socket(host, value)
    if isinstance(channel, str) and not is_can_interface(options):
        places[""] = parse_channel(channel)
    return places


def with_addresses(options: Mapping[str, object], channels: Mapping[str, str]) -> Json:
    """Options whose wires lead to ``channels``."""
    found = dict(options)
    for name, channel in channels.items():
        (key, _, rest), place = name.partition("."), parse_channel(channel)
        if isinstance(part := found.get(key), Mapping):
            found[key] = with_addresses(part, {rest: channel})
        elif "host" in options and isinstance(place, Socket):
            found |= {"host": place.host, f"{name}_{PORT}".lstrip("_"): place.port}
        else:
            found["channel"] = channel
    return found


def is_can_interface(options: Mapping[str, object]) -> bool:
    """Whether the channel is an interface of the kernel, which no relay can replace."""
    return options.get("interface") == "socketcan"


def can_interfaces(options: Mapping[str, object]) -> list[str]:
    parts = [part for part in options.values() if isinstance(part, Mapping)]
    return [str(part["channel"]) for part in (options, *parts) if is_can_interface(part)]


def _is_port(key: str) -> bool:
    return key == PORT or key.endswith(f"_{PORT}")
