"""The dashboard server of Universal Robots: one line asks, one line answers.

It greets each connection with a line. It moves nothing; ``stop`` ends the running program, and the
robot brakes.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.on_failure import on_failure
from drivers.supervision import Patience
from drivers.wires.tcp import Alarms, TcpLink
from drivers.wires.text_lines import TextLines
from hilcell.clean import clean

ANSWER_S = 3.0
GREETING = "Connected: Universal Robots Dashboard Server"


class Dashboard:
    """One connection; ``ask`` from one thread, ``send`` from any."""

    def __init__(
        self, device: str, host: str, port: int, check: Callable[[], None], alarms: Alarms
    ) -> None:
        self._link = TcpLink(device, host, port, check, alarms)
        self._lines = TextLines(self._link, end=b"\n")
        with on_failure(self._link.close):
            greeting = self._lines.receive(Patience(ANSWER_S))
            if greeting is None or not greeting.startswith(GREETING):
                found = (
                    f"no answer within {ANSWER_S:.0f} s" if greeting is None else clean(greeting)
                )
                raise self._link.broken(
                    "connect", f"{found}; is dashboard_port that of the dashboard server?"
                )

    def ask(self, command: str) -> str:
        """Return the answer to a command; raises `DeviceError`."""
        self._lines.send(command, command)
        line = self._lines.receive(Patience(ANSWER_S))
        if line is None:
            raise self._link.broken(command, f"no answer within {ANSWER_S:.0f} s")
        return clean(line)

    def send(self, command: str) -> None:
        """Send a command without waiting for its answer."""
        self._link.unheard = True
        self._lines.send(command, command)

    def close(self) -> None:
        """Close the connection."""
        self._link.close()
