"""Signals to a run: before it lives they end it, then they are commands."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from hilcell.ports import Stopped

# Ctrl-C pauses, a second one stops; a lost terminal is a lost screen.
COMMANDS = {signal.SIGINT: "interrupt", signal.SIGTERM: "terminate", signal.SIGHUP: "lost"}


@contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Turn SIGTERM, SIGINT and SIGHUP into `Stopped` while nothing moves yet."""

    def stopped(number: int, _: object) -> None:
        raise Stopped(f"stopped by {signal.Signals(number).name} before anything moved")

    with _handled(dict.fromkeys(COMMANDS, stopped)):
        yield


@contextmanager
def signals_as_commands(post: Callable[[str], None]) -> Iterator[None]:
    """Hand signals on as commands; ``post`` must be safe in a signal's handler."""
    with _handled(
        dict.fromkeys(COMMANDS, lambda number, _: post(COMMANDS[signal.Signals(number)]))
    ):
        yield


@contextmanager
def _handled(handlers: Mapping[signal.Signals, Callable[[int, Any], None]]) -> Iterator[None]:
    """Install signal handlers for a while, where this is the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
