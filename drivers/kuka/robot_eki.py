"""A KUKA robot through EthernetKRL: commands and states as XML documents over TCP.

The controller is the server of two channels. Its submit program ``eki_krl/hilcell_eki.src`` answers
each command of the first with its state, also while the robot moves or its program is halted, and
brakes by the second; motions are made by ``krl/hilcell.src``, as with `drivers.kuka.robot_c3`. The
commands of the thread that supervises a motion are heartbeats.

No length on the wire: a document ends with the closing tag of its root. Each command carries all
values, because EthernetKRL has a queue for each value, and a missing one shifts all that follow.
Each answer is a state with the Id of its command: motions have ids above 0, all other commands
below. Only Finished_Id shows that a motion has ended. An answer to an earlier command may come
late, or before the awaited one: it is never used.

A state is a flat document of elements with attributes, perhaps after `<?xml ..?>`: a document type,
entity or comment is refused before parsing. Controllers differ in capitals, and in booleans: TRUE,
FALSE or 0, 1.
"""

from __future__ import annotations

import math
import re
import secrets
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import ClassVar
from xml.parsers import expat

from drivers.device_errors import ROBOT, ProtocolError
from drivers.kuka import krl
from drivers.kuka.controller import (
    HEALTH,
    NEEDS,
    PROGRAM_VERSION,
    PROGRESS,
    Controller,
    ControllerLink,
    KeepAlive,
    Need,
    value_errors,
)
from drivers.kuka.controller_side import ethernet_krl
from drivers.kuka.krl import JOINTS, POSE, SLIDE
from drivers.kuka.robot import KukaOptions, KukaRobot, candidates
from drivers.supervision import HEARTBEAT_TIMEOUT_S, Deadline, ignore_stop, on_failure
from drivers.wires import POLL_S
from hilcell.ports import Array, Candidate, Clock, ControllerSide, DeviceError
from hilcell.sanitize import clean
from hilcell.wire.channel import Port

STATE, STOPPED = "RobotState", "RobotStopState"  # roots
LONGEST = 8192  # bytes of a document; a state has about 1000

# Variable of the controller: element and attribute.
SINGLE = {
    "HC_SEQ": ("Command", "Motion_Id"),
    "HC_ACK": ("Command", "Finished_Id"),
    "HC_STOP": ("Command", "Stopped"),
    "HC_ERR": ("Error", "Code"),
    "HC_OV_OLD": ("Override", "Old"),
    "$MODE_OP": ("Status", "Mode_Op"),
    "$PERI_RDY": ("Status", "Peri_Rdy"),
    "$STOPMESS": ("Status", "StopMess"),
    "$ALARM_STOP": ("Status", "Alarm_Stop"),
    "$USER_SAF": ("Status", "User_Saf"),
    "$PRO_STATE1": ("Status", "Pro_State1"),
    "$OV_PRO": ("Status", "Ov_Pro"),
    "$ACT_TOOL": ("Tool", "Number"),
    "$ACT_BASE": ("Base", "Number"),
    "$EX_AX_NUM": ("Slide", "Count"),
    "$AXIS_JUS[7]": ("Slide", "Mastered"),
    "HC_HELD": ("Slide", "Held"),
    "$TRAFONAME[]": ("Robot", "Model"),
    "$KR_SERIALNO": ("Robot", "Serial"),
    "HC_VER": ("Robot", "Program"),
    "HE_VER": ("Robot", "Documents"),
}

# The controller serves one client a channel and opens it again a moment after a client has gone, so
# connecting is tried for a while.
OPEN_S = 3.0  # then the channel of a client that has closed is open again


FIRST = {"$AXIS_ACT_MEAS": "A1", "$SOFTN_END": "A1", "$SOFTP_END": "A1"}  # of a structure, not X


class Kind(IntEnum):
    """Types of a command."""

    ASK = 0
    MOVE = 1
    BRAKE = 2
    RELEASE = 3
    LOWER = 4
    GIVE_BACK = 5
    HOLD_SLIDE = 6
    FREE_SLIDE = 7
    MOVE_SLIDE = 8
    LIMITS = 9


@dataclass(frozen=True, slots=True)
class State:
    """One answer: attributes as text, by element; names are without capitals."""

    BOOLEANS: ClassVar = {
        "HC_STOP", "HC_HELD", "$AXIS_JUS[7]", "$PERI_RDY", "$STOPMESS", "$ALARM_STOP", "$USER_SAF",
    }  # fmt: skip
    STRUCTURES: ClassVar = {
        "$AXIS_ACT": "Pos",
        "$AXIS_ACT_MEAS": "Pos",
        "$POS_ACT": "Pos",
        "$TOOL": "Tool",
        "$BASE": "Base",
        "$SOFTN_END": "Low",
        "$SOFTP_END": "High",
    }

    elements: Mapping[str, Mapping[str, str]]

    def text(self, element: str, attribute: str) -> str:
        try:
            return self.elements[element.casefold()][attribute.casefold()]
        except KeyError:
            raise ProtocolError(f"{element}/@{attribute} is missing") from None

    def single(self, name: str) -> krl.Value:
        value = krl.parse(self.text(*SINGLE[name]))
        return bool(value) if name in self.BOOLEANS and value in (0, 1) else value

    def numbers(self, name: str, components: Sequence[str]) -> list[float]:
        element = self.STRUCTURES[name]
        found = ", ".join(f"{each} {self.text(element, each)}" for each in components)
        return krl.numbers(f"{{{element}: {found}}}", tuple(components))


def command(
    number: int,
    kind: Kind,
    *,
    axes: Sequence[float] = (0.0,) * 6,
    e1: float = 0.0,
    percent: int = 1,
    life_ms: int = 0,
) -> bytes:
    """Return a command; ``axes`` (6,) in deg, ``e1`` in mm or deg."""
    places = dict(zip((*JOINTS, SLIDE), (*axes, e1), strict=True))
    for name, value in places.items():
        if not math.isfinite(value):
            raise ProtocolError(f"{name} {value} is not finite")
    position = " ".join(f'{name}="{value:.6f}"' for name, value in places.items())
    return (
        f'<RobotCommand Id="{number}" Type="{kind}" Percent="{percent}" Life="{life_ms}">'
        f"<Pos {position}></Pos></RobotCommand>"
    ).encode("ascii")


def stop_command(number: int, *, brake: bool) -> bytes:
    """Return a document of the stop's channel; without ``brake`` it only asks for an answer."""
    return f'<RobotStop Id="{number}" Brake="{int(brake)}"></RobotStop>'.encode("ascii")


def split(received: bytes, root: str) -> tuple[list[bytes], bytes]:
    """Return the whole documents that were received, and the rest."""
    end = f"</{root}>"
    pieces = re.split(f"({end})".encode("ascii"), received, flags=re.IGNORECASE)
    for each in pieces[::2]:
        if len(each) > LONGEST:
            raise ProtocolError(f"{len(each)} bytes without {end}, {LONGEST} are possible")
    *whole, rest = pieces[::2]
    return [begun.lstrip() + close for begun, close in zip(whole, pieces[1::2], strict=True)], rest


def parse(document: bytes, root: str) -> tuple[int, State]:
    """Return the Id and the contents of an answer; raises `ProtocolError`."""
    if prolog := re.match(rb"<\?xml\s[^<>]{0,100}\?>\s*", document):
        document = document[prolog.end() :]
    if not document.isascii() or re.search(rb"<[!?]", document):
        raise ProtocolError(f"a declaration, or bytes that are no ASCII: {document[:60]!r}")
    elements: dict[str, dict[str, str]] = {}
    path: list[str] = []

    def begin(tag: str, attributes: dict[str, str]) -> None:
        tag = tag.casefold()
        path.append(tag)
        if len(path) > 2 or path[0] != root.casefold() or tag in elements:
            raise ProtocolError(f"{'/'.join(path)[:80]} is out of place")
        elements[tag] = {name.casefold(): value for name, value in attributes.items()}
        if len(elements[tag]) != len(attributes):
            raise ProtocolError(f"{tag[:80]} has an attribute twice")

    parser = expat.ParserCreate()
    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _tag: path.pop()
    try:
        parser.Parse(document, True)
    except expat.ExpatError as error:
        raise ProtocolError(f"no XML: {error}: {document[:60]!r}") from error
    state = State(elements)
    number = state.text("Command", "Id")
    if not re.fullmatch(r"-?[0-9]{1,10}", number):
        raise ProtocolError(f"Command/@Id {number[:20]!r} is no whole number")
    return int(number), state


class EkiChannel(ControllerLink):
    """One connection, whose answers are documents."""

    ANSWER_S = 2.0
    RECEIVE = 4096

    def __init__(
        self, host: str, port: int, root: str, check: Callable[[], None], probe: bytes
    ) -> None:
        """``root`` is that of the answers; ``probe``, of Id 0, only asks for one."""
        super().__init__(host, port, check)
        self._root, self._probe = root, probe

    def ask(self, number: int, document: bytes) -> State:
        """Send a command and return its answer; raises `DeviceError`."""
        operation = f"motion {number}" if number > 0 else "command"
        with self._in_flight(operation):
            self._link.send(document, operation)
            return self._answer(number, operation)

    def send_without_reply(self, document: bytes) -> None:
        with self._unheard():
            self._link.send(document, "stop")

    def keep_alive(self) -> None:
        self.ask(0, self._probe)

    def _answer(self, number: int, operation: str) -> State:
        deadline, others = Deadline(self.ANSWER_S), 0
        while True:
            for found, state in self._documents(operation):
                if found == number:
                    return state
                others += 1
            piece = self._link.receive(self.RECEIVE, deadline)
            if not piece:
                passed = f"; {others} answers to other commands came" if others else ""
                started = f"; {len(self._received)} bytes of one came" if self._received else ""
                raise self._link.broken(
                    operation, f"no answer within {self.ANSWER_S:.1f} s{passed}{started}"
                )
            self._received += piece

    def _documents(self, operation: str) -> list[tuple[int, State]]:
        """Take the whole documents out of what was received; an unusable one ends the use."""
        try:
            whole, self._received = split(self._received, self._root)
            return [parse(document, self._root) for document in whole]
        except ProtocolError as error:
            self._dead = str(error)
            raise ROBOT.failed(
                "HC-B49",
                operation,
                f"{self._link.address}: {error}",
                expected=f"a document <{self._root}>",
                address=self._link.address,
            ) from error


def open_channel(
    host: str, port: int, root: str, check: Callable[[], None], probe: bytes
) -> EkiChannel:
    """Return a channel that has answered ``probe``; raises `DeviceError`."""
    deadline, over = Deadline(OPEN_S, OPEN_S), False
    while True:
        try:
            channel = EkiChannel(host, port, root, check, probe)
            with on_failure(channel.close):  # the controller serves one client alone
                channel.keep_alive()
        except DeviceError:
            if over:
                raise
        else:
            return channel
        over = deadline.expired()
        for _ in range(5):
            check()
            time.sleep(POLL_S)


class EkiController(Controller):
    """A refresh is an exchange of documents."""

    DOCUMENTS_VERSION = 2
    LARGEST_ID = 1_000_000_000
    LIFE_MS = round(1000 * HEARTBEAT_TIMEOUT_S)

    joints_variable = "$AXIS_ACT_MEAS"
    poll_groups = ((*HEALTH, "$OV_PRO", PROGRESS),)
    motion_checks = (*HEALTH, "$OV_PRO", "$ACT_TOOL", "$ACT_BASE")  # one document has them all

    def __init__(self, options: KukaEkiRobot.Options, robot: KukaRobot) -> None:
        self.address = f"{options.host}:{options.port}"
        self.versions = {"HC_VER": PROGRAM_VERSION, "HE_VER": self.DOCUMENTS_VERSION}
        self.needs = (*NEEDS, Need("HE_VER", "hilcell_eki.src is another version's"))
        opened = partial(open_channel, options.host)
        # Answers to an earlier session must not pass for answers to this one.
        self._number = -1 - secrets.randbelow(self.LARGEST_ID)
        self._state: State | None = None
        self._life_ms = 0
        probe, stop_probe = command(0, Kind.ASK), stop_command(0, brake=False)
        self._line: EkiChannel = opened(options.port, STATE, robot.check_wait, probe)
        with on_failure(self._line.close):
            # The stop must get through while the run is already stopping.
            self._stop_line: EkiChannel = opened(
                options.stop_port, STOPPED, ignore_stop, stop_probe
            )
        self._keeper = KeepAlive(self._stop_line)

    def refresh(self) -> None:
        """Forget the last state, so that the next value asks for one."""
        self._state = None

    def has(self, name: str) -> bool:
        """Whether a state has it, and it has all that is asked for."""
        return True

    def value(self, name: str) -> krl.Value:
        with value_errors(name):
            return self._known().single(name)

    def numbers(self, name: str, components: tuple[str, ...]) -> list[float]:
        with value_errors(name):
            return self._known().numbers(name, components)

    def text(self, name: str) -> str:
        with value_errors(name):
            return clean(self._known().text(*SINGLE[name]).strip())

    def found(self, name: str) -> str | None:
        """Return an attribute, or the first one of a structure."""
        element, attribute = SINGLE.get(name) or (State.STRUCTURES[name], FIRST.get(name, "X"))
        try:
            return clean(self._known().text(element, attribute).strip()) or None
        except ProtocolError:
            return None

    def limits(self, names: tuple[str, ...]) -> list[tuple[float, float]] | None:
        self._send(Kind.LIMITS)
        if self.found("$SOFTN_END") is None:
            return None
        low, high = (self.numbers(name, names) for name in ("$SOFTN_END", "$SOFTP_END"))
        return list(zip(low, high, strict=True))

    def tool(self, number: int) -> list[float] | None:
        """Return the active tool, if it has this number."""
        if self.found("$TOOL") is None or self.found("$ACT_TOOL") != str(number):
            return None
        return self.numbers("$TOOL", POSE)

    def start(self, number: int, target_deg: Array, speed_percent: int) -> None:
        """Send a motion; the Id of its document is its number."""
        axes, e1 = target_deg[:6].tolist(), float(sum(target_deg[6:]))
        motion = command(
            number, Kind.MOVE, axes=axes, e1=e1, percent=speed_percent, life_ms=self.LIFE_MS
        )
        self._state = self._line.ask(number, motion)

    def start_slide(self, number: int, place_mm: float, speed_percent: int) -> None:
        motion = command(
            number, Kind.MOVE_SLIDE, e1=place_mm, percent=speed_percent, life_ms=self.LIFE_MS
        )
        self._state = self._line.ask(number, motion)

    def hold_slide(self, held: bool) -> None:
        self._send(Kind.HOLD_SLIDE if held else Kind.FREE_SLIDE)

    def slide(self) -> tuple[float, bool]:
        """Return where E1 is, and whether it is held, of one state."""
        (place_mm,) = self.numbers(PROGRESS, (SLIDE,))
        return place_mm, self.value("HC_HELD") is True

    def heartbeat(self) -> None:
        """Make the next command a heartbeat; others are none, so that a motion brakes whose engine
        has died while this one polls states.
        """
        self._life_ms = self.LIFE_MS

    def brake(self) -> None:
        self._send(Kind.BRAKE)

    def end_brake(self) -> None:
        self._send(Kind.RELEASE)

    def lower_override(self, found: int, expected: int) -> None:
        """Have the controller keep the old value and set the new one."""
        self._send(Kind.LOWER, expected)
        self.check_override(expected)

    def restore_override(self) -> None:
        self._send(Kind.GIVE_BACK)

    @contextmanager
    def ignoring_stop(self) -> Iterator[EkiController]:
        """Let a stop through for a while: the controller serves one client only."""
        check, self._line.check_wait = self._line.check_wait, ignore_stop
        try:
            yield self
        finally:
            self._line.check_wait = check

    def stop(self) -> None:
        self._stop_line.send_without_reply(stop_command(1, brake=True))

    def _known(self) -> State:
        return self._state or self._send(Kind.ASK)

    def _send(self, kind: Kind, percent: int = 1) -> State:
        self._number = -1 - (-self._number) % self.LARGEST_ID
        life_ms, self._life_ms = self._life_ms, 0
        document = command(self._number, kind, percent=percent, life_ms=life_ms)
        self._state = self._line.ask(self._number, document)
        return self._state


class KukaEkiRobot(KukaRobot):
    """Satisfies `hilcell.ports.Robot`, `hilcell.ports.Sweeps` and `hilcell.ports.ExternalAxis`."""

    DRIVER = "kuka-eki"

    class Options(KukaOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Address and expected identity of the controller."""

        port: Port = 54600
        stop_port: Port = 54601

        def __post_init__(self) -> None:
            if self.port == self.stop_port:
                raise ValueError(f"stop_port: {self.stop_port} is that of port, too; they differ")

    def __init__(self, options: Options, clock: Clock) -> None:
        super().__init__(options, clock, partial(EkiController, options))

    @classmethod
    def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
        """Return the controller whose submit program answers at the host, if one is given."""

        def ask(host: str, port: int) -> tuple[str, str]:
            probe = command(0, Kind.ASK)
            with closing(open_channel(host, port, STATE, ignore_stop, probe)) as channel:
                state = channel.ask(0, probe)
            with value_errors("$TRAFONAME[]"):
                model, serial = (state.text("Robot", name) for name in ("Model", "Serial"))
            return clean(model.strip()), clean(serial.strip())

        return candidates(known, "EthernetKRL", cls.Options, ask)

    @classmethod
    def controller_side(cls, options: Mapping[str, object]) -> ControllerSide:
        return ethernet_krl(options, EkiController.DOCUMENTS_VERSION)
