"""How a CAN bus is reached, as a cell file states it, and what is impossible of it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Literal

from hilcell.wire.channel import parse_channel

Interface = Literal["slcan", "socketcan"]

BIT_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
_KERNEL_NAME = re.compile(r"[^\s/:]{1,15}")  # of a network interface


def bus_problems(interface: Interface, channel: str, bitrate: int) -> Iterator[str]:
    """Return why there can be no such bus. The kernel's own interfaces have their bit rate."""
    if interface == "socketcan":
        if not _KERNEL_NAME.fullmatch(channel):
            yield f"channel: the kernel's name of a CAN interface is wanted, found {channel!r}"
        return
    try:
        parse_channel(channel)
    except ValueError as error:
        yield str(error)
    if bitrate not in BIT_RATES:
        allowed = ", ".join(map(str, BIT_RATES))
        yield f"bitrate: a bit rate of slcan is wanted, found {bitrate}; allowed: {allowed}"
