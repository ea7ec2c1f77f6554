"""Messages of a wire: their ends, and the parts that only number an exchange.

A dialect splits the bytes of both directions into messages, and names those of the driver: messages
of one name ask the same. ``answer`` replaces the recorded number by that of a new question. Entry
points ``hilcell.wire_dialects``, by driver: a function of the cell file's options that returns
dialects by the names of the wires. A wire of plain lines needs none.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any

from hilcell.cell.devices import load_entry

Options = Mapping[str, Any]
NONE: Options = MappingProxyType({})


class Dialect:
    """Lines: each ends with CR or LF."""

    flows = False  # whether answers come by themselves, at a rate
    LINE_END = re.compile(rb"(?<=\n)|(?<=\r)(?!\n)")

    def split(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Return the whole messages, and the rest."""
        *whole, rest = self.LINE_END.split(data)
        return whole, rest

    def split_questions(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Do the same with those of the driver."""
        return self.split(data)

    def name(self, message: bytes) -> bytes:
        """Return what a message asks."""
        return message.strip()

    def unheard(self, message: bytes) -> bool:
        """Whether a message has no part in any exchange."""
        return not message.strip()

    def passed(self, message: bytes) -> None:
        """Take note of a message that has no part in any exchange."""

    def is_command(self, message: bytes) -> bool:
        """Whether a message commands something, and is never a poll."""
        return False

    def belongs(self, answer: bytes, asked: bytes) -> bool:
        """Whether a message may be an answer to a question."""
        return True

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        """Return the recorded answer as one to this question."""
        return answer

    def heard(self, asked: bytes, recorded: bytes) -> None:
        """Take note of a question that was asked in the place of the recorded one."""

    def is_sample(self, answer: bytes) -> bool:
        """Whether an answer is one of many that come when their time has come, unasked."""
        return False

    def beat(self, answer: bytes) -> bytes:
        """Return whose sign of life an answer is; b"" for any other one."""
        return b""

    def alive(self, asked: bytes) -> list[bytes]:
        """Answers to a driver's heartbeat that was never recorded, as a short motion may have none.
        None for any other message.
        """
        return []

    def repeats(self, answer: bytes) -> bool:
        """Whether an answer comes by itself again and again, until there is a next one."""
        return False

    def works(self, asked: bytes, answer: bytes) -> bool:
        """Whether a device is at work on what was asked, by an answer that comes by itself.

        The driver then waits, so such answers go on whatever was asked elsewhere meanwhile.
        """
        return False


class Slcan(Dialect):
    """CAN frames as lines; a heartbeat asks nothing."""

    HEARTBEAT = re.compile(rb"t7[0-7][0-9A-F]")

    def unheard(self, message: bytes) -> bool:
        return self.HEARTBEAT.match(message) is not None or super().unheard(message)

    def is_command(self, message: bytes) -> bool:
        """Whether it carries what a node is to do (an RPDO)."""
        return message[:1] == b"t" and message[1:2] in b"2345"

    def beat(self, answer: bytes) -> bytes:
        found = self.HEARTBEAT.match(answer)
        boot_up = b"100"  # behind a node's identifier: it has begun, once
        return b"" if found is None or answer.strip()[4:] == boot_up else found[0]


class GeoCom(Dialect):
    """Lines with the number of a transaction."""

    GEOCOM = re.compile(rb"(%R1[QP],\d+,)(\d+)(:)")

    def name(self, message: bytes) -> bytes:
        """Return the line without its number."""
        return self.GEOCOM.sub(rb"\1\3", message.strip())

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        number = self.GEOCOM.search(asked)
        return answer if number is None else self.GEOCOM.sub(rb"\g<1>" + number[2] + rb"\3", answer)


class StripLine(Dialect):
    """Commands of one letter, with a figure after A, and without an end; answers are lines."""

    STRIP = re.compile(rb"[Aa][0-9]|[^Aa]")

    def split_questions(self, data: bytes) -> tuple[list[bytes], bytes]:
        commands = self.STRIP.findall(data)
        return commands, data[sum(map(len, commands)) :]


class Sized(Dialect):
    """Binary messages that state their size."""

    def __init__(self, layout: str, at: int, more: int) -> None:
        """The size is at byte ``at``, in ``layout``; ``more`` bytes are not counted in it."""
        self._layout, self._at, self._more = struct.Struct(layout), at, more

    def split(self, data: bytes) -> tuple[list[bytes], bytes]:
        messages = []
        head = self._at + self._layout.size
        while len(data) >= head:
            size = self._layout.unpack_from(data, self._at)[0] + self._more
            if not head <= size <= len(data):
                break
            messages.append(data[:size])
            data = data[size:]
        return messages, data

    def name(self, message: bytes) -> bytes:
        return message

    def unheard(self, message: bytes) -> bool:
        """Whether it has no part in any exchange: each has."""
        return False


class C3(Sized):
    """C3 Bridge: the first two bytes number the exchange."""

    def name(self, message: bytes) -> bytes:
        """Return the request without its tag."""
        return message[2:]

    def belongs(self, answer: bytes, asked: bytes) -> bool:
        """Whether both have one tag: a stop's reply is not awaited and comes at any time."""
        return answer[:2] == asked[:2]

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        return asked[:2] + answer[2:]

    def alive(self, asked: bytes) -> list[bytes]:
        """Return the reply to a write of the timer that ends an unsupervised motion."""
        write, life, written = b"\1", b"$TIMER[10]", b"\0\1\1"  # C3 Bridge
        if asked[4:5] != write or life not in asked:
            return []
        value = asked.partition(life)[2]  # with its length
        rest = write + value + written
        return [asked[:2] + struct.pack(">H", len(rest)) + rest]


class Emscon(Sized):
    """emScon: a stream's packets are of type 3; some commands carry a place."""

    def name(self, message: bytes) -> bytes:
        numbers_of = {55: 3, 63: 1, 135: 3}  # of doubles behind these commands
        command, count = message[8:12], numbers_of.get(message[8], 0)
        if len(message) < 12 + 8 * count or not count:
            return message
        numbers = struct.unpack_from(f"<{count}d", message, 12)
        return command + " ".join(f"{each:.9f}" for each in numbers).encode()

    def is_sample(self, answer: bytes) -> bool:
        return answer[4:8] == b"\3\0\0\0"


def dialects_of(driver: str, options: Options = NONE) -> Mapping[str, Dialect]:
    """Return the dialects of a driver's wires that are no plain lines, by their names."""
    group = "wire_dialects"
    if driver not in entry_points(group=f"hilcell.{group}").names:
        return {}
    found: Mapping[str, Dialect] = load_entry(group, driver)(options)
    return found


def canopen(options: Options) -> dict[str, Dialect]:
    return {"": Slcan(), "strip": _strip(options)}


def kuka_e1(options: Options) -> dict[str, Dialect]:
    """Return the dialect of a rail's strip; its drive is reached over the robot's wire."""
    return {"strip": _strip(options)}


def kuka_c3(_options: Options) -> dict[str, Dialect]:
    return {"": C3(">H", 2, 4)}


def leica_emscon(_options: Options) -> dict[str, Dialect]:
    return {"": Emscon("<I", 0, 0)}


def leica_geocom(_options: Options) -> dict[str, Dialect]:
    return {"": GeoCom()}


def _strip(options: Options) -> Dialect:
    return Slcan() if options.get("strip", NONE).get("driver") == "canopen" else StripLine()
