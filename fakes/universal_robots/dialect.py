"""The wires of a Universal Robots controller: unsolicited states, registers, scripts.

A script carries the number of its session, new each time; the states show it, and the number of
the last request for a fresh state. A write that changes only the heartbeat commands nothing.
"""

from __future__ import annotations

import re
import struct
from itertools import pairwise

from fakes.replay.dialects import Dialect, Options, Sized

KIND, HEAD = 2, 3
DATA, OUTPUTS = 85, 79


class Rtde(Sized):
    """Packages; data packages are unsolicited."""

    flows = True
    # recipe, then sequence, command, heartbeat, stop; joints; speed
    INPUTS, QUESTION = struct.Struct("!4i6dd"), struct.Struct("!i")

    def __init__(self, sessions: dict[int, int]) -> None:
        """``sessions``: the numbers of the scripts that were sent, by those of the recording."""
        super().__init__(">H", 0, 0)
        self._sessions = sessions
        self._places_cache: dict[str, int] = {}  # of a field in a package of data
        self._time_s, self._count, self._question = 0.0, 0, 0

    def unheard(self, message: bytes) -> bool:
        """Whether it requests a fresh state: every state answers the last request."""
        return message[KIND] == DATA and len(message) == HEAD + 1 + self.QUESTION.size

    def passed(self, message: bytes) -> None:
        (self._question,) = self.QUESTION.unpack_from(message, HEAD + 1)

    def name(self, message: bytes) -> bytes:
        """Return what a write commands, with its target; other requests as they are."""
        values = message[HEAD + 1 :]
        if message[KIND] != DATA or len(values) != self.INPUTS.size:
            return message
        sequence, command, _, stop, *numbers = self.INPUTS.unpack(values)
        move = 1
        target = " ".join(f"{each:.9f}" for each in numbers[:6]) if command == move else ""
        ends = 2  # a stop that is the number of a session, or more than a brake
        return f"{sequence} {command} {min(stop, ends)} {target}".encode()

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        """Return the package with the numbers of the driver's own session; time goes on."""
        if answer[KIND] == OUTPUTS:
            self._learn(recorded, answer)
        fields = ("timestamp", "output_int_register_26", "output_int_register_27")
        echo = "input_int_register_28"
        if answer[KIND] != DATA or not self._places_cache.keys() >= {*fields, echo}:
            return answer
        found = bytearray(answer)
        time_s, number, count = (
            struct.unpack_from(form, found, self._places_cache[name])[0]
            for form, name in zip(("!d", "!i", "!i"), fields, strict=True)
        )
        least_s = 1e-6  # from one package to the next
        self._time_s = max(time_s, self._time_s + least_s)
        self._count = max(count, self._count + 1)
        session = self._sessions.get(number, number)
        struct.pack_into("!d", found, self._places_cache[fields[0]], self._time_s)
        for name, value in zip(
            (*fields[1:], echo), (session, self._count, self._question), strict=True
        ):
            struct.pack_into("!i", found, self._places_cache[name], value)
        return bytes(found)

    def repeats(self, answer: bytes) -> bool:
        return answer[KIND] == DATA

    def works(self, asked: bytes, answer: bytes) -> bool:
        """Whether the script has not acknowledged a write's number yet."""
        acknowledged = "output_int_register_24"
        values, at = asked[HEAD + 1 :], self._places_cache.get(acknowledged)
        if asked[KIND : KIND + 1] != bytes([DATA]) or len(values) != self.INPUTS.size or at is None:
            return False
        sequence, *_ = self.INPUTS.unpack(values)
        return answer[KIND] == DATA and struct.unpack_from("!i", answer, at) != (sequence,)

    def _learn(self, asked: bytes, answer: bytes) -> None:
        size = {"DOUBLE": 8, "INT32": 4, "UINT32": 4, "UINT64": 8, "BOOL": 1, "UINT8": 1}
        size |= {"VECTOR3D": 24, "VECTOR6D": 48, "VECTOR6INT32": 24, "VECTOR6UINT32": 24}
        names = asked[HEAD + 8 :].decode("ascii", "replace").split(",")
        types = answer[HEAD + 1 :].decode("ascii").split(",")
        at = HEAD + 1
        self._places_cache, self._time_s, self._count = {}, 0.0, 0
        for name, kind in zip(names, types, strict=False):
            self._places_cache[name], at = at, at + size.get(kind, 0)


class UrScript(Dialect):
    """Scripts, each up to its end; the states on this wire are not used."""

    NUMBER = re.compile(rb"write_output_integer_register\(26, (\d+)\)")
    END = b"\nend\n"

    def __init__(self, sessions: dict[int, int]) -> None:
        self._sessions = sessions

    def split(self, data: bytes) -> tuple[list[bytes], bytes]:
        """Return no messages: they are not used."""
        return [], b""

    def split_questions(self, data: bytes) -> tuple[list[bytes], bytes]:
        ends = [0]
        while (end := data.find(self.END, ends[-1])) >= 0:
            ends.append(end + len(self.END))
        return [data[a:b] for a, b in pairwise(ends)], data[ends[-1] :]

    def name(self, message: bytes) -> bytes:
        """Return the script without the number of its session."""
        return self.NUMBER.sub(b"", message)

    def heard(self, asked: bytes, recorded: bytes) -> None:
        new, old = self.NUMBER.search(asked), self.NUMBER.search(recorded)
        if new is not None and old is not None:
            self._sessions[int(old[1])] = int(new[1])


def ur_rtde(_options: Options) -> dict[str, Dialect]:
    """Return the dialects of a Universal Robots controller; its dashboard's are lines."""
    sessions: dict[int, int] = {}
    return {"rtde": Rtde(sessions), "script": UrScript(sessions)}
