"""Which strips there are on a wire of their own, by the options that name one."""

from __future__ import annotations

from collections.abc import Callable

from drivers.strip import Strip, StripOptions
from drivers.strip_canopen import CanopenStrip
from drivers.strip_serial import SerialStrip


def strip_of(options: StripOptions, check: Callable[[], None]) -> Strip:
    """Return the strip, not connected; ``check`` ends every wait of its connect."""
    if options.driver == "canopen":
        return CanopenStrip(options, check)
    return SerialStrip(options, check)
