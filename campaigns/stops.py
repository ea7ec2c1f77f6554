"""Stop frames of a busy engine: from a screen's socket to the wires, 99 of 100 within 20 ms.

A case is a stop, in turn while the rail moves, the robot moves, the tracker measures and a prompt
waits. ``benchmarks.stop`` measures; relays and load count as the engine's.
"""

from __future__ import annotations

import re
import subprocess
import sys

COUNT = 500
MOST_MS = 20.0
_ROW = re.compile(r"^(frame of the \w+) +\d+ .* p99 +([\d.]+|nan) ", re.MULTILINE)


def campaign(stops: range) -> int:
    """Measure so many stops, half of them at the speed of a real cell."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.stop", str(len(stops))],
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    print(done.stdout)
    return 0 if done.returncode == 0 and report(done.stdout) else 1


def report(said: str) -> bool:
    """Print the slowest; return whether all are in time."""
    p99_ms = [(name, float(value)) for name, value in _ROW.findall(said)]  # at both speeds
    late = [f"{name} {value} ms" for name, value in p99_ms if not value <= MOST_MS]
    print(f"p99 of stop frames wanted <= {MOST_MS:.0f} ms: {', '.join(late) or 'all are'}")
    return bool(p99_ms) and not late
