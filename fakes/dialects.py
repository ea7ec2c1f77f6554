"""The messages of a wire: their ends, and the parts of them that only number an exchange.

A dialect splits the bytes that a driver has sent into messages, and names each: messages of one
name ask the same. ``answer`` puts the number of a new question in the place of the recorded one's.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

_GEOCOM = re.compile(rb"(%R1[QP],\d+,)(\d+)(:)")
_HEARTBEAT = re.compile(rb"t7[0-7][0-9A-F]")


@dataclass(frozen=True, slots=True)
class Dialect:
    """Lines by default: each ends with CR or LF."""

    def split(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Return the whole messages, and the rest."""
        *whole, rest = re.split(rb"(?<=[\r\n])", data) if data else [b""]
        return [line for line in whole if line.strip()], rest

    def name(self, message: bytes) -> bytes:
        """Return what a message asks."""
        return message

    def unheard(self, message: bytes) -> bool:
        """Whether a message has no part in any exchange."""
        return False

    def belongs(self, answer: bytes, asked: bytes) -> bool:
        """Whether a message may be an answer to a question."""
        return True

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        """Return the recorded answer as one to this question."""
        return answer


class Slcan(Dialect):
    """CAN frames as lines; a heartbeat asks nothing."""

    def unheard(self, message: bytes) -> bool:
        """Whether it is a heartbeat."""
        return _HEARTBEAT.match(message) is not None


class GeoCom(Dialect):
    """Lines with the number of a transaction."""

    def name(self, message: bytes) -> bytes:
        """Return the line without its number."""
        return _GEOCOM.sub(rb"\1\3", message)

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        """Return the answer with the number of this question."""
        number = _GEOCOM.search(asked)
        return answer if number is None else _GEOCOM.sub(rb"\g<1>" + number[2] + rb"\3", answer)


@dataclass(frozen=True, slots=True)
class Sized(Dialect):
    """Binary messages that state their size at ``at``; ``more`` bytes are not counted in it."""

    layout: str
    at: int
    more: int

    def split(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Return the whole messages, and the rest."""
        messages = []
        head = self.at + struct.calcsize(self.layout)
        while len(data) >= head:
            size = struct.unpack_from(self.layout, data, self.at)[0] + self.more
            if not head <= size <= len(data):
                break
            messages.append(data[:size])
            data = data[size:]
        return messages, data


class C3(Sized):
    """C3 Bridge: the first two bytes number the exchange."""

    def name(self, message: bytes) -> bytes:
        """Return the request without its tag."""
        return message[2:]

    def belongs(self, answer: bytes, asked: bytes) -> bool:
        """Whether both have one tag: a stop's reply is awaited by nobody and comes when it may."""
        return answer[:2] == asked[:2]

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        """Return the reply with the tag of this request."""
        return asked[:2] + answer[2:]


DIALECTS: dict[str, Dialect] = {
    "canopen": Slcan(),
    "kuka-c3": C3(">H", 2, 4),
    "leica-emscon": Sized("<I", 0, 0),
    "leica-geocom": GeoCom(),
}
