"""The simulated cell of a run in threads of the test, in place of a process of its own."""

from __future__ import annotations

import tempfile
import threading
from typing import IO, Any

import msgspec

from fakes.host import Host, Order
from hilcell.errors import HilcellError


class HostThread:
    """Satisfies what `fakes.simulator` uses of a process."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._thread = threading.Thread(target=host.run, name="simulated cell")
        self._thread.start()

    def communicate(self, timeout: float | None = None) -> None:
        """End the cell, whatever the time."""
        self._host.end()
        self._thread.join()


def start_here(order: bytes) -> tuple[HostThread, IO[bytes], dict[str, Any]]:
    """Start the cell; return it, its words, of which there are none, and where it listens."""
    try:
        host = Host(msgspec.json.decode(order, type=Order))
    except (msgspec.DecodeError, HilcellError) as error:
        raise HilcellError(f"simulated cell did not start (exit 2):\n{error}") from error
    return HostThread(host), tempfile.TemporaryFile(), host.addresses()
