"""A serial-line CAN gateway (slcan) that survives bad lines and a PC that is busy.

python-can's own class loses its receiver to one byte >= 0x80 or one malformed line, takes a
truncated frame for a short one, and calls a write that was late, but complete, an error. A stop
must get out while another thread waits for the port. So no thread holds a lock while it waits:
lines stand in one queue, and the thread that finds the port ready sends.
"""

from __future__ import annotations

import os
import re
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Literal

import can
import serial

from drivers.on_failure import on_failure
from hilcell.wire.channel import Socket, parse_channel

Interface = Literal["slcan", "socketcan"]

BIT_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
_KERNEL_NAME = re.compile(r"[^\s/:]{1,15}")  # of a network interface


def bus_problems(interface: Interface, channel: str, bitrate: int) -> Iterator[str]:
    """Return why there can be no such bus. The kernel's own interfaces have their bit rate."""
    if interface == "socketcan":
        if not _KERNEL_NAME.fullmatch(channel):
            yield f"channel: the kernel's name of a CAN interface is wanted, found {channel!r}"
        return
    try:
        parse_channel(channel)
    except ValueError as error:
        yield str(error)
    if bitrate not in BIT_RATES:
        allowed = ", ".join(map(str, BIT_RATES))
        yield f"bitrate: a bit rate of slcan is wanted, found {bitrate}; allowed: {allowed}"


CONNECT_S = 5.0
SEND_S = 0.2  # of a port that takes nothing; time in which this PC did nothing does not count
LONGEST_LINE = 64
# CR ends a line, BELL refuses one; some gateways send CR LF.
_END = re.compile(rb"[\r\n\a]")
# Data (t, T) and remote frames (r, R), an optional time stamp of the gateway behind them.
_FRAME = re.compile(
    rb"(?:([tr])([0-9A-Fa-f]{3})|([TR])([0-9A-Fa-f]{8}))([0-8])((?:[0-9A-Fa-f]{2})*)"
)
_ANSWERS = (b"", b"z", b"Z")  # acknowledgements; many gateways send none


class SlcanBus(can.BusABC):
    """An slcan bus; counts the lines that were bad and the frames that the gateway refused."""

    def __init__(self, channel: str, bitrate: int) -> None:
        self._is_shutdown = True  # there is no port yet
        self.bad_lines = 0
        self.refused = 0
        self._bytes = b""
        self._unsent = b""
        self._taken = 0  # bytes that the port has taken
        self._writing = threading.Lock()  # never held while waiting
        if bitrate not in BIT_RATES:
            raise ValueError(f"bit rate {bitrate}, slcan has {', '.join(map(str, BIT_RATES))}")
        opening = (b"", b"C", b"S%d" % BIT_RATES.index(bitrate), b"O")
        self._commands = len(opening)  # not answered yet: one may be refused and all is well
        self._port, self._close_port = _open(channel)
        with on_failure(self._close_port):
            os.set_blocking(self._port, False)
            self._put(b"".join(line + b"\r" for line in opening))
        super().__init__(channel)
        self._is_shutdown = False

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline_s = time.monotonic() + (timeout or 0.0)
        while True:
            while (line := self._line()) is not None:
                if (message := self._message(line)) is not None:
                    return message, False
            left_s = max(0.0, deadline_s - time.monotonic())
            if not self._fill(left_s) and not left_s:
                return None, False

    def _fill(self, timeout_s: float) -> bool:
        try:
            ready, _, _ = select.select([self._port], [], [], timeout_s)
            data = os.read(self._port, 4096) if ready else b""
        except (OSError, ValueError) as error:
            raise can.CanOperationError(f"the gateway's port failed: {error}") from error
        if ready and not data:
            raise can.CanOperationError("the gateway closed the connection")
        self._bytes += data
        return bool(data)

    def _line(self) -> bytes | None:
        """Return the next whole line; a line that never ends is dropped."""
        end = _END.search(self._bytes)
        if end is None:
            if len(self._bytes) > LONGEST_LINE:
                self.bad_lines += 1
                self._bytes = b""
            return None
        line, self._bytes = self._bytes[: end.start()], self._bytes[end.end() :]
        answer = line in _ANSWERS
        if end.group() == b"\a" and not self._commands:
            self.refused += 1
        self._commands = max(0, self._commands - 1) if answer else 0
        return line

    def _message(self, line: bytes) -> can.Message | None:
        if line in _ANSWERS:
            return None
        match = _FRAME.fullmatch(line)
        if match is None:
            self.bad_lines += 1
            return None
        kind, number = match[1] or match[3], match[2] or match[4]
        remote, size = kind in b"rR", int(match[5])
        carried = 0 if remote else 2 * size
        if len(match[6]) not in (carried, carried + 4):
            self.bad_lines += 1
            return None
        return can.Message(
            arbitration_id=int(number, 16),
            is_extended_id=kind in b"TR",
            is_remote_frame=remote,
            dlc=size,
            timestamp=time.time(),
            data=None if remote else bytes.fromhex(match[6][:carried].decode()),
        )

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame with an 11-bit identifier; raises `can.CanOperationError`.

        A port that takes nothing for `SEND_S` (or ``timeout``) is an error, not a wait.
        """
        line = f"t{msg.arbitration_id:03X}{msg.dlc}{bytes(msg.data).hex().upper()}\r"
        self._put(line.encode(), SEND_S if timeout is None else timeout)

    def _put(self, line: bytes, patience_s: float = SEND_S) -> None:
        """Send ``line`` behind other threads' lines; return when the port has taken it."""
        with self._writing:
            self._unsent += line
            mine = self._taken + len(self._unsent)
            self._push()
        while self._taken < mine:
            # The kernel looks at the port again when the time is over, however late this thread is.
            if not select.select([], [self._port], [], patience_s)[1]:
                raise can.CanOperationError(f"the gateway takes no bytes for {patience_s:.1f} s")
            with self._writing:
                self._push()

    def _push(self) -> None:
        """Hand the port as many bytes as it takes at once."""
        try:
            taken = os.write(self._port, self._unsent) if self._unsent else 0
        except BlockingIOError:
            return
        except OSError as error:
            raise can.CanOperationError(f"the gateway's port failed: {error}") from error
        self._unsent = self._unsent[taken:]
        self._taken += taken

    def shutdown(self) -> None:
        """Close the channel and the port, also when the far side is gone."""
        if self._is_shutdown:
            return
        super().shutdown()
        try:
            self._put(b"C\r")
        finally:
            self._close_port()


def _open(channel: str) -> tuple[int, Callable[[], Any]]:
    """Open a channel; return its file and its end."""
    place = parse_channel(channel)
    if isinstance(place, Socket):
        link = socket.create_connection((place.host, place.port), CONNECT_S)
        # A frame must not wait for the acknowledgement of the one before.
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return link.fileno(), link.close
    # Alone: a second program would take half of the lines.
    port = serial.Serial(place.path, place.baud, timeout=0, exclusive=True)
    return port.fileno(), port.close
