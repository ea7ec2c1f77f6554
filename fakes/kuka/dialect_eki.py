"""Documents of EthernetKRL: a number and a sign of life are no part of what one asks."""

from __future__ import annotations

import re
from itertools import pairwise

from fakes.replay.dialects import Dialect, Options

_ASKED = re.compile(rb'(<(?:RobotCommand|RobotStop|Command)\s+Id=")(-?\d+)(")')


class Eki(Dialect):
    """Commands with an Id, and states that repeat it; that of a motion is above 0."""

    END = re.compile(rb"</Robot\w+>")
    LIFE = re.compile(rb' Life="\d+"')

    def split(self, data: bytes) -> tuple[list[bytes], bytes]:
        ends = [0, *(found.end() for found in self.END.finditer(data))]
        return [data[a:b] for a, b in pairwise(ends)], data[ends[-1] :]

    def name(self, message: bytes) -> bytes:
        """Return the document without the Id of a question, and without its sign of life."""
        return _ASKED.sub(self._kept, self.LIFE.sub(b"", message))

    def belongs(self, answer: bytes, asked: bytes) -> bool:
        """Whether both have one Id: a state may come once more, with the next."""
        return self._id(answer) == self._id(asked)

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        """Return the state with the Id of this command, where it has the recorded one's."""
        if self._id(answer) != self._id(recorded):
            return answer
        return _ASKED.sub(rb"\g<1>" + self._id(asked) + rb"\g<3>", answer, count=1)

    @staticmethod
    def _id(message: bytes) -> bytes:
        found = _ASKED.search(message)
        return b"" if found is None else found[2]

    @staticmethod
    def _kept(found: re.Match[bytes]) -> bytes:
        return found[0] if int(found[2]) > 0 else found[1] + found[3]


def kuka_eki(_options: Options) -> dict[str, Dialect]:
    return {"": Eki(), "stop": Eki()}
