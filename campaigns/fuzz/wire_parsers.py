"""Parsers of the second makes' wires, each behind its own driver's wire, of URScript and of TP.

An input arrives on the wire in pieces, of the size of its first byte; then the wire dies.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, cast

from drivers.abb.program_rapid import files as program_rapid
from drivers.device_errors import ROBOT, ProtocolError
from drivers.fanuc import program_tp
from drivers.kuka import robot_eki as eki
from drivers.kuka.robot_eki import EkiChannel
from drivers.leica.tracker_geocom import LeicaGeocomTracker, Rpc
from drivers.spatialanalyzer.tracker_t2sa import T2saTracker
from drivers.strips import SerialStrip, StripOptions
from drivers.supervision import Deadline
from drivers.universal_robots import rtde
from drivers.universal_robots.program_urscript import read_program
from drivers.universal_robots.rtde import INPUTS, OUTPUTS, UrState
from drivers.wires import Link, TextLines
from fakes.kuka.eki_server import BOMB
from hilcell.clock import WallClock
from hilcell.errors import HilcellError
from tests.clocks import DrivenClock
from tests.drivers.abb.program_rapid.samples import MODULE
from tests.drivers.fanuc.program_tp.samples import LISTING
from tests.drivers.universal_robots.program_urscript.samples import SCRIPT

ASKED = -7
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
NUMBER = 41  # of a GeoCOM request
TYPES = ",".join(
    "VECTOR6D" if name.startswith("actual") else "DOUBLE" if "double" in name else "INT32"
    for name in OUTPUTS
)


class Wire(Link):
    """What an input brings, and then nothing any more."""

    def __init__(self, data: bytes) -> None:
        super().__init__(ROBOT, "fuzz", lambda: None)
        self._size, self._left = max(data[0], 1) if data else 1, data[1:]

    def send(self, data: bytes, operation: str) -> None:
        """Take all bytes."""

    def receive(self, size: int, deadline: Deadline) -> bytes:
        """Return the next piece, none at the end."""
        return self._poll(size, wait=False)

    def _poll(self, size: int, *, wait: bool) -> bytes:
        piece, self._left = self._left[: self._size], self._left[self._size :]
        return piece

    def close(self) -> None:
        """Take it."""


def documents(data: bytes) -> None:
    """States of EthernetKRL: command -7 is answered, then the next one by what is left."""
    channel = object.__new__(EkiChannel)
    channel.check_wait = lambda: None
    channel._root, channel._link = eki.STATE, cast("Any", Wire(data))
    channel._lock, channel._received, channel._dead = threading.Lock(), b"", ""
    for number in (ASKED, ASKED - 1):
        state = channel.ask(number, eki.command(number, eki.Kind.ASK))
        for name in eki.SINGLE:
            with suppress(ProtocolError, ValueError):
                state.single(name)
        with suppress(ProtocolError, ValueError):
            state.numbers("$AXIS_ACT", AXES)


def state(number: int, place: str = "12.5") -> bytes:
    axes = " ".join(f'{axis}="{place}"' for axis in AXES)
    return (
        f'<RobotState><Command Id="{number}" Motion_Id="3" Finished_Id="3" Stopped="FALSE"/>'
        f'<Pos {axes} E1="0"/><Error Code="0"/><Status Mode_Op="#EX" Ov_Pro="100"/></RobotState>'
    ).encode("ascii")


def document_samples() -> Iterable[bytes]:
    one, two = state(ASKED), state(ASKED - 1)
    yield b"\xff" + one + two  # two documents in a packet
    yield b"\x05" + one + two  # one over many
    yield b"\xff" + state(99) + one  # the answer to another command
    yield b"\xff" + BOMB
    yield b"\xff" + one[:-30]
    yield b"\xff" + state(ASKED, "NaN") + state(ASKED - 1, "1e999")
    yield b"\xff" + one.replace(b"<Pos", b"<!-- --><Pos") + b"<![CDATA[</RobotState>"
    yield b"\xff" + b'<RobotState><Command Id="-7"><Command Id="-7"/></Command></RobotState>'


def packages(data: bytes) -> None:
    """Packages of RTDE: the answers that set recipes up, then states."""
    wire, read = Wire(data), rtde.Packages()
    recipe: rtde.Recipe | None = None
    while piece := wire.receive(0, Deadline(0.0)):
        for kind, payload in read.feed(piece):
            if kind == rtde.Kind.OUTPUTS:
                recipe = rtde.Recipe.from_answer(OUTPUTS, payload)
                if recipe.unlike():
                    return
            elif kind == rtde.Kind.INPUTS:
                rtde.Recipe.from_answer(INPUTS, payload).lacking("IN_USE")
            elif kind == rtde.Kind.DATA and recipe is not None:
                UrState.checked(recipe.decode(payload), 0.0, 0.0)


def package_samples() -> Iterable[bytes]:
    version = rtde.encode(rtde.Kind.VERSION, b"\1")
    asked = rtde.encode(rtde.Kind.CONTROLLER_VERSION, struct.pack(">4I", 5, 12, 0, 1))
    outputs = rtde.encode(rtde.Kind.OUTPUTS, b"\1" + TYPES.encode())
    lacking = rtde.encode(rtde.Kind.OUTPUTS, b"\1" + TYPES.replace("INT32", "NOT_FOUND").encode())
    recipe = rtde.Recipe(1, OUTPUTS, tuple(TYPES.split(",")))
    values: dict[str, rtde.Numbers] = {
        name: (0.5,) * 6 if kind == "VECTOR6D" else (1,)
        for name, kind in zip(OUTPUTS, recipe.types, strict=True)
    }
    good = recipe.encode(values)
    bad = recipe.encode(values | {"actual_q": (float("nan"),) * 6})
    text = rtde.encode(rtde.Kind.TEXT, b"\4text\3src\1")
    yield b"\xff" + version + asked + outputs + good + good
    yield b"\x03" + outputs + good + text + good[:-5]
    yield b"\xff" + outputs + bad
    yield b"\xff" + lacking + good
    yield b"\xff" + outputs + good[:3] + b"\2" + good[4:]  # another recipe's
    yield b"\xff" + outputs + b"\0\0\x55" + b"\xff\xff\x55"


def replies(data: bytes) -> None:
    """Lines of GeoCOM: the answers to a few requests."""
    options = LeicaGeocomTracker.Options(
        channel="socket://127.0.0.1:1", reflector="r", max_std_mm=1.0, find_radius_mm=50.0
    )
    tracker = LeicaGeocomTracker(options, WallClock(threading.Event()))
    tracker.REPLY_S = 0.0  # busy answers are asked again at once
    tracker._lines, tracker._transactions = TextLines(Wire(data)), cast("Any", iter(range(40, 99)))
    tracker._ask(Rpc.GET_NAME)
    tracker._numbers(Rpc.GET_ATMOSPHERE, 4)
    tracker._ask(Rpc.GET_MEASUREMENT, 5000, 1, accepted=True)


def reply(number: int, values: str) -> bytes:
    return f"%R1P,0,{number}:{values}\r\n".encode("ascii")


def reply_samples() -> Iterable[bytes]:
    name, air = reply(NUMBER, '0,"TDRA6000"'), reply(NUMBER + 1, "0,0.00000065,1013.25,20.0,20.0")
    yield b"\xff" + name + air + reply(NUMBER + 2, "1284,1.5,1.2,3.75")
    yield b"\x04" + name + air + reply(NUMBER + 2, "8710")
    yield b"\xff" + name + reply(77, "0,1")  # a wrong transaction id
    yield b"\xff" + name + air + reply(NUMBER + 2, "0,nan,inf,-1")[:-6]  # it dies in mid-line
    yield b"\xff" + name + b"\xfe\x80\xf8\x06" + air  # a wrong baud rate
    yield b"\xff" + b'%R1P,13,41:13\r\n%R1P,0,41,5:0,"a,b"\r\n'


def bridge_replies(data: bytes) -> None:
    """Lines of T2SA: the answers to a setting and to a measurement."""
    options = T2saTracker.Options(
        host="127.0.0.1", reflector="r", max_std_mm=1.0, find_radius_mm=50.0
    )
    tracker = T2saTracker(options, WallClock(threading.Event()))
    tracker._lines = TextLines(Wire(data), letters=True)
    tracker._exchange("!SET_SIM:0")
    tracker._position(T2saTracker.MEASURE, "P1")


def bridge_samples() -> Iterable[bytes]:
    set_, point = b"ACK-300 Set 0\r\n", b"ACK-300 Single Point Measurement A;G;P1 result "
    yield b"\xff" + set_ + point + b"1100.25,-2.5,0.125 01/05/2026 08:00:00 AM\r\n"
    yield b"\x05" + set_ + b"ACK-300 Measured single pt P1 result: X:1.0;Y:2.0;Z:-3e2;\xcf\xc2\r\n"
    yield b"\xff" + b" ERR-306: Did not find it.\r\nERR-305 Failed.\r\n"
    yield b"\xff" + set_ + point + b"nan,inf,1,5\r\n"
    yield b"\xff" + set_ + b"ERR-330 Halted.\r\nACK-300 READY\r\nACK-300 LON\r\n"


def strip_answers(data: bytes) -> None:
    """Answers of a strip on a serial line."""
    strip = SerialStrip(StripOptions(driver="serial", channel="/dev/null"), DrivenClock())
    strip._lines = TextLines(cast("Any", Wire(data)), end=b"", split=rb"\r")
    strip._identify("fuzz")
    strip.alarm_text(strip.read(lambda: None)[1])


def strip_samples() -> Iterable[bytes]:
    named = b"MSAC501>\rV1.00>\r002014003>\r"
    yield b"\xff" + named + b"+0110042>\r0x01>\r"
    yield b"\x03" + named + b"-0110042>\r?\r"
    yield b"\xff" + named + b"+01100"


def script(data: bytes) -> None:
    """A URScript program, and one with its poses moved."""
    program = read_program("p.script", data.decode("latin-1"))
    program.with_positions(program.values()[:, :3] + 1.0, "corrected")


def script_samples() -> Iterable[bytes]:
    yield SCRIPT.encode("latin-1")
    yield SCRIPT.replace("\n", "\r\n").encode("latin-1")
    yield b"def d():\n  movej(p[1.0, 0.0, 0.5, 0.0, 1.0, 0.0], a=1.4)\nend\n"


def listing(data: bytes) -> None:
    """A TP listing, and one with its positions moved."""
    program = program_tp.read_program("p.ls", data.decode("latin-1"))
    program.with_positions(program.values() + 1.0, "corrected")


def listing_samples() -> Iterable[bytes]:
    yield LISTING.encode("latin-1")
    yield LISTING.replace("\n", "\r\n").encode("latin-1")


def rapid(data: bytes) -> None:
    """A RAPID module, and one with its targets moved."""
    program = program_rapid.read_program("p.mod", data.decode("latin-1"))
    program.with_positions(program.values() + 1.0, "corrected")


def rapid_samples() -> Iterable[bytes]:
    yield MODULE.encode("latin-1")
    yield MODULE.replace("\n", "\r\n").encode("latin-1")


# Name, how bytes are handed over, what it may raise, samples.
WIRE_PARSERS = (
    ("eki", documents, (HilcellError,), document_samples),
    ("rtde", packages, (ProtocolError,), package_samples),
    ("geocom", replies, (HilcellError,), reply_samples),
    ("t2sa", bridge_replies, (HilcellError,), bridge_samples),
    ("strip", strip_answers, (HilcellError,), strip_samples),
    ("urscript", script, (HilcellError,), script_samples),
    ("tp-listing", listing, (HilcellError,), listing_samples),
    ("rapid-module", rapid, (HilcellError,), rapid_samples),
)
