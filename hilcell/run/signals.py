"""Signals to a run: while it starts they end it, while it lives they are commands.

None of them interrupts a teardown: outside of the start-up a handler only notes or queues.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

from hilcell.ports import Stopped

# Ctrl-C pauses, a second one stops; a lost terminal is a lost screen.
COMMANDS = {signal.SIGINT: "interrupt", signal.SIGTERM: "terminate", signal.SIGHUP: "lost"}


def note_signals() -> list[signal.Signals]:
    """Note SIGTERM, SIGINT and SIGHUP in the list until the process ends, and let all go on.

    Nothing is put back: between that and the process's end a signal would change the exit code.
    """
    noted: list[signal.Signals] = []
    if threading.current_thread() is threading.main_thread():
        for number in COMMANDS:
            signal.signal(number, lambda number, _: noted.append(signal.Signals(number)))
    return noted


@contextmanager
def stopped_by_signals(noted: list[signal.Signals]) -> Iterator[None]:
    """Let the first signal raise `Stopped` while nothing moves yet; later ones change nothing.

    The first may have been ``noted`` before, or come at the very end.
    """

    def refuse() -> None:
        if noted:
            raise Stopped(f"stopped by {noted[0].name} before anything moved")

    def stopped(number: int, _: object) -> None:
        noted.append(signal.Signals(number))
        if len(noted) == 1:  # else what this one would interrupt is the way out
            refuse()

    refuse()
    with _handled(dict.fromkeys(COMMANDS, stopped)):
        yield
    refuse()


@contextmanager
def signals_as_commands(post: Callable[[str], None]) -> Iterator[None]:
    """Hand signals on as commands; ``post`` must be safe in a signal's handler."""
    with _handled(
        dict.fromkeys(COMMANDS, lambda number, _: post(COMMANDS[signal.Signals(number)]))
    ):
        yield


@contextmanager
def interrupted_once() -> Iterator[Callable[[], None]]:
    """Let the first signal raise `KeyboardInterrupt`; later ones would interrupt its way out.

    Python loses an exception that is raised in a callback of its garbage collection, so the check
    that is yielded raises it again. Signals that this process ignores, as under nohup, stay so.
    """
    noted: list[int] = []

    def interrupt(number: int, _: object) -> None:
        noted.append(number)
        if noted == [number]:
            raise KeyboardInterrupt

    def check() -> None:
        if noted:
            raise KeyboardInterrupt

    heard = [each for each in COMMANDS if signal.getsignal(each) is not signal.SIG_IGN]
    with _handled(dict.fromkeys(heard, interrupt)):
        yield check


@contextmanager
def postponed(*numbers: signal.Signals) -> Iterator[None]:
    """Let signals wait until the end, where an interruption would leave things half made."""
    noted: list[int] = []
    heard = [each for each in numbers if signal.getsignal(each) is not signal.SIG_IGN]
    with _handled(dict.fromkeys(heard, lambda number, _: noted.append(number))):
        yield
    if noted:
        signal.raise_signal(noted[0])


@contextmanager
def _handled(
    handlers: Mapping[signal.Signals, Callable[[int, FrameType | None], None]],
) -> Iterator[None]:
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
