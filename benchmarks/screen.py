"""``python -m benchmarks.screen``: the technician's screen in a real terminal.

First paint, key to paint, Esc to the engine, processor time and bytes, each beside its target. The
engine of the Esc figures is the real control channel with nobody moving behind it; what follows
on the wire is measured by ``python -m benchmarks.stop``.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from benchmarks.words import parser
from hilcell.journal.journal import Journal
from hilcell.journal.runs import JOURNAL
from hilcell.run.control import Control, Status
from tests.hilcell.run.test_control import Recorder
from tests.hilcell.tui.sample_runs import RUN, sample_run, status
from tests.whole.bench import HILCELL
from tests.whole.terminal import Terminal

PAGES = {"run": "", "plots": "p", "log": "l", "interlocks": "i", "alarms": "e", "help": "?",
         "history": "h", "history, in the filter": "h/", "points, in the filter": "/",
         "abort?": "a", "palette": "\x10"}  # fmt: skip


class StandIn(Recorder):
    """An engine that only listens, and knows when it was asked to stop."""

    def __init__(self, state: str) -> None:
        super().__init__()
        self.stopped = threading.Event()
        self.stopped_s = 0.0
        self._status = status(state)

    def stop(self) -> None:
        self.stopped_s = time.monotonic()
        self.stopped.set()

    def status(self) -> Status:
        return self._status


def write_run(runs: Path, state: str) -> Path:
    folder = runs / RUN
    folder.mkdir(parents=True)
    journal = Journal(folder / JOURNAL, RUN, create=True)
    for record in sample_run(state).records:
        journal.append(record.kind, record.key, record.body)
    journal.close()
    return folder


def quantile_ms(seconds: list[float], share: float) -> float:
    """Return the value that this share of the values keeps, ms."""
    ordered = sorted(seconds)
    return 1e3 * ordered[min(int(share * len(ordered)), len(ordered) - 1)]


def first_screen(folder: Path) -> None:
    """From the start of the process to the first words on the terminal."""
    taken = []
    for _ in range(10):
        began_s = time.monotonic()
        with Terminal(["tui", "--runs", str(folder)]) as terminal:
            terminal.until(lambda text: bool(text.strip()))
            taken.append(time.monotonic() - began_s)
    bare = []
    for _ in range(10):
        began_s = time.monotonic()
        subprocess.run([sys.executable, "-c", "import textual.app"], check=True)
        bare.append(time.monotonic() - began_s)
    median, worst = quantile_ms(taken, 0.5), quantile_ms(taken, 1.0)
    ratio = median / quantile_ms(bare, 0.5)
    print(
        f"first screen      {median:6.0f} ms, worst {worst:.0f} (target 800) = {ratio:.1f} x "
        "importing textual alone"
    )


def keys(runs: Path) -> None:
    """From a key to the bytes of its new words, while a run is live."""
    with Terminal(["tui", "--runs", str(runs), "last"]) as terminal:
        terminal.shows("RUNNING")
        taken = []
        for number in range(400):
            key, words = (("i", b"before anything moves"), ("q", b"newest point"))[number % 2]
            mark, began_s = len(terminal.raw), time.monotonic()
            terminal.press(key)
            while words not in terminal.raw[mark:]:
                terminal.pump(0.5)
            taken.append(time.monotonic() - began_s)
            terminal.pump(0.03)
    print(
        f"key to paint      p50 {quantile_ms(taken, 0.5):.1f} ms, "
        f"p99 {quantile_ms(taken, 0.99):.1f} (target 50), {len(taken)} keys"
    )


def escapes(folder: Path, state: str, pages: dict[str, str], times: int) -> None:
    """From Esc to the engine's handler, on every page."""
    engine = StandIn(state)
    control = Control(folder, engine)
    everything = []
    try:
        for name, open_keys in pages.items():
            taken = []
            with Terminal(["tui", "--runs", str(folder.parent), "last"]) as terminal:
                terminal.shows("LIVE")
                for _ in range(times):
                    for key in open_keys:
                        terminal.press(key)
                        terminal.pump(0.05)
                    engine.stopped.clear()
                    began_s = time.monotonic()
                    terminal.press("\x1b")
                    if not engine.stopped.wait(2.0):
                        terminal.pump(0.3)
                        raise TimeoutError(f"no stop from {name}\n{terminal.text}")
                    taken.append(engine.stopped_s - began_s)
                    terminal.pump(0.05)
                    if name not in ("run", "abort?", "palette") and open_keys:
                        terminal.press("\rq" if "/" in open_keys else "q")
                        terminal.pump(0.05)
            everything += taken
            print(
                f"  {name:24} p99 {quantile_ms(taken, 0.99):5.1f} ms, worst {max(taken) * 1e3:.1f}"
            )
    finally:
        control.close()
    print(
        f"Esc to the engine ({state})  p99.9 {quantile_ms(everything, 0.999):.1f} ms, "
        f"{len(everything)} stops"
    )


def processor(folder: Path, speed: int) -> None:
    """Processor time and bytes while a calibration runs at so many times its pace."""
    words = [*HILCELL, "run", "--unattended", "--speed", str(speed), "--runs", str(folder)]
    run = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while not list(folder.glob("*/engine.json")):
            time.sleep(0.1)
        for slow in ([], ["--slow"]):
            with Terminal(["tui", "--runs", str(folder), "last", *slow]) as terminal:
                terminal.shows("RUNNING")
                shares, mark = [], len(terminal.raw)
                for _ in range(4):
                    before_s, end_s = terminal.cpu_s(), time.monotonic() + 10.0
                    while time.monotonic() < end_s:
                        terminal.pump(0.2)
                    shares.append((terminal.cpu_s() - before_s) / 10.0)
                sent = (len(terminal.raw) - mark) / 40.0 / 1e3
            how = " ".join([f"speed {speed}", *slow])
            print(
                f"processor, {how:16} {100 * max(shares):4.1f} % of a core at most (target 5), "
                f"{sent:.1f} kB/s"
            )
    finally:
        run.terminate()
        run.wait()


def main() -> None:
    parser(__doc__).parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first_screen(folder / "empty")
        running = write_run(folder / "running", "running")
        stand_in = Control(running, StandIn("running"))
        keys(running.parent)
        stand_in.close()
        escapes(running, "running", PAGES, 100)
        escapes(write_run(folder / "asked", "suspended"), "suspended", {"prompt": ""}, 100)
        for speed in (1, 10):
            processor(folder / f"speed-{speed}", speed)


if __name__ == "__main__":
    main()
