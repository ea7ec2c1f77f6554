"""The strip of a rail, where it has a wire of its own: which ones there are, and how one is lost.

No motion needs the strip. So a strip whose line breaks shows as one more alarm in its polls, as a
missing magnet does, and a reading that needs it raises `StripLost`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple
from typing import Annotated, Literal, Protocol

import msgspec
from msgspec import Meta

from drivers.canopen.slcan_bus import Interface, bus_problems
from hilcell.cell.settings import refuse
from hilcell.ports import DeviceError, Identity, LinkStatistics
from hilcell.wire.channel import parse_channel

LOST = 1 << 16  # beside the sensor's own alarm bits, of which there are 16

CountsPerMm = Annotated[float, Meta(gt=0, le=1e6)]  # of a strip: 1 nm and more
U32 = Annotated[int, Meta(ge=0, le=2**32 - 1)]


class StripOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A strip's wire and scale: a serial line, or a CAN bus that is not the drive's."""

    driver: Literal["serial", "canopen"]
    channel: str
    counts_per_mm: CountsPerMm = 100.0
    serial: U32 = 0  # of the sensor; 0: any
    interface: Interface = "slcan"  # from here on: of a CAN bus
    bitrate: int = 500_000
    node: Annotated[int, Meta(ge=1, le=127)] = 6
    vendor: U32 = 0x484
    product: U32 = 0x406

    def __post_init__(self) -> None:
        if self.driver == "serial":
            plain = {each.name: each.default for each in msgspec.structs.fields(StripOptions)}
            for key in ("interface", "bitrate", "node", "vendor", "product"):
                if getattr(self, key) != plain[key]:
                    raise ValueError(f"{key}: only of a strip with driver canopen")
            parse_channel(self.channel)
        else:
            refuse(bus_problems(self.interface, self.channel, self.bitrate))


class Strip(Protocol):
    """A magnetic strip's sensor on a wire of its own; used by one thread."""

    def connect(self) -> Identity:
        """Open the wire and verify the sensor; raises `DeviceError`."""

    def read(self, check: Callable[[], None]) -> tuple[int, int]:
        """Return its counts and alarms (0: the counts are good); raises `DeviceError`."""

    def alarm_text(self, alarms: int) -> str:
        """Return its alarms in words."""

    def statistics(self) -> LinkStatistics:
        """Return its wire's counts since ``connect``, also after ``close``."""

    def close(self) -> None:
        """Close the wire; a second close does nothing."""


class StripFeed:
    """The polls of one strip; one that is lost is opened again only while nothing moves."""

    def __init__(self, strip: Strip) -> None:
        self._strip = strip
        self._lost: DeviceError | None = None
        self._counts = 0
        self._before = LinkStatistics()  # of wires that were lost

    def connect(self) -> Identity:
        """Open the wire and verify the sensor."""
        self._before = LinkStatistics()
        return self._open()

    def _open(self) -> Identity:
        self._strip.close()
        identity, self._lost = self._strip.connect(), None
        return identity

    def poll(self, check: Callable[[], None]) -> tuple[int, int]:
        """Return counts and alarms: the last counts and `LOST` of a strip that does not answer."""
        if self._lost is None:
            try:
                self._counts, alarms = self._strip.read(check)
            except DeviceError as error:
                self._lost = error
            else:
                return self._counts, alarms
        return self._counts, LOST

    def mend(self) -> None:
        """Open the wire of a strip that was lost again, if it lets itself be opened."""
        if self._lost is not None:
            self._before = self.statistics()
            try:
                self._open()
            except DeviceError as error:
                self._lost = error

    def statistics(self) -> LinkStatistics:
        """Return the wire's counts since `connect`, of wires that were lost as well."""
        return summed(self._before, self._strip.statistics())

    def alarm_text(self, alarms: int) -> str:
        """Return alarms in words."""
        if alarms & LOST and self._lost is not None:
            return self._lost.summary
        return self._strip.alarm_text(alarms & ~LOST)

    def close(self) -> None:
        """Close the wire."""
        self._strip.close()


def summed(one: LinkStatistics, other: LinkStatistics) -> LinkStatistics:
    """Return the counts of two wires together."""
    counts = zip(astuple(one), astuple(other), strict=True)
    return LinkStatistics(*(ours + theirs for ours, theirs in counts))
