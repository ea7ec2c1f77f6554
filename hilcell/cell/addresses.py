"""Normalised addresses of devices: two spellings of one address must give one lock.

A host is compared by its IP addresses, a device file by the target of its links. A name server may
be slow; a name not resolved within `RESOLVE_S` is compared as text.
"""

from __future__ import annotations

import ipaddress
import json
import socket
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

RESOLVE_S = 1.0
THIS_MACHINE = "this machine"


def places(options: Mapping[str, object]) -> list[str]:
    """Return the normalised addresses in a driver's options, and in tables of its parts.

    ``host`` with ``port``, or with named ports such as ``rtde_port``; or ``channel``: the URL of a
    network gateway, a serial port with or without baud rate, a CAN interface. Options without
    either are one address as a whole.
    """
    parts = [part for part in options.values() if isinstance(part, Mapping)]
    of_parts = [
        place for part in parts if part.keys() & {"host", "channel"} for place in places(part)
    ]
    host, port, channel = (options.get(key) for key in ("host", "port", "channel"))
    if host is not None:
        named = [each for key, each in options.items() if key.endswith("_port")]
        ports = named if port is None and named else [port]
        return [place for each in ports for place in _network(str(host), each)] + of_parts
    if channel is not None:
        return _channel(str(channel)) + of_parts
    return of_parts or [json.dumps(dict(options), sort_keys=True, default=str)]


def _channel(channel: str) -> list[str]:
    if "://" in channel:
        try:
            url = urlsplit(channel)
            return _network(url.hostname or "", url.port)
        except ValueError:  # impossible port: the driver refuses it
            return [channel]
    port = channel.partition("@")[0]  # of a serial port, as python-can writes its baud rate
    if port.startswith("/"):
        return [str(Path(port).resolve())]
    return [port.upper() if port.upper().startswith("COM") else port]


def _network(host: str, port: object) -> list[str]:
    """Return the addresses of a host; all of this machine's own are one."""
    found = _resolved(host.rstrip(".")) if _number(host) is None else {host}
    return sorted({f"{THIS_MACHINE if _is_ours(each) else each}:{port}" for each in found})


def _number(address: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    with suppress(ValueError):
        return ipaddress.ip_address(address)
    return None


def _resolved(host: str) -> set[str]:
    found: set[str] = set()

    def ask() -> None:
        try:
            answers = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
        except OSError:  # the driver reports it when it connects
            return
        found.update(str(answer[4][0]) for answer in answers)

    asking = threading.Thread(target=ask, name="resolve", daemon=True)
    asking.start()
    asking.join(RESOLVE_S)
    return set(found) or {host.casefold()}


def _is_ours(address: str) -> bool:
    """Whether an address is one of this machine's: a socket can be bound to it."""
    number = _number(address)
    if number is None:
        return False
    if isinstance(number, ipaddress.IPv6Address) and number.ipv4_mapped is not None:
        number = number.ipv4_mapped
    if number.is_loopback or number.is_unspecified:
        return True
    family = socket.AF_INET if number.version == 4 else socket.AF_INET6
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind((str(number), 0))
    except OSError:
        return False
    return True
