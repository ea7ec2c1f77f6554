"""The text API of a Mecademic robot: commands out, ``[code][text]`` in, each ended by NUL.

The controller has one connection for control, TCP 10000. Motion commands are queued and not
answered; whether one has ended says a checkpoint behind it. `SyncCmdQueue` is answered with its
number, so that a late answer is known by the number before it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from drivers.device_errors import ROBOT
from drivers.supervision import Deadline
from drivers.wires import TcpLink, TextLines
from hilcell.ports import Array
from hilcell.sanitize import clean

ANSWER_S = 2.0
CONNECTED, SYNCHRONISED, CHECKPOINT, EMERGENCY_STOP = 3000, 2097, 3030, 3070
ERRORS = range(1000, 2000)
BEYOND_REACH = {1007: "HC-B20", 1016: "HC-B20"}  # joint over its limit, target out of reach
_MESSAGE = re.compile(r"\[(\d{4})\]\[(.*)\]", re.ASCII)


class Message(NamedTuple):
    """A message of the controller."""

    code: int
    text: str


class Wire:
    """The control connection. One thread asks; any thread may send."""

    def __init__(self, host: str, port: int, check: Callable[[], None]) -> None:
        """Connect; raises `DeviceError`. ``check`` runs in every wait."""
        self._link = TcpLink(ROBOT, host, port, check)
        self._lines = TextLines(self._link, end=b"\0", split=rb"\0")
        self._number = 0
        self.address = self._link.address
        self.checkpoint = 0  # that was reached last
        self.emergency_stop = False
        try:
            self._greet()
        except BaseException:
            self.close()
            raise

    def send(self, *commands: str) -> None:
        """Send commands and wait for nothing; any thread."""
        self._lines.send("\0".join(commands), commands[-1])

    def ask(self, command: str, code: int) -> str:
        """Return the text of the message ``code`` that answers a command; raises `DeviceError`."""
        self._number += 1
        self.send(f"SyncCmdQueue({self._number})", command)
        deadline, ours = Deadline(ANSWER_S), False
        while (message := self._next(deadline)) is not None:
            if message.code == SYNCHRONISED:
                ours = message.text == str(self._number)
            elif ours and message.code == code:
                return message.text
            else:
                self._note(message)
        raise self._link.broken(command, f"no answer [{code}] within {ANSWER_S:.0f} s")

    def numbers(self, command: str, code: int, count: int) -> Array:
        """Return the numbers (count,) that answer a command; raises `DeviceError`."""
        text = self.ask(command, code)
        try:
            found = np.array([float(word) for word in text.split(",")])
        except ValueError:
            found = np.array([])
        if found.shape != (count,) or not bool(np.all(np.isfinite(found))):
            raise ROBOT.failed("HC-B26", command, repr(text), expected=f"{count} finite numbers")
        return found

    def close(self) -> None:
        """Close the connection; a robot that moves stops."""
        self._link.close()

    def _greet(self) -> None:
        greeting = self._next(Deadline(ANSWER_S))
        if greeting is None:
            raise self._link.broken("connect", f"no greeting within {ANSWER_S:.0f} s")
        if greeting.code != CONNECTED:
            raise ROBOT.refused(
                "MX-B04",
                "connect",
                f"[{greeting.code}] {greeting.text}",
                expected=f"[{CONNECTED}]",
                act="end the other program that controls the robot",
            )

    def _next(self, deadline: Deadline) -> Message | None:
        line = self._lines.receive(deadline)
        if line is None:
            return None
        match = _MESSAGE.fullmatch(line)
        if match is None:
            raise self._link.broken("receive", f"no message: {clean(line[:80])!r}")
        return Message(int(match[1]), clean(match[2]))

    def _note(self, message: Message) -> None:
        """Take what nobody has asked for; raises `DeviceError` for an error."""
        if message.code == CHECKPOINT and message.text.isdecimal():
            self.checkpoint = int(message.text)
        elif message.code == EMERGENCY_STOP:
            self.emergency_stop = message.text == "1"
        elif message.code in ERRORS:
            raise ROBOT.failed(
                BEYOND_REACH.get(message.code, "MX-B03"),
                "move",
                f"[{message.code}] {message.text}",
                act="see the MecaPortal, reset the error, resume",
                error=message.code,
            )
