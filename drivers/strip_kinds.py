"""The strip that a rail's options name."""

from __future__ import annotations

from collections.abc import Callable

from drivers.strip import Strip, StripOptions
from drivers.strip_serial import SerialStrip


def build_strip(options: StripOptions, check: Callable[[], None]) -> Strip:
    """Return the strip, unopened; ``check`` runs in its waits."""
    return SerialStrip(options, check)
