"""``python -m benchmarks.escape [STOPS]``: from Esc in a terminal to the stop frames on the wires.

The whole chain at once: a byte into a real terminal, the screen of `hilcell tui` behind it, a real
engine, its drivers, the wires. On every page of the screen and in every phase of the engine, at a
clock of speed 1 and as fast as it goes.
"""

from __future__ import annotations

import math
import random
import tempfile
import time
from itertools import cycle, islice, product
from pathlib import Path

from benchmarks.screen import PAGES
from benchmarks.stop import PHASES, Rig, await_phase, connected, report
from benchmarks.words import parser
from tests.whole.terminal import Terminal

STOPS = 200


def escape(rig: Rig, page: str, phase: str, rng: random.Random) -> float:
    """Return the time, s, from Esc on a page to the last device's stop frame."""
    folder = rig.begin(phase)
    with (
        connected(folder / "engine.json") as watcher,
        Terminal(["tui", "--runs", str(folder.parent), folder.name]) as terminal,
    ):
        terminal.shows("LIVE")
        for key in PAGES[page]:
            terminal.press(key)
            terminal.pump(0.1)
        await_phase(watcher, phase)
        end_s = time.monotonic() + rng.uniform(0.0, 0.6)
        while time.monotonic() < end_s:
            terminal.pump(0.02)
        sent_s = rig.arm()
        terminal.press("\x1b")
        frames_s = rig.frames_s(sent_s)
    assert not math.isnan(sum(frames_s.values())), f"{page}, {phase}: a frame is missing"
    return max(frames_s.values())


def main() -> None:
    words = parser(__doc__)
    words.add_argument("stops", type=int, nargs="?", default=STOPS, metavar="STOPS")
    stops = words.parse_args().stops
    rng = random.Random(1)
    everything: list[float] = []
    for speed in (1.0, math.inf):
        taken: dict[str, list[float]] = {}
        with tempfile.TemporaryDirectory() as folder:
            rig = Rig(Path(folder), speed)
            try:
                for page, phase in islice(cycle(product(PAGES, PHASES)), stops // 2):
                    taken_s = escape(rig, page, phase, rng)
                    taken.setdefault(f"on: {page}", []).append(taken_s)
                    taken.setdefault(f"in: {phase}", []).append(taken_s)
                    everything.append(taken_s)
            finally:
                rig.close()
        print(f"speed {'max' if math.isinf(speed) else speed:}")
        for name, values in taken.items():
            report(name, values)
    report("Esc to the wires", everything)


if __name__ == "__main__":
    main()
