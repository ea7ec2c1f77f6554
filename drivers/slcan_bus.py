"""A serial-line CAN gateway (slcan) that survives bad lines: they are dropped and counted.

python-can's own class loses its receiver to one byte >= 0x80 or one malformed line, takes a
truncated frame for a short one, and leaks its socket when the far side is gone at shutdown.
"""

from __future__ import annotations

import os
import re
import select
import socket
import time
from contextlib import suppress

import can
from can.interfaces.slcan import slcanBus

SEND_S = 0.2
LONGEST_LINE = 64
_END = re.compile(rb"[\r\a]")
# Standard data frame, an optional time stamp of the gateway behind it.
_FRAME = re.compile(rb"t([0-9A-Fa-f]{3})([0-8])((?:[0-9A-Fa-f]{2})*)")
_ANSWERS = (b"", b"z", b"Z")  # acknowledgements


class SlcanBus(slcanBus):
    """An slcan bus; counts the lines that were bad and the commands that the gateway refused."""

    def __init__(self, channel: str, bitrate: int) -> None:
        self.bad_lines = 0
        self.refused = 0
        self._bytes = b""
        try:
            super().__init__(channel, bitrate=bitrate, sleep_after_open=0)
        except (can.CanError, OSError, ValueError):
            self._close_port(self._link())
            raise
        self._fd: int = self.serialPortOrig.fileno()
        # A frame must not wait for the acknowledgement of the one before; a real serial port
        # knows no such delay and refuses.
        with suppress(OSError), socket.socket(fileno=os.dup(self._fd)) as link:
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

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
            ready, _, _ = select.select([self._fd], [], [], timeout_s)
            data = os.read(self._fd, 4096) if ready else b""
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
        self.refused += end.group() == b"\a"
        return line

    def _message(self, line: bytes) -> can.Message | None:
        if line in _ANSWERS:
            return None
        match = _FRAME.fullmatch(line)
        size = int(match[2]) if match else 0
        if match is None or len(match[3]) not in (2 * size, 2 * size + 4):
            self.bad_lines += 1
            return None
        return can.Message(
            arbitration_id=int(match[1], 16),
            is_extended_id=False,
            timestamp=time.time(),
            data=bytes.fromhex(match[3][: 2 * size].decode()),
        )

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; a gateway that takes no bytes for `SEND_S` is an error, not a wait."""
        super().send(msg, SEND_S if timeout is None else timeout)

    def shutdown(self) -> None:
        """Close the channel and the port, also when the far side is gone."""
        link = self._link()
        try:
            super().shutdown()
        finally:
            self._close_port(link)

    def _link(self) -> socket.socket | None:
        """Return the socket under the port: pyserial leaks it when the far side is gone first."""
        return getattr(getattr(self, "serialPortOrig", None), "_socket", None)

    def _close_port(self, link: socket.socket | None) -> None:
        if hasattr(self, "serialPortOrig"):
            self.serialPortOrig.close()
        if link is not None:
            link.close()
