"""The strip of a rail on a wire of its own. No motion needs the strip: a broken line shows as one
more alarm in its polls, as a missing magnet does, and a reading that needs it raises `StripLost`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import reduce
from operator import or_
from typing import Annotated, ClassVar, Literal

import msgspec
from msgspec import Meta

from drivers.canopen import cia
from drivers.canopen.can_link import CanLink, open_bus
from drivers.canopen.cia import Object
from drivers.canopen.nodes import Expected, Node, has_sensor_error, start_nodes
from drivers.canopen.process_image import Inbox, Pdo, Transmission
from drivers.canopen.sdo import ABSENT, Aborted
from drivers.canopen.slcan_bus import Interface, bus_problems
from drivers.device_errors import STRIP
from drivers.supervision import Deadline, on_failure
from drivers.wires import TextLines, open_link
from hilcell.cell.settings import refuse
from hilcell.ports import Clock, DeviceError, Identity, LinkStatistics, is_simulated_name
from hilcell.sanitize import clean
from hilcell.wire.channel import parse_channel

LOST = 1 << 16  # beside the sensor's own alarm bits, of which there are 16

CountsPerMm = Annotated[float, Meta(ge=-1e6, le=1e6)]  # of a strip: 1 nm and more
Positive = Annotated[float, Meta(gt=0)]
NodeNumber = Annotated[int, Meta(ge=1, le=127)]
U32 = Annotated[int, Meta(ge=0, le=2**32 - 1)]


class StripOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A strip's wire and scale: a serial line, or a CAN bus that is not the drive's.

    A negative scale counts down where the slide moves up. ``zero_mm``: the strip's reading,
    by this scale, with the slide at 0 of its travel.
    """

    driver: Literal["serial", "canopen"]
    channel: str
    counts_per_mm: CountsPerMm = 100.0
    zero_mm: float = 0.0
    serial: U32 = 0  # of the sensor; 0: any
    interface: Interface = "slcan"  # from here on: of a CAN bus
    bitrate: int = 500_000
    node: NodeNumber = 6
    vendor: U32 = 0x484
    product: U32 = 0x406

    def __post_init__(self) -> None:
        if not self.counts_per_mm:
            raise ValueError("counts_per_mm must not be 0")
        if self.driver == "serial":
            plain = {each.name: each.default for each in msgspec.structs.fields(StripOptions)}
            for key in ("interface", "bitrate", "node", "vendor", "product"):
                if getattr(self, key) != plain[key]:
                    raise ValueError(f"{key}: only of a strip with driver canopen")
            parse_channel(self.channel)
        else:
            refuse(bus_problems(self.interface, self.channel, self.bitrate))

    @property
    def scale(self) -> float:
        """Return the counts a mm, without their sign."""
        return abs(self.counts_per_mm)

    def counts(self, of_sensor: int) -> int:
        """Return counts that rise with the travel, 0 at its zero."""
        counts = of_sensor if self.counts_per_mm > 0 else -of_sensor
        return counts - round(self.zero_mm * self.scale)


class SerialStrip:
    """A sensor on a serial line, by the service commands of SIKO's sensors.

    A command is a letter, with a figure where it has one, and no end of line; every answer ends
    with ``>`` and CR. ``A0``, ``A1``, ``A2``: type, firmware, serial number; ``Z``: position,
    ``+0110042>``; ``X``: system register, ``0x01>``; ``?`` refuses a command (MSAC501-S(RS485) and
    AP10S manuals). Answers do not name their command, so a line that missed one is not used again.
    """

    BITS: ClassVar = {
        0: "the head is too far from the strip",
        1: "the absolute value is not plausible",
        2: "the slide was too fast for the head",
        4: "the head is being adjusted",
        5: "wrong values in the sensor's memory",
        6: "wrong check sum in the sensor's memory",
        7: "the sensor's memory cannot be read",
    }
    REPLY_S = 0.3  # 11 characters at 4800 baud take 25 ms

    def __init__(self, options: StripOptions, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._check = clock.check  # in each wait of its wire
        self._lines: TextLines | None = None
        self._answers = self._bad = 0

    def connect(self) -> Identity:
        self._answers = self._bad = 0
        self._check = self._clock.check
        link = open_link(STRIP, self._options.channel, self._poll)
        self._lines = TextLines(link, end=b"", split=rb"\r")
        with on_failure(self.close):
            self._lines.drop_pending()
            return self._identify(link.address)

    def read(self, check: Callable[[], None]) -> tuple[int, int]:
        """Return counts and alarms; the alarms are asked for after the counts."""
        self._check = check
        check()
        counts = int(self._ask("Z", r"[+-]\d{6,9}"))
        check()
        return self._options.counts(counts), int(self._ask("X", r"0x[0-9a-fA-F]{2}"), 16)

    def alarm_text(self, alarms: int) -> str:
        bits = [bit for bit in range(16) if alarms >> bit & 1]
        return "; ".join(self.BITS.get(bit, f"bit {bit} of its register") for bit in bits)

    def statistics(self) -> LinkStatistics:
        """Return the counts of answers, and of those in another form."""
        return LinkStatistics(frames=self._answers, bad_lines=self._bad)

    def close(self) -> None:
        lines, self._lines = self._lines, None
        if lines is not None:
            lines.link.close()

    def _poll(self) -> None:
        self._check()

    def _identify(self, address: str) -> Identity:
        model, firmware = self._ask("A0"), self._ask("A1")
        serial = self._ask("A2", r"\d{1,10}").lstrip("0")
        if self._options.serial and serial != str(self._options.serial):
            raise STRIP.refused(
                "HC-R08",
                "connect",
                f"strip sensor {serial}",
                expected=f"{self._options.serial}",
                serial=serial,
            )
        simulated = is_simulated_name(model)
        return Identity(STRIP.name, model, serial, address, simulated, "strip", "", firmware)

    def _ask(self, command: str, form: str = ".*") -> str:
        """Return the answer to a command; raises `DeviceError` for none, or one of another form."""
        lines = STRIP.connected(self._lines)
        lines.send(command, command)
        answer = lines.receive(Deadline(self.REPLY_S))
        if answer is None:
            raise lines.link.broken(
                command, f"the strip sensor did not answer in {self.REPLY_S:.1f} s"
            )
        text = answer.removesuffix(">")
        if text == answer or not re.fullmatch(form, text):
            self._bad += 1
            raise STRIP.failed(
                "HC-S13",
                f"strip, command {command}",
                f"answer {clean(answer)[:40]!r}",
                command=command,
            )
        self._answers += 1
        return clean(text)


class StripNode(Node):
    """A strip sensor by CiA 406, on the drive's bus or on one of its own."""

    def __init__(self, link: CanLink, options: StripOptions, check: Callable[[], None]) -> None:
        o, objects = options, (Object.STRIP_POSITION, Object.STRIP_ALARMS)
        expected = Expected("strip", o.node, cia.ENCODER_PROFILE, o.vendor, o.product, o.serial)
        super().__init__(link, expected, check, in_pdo=cia.SENSOR_ERRORS)
        self.pdo = Pdo(0x1800, 0x180 + o.node, Transmission.EVERY_SYNC, objects, "<iH")
        self._options = options
        self._has_alarms = True  # it has alarms of its own

    def identify(self, address: str) -> Identity:
        identity = super().identify(address)
        self._check_step()
        return identity

    def _check_step(self) -> None:
        """Refuse a strip whose step, where it has one, is not that of the cell file."""
        expected_nm = cia.step_nm(self._options.scale)
        for found_nm, where in (
            (self._step(), "6005h"),
            (self.sdo.read_if_present(Object.POSITION_STEP), "6501h"),
        ):
            if found_nm is not None and found_nm != expected_nm:
                raise STRIP.refused(
                    "HC-S07",
                    "connect",
                    f"strip step ({where}) is {found_nm} nm",
                    expected=f"{expected_nm} nm",
                    step_nm=found_nm,
                    wanted_nm=expected_nm,
                )

    def _step(self) -> int | None:
        """Return 6005h: sub-index 1 of an array, or the plain value."""
        step = self.sdo.read_if_present(Object.MEASURING_STEP, 1)
        if step is not None:
            return step
        try:
            return int.from_bytes(self.sdo.read_bytes(Object.MEASURING_STEP, 0), "little")
        except Aborted as error:
            if error.abort_code not in ABSENT:
                raise
            return None

    def map(self, inbox: Inbox) -> None:
        """Configure its PDO, for ``inbox``: without the alarms where it has no 6503h.

        Then, or where 6503h never has a position error (6504h), its emergencies have them; an
        earlier one is still in the error register.
        """
        self.pdo, whole = self.pdo.configure_most(self.sdo), self.pdo
        inbox.expect(self.pdo)
        supported = self.sdo.read_if_present(Object.SUPPORTED_ALARMS)
        silent = supported is not None and not supported & cia.POSITION_ERROR
        self._has_alarms = not silent and self.pdo is whole
        self.sensor_fails = not self._has_alarms and has_sensor_error(
            self.sdo.read(Object.ERROR_REGISTER)
        )

    def values(self, values: Mapping[int, tuple[int, ...]]) -> tuple[int, int]:
        """Return counts and alarms of a SYNC, of which ``values`` came by identifier.

        Where 6503h is absent or has none, emergencies are the alarms.
        """
        counts, *alarms = values[self.pdo.cob_id]
        if not self._has_alarms and self.sensor_fails:
            alarms.append(cia.POSITION_ERROR)
        return self._options.counts(counts), reduce(or_, alarms, 0)


class CanopenStrip:
    """A sensor by CiA 406, on a CAN bus that is not the drive's.

    Nothing moves on this bus, so the PC sends no heartbeat: it polls by SYNC, and a sensor that was
    reset or is silent is lost like any other strip.
    """

    SYNCS = 2  # while they bring nothing, a slide that may move is not supervised

    def __init__(self, options: StripOptions, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._link: CanLink | None = None
        self._set: tuple[StripNode, Inbox] | None = None
        self._statistics = LinkStatistics()

    def connect(self) -> Identity:
        self._statistics = LinkStatistics()
        options = self._options
        bus = open_bus(options.interface, options.channel, options.bitrate)
        self._link = CanLink(bus, self._clock)
        with on_failure(self.close):
            return self._set_up(self._link)

    def read(self, check: Callable[[], None]) -> tuple[int, int]:
        node, inbox = STRIP.connected(self._set)

        def look() -> None:
            check()
            node.check("strip")

        look()
        return node.values(inbox.refresh(look)[0])

    def alarm_text(self, alarms: int) -> str:
        return cia.alarm_text(alarms)

    def statistics(self) -> LinkStatistics:
        link = self._link
        return self._statistics if link is None else link.statistics()

    def close(self) -> None:
        link, self._link = self._link, None
        self._set = None
        if link is not None:
            self._statistics = link.statistics()
            link.close()

    def _set_up(self, link: CanLink) -> Identity:
        options = self._options
        node = StripNode(link, options, self._clock.check)
        inbox = Inbox(link, (node.pdo,), self.SYNCS)
        identity = node.identify(options.channel)
        node.begin_set_up()
        node.set_heartbeat(options.bitrate)
        node.map(inbox)
        start_nodes(link, (node,), self._clock.check)
        node.check("connect")
        node.arm()
        self._set = node, inbox
        return identity


Strip = SerialStrip | CanopenStrip


class StripReader:
    """The polls of one strip; one that is lost is opened again only while nothing moves."""

    def __init__(self, strip: Strip) -> None:
        self._strip = strip
        self._lost: DeviceError | None = None
        self._counts = 0
        self._before = LinkStatistics()  # of wires that were lost

    def connect(self) -> Identity:
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

    def reconnect(self) -> None:
        """Open the wire of a strip that was lost again, if it can be opened."""
        if self._lost is not None:
            self._before = self.statistics()
            try:
                self._open()
            except DeviceError as error:
                self._lost = error

    def statistics(self) -> LinkStatistics:
        """Return the counts since `connect`, including wires that were lost."""
        return self._before + self._strip.statistics()

    def alarm_text(self, alarms: int) -> str:
        if alarms & LOST and self._lost is not None:
            return self._lost.summary
        return self._strip.alarm_text(alarms & ~LOST)

    def close(self) -> None:
        self._strip.close()


def strip_of(options: StripOptions, clock: Clock) -> Strip:
    """Return the strip, not connected; a stop on ``clock`` ends every wait of its connect."""
    if options.driver == "canopen":
        return CanopenStrip(options, clock)
    return SerialStrip(options, clock)
