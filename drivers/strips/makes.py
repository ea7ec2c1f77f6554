"""Which strips there are on a wire of their own, by the options that name one."""

from __future__ import annotations

from collections.abc import Callable

from drivers.strips.canopen import CanopenStrip
from drivers.strips.serial import SerialStrip
from drivers.strips.strip import Strip, StripOptions


def strip_of(options: StripOptions, check: Callable[[], None]) -> Strip:
    """Return the strip, not connected; ``check`` ends every wait of its connect."""
    if options.driver == "canopen":
        return CanopenStrip(options, check)
    return SerialStrip(options, check)
