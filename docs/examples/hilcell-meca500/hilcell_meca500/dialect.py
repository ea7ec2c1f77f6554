"""Messages of a recorded wire, so that a recording of this robot can be replayed as a device."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from fakes.replay.dialects import Dialect

_QUESTION = re.compile(rb"(?:SyncCmdQueue\(\d+\)\0)?[^\0]*\0")
_NUMBER = re.compile(rb"SyncCmdQueue\((\d+)\)\0")
_ECHO = re.compile(rb"\[2097\]\[\d+\]\0")


class TextApi(Dialect):
    """Each message ends with NUL; a number before a question belongs to it."""

    def split(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Return the whole answers, and the rest."""
        *whole, rest = data.split(b"\0")
        return [each + b"\0" for each in whole], rest

    def split_questions(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Return the whole questions, each with its number, and the rest."""
        found = _QUESTION.findall(data)
        if found and _NUMBER.fullmatch(found[-1]):
            found.pop()
        return found, data[sum(map(len, found)) :]

    def name(self, message: bytes) -> bytes:
        """Return the question without its number."""
        return _NUMBER.sub(b"", message)

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        """Return an answer with the number of this question."""
        number = _NUMBER.match(asked)
        echo = number and b"[2097][%b]\0" % number[1]
        return echo if echo and _ECHO.fullmatch(answer) else answer


def dialects(_options: Mapping[str, Any]) -> dict[str, Dialect]:
    """Return the dialects of the driver's wires, by their names: there is one wire."""
    return {"": TextApi()}
