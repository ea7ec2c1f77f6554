"""stdout and stderr of commands that are done in this process, several at once in threads."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TextIO, cast

Pair = tuple[TextIO, TextIO]


class Outputs:
    """A thread writes to the outputs of its own command, the innermost where one does another.

    Threads that have none, as a run's worker, write to those of the command that began first.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._by_thread: dict[int, list[Pair]] = {}  # in the order in which they began
        self._before: Pair = (sys.stdout, sys.stderr)

    @contextmanager
    def to(self, out: TextIO, err: TextIO) -> Iterator[None]:
        mine = threading.get_ident()
        with self._lock:
            if not self._by_thread:
                self._before = (sys.stdout, sys.stderr)
                sys.stdout, sys.stderr = (cast("TextIO", _Stream(self, n)) for n in (0, 1))
            self._by_thread.setdefault(mine, []).append((out, err))
        try:
            yield
        finally:
            with self._lock:
                self._by_thread[mine].pop()
                if not self._by_thread[mine]:
                    del self._by_thread[mine]
                if not self._by_thread:
                    sys.stdout, sys.stderr = self._before

    def here(self) -> Pair:
        with self._lock:
            first = next(iter(self._by_thread.values()), [self._before])
            return self._by_thread.get(threading.get_ident(), first)[-1]


@dataclass(frozen=True, eq=False)
class _Stream:
    """Is, in each thread, the stream of that thread."""

    outputs: Outputs
    number: int

    def __getattr__(self, name: str) -> Any:
        return getattr(self.outputs.here()[self.number], name)
