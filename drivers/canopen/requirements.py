"""Objects that drive and strip sensor must have, or may lack, as one table.

`docs/hardware.md` shows it, and `inspect` compares it with a device: by reading, and by writing
back what it has read, which changes nothing and shows what is read only.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from drivers.canopen import cia
from drivers.canopen.cia import Object, State
from drivers.canopen.sdo import ABSENT, Aborted, SdoChannel
from hilcell.ports import Ability

Need = Literal["mandatory", "optional"]


@dataclass(frozen=True, slots=True)
class Requirement:
    """One object; ``instead`` replaces an optional one.

    ``sub`` -1: an array or a plain value, as the maker likes. ``setting``: connect writes it;
    ``takes``: the values of which one must be, of any where it is empty.
    """

    index: int
    sub: int
    purpose: str
    needed: Need = "mandatory"
    instead: str = ""
    setting: bool = False
    takes: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        return object_name(self.index, self.sub)


def object_name(index: int, sub: int) -> str:
    return f"{index:04X}h" + (f":{sub:02X}" if sub > 0 else "")


def _may(index: int, sub: int, purpose: str, instead: str, *, setting: bool = False) -> Requirement:
    return Requirement(index, sub, purpose, "optional", instead, setting)


def _set(index: int, sub: int, purpose: str, *takes: int) -> Requirement:
    return Requirement(index, sub, purpose, setting=True, takes=takes)


COMMON = (
    Requirement(0x1000, 0, "device profile"),
    Requirement(0x1001, 0, "error register"),
    _set(0x1017, 0, "producer heartbeat"),
    Requirement(0x1018, 1, "vendor"),
    _may(0x1018, 2, "product", "not compared"),
    _may(0x1018, 4, "serial number", "not compared"),
    _may(0x1008, 0, "name", "vendor and product"),
)
DRIVE = (
    *COMMON,
    _set(0x1016, 1, "consumer heartbeat: notices that the PC has died"),
    Requirement(0x1400, 1, "an RPDO for 6040h with 607Ah; a fixed mapping of the two suffices"),
    Requirement(0x1800, 1, "a TPDO on SYNC for 6041h with 6064h; a fixed mapping suffices"),
    Requirement(0x1801, 1, "a TPDO on SYNC for 606Ch; a fixed mapping suffices"),
    _set(0x6007, 0, "abort connection option: takes 3, quick stop", 3),
    Requirement(0x6040, 0, "control word"),
    Requirement(0x6041, 0, "status word"),
    _set(0x605A, 0, "quick-stop option: takes 2; 1 without 6085h", 2, 1),
    Requirement(0x6060, 0, "mode of operation: takes 1 and 6; write-only is accepted"),
    Requirement(0x6061, 0, "mode shown, in a PDO or by SDO"),
    Requirement(0x6064, 0, "position"),
    Requirement(0x606C, 0, "speed"),
    Requirement(0x607A, 0, "target position"),
    _set(0x6081, 0, "speed of motions"),
    _set(0x6083, 0, "ramp of motions"),
    _may(0x6098, 0, "homing method", 'homing = "absolute"', setting=True),
    _may(0x6099, 1, "homing speeds", "not needed for homing 35, 37 or absolute", setting=True),
    _may(0x607C, 0, "home offset", "home_mm = 0; needed for homing 35 and 37", setting=True),
    _may(0x6084, 0, "braking ramp", "6083h holds for both", setting=True),
    _may(0x6085, 0, "quick-stop ramp", "605Ah = 1", setting=True),
    _may(0x605E, 0, "fault reaction", "the drive's own", setting=True),
    _may(0x609A, 0, "ramp of homing", "the drive's own", setting=True),
    _may(0x6067, 0, "position window", "hilcell judges the position", setting=True),
    _may(0x6068, 0, "position window time", "hilcell judges the position", setting=True),
    _may(0x606F, 0, "velocity threshold", "hilcell judges standstill", setting=True),
    _may(0x6070, 0, "velocity threshold time", "hilcell judges standstill", setting=True),
    _may(0x603F, 0, "error code", "the emergency"),
    _may(0x60FD, 0, "limit switches", "the end of the travel"),
    _may(0x6090, 1, "counts of a turn", "counts_per_turn"),
    _may(0x60A8, 0, "unit of position", "counts_per_mm"),
    _may(0x60A9, 0, "unit of speed", "speed_unit"),
    _may(0x60AA, 0, "unit of acceleration", "acceleration_unit"),
    _may(0x6502, 0, "supported modes", "the answer to 6060h"),
)
STRIP = (
    *COMMON,
    Requirement(0x1800, 1, "a TPDO on SYNC for 6004h; a fixed mapping suffices"),
    Requirement(0x6004, 0, "position"),
    _may(0x6005, -1, "measuring step", "strip_counts_per_mm"),
    _may(0x6501, 0, "position step", "strip_counts_per_mm"),
    _may(0x6503, 0, "alarms", "error register and emergencies 73xxh"),
    _may(0x6504, 0, "supported alarms", "those of 6503h are believed"),
)

MANDATORY_OF_DRIVE = frozenset(each.index for each in DRIVE if each.needed == "mandatory")
OPTIONAL_OF_DRIVE = frozenset(each.index for each in DRIVE) - MANDATORY_OF_DRIVE


def table() -> str:
    """Return both lists in Markdown."""
    rows = [
        f"| {node} | {each.name} | {each.purpose} | {each.needed} | {each.instead or '-'} |"
        for node, requirements in (("drive", DRIVE), ("strip", STRIP))
        for each in requirements
    ]
    head = ("| node | object | purpose | needed | else |", "|---|---|---|---|---|")
    return "\n".join((*head, *rows)) + "\n"


def is_off(drive: SdoChannel) -> bool:
    """Whether a drive shows that it has no power and that nothing prepares it for any."""
    try:
        state = cia.state_of(drive.read(Object.STATUSWORD))
    except Aborted:
        return False
    return state in (State.SWITCH_ON_DISABLED, State.FAULT)


def inspect(
    sdo: SdoChannel, device: str, requirements: Iterable[Requirement], *, off: bool
) -> Iterator[Ability]:
    """Compare a node with its list; raises `DeviceError` where it does not answer.

    ``off``: nothing has power, so settings are written back as they are.
    """
    for each in requirements:
        feature = f"{each.name} {each.purpose}"
        try:
            data = sdo.read_bytes(each.index, max(0, each.sub))
        except Aborted as refusal:
            absent = refusal.abort_code in ABSENT
            note = each.instead if absent else f"does not let it be read ({refusal.found})"
            yield Ability(device, feature, "has not" if absent else "has", each.needed, note)
            continue
        value = int.from_bytes(data, "little")
        note = f"0x{value:X}" if len(data) <= 4 else ""
        if not (off and each.setting and sdo.is_read_only(each.index, each.sub)):
            yield Ability(device, feature, "has", each.needed, note)
        elif each.takes and value not in each.takes:
            yield Ability(device, feature, "has not", each.needed, f"read only at {note}")
        else:
            yield Ability(device, feature, "read only", each.needed, note)
