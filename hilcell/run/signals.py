"""Signals to a run: during start-up they end it, afterwards they are commands.

After the start-up a handler only notes or queues, so no signal interrupts a teardown.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

from hilcell.ports import Stopped

# Ctrl-C pauses, a second one stops; a lost terminal (SIGHUP) counts as a lost screen.
COMMANDS = {signal.SIGINT: "interrupt", signal.SIGTERM: "terminate", signal.SIGHUP: "lost"}


def note_signals() -> list[signal.Signals]:
    """Note SIGTERM, SIGINT and SIGHUP in the returned list until the process ends.

    The handlers stay: after a restoration a late signal would change the exit code. A process that
    works on after its run restores them by `signals_restored`.
    """
    noted: list[signal.Signals] = []
    if threading.current_thread() is threading.main_thread():
        for number in COMMANDS:
            signal.signal(number, lambda number, _: noted.append(signal.Signals(number)))
    return noted


@contextmanager
def signals_restored() -> Iterator[None]:
    """Restore what handles signals at the block's end."""
    before = {number: signal.getsignal(number) for number in COMMANDS}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in before.items():
                signal.signal(number, handler)


@contextmanager
def stopped_by_signals(noted: list[signal.Signals]) -> Iterator[None]:
    """Let the first signal, or one ``noted`` before, raise `Stopped`; later ones are ignored."""

    def refuse() -> None:
        if noted:
            raise Stopped(f"stopped by {noted[0].name} before anything moved")

    def stopped(number: int, _: object) -> None:
        noted.append(signal.Signals(number))
        if len(noted) == 1:  # a later one would interrupt the exit
            refuse()

    refuse()
    with _handled(dict.fromkeys(COMMANDS, stopped)):
        yield
    refuse()


@contextmanager
def signals_as_commands(post: Callable[[str], None]) -> Iterator[None]:
    """Pass signals on as commands; ``post`` must be safe in a signal handler."""
    with _handled(
        dict.fromkeys(COMMANDS, lambda number, _: post(COMMANDS[signal.Signals(number)]))
    ):
        yield


@contextmanager
def interrupted_once() -> Iterator[Callable[[], None]]:
    """Let the first signal raise `KeyboardInterrupt`, and ignore later ones.

    Python loses an exception raised in a callback of its garbage collection; the yielded check
    raises it again. Signals that this process ignores, as under nohup, stay ignored.
    """
    noted: list[int] = []

    def interrupt(number: int, _: object) -> None:
        noted.append(number)
        if noted == [number]:
            raise KeyboardInterrupt

    def check() -> None:
        if noted:
            raise KeyboardInterrupt

    handled = [each for each in COMMANDS if signal.getsignal(each) is not signal.SIG_IGN]
    with _handled(dict.fromkeys(handled, interrupt)):
        yield check


@contextmanager
def postponed(*numbers: signal.Signals) -> Iterator[None]:
    """Postpone signals until the block has ended."""
    noted: list[int] = []
    handled = [each for each in numbers if signal.getsignal(each) is not signal.SIG_IGN]
    with _handled(dict.fromkeys(handled, lambda number, _: noted.append(number))):
        yield
    if noted:
        signal.raise_signal(noted[0])


@contextmanager
def _handled(
    handlers: Mapping[signal.Signals, Callable[[int, FrameType | None], None]],
) -> Iterator[None]:
    """Install signal handlers for a block in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
