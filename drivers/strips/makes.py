"""Which strips there are on a wire of their own, by the options that name one."""

from __future__ import annotations

from drivers.strips.canopen import CanopenStrip
from drivers.strips.serial import SerialStrip
from drivers.strips.strip import Strip, StripOptions
from hilcell.ports import Clock


def strip_of(options: StripOptions, clock: Clock) -> Strip:
    """Return the strip, not connected; a stop on ``clock`` ends every wait of its connect."""
    if options.driver == "canopen":
        return CanopenStrip(options, clock)
    return SerialStrip(options, clock)
