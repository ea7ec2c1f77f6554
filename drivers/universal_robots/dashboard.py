"""The dashboard server of Universal Robots: one line asks, one line answers.

It greets each connection with a line. It moves nothing; ``stop`` ends the running program, and the
robot brakes.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.device_errors import ROBOT
from drivers.supervision import Deadline, on_failure
from drivers.wires import TcpLink, TextLines
from hilcell.ports import DeviceError
from hilcell.sanitize import clean

ANSWER_S = 3.0


class Dashboard:
    """One connection; ``ask`` from one thread, ``send`` from any."""

    GREETING = "Connected: Universal Robots Dashboard Server"

    def __init__(self, host: str, port: int, check: Callable[[], None]) -> None:
        try:
            self._link = TcpLink(ROBOT, host, port, check)
        except DeviceError as error:
            if isinstance(error.__cause__, ConnectionRefusedError):  # the controller itself answers
                error.act = (
                    "wait until PolyScope runs; allow the dashboard server in its security "
                    "settings, and compare dashboard_port. Not supported: PolyScope X, which has "
                    "no dashboard server"
                )
            raise
        self._lines = TextLines(self._link, end=b"\n")
        with on_failure(self._link.close):
            greeting = self._lines.receive(Deadline(ANSWER_S))
            found = f"no answer within {ANSWER_S:.0f} s" if greeting is None else clean(greeting)
            if not found.startswith(self.GREETING):
                raise self._link.broken(
                    "connect", f"{found}; is dashboard_port that of the dashboard server?"
                )

    def ask(self, command: str) -> str:
        """Return the answer to a command; raises `DeviceError`."""
        self._lines.send(command, command)
        line = self._lines.receive(Deadline(ANSWER_S))
        if line is None:
            raise self._link.broken(command, f"no answer within {ANSWER_S:.0f} s")
        return clean(line)

    def answer_to(self, question: str) -> str | None:
        """Return the answer to a question, None where this PolyScope does not have the question."""
        answer = self.ask(question)
        return None if answer.casefold().startswith("could not understand") else answer

    def send(self, command: str) -> None:
        """Send a command without waiting for its answer."""
        self._link.reply_pending = True
        self._lines.send(command, command)

    def last_answer(self, deadline: Deadline) -> str | None:
        """Return the last answer that has come to what was sent, None where none has."""
        line = self._lines.receive(deadline)
        while (newer := self._lines.receive(Deadline(0.0))) is not None:
            line = newer
        return None if line is None else clean(line)

    def is_open(self) -> bool:
        """Whether the controller has not closed the connection meanwhile, as of one that idles."""
        try:
            self._lines.drop_pending()
        except DeviceError:
            return False
        return True

    def close(self) -> None:
        self._link.close()
