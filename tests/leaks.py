"""What a test has left behind: threads, open files and sockets, processes."""

from __future__ import annotations

import gc
import os
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# A thread that was told to end may need a while on a busy PC, and a server to see that its client
# has gone.
END_S = 60.0
# Kept by a library for its next use.
POOLED = ("ThreadPoolExecutor", "asyncio_", "execnet", "Dask-Offload")
NOBODYS = re.compile(r"/dev/|/proc/|anon_inode:|\.pyc|\.ttf|\.so")


@contextmanager
def no_leaks() -> Iterator[None]:
    """Raise `AssertionError` that names all that was opened meanwhile and is still there."""
    threads, files, processes = set(threading.enumerate()), open_files(), children()
    yield
    left = [f"thread {each.name}" for each in _running(threads)]
    give_up_s = time.monotonic() + END_S
    while (opened := open_files() - files) and time.monotonic() < give_up_s:
        gc.collect()
        time.sleep(0.01)
    left += sorted(f"file {place}{_ends(number, place)}" for number, place in opened)
    left += [f"process {pid}: {words}" for pid, words in children().items() if pid not in processes]
    if left:
        raise AssertionError("left behind: " + "; ".join(left))


def _ends(number: int, place: str) -> str:
    """Return who talks to whom by a socket."""
    if place.startswith("socket:"):
        with socket.socket(fileno=os.dup(number)) as same, suppress(OSError):
            return f" from {same.getsockname()} to {same.getpeername()}"
    return ""


def _running(before: set[threading.Thread]) -> Iterator[threading.Thread]:
    for each in threading.enumerate():
        if each not in before and not each.name.startswith(POOLED):
            each.join(END_S)
            if each.is_alive():
                yield each


def open_files() -> set[tuple[int, str]]:
    """Return numbers and places of what this process holds open; empty where no system says."""
    found = set()
    with suppress(FileNotFoundError):
        for each in os.scandir("/proc/self/fd"):
            with suppress(FileNotFoundError):
                place = os.readlink(each.path)  # noqa: PTH115 - twice a test; a Path is slow
                if not NOBODYS.search(place):
                    found.add((int(each.name), place))
    return found


def children() -> dict[int, str]:
    """Return the command of each process that this one has started, also of dead ones.

    A process has its starter's command until it executes its own.
    """
    found = {}
    with suppress(FileNotFoundError):
        for task in os.scandir("/proc/self/task"):
            with suppress(FileNotFoundError):
                for pid in Path(task.path, "children").read_text().split():
                    with suppress(FileNotFoundError):
                        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
                        found[int(pid)] = b" ".join(words).decode(errors="replace")[:120]
    return found
