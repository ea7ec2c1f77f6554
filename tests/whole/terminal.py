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
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

import pyte

from hilcell.tui.app.app import BURST_S

HILCELL = (sys.executable, "-m", "hilcell")
READ = 1 << 16
LIMIT_S = 100.0  # a busy machine may take long, and is not at fault
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
        self.began_s = time.monotonic()
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
        """Return what is seen."""
        across = range(self.screen.columns)  # pyte's own lines break on a wide letter half gone
        rows = (self.screen.buffer[y] for y in range(self.screen.lines))
        return "\n".join("".join(row[x].data for x in across).rstrip() for row in rows)

    def press(self, keys: str) -> None:
        """Type."""
        os.write(self._end, keys.encode())

    def answer(self, keys: str) -> None:
        """Type like a person who has read a question: in one burst it would be no answer."""
        self.pump_for(1.5 * BURST_S)
        self.press(keys)

    def pump(self, wait_s: float) -> bool:
        """Take what has come within some time; return whether anything did."""
        ready, _, _ = select.select([self._end], [], [], wait_s)
        if not ready:
            return False
        try:
            read = os.read(self._end, READ)
        except OSError:  # the other side has closed its terminal
            read = b""
        self.raw += read
        self._stream.feed(read)
        return bool(read)

    def pump_for(self, while_s: float) -> None:
        """Take what comes for so long."""
        end_s = time.monotonic() + while_s
        while (left_s := end_s - time.monotonic()) > 0 and not self.ended:
            self.pump(left_s)

    def until(self, seen: Callable[[str], bool], limit_s: float = LIMIT_S) -> float:
        """Wait until the screen shows something; return how long that took, s."""
        began_s = time.monotonic()
        while not seen(self.text):
            left_s = limit_s - (time.monotonic() - began_s)
            if left_s <= 0 or (not self.pump(min(left_s, 0.5)) and self.ended):
                raise TimeoutError(f"not seen within {limit_s} s; the screen shows\n{self.text}")
        return time.monotonic() - began_s

    def shows(self, words: str, limit_s: float = LIMIT_S) -> float:
        """Wait until the screen shows these words."""
        return self.until(lambda text: words in text, limit_s)

    @property
    def ended(self) -> bool:
        """Whether the program has ended."""
        return self.process.poll() is not None

    def ends(self, limit_s: float = LIMIT_S) -> int:
        """Wait until the program has ended; return its exit code."""
        deadline_s = time.monotonic() + limit_s
        while not self.ended:
            self.pump(0.1)
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"lives on after {limit_s} s; the screen shows\n{self.text}")
        return self.process.wait()

    def cpu_s(self) -> float:
        """Return how much processor time the program has used."""
        stat = Path(f"/proc/{self.pid}/stat").read_text("ascii")
        fields = stat.rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def close(self) -> None:
        """End the program and the terminal."""
        if not self.ended:
            self.process.send_signal(signal.SIGKILL)
            self.process.wait()
        os.close(self._end)
