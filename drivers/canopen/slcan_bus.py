"""A serial-line CAN gateway (slcan) that survives bad lines and a busy PC.

python-can's own class loses its receiver to one byte >= 0x80 or one malformed line, takes a
truncated frame for a short one, and reports a late but complete write as an error. A stop must get
out while another thread waits for the port: lines wait in one queue, no thread holds a lock while
it waits, and a thread that finds the port ready sends them.
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

from drivers.supervision import on_failure
from hilcell.wire.channel import Socket, parse_channel

Interface = Literal["slcan", "socketcan"]

BIT_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)


def bus_problems(interface: Interface, channel: str, bitrate: int) -> Iterator[str]:
    """Return why there can be no such bus. The kernel's own interfaces have their bit rate."""
    if interface == "socketcan":
        if not re.fullmatch(r"[^\s/:]{1,15}", channel):
            yield f"channel: expected the kernel's name of a CAN interface, got {channel!r}"
        return
    try:
        parse_channel(channel)
    except ValueError as error:
        yield str(error)
    if bitrate not in BIT_RATES:
        allowed = ", ".join(map(str, BIT_RATES))
        yield f"bitrate: expected a bit rate of slcan, got {bitrate}; allowed: {allowed}"


CONNECT_S = 5.0
# Data (t, T) and remote frames (r, R), an optional time stamp of the gateway behind them. A
# line with one of 32 bits may as well be a frame whose length was garbled.
_FRAME = re.compile(
    rb"(?:([tr])([0-9A-Fa-f]{3})|([TR])([0-9A-Fa-f]{8}))([0-8])((?:[0-9A-Fa-f]{2})*)"
)


class SlcanBus(can.BusABC):
    """An slcan bus; counts bad lines and frames refused by the gateway.

    ``bad_line``: the last bad one. The constructor raises `can.CanInitializationError` where the
    gateway refuses the bit rate or to open.
    """

    SEND_S = 0.2  # of a port that takes nothing; time in which this PC did nothing does not count
    _BELL = b"\a"
    ANSWER_S = 0.3  # to a command; many gateways send none
    LONGEST_LINE = 64

    def __init__(self, channel: str, bitrate: int, *, listens: bool = False) -> None:
        """``listens``: listen only, which sends nothing and acknowledges no frame."""
        self._opens = b"L" if listens else b"O"
        self._is_shutdown = True  # there is no port yet
        self.bad_lines, self.bad_line = 0, b""
        self.refused = 0
        self._bytes = b""
        self._unsent = b""
        self._taken = 0  # bytes that the port has taken
        self._writing = threading.Lock()  # never held while waiting
        if bitrate not in BIT_RATES:
            raise ValueError(f"bit rate {bitrate}, slcan has {', '.join(map(str, BIT_RATES))}")
        self._port, self._close_port = _open(channel)
        with on_failure(self._close_port):
            os.set_blocking(self._port, False)
            self._open_channel(bitrate)
        super().__init__(channel)
        self._is_shutdown = False

    def _open_channel(self, bitrate: int) -> None:
        """Close the channel, set its bit rate and open it, each command after the other's answer.
        An answer does not name its command; a closed channel may refuse to be closed.
        """
        self._put(b"\rC\r")
        if self._taken_command() is not None:
            self._taken_command()
        for command, what in (
            (b"S%d" % BIT_RATES.index(bitrate), f"the bit rate {bitrate}"),
            (self._opens, "to open the channel"),
        ):
            self._put(command + b"\r")
            if self._taken_command(command == self._opens) is False:
                raise can.CanInitializationError(
                    f"the gateway refuses {what} (it answers BELL to {command.decode()})"
                )

    def _taken_command(self, opening: bool = False) -> bool | None:
        """Return whether the gateway takes a command; None where it does not answer."""
        for line, end in self._lines(self.ANSWER_S):
            if end == self._BELL:
                return False
            if not line:
                return True
            if opening and _FRAME.fullmatch(line):  # it is open, and there is no answer
                self._bytes = line + b"\r" + self._bytes
                break
        return None

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        for line, end in self._lines(timeout or 0.0):
            self.refused += end == self._BELL
            if (message := self._message(line)) is not None:
                return message, False
        return None, False

    def _lines(self, timeout_s: float) -> Iterator[tuple[bytes, bytes]]:
        deadline_s = time.monotonic() + timeout_s
        while True:
            while (found := self._line()) is not None:
                yield found
            left_s = max(0.0, deadline_s - time.monotonic())
            if not self._fill(left_s) and not left_s:
                return

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

    def _line(self) -> tuple[bytes, bytes] | None:
        """Return the next whole line and its end; a line that never ends is dropped."""
        self._bytes = self._bytes.lstrip(b"\n")  # of CR LF
        end = re.search(rb"[\r\n\a]", self._bytes)  # CR ends a line, BELL refuses one
        if end is None:
            if len(self._bytes) > self.LONGEST_LINE:
                self._drop(self._bytes)
                self._bytes = b""
            return None
        line, self._bytes = self._bytes[: end.start()], self._bytes[end.end() :]
        return line, end.group()

    def _drop(self, line: bytes) -> None:
        self.bad_lines += 1
        self.bad_line = line[: self.LONGEST_LINE]

    def _message(self, line: bytes) -> can.Message | None:
        if line in (b"", b"z", b"Z"):  # acknowledgements; many gateways send none
            return None
        match = _FRAME.fullmatch(line)
        if match is None:
            self._drop(line)
            return None
        kind, number = match[1] or match[3], match[2] or match[4]
        remote, size, carried = kind in b"rR", int(match[5]), _carried(match)
        if len(match[6]) not in (carried, carried + 4):  # digits of a time stamp
            self._drop(line)
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
        """Send a frame with an 11-bit identifier; raises `can.CanOperationError`. A port that takes
        nothing for `SEND_S` (or ``timeout``) is an error, not a wait.
        """
        line = f"t{msg.arbitration_id:03X}{msg.dlc}{bytes(msg.data).hex().upper()}\r"
        self._put(line.encode(), self.SEND_S if timeout is None else timeout)

    def _put(self, line: bytes, limit_s: float = SEND_S) -> None:
        """Send ``line`` behind other threads' lines; return when the port has taken it."""
        with self._writing:
            self._unsent += line
            mine = self._taken + len(self._unsent)
            self._push()
        while self._taken < mine:
            # The kernel checks the port again after the time, however late this thread is.
            try:
                _, ready, _ = select.select([], [self._port], [], limit_s)
            except (OSError, ValueError) as error:
                raise can.CanOperationError(f"the gateway's port failed: {error}") from error
            if not ready:
                raise can.CanOperationError(f"the gateway takes no bytes for {limit_s:.1f} s")
            with self._writing:
                self._push()

    def _push(self) -> None:
        try:
            taken = os.write(self._port, self._unsent) if self._unsent else 0
        except BlockingIOError:
            return
        except OSError as error:
            raise can.CanOperationError(f"the gateway's port failed: {error}") from error
        self._unsent = self._unsent[taken:]
        self._taken += taken

    def shutdown(self) -> None:
        """Close the channel and the port, also when the far side has closed."""
        if self._is_shutdown:
            return
        super().shutdown()
        try:
            self._put(b"C\r")
        finally:
            with self._writing:  # the number of a closed port may be another file's
                self._port = -1
                self._close_port()


def has_long_stamp(line: bytes) -> bool:
    """Whether a line is a frame with a time stamp of 32 bits."""
    match = _FRAME.fullmatch(line)
    return match is not None and len(match[6]) == _carried(match) + 8


def _carried(match: re.Match[bytes]) -> int:
    return 0 if (match[1] or match[3]) in b"rR" else 2 * int(match[5])


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
