"""Devices on a CAN bus: interfaces, bit rate and nodes, by listening and reading alone.

Node numbers come from an upload of 1000h from each of the 127: nothing is written, started or
moved. A serial line is opened only where a person has named it, for it may belong to another
device.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event

import can

from drivers.canopen import cia
from drivers.canopen.can_link import CanLink, open_bus
from drivers.canopen.cia import Object
from drivers.canopen.sdo import Aborted, open_channel
from drivers.canopen.slcan_bus import BIT_RATES, SlcanBus
from hilcell.clock import WallClock
from hilcell.ports import Candidate, DeviceError, Identity, is_simulated_name
from hilcell.sanitize import clean

NODES = range(1, 128)
ANSWERS_S, LISTEN_S = 0.6, 0.4
USUAL = 500_000
ARPHRD_CAN = "280"  # of the kernel


@dataclass(frozen=True, slots=True)
class Found:
    """A node that answers; ``step_nm`` of an encoder's count, 0 where it does not state it."""

    node: int
    profile: int
    vendor: int
    product: int
    serial: int
    name: str
    step_nm: int = 0

    @property
    def title(self) -> str:
        kinds = {cia.DRIVE_PROFILE: "drive (CiA 402)", cia.ENCODER_PROFILE: "encoder (CiA 406)"}
        kind = kinds.get(self.profile, f"CiA {self.profile}")
        return f"node {self.node}: {kind} {self.name or 'without a name'}, serial {self.serial}"

    def options(self, role: str) -> dict[str, object]:
        scale: dict[str, object] = (
            {f"{role}_counts_per_mm": 1e6 / self.step_nm} if self.step_nm > 0 else {}
        )
        return scale | {
            f"{role}_node": self.node,
            f"{role}_vendor": self.vendor,
            f"{role}_product": self.product,
            f"{role}_serial": self.serial,
        }

    def identity(self, role: str, address: str) -> Identity:
        model = clean(f"{role} vendor 0x{self.vendor:X} product 0x{self.product:X}")
        where, simulated = f"{address} node {self.node}", is_simulated_name(self.name)
        return Identity("Rail", model, str(self.serial), where, simulated, role)


def discover(known: Mapping[str, object]) -> list[Candidate]:
    """Return drive and strip of each bus; serial lines that were not named are only listed."""
    if "channel" in known:
        channel = str(known["channel"])
        usual = "slcan" if "/" in channel else "socketcan"
        return list(_candidates(str(known.get("interface", usual)), channel, known))
    buses = [
        path.parent.name
        for path in sorted(Path("/sys/class/net").glob("*/type"))
        if path.read_text("ascii").strip() == ARPHRD_CAN
    ]
    found = [each for bus in buses for each in _candidates("socketcan", bus, known)]
    lines = sorted(str(path) for path in Path("/dev/serial/by-id").glob("*"))
    return found + [
        Candidate(f"serial line {line}, not opened", {"interface": "slcan", "channel": line}, [])
        for line in lines
    ]


def _candidates(interface: str, channel: str, known: Mapping[str, object]) -> Iterator[Candidate]:
    options: dict[str, object] = {"interface": interface, "channel": channel}
    if interface == "slcan":
        options["bitrate"] = known["bitrate"] if "bitrate" in known else _heard_rate(channel)
    nodes = _nodes(interface, channel, int(str(options.get("bitrate", USUAL))))
    drives = [each for each in nodes if each.profile == cia.DRIVE_PROFILE]
    encoders = [each for each in nodes if each.profile == cia.ENCODER_PROFILE]
    for drive in drives:
        for pair in [{"drive": drive, "strip": strip} for strip in encoders] or [{"drive": drive}]:
            all_options = dict(options)
            for role, each in pair.items():
                all_options |= each.options(role)
            title = f"{channel}: " + "; ".join(each.title for each in pair.values())
            identities = [each.identity(role, channel) for role, each in pair.items()]
            yield Candidate(title, all_options, identities)
    if not drives and nodes:
        title = f"{channel}: no drive; " + "; ".join(each.title for each in nodes)
        yield Candidate(title, options, [])


def _heard_rate(channel: str) -> int:
    """Return the bit rate at which frames are heard; the usual one where none is."""
    rates = sorted(BIT_RATES, key=lambda rate: abs(rate - USUAL))
    for rate in rates:
        with suppress(can.CanError, OSError):
            bus = SlcanBus(channel, rate, listens=True)
            try:
                message = bus.recv(LISTEN_S)
            finally:
                bus.shutdown()
            if message is not None and not message.is_error_frame:
                return rate
    return USUAL


def _nodes(interface: str, channel: str, bitrate: int) -> list[Found]:
    """Return the nodes of a bus; raises `DeviceError` where it does not open."""
    link = CanLink(open_bus(interface, channel, bitrate), WallClock(Event()))
    answers: dict[int, int] = {}

    def take(cob_id: int, data: bytearray, _at_s: float) -> None:
        if data.startswith((b"\x43\x00\x10\x00", b"\x42\x00\x10\x00")):
            answers[cob_id - 0x580] = struct.unpack_from("<I", data, 4)[0]

    try:
        for node in NODES:
            link.subscribe(0x580 + node, take)
        for node in NODES:
            link.send(0x600 + node, struct.pack("<BHBI", 0x40, Object.DEVICE_TYPE, 0, 0))
        end_s = link.time.listened_s + ANSWERS_S
        while link.time.listened_s < end_s:
            link.check()
            time.sleep(0.02)
        return [_found(link, node, answers[node] & 0xFFFF) for node in sorted(answers)]
    finally:
        link.close()


def _found(link: CanLink, node: int, profile: int) -> Found:
    eds = "strip.eds" if profile == cia.ENCODER_PROFILE else "drive.eds"
    sdo = open_channel(link, node, eds, lambda: None)
    vendor, product, serial = (sdo.read_if_present(Object.IDENTITY, sub) or 0 for sub in (1, 2, 4))
    try:
        name = clean(sdo.read_bytes(Object.DEVICE_NAME).decode("ascii", errors="replace"))
    except (Aborted, DeviceError):
        name = ""
    encoder = profile == cia.ENCODER_PROFILE
    step_nm = (sdo.read_if_present(Object.POSITION_STEP) or 0) if encoder else 0
    return Found(node, profile, vendor, product, serial, name, step_nm)
