"""The wire of a driver that exchanges bytes: a TCP connection or a serial line, used alike.

A serial line is opened for this program alone: a second one would take half of the answers. One
that is pulled out mid-byte is lost; bytes of before it was opened are nobody's answer, and dropped.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable

import serial

from drivers.device_errors import Device
from drivers.wires.tcp import POLL_S, SEND_S, Link, TcpLink
from hilcell.ports import DeviceError
from hilcell.wire.channel import SerialLine, Socket, parse_channel


class SerialLink(Link):
    """An open serial line."""

    def __init__(self, device: Device, line: SerialLine, check: Callable[[], None]) -> None:
        super().__init__(device, line.path, check)
        try:
            self._port = serial.Serial(
                line.path, line.baud, timeout=POLL_S, write_timeout=SEND_S, exclusive=True
            )
            self._port.reset_input_buffer()
        except (serial.SerialException, OSError, ValueError) as error:
            found = f"{line.path} at {line.baud} baud: {system_words(error)}"
            act = (
                "check the cable, the path (/dev/serial/by-id keeps its name), the right to open "
                "it, and that no other program has it"
            )
            raise device.failed(
                device.unreachable, "connect", found, act=act, address=line.path, baud=line.baud
            ) from error

    def send(self, data: bytes, operation: str) -> None:
        try:
            self._port.write(data)
        except (serial.SerialException, OSError, TypeError) as error:
            raise self._gone(operation, error) from error

    def _come(self, size: int, *, wait: bool) -> bytes:
        """Wait as long as the port does, whose settings each other wait would write again."""
        try:
            first = self._port.read(1)
            return first + self._port.read(min(self._port.in_waiting, size - 1)) if first else b""
        except (serial.SerialException, OSError, TypeError) as error:
            raise self._gone("receive", error) from error

    def _gone(self, operation: str, error: Exception) -> DeviceError:
        found = f"the line failed: {system_words(error)}"
        return self.broken(operation, f"{found}; was its cable pulled, or its path renamed?")

    def close(self) -> None:
        self._port.close()


def system_words(error: Exception) -> str:
    """Return the system's words alone: pyserial repeats the path and the error's number."""
    numbers = [getattr(each, "errno", None) for each in (error, error.__context__)]
    number = next(filter(None, numbers), None)
    if number == errno.EAGAIN:
        return "another program has it"
    return str(error) if number is None else os.strerror(number)


def open_link(device: Device, channel: str, check: Callable[[], None]) -> Link:
    """Open ``socket://HOST:PORT`` or ``PATH[@BAUD]``; raises `DeviceError`."""
    place = parse_channel(channel)
    if isinstance(place, Socket):
        return TcpLink(device, place.host, place.port, check)
    return SerialLink(device, place, check)
