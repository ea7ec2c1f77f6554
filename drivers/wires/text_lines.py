"""Lines of ASCII text over a wire: whole lines in, whole lines out.

A wrong baud rate or a line that died in mid-byte shows as bytes that are no text: such a line is an
error, never an answer. A line that never ends is one, too.
"""

from __future__ import annotations

import re

from drivers.supervision import Patience
from drivers.wires.tcp import Link


class TextLines:
    """Reads and writes the lines of one wire."""

    LONGEST = 4096

    def __init__(
        self,
        link: Link,
        end: bytes = b"\r\n",
        split: bytes = rb"\r\n|\r|\n",
        *,
        letters: bool = False,
    ) -> None:
        """``end`` closes a line that is sent; the pattern ``split`` ends one that is received.

        ``letters``: letters of an unknown encoding may occur; each byte of them becomes a "?".
        """
        self.link = link
        self._text = re.compile(rb"[\t\x20-\x7e\x80-\xff]*" if letters else rb"[\t\x20-\x7e]*")
        self._end, self._split = end, re.compile(split)
        self._bytes = b""

    def send(self, line: str, operation: str) -> None:
        self.link.send(line.encode("ascii") + self._end, operation)

    def receive(self, patience: Patience) -> str | None:
        """Return the next line that is not empty, None when ``patience`` is over.

        Raises `DeviceError` for a line that is no text, or too long.
        """
        while True:
            while (found := self._split.search(self._bytes)) is not None:
                line, self._bytes = self._bytes[: found.start()], self._bytes[found.end() :]
                if not self._text.fullmatch(line):
                    raise self.link.broken(
                        "receive", f"no text: {line[:40]!r}; is the baud rate right?"
                    )
                if line.strip():
                    return re.sub(rb"[\x80-\xff]", b"?", line).decode("ascii").strip()
            if len(self._bytes) > self.LONGEST:
                start = self._bytes[:40]
                raise self.link.broken("receive", f"a line without an end: {start!r} ..")
            if not (data := self.link.receive(self.LONGEST, patience)):
                return None
            self._bytes += data

    @property
    def unended(self) -> int:
        """Return how many bytes have come of a line that has no end yet."""
        return len(self._bytes)

    def drop_pending(self) -> None:
        """Forget what has been received and not been read."""
        self._bytes = b""
        while self.link.receive(self.LONGEST, Patience(0.0)):
            pass
