"""The wire of a driver that exchanges bytes: a TCP connection or a serial line, used alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from drivers.supervision import Patience
from drivers.wires.serial_link import SerialLink
from drivers.wires.tcp import Alarms, TcpLink
from hilcell.ports import DeviceError
from hilcell.wire.channel import Socket, parse_channel


class Link(Protocol):
    """An open wire. One thread receives; any thread may send."""

    address: str

    def send(self, data: bytes, operation: str) -> None:
        """Send all of ``data``; raises `DeviceError` when it does not leave in time."""

    def receive(self, size: int, patience: Patience) -> bytes:
        """Return 1 to ``size`` bytes, or none when ``patience`` is over; raises `DeviceError`."""

    def broken(self, operation: str, found: str) -> DeviceError:
        """Return the error that this wire's failure is."""

    def close(self) -> None:
        """Close the wire; a second close does nothing."""


def open_link(device: str, channel: str, check: Callable[[], None], alarms: Alarms) -> Link:
    """Open ``socket://HOST:PORT`` or ``PATH[@BAUD]``; raises `DeviceError`."""
    place = parse_channel(channel)
    if isinstance(place, Socket):
        return TcpLink(device, place.host, place.port, check, alarms)
    return SerialLink(device, place, check, alarms)
