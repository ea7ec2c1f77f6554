"""``python -m benchmarks.end_seen [BUSY]``: how long after its end a screen shows a run's end.

A calibration runs, a screen attends it in a real terminal, with nothing beside and then with eight
processes that never rest, or with BUSY. Target: 2 s from the journal's last record.
"""

from __future__ import annotations

import math
import multiprocessing
import subprocess
import tempfile
import time
from datetime import datetime
from pathlib import Path

from benchmarks.words import parser
from hilcell.journal.journal import read_journal
from hilcell.journal.runs import JOURNAL
from hilcell.tui.text.run import STATES
from tests.whole.bench import HILCELL
from tests.whole.terminal import Terminal

ENDS = tuple(STATES[state][0] for state in ("done", "intolerant", "aborted", "fault"))
AFTER_S = 20.0  # how long the screen is read after its engine's end


def never_rests() -> None:
    while True:
        pass


def late_s(runs: Path) -> float:
    """Calibrate beside a screen; return the time from the last record to the end on the screen.

    What the screen writes is shown after the run: a terminal in Python would itself be late.
    """
    words = [*HILCELL, "run", "--unattended", "--name", "run", "--runs", str(runs)]
    engine = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    written = []
    try:
        while not (runs / "run" / "engine.json").exists():
            time.sleep(0.05)
        with Terminal(["tui", "--runs", str(runs), "run"], columns=140, rows=45) as terminal:
            end_s = math.inf
            while time.monotonic() < end_s:
                if read := terminal.read(0.5):
                    written.append((time.time(), read))
                if end_s == math.inf and engine.poll() is not None:
                    end_s = time.monotonic() + AFTER_S
    finally:
        engine.wait()
    *_, last = read_journal(runs / "run" / JOURNAL)
    for at_s, read in written:
        terminal.show(read)
        if any(each in terminal.text.partition("\n")[0] for each in ENDS):
            return at_s - datetime.fromisoformat(last.t).timestamp()
    return math.inf


def main() -> None:
    words = parser(__doc__)
    words.add_argument("busy", nargs="?", type=int, default=8, metavar="BUSY")
    busy = words.parse_args().busy
    beside = [multiprocessing.Process(target=never_rests, daemon=True) for _ in range(busy)]
    with tempfile.TemporaryDirectory() as folder:
        alone_s = late_s(Path(folder, "alone"))
        for each in beside:
            each.start()
        busy_s = late_s(Path(folder, "busy"))
        for each in beside:
            each.kill()
    print(
        f"end on the screen: alone {alone_s:.2f} s after it, beside {busy} busy processes "
        f"{busy_s:.2f} s (target 2) = {busy_s / alone_s:.1f} x"
    )


if __name__ == "__main__":
    main()
