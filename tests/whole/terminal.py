"""A real terminal, as a pty with a screen in memory: keys go in, the visible text comes out."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

import pyte

from hilcell.tui.app import HilcellApp

HILCELL = (sys.executable, "-m", "hilcell")
READ = 1 << 16
AROUND = ("COLUMNS", "LINES", "NO_COLOR")  # of the terminal that the tests run in


def _own_terminal() -> None:
    """Make the terminal the program's own, so that the program learns of its loss."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # tests may run under nohup
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # or in the background of a shell
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


class Terminal:
    """Runs `hilcell`, or another program, with some words in a terminal of its own."""

    def __init__(
        self,
        words: Sequence[str],
        *,
        program: Sequence[str] = HILCELL,
        columns: int = 80,
        rows: int = 24,
        **environment: str,
    ) -> None:
        self.screen = pyte.Screen(columns, rows)
        self.raw = bytearray()
        self._stream = pyte.ByteStream(self.screen)
        self._end, inner = pty.openpty()
        fcntl.ioctl(inner, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        seen = {"TERM": "xterm-256color", "COLORTERM": "truecolor", "LC_ALL": "C.UTF-8"}
        # Parallel tests state a size of their own, which would be believed over the terminal's.
        around = {k: v for k, v in os.environ.items() if k not in AROUND}
        self.process = subprocess.Popen(
            [*program, *words],
            stdin=inner,
            stdout=inner,
            stderr=inner,
            env=around | seen | environment,
            start_new_session=True,
            preexec_fn=_own_terminal,  # noqa: PLW1509 - one system call, no lock
        )
        os.close(inner)
        self.pid = self.process.pid

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def text(self) -> str:
        across = range(self.screen.columns)  # pyte's own lines break on a wide letter half gone
        rows = (self.screen.buffer[y] for y in range(self.screen.lines))
        return "\n".join("".join(row[x].data for x in across).rstrip() for row in rows)

    def press(self, keys: str) -> None:
        os.write(self._end, keys.encode())

    def answer(self, keys: str) -> None:
        """Type like a person who has read a question: in one burst it would be no answer."""
        select.select([], [], [], 1.5 * HilcellApp.BURST_S)
        self.press(keys)

    def read(self, wait_s: float | None = None) -> bytes | None:
        """Return what has come, within some time if stated, not shown yet; b"" at the end."""
        ready, _, _ = select.select([self._end], [], [], wait_s)
        if not ready:
            return None
        try:
            read = os.read(self._end, READ)
        except OSError:  # the other side has closed its terminal
            read = b""
        self.raw += read
        return read

    def show(self, read: bytes) -> None:
        self._stream.feed(read)

    def pump(self, wait_s: float | None = None) -> bool:
        """Show what has come, within some time if stated; return whether anything did."""
        read = self.read(wait_s)
        if read:
            self.show(read)
        return bool(read)

    def until(self, seen: Callable[[str], bool]) -> None:
        """Wait until the screen shows something; only the end of the program ends the wait."""
        while not seen(self.text):
            if not self.pump():
                raise EOFError(f"the program has ended; the screen shows\n{self.text}")

    def shows(self, *words: str) -> None:
        self.until(lambda text: all(each in text for each in words))

    @property
    def ended(self) -> bool:
        return self.process.poll() is not None

    def ends(self) -> int:
        """Wait until the program has ended; return its exit code."""
        while self.pump():
            continue
        return self.process.wait()

    def cpu_s(self) -> float:
        """Return how much processor time the program has used."""
        stat = Path(f"/proc/{self.pid}/stat").read_text("ascii")
        fields = stat.rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def close(self) -> None:
        if not self.ended:
            self.process.send_signal(signal.SIGKILL)
            self.process.wait()
        os.close(self._end)
