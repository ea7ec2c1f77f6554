"""A serial device's end of a line, which a pseudo terminal stands for; it has no connections.

Bytes that nobody takes are lost, as on any UART; the line stays when its user goes.
"""

from __future__ import annotations

import os
import pty
import select
import tty


class SerialEnd:
    """Used like a client's socket, by one thread."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.path = os.ttyname(self._theirs)
        self._open = True

    def fileno(self) -> int:
        """Return the descriptor to wait for."""
        return self._ours

    def recv(self, size: int, /) -> bytes:
        """Return bytes that have come."""
        return os.read(self._ours, size)

    def sendall(self, data: bytes, /) -> None:
        """Send bytes; those that the line does not take in time are lost."""
        while data and select.select([], [self._ours], [], self._patience_s)[1]:
            data = data[os.write(self._ours, data) :]

    def close(self) -> None:
        """Unplug the device."""
        if self._open:
            self._open = False
            os.close(self._ours)
            os.close(self._theirs)
