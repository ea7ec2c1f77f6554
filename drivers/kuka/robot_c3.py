"""A KUKA robot through C3 Bridge or KUKAVARPROXY: variables of the controller, one at a time.

C3 Bridge Interface Protocol 1.5, big-endian. Request ``tag u16, length u16 of the rest, type u8,
name length u16, name`` and, to write, ``value length u16, value``; reply ``tag, length, type, value
length, value, error u16, ok``. The two servers fill the error field differently, so only the last
byte shows success. A reply after its deadline would answer the next request, so tags are compared
and a connection that missed a reply is never used again.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial

from drivers.device_errors import ROBOT, ProtocolError
from drivers.kuka import krl
from drivers.kuka.controller import (
    NEEDS,
    PROGRAM_VERSION,
    PROGRESS,
    Controller,
    ControllerLink,
    KeepAlive,
    Need,
    value_error,
    value_errors,
)
from drivers.kuka.controller_side import variable_server
from drivers.kuka.krl import JOINTS, POSE, SLIDE
from drivers.kuka.robot import KukaOptions, KukaRobot, candidates
from drivers.supervision import HEARTBEAT_TIMEOUT_S, Deadline, ignore_stop, on_failure
from hilcell.ports import Array, Candidate, Clock, ControllerSide, DeviceError
from hilcell.sanitize import clean
from hilcell.wire.channel import Port

MAX_BODY = 4096
REPLY_S = 2.0
_HEADER = struct.Struct(">HH")


@dataclass(frozen=True, slots=True)
class Reply:
    """One reply: ``ok`` is the last byte alone."""

    tag: int
    kind: int
    value: str
    error: int
    ok: bool


def encode(tag: int, name: str, value: str | None = None) -> bytes:
    """Return the request to read a variable, or to write a value; raises `ProtocolError`."""
    text, rest = name.encode("ascii"), b""
    if value is not None:
        written = value.encode("latin-1")
        rest = struct.pack(">H", len(written)) + written
    if not 0 < len(text) <= 250 or len(rest) > MAX_BODY:
        raise ProtocolError(f"{name[:40]!r} or its value is too long for one request")
    body = struct.pack(">BH", value is not None, len(text)) + text + rest
    return _HEADER.pack(tag, len(body)) + body


def decode_header(header: bytes) -> tuple[int, int]:
    """Return tag and length of the body, which has to be read next."""
    tag, length = _HEADER.unpack(header)
    if not 6 <= length <= MAX_BODY:
        raise ProtocolError(f"a reply of {length} bytes is announced, 6 to {MAX_BODY} are possible")
    return tag, length


def decode_body(tag: int, body: bytes) -> Reply:
    kind, size = struct.unpack_from(">BH", body)
    if size != len(body) - 6:
        raise ProtocolError(f"a value of {size} bytes in a body of {len(body)}")
    (error,) = struct.unpack_from(">H", body, 3 + size)
    return Reply(tag, kind, body[3 : 3 + size].decode("latin-1"), error, body[-1] == 1)


def char_array(value: str) -> str:
    """Return the text of a CHAR array; some servers leave the quotes out, or pad it."""
    return clean(value.strip("\0 \t\r\n").strip('"').strip())


class C3Connection(ControllerLink):
    """One connection; a request has a tag."""

    _tag = 0
    _has_stopped = False

    def read(self, name: str) -> str:
        """Return the text of a variable; raises `DeviceError`."""
        return self._exchange("read", name).value

    def has(self, name: str) -> bool:
        return self._reply("read", name).ok

    def found(self, name: str) -> str | None:
        """Return a variable's text, cleaned; None where the server refuses it."""
        reply = self._reply("read", name)
        return char_array(reply.value) if reply.ok else None

    def write(self, name: str, value: str) -> None:
        """Write a variable and wait for the acknowledgement; raises `DeviceError`."""
        self._exchange("write", name, value)

    def write_without_reply(self, name: str, value: str) -> None:
        """Write without waiting for the reply; the connection is unusable afterwards."""
        with self._unheard():
            self._link.send(encode(self._next_tag(), name, value), f"write {name}")
            self._dead = f"{name} was written without waiting for its reply"
            self._has_stopped = True

    def keep_alive(self) -> None:
        """Ask something harmless, unless the stop has gone over this connection: its last use."""
        try:
            self.read("$MODE_OP")
        except DeviceError:
            if not self._has_stopped:
                raise

    def _next_tag(self) -> int:
        self._tag = self._tag % 0xFFFF + 1
        return self._tag

    def _exchange(self, act: str, name: str, value: str | None = None) -> Reply:
        reply = self._reply(act, name, value)
        if not reply.ok:
            found = f"refused with error {reply.error}"
            raise ROBOT.failed("HC-B03", f"{act} {name}", found, error=reply.error)
        return reply

    def _reply(self, act: str, name: str, value: str | None = None) -> Reply:
        operation = f"{act} {name}"
        with self._in_flight(operation):
            tag = self._next_tag()
            self._dead = f"{operation} was never answered"
            self._link.send(encode(tag, name, value), operation)
            reply = self._receive(operation, tag)
            self._dead = ""
        return reply

    def _receive(self, operation: str, tag: int) -> Reply:
        deadline = Deadline(REPLY_S)
        try:
            self._await(_HEADER.size, operation, deadline)
            found, length = decode_header(self._received[: _HEADER.size])
            if found != tag:
                raise ProtocolError(f"a reply with tag {found} came, {tag} was asked")
            end = _HEADER.size + length
            self._await(end, operation, deadline)
            body, self._received = self._received[_HEADER.size : end], self._received[end:]
            return decode_body(tag, body)
        except ProtocolError as error:
            self._dead = str(error)
            raise self._link.broken(operation, str(error)) from error

    def _await(self, size: int, operation: str, deadline: Deadline) -> None:
        while len(self._received) < size:
            piece = self._link.receive(_HEADER.size + MAX_BODY, deadline)
            if not piece:
                raise self._link.broken(operation, f"no answer within {REPLY_S:.1f} s")
            self._received += piece


class C3Controller(Controller):
    """Each poll of a motion reads HC_ACK and the next of ``poll_groups``, so that all are read
    within eight polls: with 4 to 12 ms an exchange, each of them once in 0.30 to 0.45 s.
    """

    poll_groups = (
        ("$ALARM_STOP",),
        ("$PRO_STATE1",),
        ("$MODE_OP",),
        ("$STOPMESS",),
        ("$USER_SAF",),
        ("$OV_PRO",),
        ("$PERI_RDY",),
        (PROGRESS,),
    )

    PTP_JOINTS, PTP_SLIDE = 1, 2
    MEASURED, PLACE = "$AXIS_ACT_MEAS", "$AXIS_ACT.E1"
    HEARTBEAT_S, TIMER = 0.2, "$TIMER[10]"  # of heartbeats, from the first motion on

    motion_checks = (
        "$MODE_OP",
        "$USER_SAF",
    )  # who may be near; an exchange each, and the rest follows

    def __init__(self, options: KukaC3Robot.Options, robot: KukaRobot) -> None:
        self._open = partial(C3Connection, options.host, options.port)
        self.address = f"{options.host}:{options.port}"
        self.versions = {"HC_VER": PROGRAM_VERSION}
        more = ("$AXIS_ACT", "$TIMER[10]", "HC_TGT", "HC_VEL", "HC_CMD", "HC_LIFE", "HC_OV_SET")
        limits = Need("$SOFTN_END[1]", "the cell file's joint limits are not compared", "optional")
        tool = Need(f"TOOL_DATA[{options.tool}]", "$TOOL replaces it", "optional")
        self.needs = (*NEEDS, *map(Need, more), limits, tool)
        self._line: C3Connection = self._open(robot.check_wait)
        with on_failure(self._line.close):
            # The stop must get through while the run is already stopping.
            self._stop_line: C3Connection = self._open(ignore_stop)
        self._keeper = KeepAlive(self._line, self._stop_line)
        self._due_s = math.inf  # of the next sign of life

    @cached_property
    def joints_variable(self) -> str:
        return self.MEASURED if self.has(self.MEASURED) else PROGRESS

    def refresh(self) -> None:
        """Do nothing: each variable is asked for."""

    def has(self, name: str) -> bool:
        return self._line.has(name)

    def value(self, name: str) -> krl.Value:
        with value_errors(name):
            return krl.parse(self._line.read(name))

    def numbers(self, name: str, components: tuple[str, ...]) -> list[float]:
        with value_errors(name):
            return krl.numbers(self._line.read(name), components)

    def text(self, name: str) -> str:
        return char_array(self._line.read(name))

    def found(self, name: str) -> str | None:
        return self._line.found(name)

    def limits(self, names: tuple[str, ...]) -> list[tuple[float, float]] | None:
        rows = []
        for axis, name in enumerate((*JOINTS, SLIDE), start=1):
            if name in names:
                low, high = (f"${end}_END[{axis}]" for end in ("SOFTN", "SOFTP"))
                if not (self.has(low) and self.has(high)):
                    return None
                rows.append((self._place(low), self._place(high)))
        return rows

    def tool(self, number: int) -> list[float] | None:
        for name in (f"TOOL_DATA[{number}]", "$TOOL"):
            if self.has(name):
                return self.numbers(name, POSE)
        return None

    def start(self, number: int, target_deg: Array, speed_percent: int) -> None:
        self._start(number, target_deg.tolist(), self.PTP_JOINTS, speed_percent)

    def start_slide(self, number: int, place_mm: float, speed_percent: int) -> None:
        """Write the target of E1; the program uses no other axis of it."""
        joints_deg = self.numbers(PROGRESS, JOINTS)
        self._start(number, [*joints_deg, place_mm], self.PTP_SLIDE, speed_percent)

    def _start(self, number: int, axes: list[float], command: int, speed_percent: int) -> None:
        """Write a motion, and its number last."""
        target = dict(zip((*JOINTS, SLIDE), axes, strict=False))
        self._line.write("HC_TGT", krl.structure("E6AXIS", target))
        self._line.write("HC_VEL", str(speed_percent))
        self._line.write("HC_CMD", str(command))
        if self._due_s == math.inf:  # the PC's heartbeat timeout
            self._line.write("HC_LIFE", str(round(HEARTBEAT_TIMEOUT_S * 1000)))
        self._due_s = time.monotonic() + self.HEARTBEAT_S
        self._line.write("HC_SEQ", str(number))

    def heartbeat(self) -> None:
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + self.HEARTBEAT_S
            self._line.write(self.TIMER, str(round(-HEARTBEAT_TIMEOUT_S * 1000)))

    def hold_slide(self, held: bool) -> None:
        self._line.write("HC_HELD", "TRUE" if held else "FALSE")

    def slide(self) -> tuple[float, bool]:
        """Read the place of E1, which is less to send than all axes, and whether it is held."""
        return self._place(self.PLACE), self.value("HC_HELD") is True

    def _place(self, name: str) -> float:
        place = self.value(name)
        if isinstance(place, bool | str) or not abs(place) <= krl.LARGEST:
            raise value_error(name, f"{place!r} is no place")
        return float(place)

    def brake(self) -> None:
        self._line.write("HC_STOP", "TRUE")

    def end_brake(self) -> None:
        self._line.write("HC_STOP", "FALSE")

    def lower_override(self, found: int, expected: int) -> None:
        """Write both values before the override itself."""
        self._line.write("HC_OV_SET", str(expected))
        self._line.write("HC_OV_OLD", str(found))  # from here on the controller knows its old value
        self._line.write("$OV_PRO", str(expected))
        self.check_override(expected)

    def restore_override(self) -> None:
        before = self.integer("HC_OV_OLD")
        if before == 0:
            return
        if self.integer("$OV_PRO") == self.integer("HC_OV_SET"):
            self._line.write("$OV_PRO", str(before))
        self._line.write("HC_OV_OLD", "0")

    @contextmanager
    def ignoring_stop(self) -> Iterator[C3Controller]:
        other, line = copy(self), self._open(ignore_stop)
        other._line = line  # noqa: SLF001 # of its own class
        try:
            yield other
        finally:
            line.close()

    def stop(self) -> None:
        self._stop_line.write_without_reply("HC_STOP", "TRUE")


class KukaC3Robot(KukaRobot):
    """Satisfies `hilcell.ports.Robot`, `hilcell.ports.Sweeps` and `hilcell.ports.ExternalAxis`."""

    DRIVER = "kuka-c3"

    class Options(KukaOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Address and expected identity of the controller."""

        port: Port = 7000

    def __init__(self, options: Options, clock: Clock) -> None:
        super().__init__(options, clock, partial(C3Controller, options))

    @classmethod
    def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
        """Return the controller whose variable server answers at the host, if one is given."""

        def ask(host: str, port: int) -> tuple[str, str]:
            line = C3Connection(host, port, ignore_stop)
            try:
                model, serial = char_array(line.read("$TRAFONAME[]")), line.read("$KR_SERIALNO")
            finally:
                line.close()
            return model, clean(serial.strip())

        return candidates(known, "C3 Bridge or KUKAVARPROXY", cls.Options, ask)

    @classmethod
    def controller_side(cls, options: Mapping[str, object]) -> ControllerSide:
        return variable_server(options)
