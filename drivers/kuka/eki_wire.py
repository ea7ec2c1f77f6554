"""One EthernetKRL channel: a command, and the answer with its Id.

An answer to an earlier command may come late, or before the one that is awaited: it is never used.
The controller serves one client a channel and opens it again a moment after a client has gone, so
connecting is tried for a while.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from drivers.kuka import eki
from drivers.supervision import Patience
from drivers.wires.tcp import POLL_S, Alarms, TcpLink
from hilcell.ports import DeviceError

ANSWER_S = 2.0
OPEN_S = 3.0  # the channel of a client that has gone is open again
AGAIN = 5  # times POLL_S from one try to the next
RECEIVE = 4096
ALARMS = Alarms(unreachable="HC-B01", lost="HC-B02")


class EkiChannel:
    """One connection, one command in flight; a lock lets a keep-alive share it."""

    def __init__(
        self, device: str, host: str, port: int, root: str, attend: Callable[[], None]
    ) -> None:
        """``root`` is that of the answers; ``attend`` runs in every wait."""
        self.attend = attend
        self._device, self._root = device, root
        self._link = TcpLink(device, host, port, self._attend, ALARMS)
        self._lock = threading.Lock()
        self._received = b""
        self._dead = ""
        self.used_s = time.monotonic()

    def ask(self, number: int, document: bytes) -> eki.State:
        """Send a command and return its answer; raises `DeviceError`."""
        operation = f"motion {number}" if number > 0 else "command"
        with self._lock:
            if self._dead:
                raise self._link.broken(operation, self._dead)
            self._link.send(document, operation)
            state = self._answer(number, operation)
            self.used_s = time.monotonic()
        return state

    def send_unheard(self, document: bytes, patience_s: float = 0.05) -> None:
        """Send without waiting for the answer; a command in flight may end first."""
        held = self._lock.acquire(timeout=patience_s)
        try:
            self._link.send(document, "stop")
        finally:
            if held:
                self._lock.release()

    def close(self) -> None:
        """Close the connection."""
        self._link.close()

    def _attend(self) -> None:
        self.attend()

    def _answer(self, number: int, operation: str) -> eki.State:
        patience, others = Patience(ANSWER_S), 0
        while True:
            for found, state in self._documents(operation):
                if found == number:
                    return state
                others += 1
            piece = self._link.receive(RECEIVE, patience)
            if not piece:
                passed = f"; {others} answers to other commands came" if others else ""
                started = f"; {len(self._received)} bytes of one came" if self._received else ""
                raise self._link.broken(
                    operation, f"no answer within {ANSWER_S:.1f} s{passed}{started}"
                )
            self._received += piece

    def _documents(self, operation: str) -> list[tuple[int, eki.State]]:
        """Take the whole documents out of what was received; an unusable one ends the use."""
        try:
            whole, self._received = eki.split(self._received, self._root)
            return [eki.parse(document, self._root) for document in whole]
        except eki.EkiError as error:
            self._dead = str(error)
            raise DeviceError(
                "HC-B49",
                self._device,
                operation,
                f"{self._link.address}: {error}",
                wanted=f"a document <{self._root}>",
                act="is this the port of hilcell's channel? see docs/hardware.md",
                fields={"address": self._link.address},
            ) from error


def open_channel(
    device: str, host: str, port: int, root: str, attend: Callable[[], None], probe: bytes
) -> EkiChannel:
    """Return a channel that has answered ``probe``, of Id 0; raises `DeviceError`."""
    patience, over = Patience(OPEN_S, OPEN_S), False
    while True:
        channel = None
        try:
            channel = EkiChannel(device, host, port, root, attend)
            channel.ask(0, probe)
        except BaseException as error:
            if channel is not None:
                channel.close()
            if over or not isinstance(error, DeviceError):
                raise
        else:
            return channel
        over = patience.over()
        for _ in range(AGAIN):
            attend()
            time.sleep(POLL_S)
