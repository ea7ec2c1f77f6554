"""Every parser of what comes from outside: how bytes are handed to it, and what it may raise."""

from __future__ import annotations

import json
import queue
import struct
import tempfile
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import can
import canopen
import msgspec

from benchmarks.screen import StandIn
from campaigns.fuzz.wire_parsers import WIRE_PARSERS
from drivers.canopen import sdo
from drivers.canopen.can_link import CanLink
from drivers.canopen.cia import NodeState
from drivers.canopen.nodes import NodeMonitor
from drivers.canopen.sdo import SdoChannel
from drivers.canopen.slcan_bus import SlcanBus
from drivers.device_errors import ProtocolError
from drivers.kuka import krl, robot_c3
from drivers.kuka.program_krl.files import read_program
from drivers.leica import emscon
from fakes.leica import emscon_server
from hilcell.alarms import Latch
from hilcell.calibration.file import SEAL, _seal, read_calibration, write_calibration
from hilcell.cell.file import load_cell
from hilcell.compensation.targets import read_targets
from hilcell.errors import HilcellError
from hilcell.journal.journal import Journal, StorageError, _record, read_journal
from hilcell.journal.log import Log
from hilcell.programs.holes import read_holes
from hilcell.run.control import _Handler
from hilcell.sanitize import clean
from hilcell.tui.keys import ACTIONS
from hilcell.tui.layout import Lines
from hilcell.tui.run_view import RunView
from hilcell.tui.screens.pages import RecordRow
from hilcell.tui.session import RunUpdate
from hilcell.tui.terminal import UNICODE
from hilcell.tui.text.alarms import AlarmContext
from hilcell.tui.text.devices import DeviceText
from hilcell.tui.text.run import RunText
from tests.drivers.kuka.program_krl.samples import DAT, SRC
from tests.hilcell.calibration.calibrations import calibration as made_calibration
from tests.hilcell.tui.sample_runs import fresh
from tests.hilcell.tui.untrusted_text import NASTY, dangerous, poison

CONTEXT = AlarmContext(None, {action.name: action.keys for action in ACTIONS}, UNICODE)
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
DRIVE = 5
FEW = 4  # records of a screen
Samples = Callable[[], Iterable[bytes]]


@dataclass(frozen=True)
class Parser:
    """``feed`` hands bytes to it; what it raises besides ``declared`` is a finding."""

    name: str
    feed: Callable[[bytes], object]
    declared: tuple[type[Exception], ...]
    samples: Samples

    def take(self, data: bytes) -> None:
        """Hand over one input; raises whatever is not declared."""
        with suppress(*self.declared):
            self.feed(data)


@cache
def folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="fuzz-")


def file_of(name: str, data: bytes) -> Path:
    path = Path(folder().name, name)
    path.write_bytes(data)
    return path


# -- devices --------------------------------------------------------------------------------------


def tracker(data: bytes) -> None:
    for packet in emscon.PacketReader().feed(data):
        if isinstance(packet, emscon.Reply):
            for decode in (
                emscon.SystemStatus.decode,
                emscon.decode_tracker_name,
                emscon.Reflector.decode,
            ):
                with suppress(struct.error):
                    decode(packet.body)


def tracker_samples() -> Iterable[bytes]:
    yield emscon_server.single_result(tuple(float(n) for n in range(17)))
    yield emscon_server.status_change(1)
    for size in (0, 8, 40, 100):
        yield emscon_server.reply(1, body=bytes(range(size)))


def robot(data: bytes) -> None:
    tag, _size = robot_c3.decode_header(data[:4].ljust(4, b"\0"))
    body = data[4:]
    if not 6 <= len(body) <= robot_c3.MAX_BODY:
        return  # `decode_header` has refused it
    value = robot_c3.decode_body(tag, body).value
    with suppress(ProtocolError):
        krl.parse(value)
    krl.numbers(value, AXES)


def robot_samples() -> Iterable[bytes]:
    axes = ", ".join(f"{axis} 12.5" for axis in AXES)
    for text in ("TRUE", "#EX", '"KR"', "-1.5E3", f"{{E6AXIS: {axes}}}", "{X 1, Y NaN}"):
        body = b"\0" + len(text).to_bytes(2, "big") + text.encode() + b"\0\0\1"
        yield b"\0\7" + len(body).to_bytes(2, "big") + body


class _Replies:
    """A CAN network that answers each request with the next eight bytes of an input."""

    def __init__(self, data: bytes) -> None:
        self.left, self.client = data, cast("Any", None)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        answer, self.left = self.left[:8], self.left[8:]
        if answer:
            self.client.responses.put(answer)


class _Time:
    """Time that passes while one looks at it."""

    now_s = 0.0

    @property
    def listened_s(self) -> float:
        self.now_s += sdo.SdoChannel.LATE_S / 2
        return self.now_s


@cache
def _objects() -> canopen.ObjectDictionary:
    with resources.as_file(resources.files("drivers.canopen") / "eds" / "drive.eds") as path:
        return canopen.import_od(str(path), DRIVE)


def sdo_replies(data: bytes) -> None:
    sdo.POLL_S = 0.0
    node = canopen.RemoteNode(DRIVE, _objects())
    link = cast("CanLink", SimpleNamespace(time=_Time(), check=lambda: None))
    channel = SdoChannel(DRIVE, node, link, lambda: None)
    network = _Replies(data)
    network.client = channel._client
    channel._client.network = cast("canopen.Network", network)
    channel._client.responses = queue.Queue()
    for read in (lambda: channel.read(0x6041), lambda: channel.read_bytes(0x1008)):
        with suppress(HilcellError):
            read()
    channel.write(0x6081, 0, 7)


def sdo_samples() -> Iterable[bytes]:
    expedited = bytes.fromhex("4b41600031020000")
    segmented = bytes.fromhex("4108100003000000") + bytes.fromhex("096162630000000000")[:8]
    refused = bytes.fromhex("8041600000000206")
    yield expedited
    yield expedited + segmented + bytes.fromhex("6081600000000000438160000700000000")[:16]
    yield refused


def can_frames(data: bytes) -> None:
    """Lines of the gateway, their frames, and those that a node sends unasked."""
    bus = object.__new__(SlcanBus)
    bus._is_shutdown, bus.bad_line = True, b""
    bus.bad_lines = bus.refused = 0
    link = object.__new__(CanLink)
    link.network, link._malformed = cast("Any", canopen.Network()), 0
    link.time = cast("Any", _Time())
    link._beat_s, link._pause_s, link._paused_s = None, 0.0, 0.0
    watch = NodeMonitor(link, DRIVE)
    watch.state = NodeState.OPERATIONAL
    watch.arm()
    bus._bytes = data
    while (found := bus._line()) is not None:
        if (message := bus._message(found[0])) is not None:
            link._notify(message)
    watch.check("fuzz")


def can_samples() -> Iterable[bytes]:
    yield b"t705105\rt08581023810000000000\r"
    yield b"T000000058000102030405060708\rr0858\r\a\rz\r"


# -- files ----------------------------------------------------------------------------------------


def journal_file(data: bytes) -> None:
    Log(read_journal(file_of("journal.sqlite", data)))


def journal_samples() -> Iterable[bytes]:
    path = file_of("sample.sqlite", b"")
    path.unlink()
    journal = Journal(path, "r", create=True)
    journal.append("event", "", {"what": "text", "note": "a"})
    journal.append("verdict", "own", {"holds": True})
    journal.close()
    yield path.read_bytes()


def journal_record(data: bytes) -> None:
    """A row, its fields apart by NUL."""
    texts = [*data.split(b"\0"), b"", b"", b"", b""]
    _record((1, *texts[:4], b""))


def record_samples() -> Iterable[bytes]:
    yield b'2026-01-01T00:00:00\0event\0\0{"what": "text", "n": [1, 2.5, null]}'


def calibration(data: bytes) -> None:
    """The file, sealed again, so that more than the seal is looked at."""
    with suppress(ValueError, RecursionError):
        content = msgspec.json.decode(data)
        if isinstance(content, dict):
            content.pop(SEAL, None)
            data = msgspec.json.encode(content | {SEAL: _seal(content)})
    read_calibration(file_of("calibration.json", data))


def calibration_samples() -> Iterable[bytes]:
    for method in ("trilinear", "idw"):
        path = file_of(f"{method}.json", b"")
        write_calibration(made_calibration(method=method), path)
        yield path.read_bytes()


def cell_file(data: bytes) -> None:
    load_cell(str(file_of("cell.toml", data)))


def cell_samples() -> Iterable[bytes]:
    for name in ("paper", "replay"):
        yield (resources.files("hilcell.cells") / f"{name}.toml").read_bytes()


def krl_program(data: bytes) -> None:
    source, _, listed = data.decode("latin-1").partition("\0")
    program = read_program("p.src", source, ("p.dat", listed) if listed else None)
    positions_mm = program.values()[:, :3] + 1.0
    program.with_positions(positions_mm, "corrected")


def krl_samples() -> Iterable[bytes]:
    yield SRC.encode("latin-1") + b"\0" + DAT.encode("latin-1")
    yield b"DEF P()\nPTP {X 1,Y 2,Z 3,A 0,B 0,C 0}\nLIN {X 1.5,Y 2,Z 3,A 0,B 0,C 0} C_DIS\nEND\n"


def holes(data: bytes) -> None:
    path = file_of("holes.csv", data)
    with suppress(HilcellError):
        read_targets(path)
    read_holes(path)


def holes_samples() -> Iterable[bytes]:
    yield b"name,x_mm,y_mm,z_mm,nx,ny,nz\nH1,1,2,3,0,0,1\n"
    yield b'name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n"H,1",1.5,-2,3e2,0,75,0\n'


# -- sockets and the screen -----------------------------------------------------------------------


def control(data: bytes) -> None:
    handler = object.__new__(_Handler)
    handler.server = cast("Any", SimpleNamespace(runner=StandIn("running")))
    handler.attends = False
    for line in data.split(b"\n"):
        msgspec.json.encode(handler._answer(line[: handler.LONGEST_REQUEST]))


def control_samples() -> Iterable[bytes]:
    for command in ("status", "pause", "stop", "answer", "attend"):
        yield json.dumps({"command": command, "before": "1e9"}).encode() + b"\n"
    yield b'{"command": "retake", "key": "grid/1-1-1"}\n'


@cache
def _faulted() -> RunUpdate:
    return fresh("fault")


def screen(data: bytes) -> None:
    """A run of which a few records carry the input in every text, and how it is shown.

    The first byte says which records.
    """
    sample = _faulted()
    at = int.from_bytes(data[:1]) % len(sample.records)
    few = replace(sample, records=sample.records[at : at + FEW])
    found = poison(few, data[1:].decode("utf-8", errors="replace"))
    view = RunView("run", status=found.status)
    for record in (*sample.records[:FEW], *found.records):
        view.take(record)
    shown: list[Lines] = [
        RunText(view).identity(),
        RunText(view).step(),
        RunText(view).banner(),
        DeviceText(view).lamps(),
        DeviceText(view).interlocks(),
        CONTEXT.page(view.alarms, Latch()),
    ]
    painted = [
        *(line.plain for each in shown for line in each.lines(80)),
        *(cell for record in view.records for cell in RecordRow.of(record)),
    ]
    for text in painted:
        assert not dangerous(clean(text)), text


def screen_samples() -> Iterable[bytes]:
    return (bytes([n]) + text.encode() for n, text in enumerate(NASTY.values()))


PARSERS = {
    parser.name: parser
    for parser in (
        Parser("tracker", tracker, (ProtocolError,), tracker_samples),
        Parser("robot", robot, (ProtocolError,), robot_samples),
        Parser("sdo", sdo_replies, (HilcellError,), sdo_samples),
        Parser("can", can_frames, (HilcellError, can.CanError), can_samples),
        Parser("journal-record", journal_record, (ValueError, TypeError), record_samples),
        Parser("journal-file", journal_file, (StorageError,), journal_samples),
        Parser("calibration", calibration, (HilcellError,), calibration_samples),
        Parser("cell", cell_file, (HilcellError,), cell_samples),
        Parser("krl-program", krl_program, (HilcellError,), krl_samples),
        Parser("holes", holes, (HilcellError,), holes_samples),
        Parser("control", control, (), control_samples),
        Parser("screen", screen, (), screen_samples),
        *(Parser(*each) for each in WIRE_PARSERS),
    )
}
