"""A magnetic strip's sensor (CiA 406) on a CAN bus of its own, not the drive's.

Nothing moves on this bus, so the PC sends no heartbeat there: it asks by SYNC, and a sensor that
was reset or that falls silent is lost like any other strip.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.canopen import cia406, rail_setup
from drivers.canopen.can_link import CanLink, open_bus
from drivers.canopen.cia301 import NMT, NodeCommand
from drivers.canopen.node_watch import NodeWatch
from drivers.canopen.pdo import Inbox
from drivers.canopen.process_image import strip_mapping, strip_values
from drivers.canopen.rail_setup import Expected
from drivers.canopen.sdo import open_channel
from drivers.standing import DEVICE
from drivers.strips.strip import StripOptions
from drivers.supervision import on_failure
from hilcell.ports import Clock, DeviceError, Identity, LinkStatistics

SYNCS = 2  # while they bring nothing nobody looks at a slide that may move


class CanopenStrip:
    """Satisfies `drivers.strips.strip.Strip`."""

    def __init__(self, options: StripOptions, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._pdo = strip_mapping(options.node)
        self._link: CanLink | None = None
        self._watch: NodeWatch | None = None
        self._inbox: Inbox | None = None
        self._statistics = LinkStatistics()

    def connect(self) -> Identity:
        """Open the bus, verify the sensor, and have it send its counts on SYNC."""
        self._statistics = LinkStatistics()
        options = self._options
        bus = open_bus(DEVICE, options.interface, options.channel, options.bitrate)
        self._link = CanLink(DEVICE, bus, self._clock)
        with on_failure(self.close):
            return self._set_up(self._link)

    def read(self, check: Callable[[], None]) -> tuple[int, int]:
        """Return counts and alarms of a SYNC that is sent now."""
        inbox, watch = self._inbox, self._watch
        if inbox is None or watch is None:
            raise DeviceError("HC-S12", DEVICE, "strip", "not connected", act="connect first")

        def look() -> None:
            check()
            watch.check("strip")

        look()
        return strip_values(inbox.refresh(look)[0][self._pdo.cob_id], watch)

    def alarm_text(self, alarms: int) -> str:
        """Return the bits of 6503h in words."""
        return cia406.alarm_text(alarms)

    def statistics(self) -> LinkStatistics:
        """Return the bus's counts since `connect`, also after `close`."""
        link = self._link
        return self._statistics if link is None else link.statistics()

    def close(self) -> None:
        """Close the bus."""
        link, self._link = self._link, None
        self._watch = self._inbox = None
        if link is not None:
            self._statistics = link.statistics()
            link.close()

    def _set_up(self, link: CanLink) -> Identity:
        options, check = self._options, self._clock.check
        sdo = open_channel(DEVICE, link, options.node, "strip.eds", check)
        watch = NodeWatch(DEVICE, link, options.node, in_pdo=cia406.SENSOR_ERRORS)
        inbox = Inbox(DEVICE, link, (self._pdo,), SYNCS)
        expected = Expected(
            "strip",
            options.node,
            cia406.DEVICE_PROFILE,
            options.vendor,
            options.product,
            options.serial,
        )
        device_type = rail_setup.find_node(link, sdo, expected, check)
        identity = rail_setup.identify(sdo, expected, device_type, options.channel)
        rail_setup.check_strip_step(sdo, options.counts_per_mm)
        watch.begin_set_up()
        link.send(NMT, bytes((NodeCommand.ENTER_PRE_OPERATIONAL, options.node)))
        rail_setup.set_heartbeat(sdo, options.bitrate)
        inbox.expect(rail_setup.map_strip(sdo, self._pdo, watch))
        rail_setup.start_nodes(link, (watch,), check)
        watch.check("connect")
        watch.arm()
        self._watch, self._inbox = watch, inbox
        return identity
