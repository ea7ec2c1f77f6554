"""``python -m fakes``: one simulated cell as a process of its own.

The first line on stdin is the order (JSON), the first line on stdout says where everything
listens. It lives until stdin ends, so it never outlives its parent.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading

import msgspec

from fakes.host import Host, Order
from hilcell.errors import HilcellError, with_place
from hilcell.typed import decoded

STDIN = 0


def main() -> int:
    """Serve the ordered cell until stdin ends or the control channel says quit."""
    threading.excepthook = _report
    try:
        host = Host(decoded(_first_line(), Order))
    except (msgspec.DecodeError, HilcellError) as error:
        print(error, file=sys.stderr)
        return 2
    threading.Thread(target=_watch, args=(host,), name="stdin", daemon=True).start()
    print(msgspec.json.encode(host.addresses()).decode(), flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        host.run()
    return 0


def _first_line() -> bytes:
    """Read up to the first newline, unbuffered: a buffer's lock would outlive the watcher."""
    line = b""
    while not line.endswith(b"\n") and (data := os.read(STDIN, 65536)):
        line += data
    return line


def _report(failed: threading.ExceptHookArgs) -> None:
    """Say which error ended a thread of a simulated device: its client sees a closed wire."""
    error = failed.exc_value or failed.exc_type()
    name = failed.thread.name if failed.thread else "a thread"
    print(f"simulated cell: {name}: {with_place(error)}", file=sys.stderr)


def _watch(host: Host) -> None:
    while os.read(STDIN, 4096):
        pass
    host.end()


if __name__ == "__main__":
    sys.exit(main())
