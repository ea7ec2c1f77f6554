"""The process of a command: ``hilcell``, or ``python -m hilcell``.

A signal that comes while modules are imported ends it without a trace of them; one that comes when
the exit code is known does not change that code, also while the interpreter ends.
"""

import os
import signal
import sys

EXIT_ABORTED = 4  # of `hilcell.errors`, which is not imported yet
ONE_THREAD = ("OPENBLAS_NUM_THREADS", "1")  # numpy's, which spin and take turns with the engine's


def _leave(*_: object) -> None:
    """End at once: nothing has begun. An exception would be lost in some modules' imports."""
    os.write(2, b"hilcell: interrupted before anything began\n")
    os._exit(EXIT_ABORTED)


def entry() -> int:
    """Run the command that the process was started with; return its exit code."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:  # as in the background of a shell
        signal.signal(signal.SIGINT, _leave)
    os.environ.setdefault(*ONE_THREAD)
    from hilcell.commands.cli import main

    try:
        return main(imported=lambda: signal.signal(signal.SIGINT, before))
    finally:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)


if __name__ == "__main__":
    sys.exit(entry())
