"""EthernetKRL on a KUKA controller, over TCP, and its submit program hilcell_eki.src.

Each configured value of a document has its own queue, so a missing one shifts all later ones. The
program takes one value of each queue, acts on the variables of hilcell.src, and replies with a
state. Each of the two channels serves one client. The stop channel is polled once a cycle of the
submit interpreter, and all data are processed, even after the client has gone. States are sent as
`fakes.wires` describes; occasionally the previous one is repeated in one segment with the next.
"""

from __future__ import annotations

import re
import select
import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import pairwise
from typing import ClassVar
from xml.parsers import expat

from fakes.faults import Faults
from fakes.kuka.controller import AXES, FRAME, KrlController, KrlError, aggregate, raw_members
from fakes.replay.dialects import Dialect, Options
from fakes.site import Site
from fakes.time import CellTime
from fakes.wires import HOST, RECEIVE, Answers, Listener, Segments, Server

RECEIVED = (
    *(f"RobotCommand/@{name}" for name in ("Id", "Type", "Percent", "Life")),
    *(f"RobotCommand/Pos/@{name}" for name in (*AXES, "E1")),
)


class Overflow(Exception):
    """A queue is full: the interface closes the connection."""


class Queues:
    """The received values of one channel, by their paths."""

    LENGTH = 16  # values; one more closes the connection

    def __init__(self, paths: tuple[str, ...]) -> None:
        self._queues: dict[str, deque[str]] = {path: deque() for path in paths}
        self._end = f"</{paths[0].partition('/')[0]}>".encode()
        self._pending = b""

    def poll(self, client: socket.socket) -> bool:
        """Process received data; return whether the client is still connected."""
        try:
            while select.select([client], [], [], 0)[0]:
                data = client.recv(RECEIVE)
                if not data:
                    return False
                self.receive(data)
        except (OSError, Overflow, KrlError):
            return False  # the interface closes the connection, and keeps the data
        return True

    def receive(self, data: bytes) -> None:
        """Process complete documents; raises as `add`."""
        *documents, self._pending = (self._pending + data).split(self._end)
        for document in documents:
            self.add(document + self._end)

    def add(self, document: bytes) -> None:
        """Queue the values of a document; raises `Overflow`, or `KrlError` for invalid XML."""
        path: list[str] = []

        def begin(tag: str, attributes: dict[str, str]) -> None:
            path.append(tag)
            for name, text in attributes.items():
                queue = self._queues.get(f"{'/'.join(path)}/@{name}")
                if queue is not None:
                    queue.append(text)
                    if len(queue) > self.LENGTH:
                        raise Overflow

        parser = expat.ParserCreate()
        parser.StartElementHandler = begin
        parser.EndElementHandler = lambda _tag: path.pop()
        try:
            parser.Parse(document, True)
        except expat.ExpatError as error:
            raise KrlError(str(error)) from error

    def waiting(self) -> bool:
        """Whether the last path has a value: the document is complete."""
        return bool(next(reversed(self._queues.values())))

    def take(self) -> dict[str, str]:
        """Return one value of each queue that is not empty, by name."""
        queues = self._queues.items()
        return {path.rpartition("@")[2]: queue.popleft() for path, queue in queues if queue}


class EkiProgram:
    """One cycle of the submit program for each command."""

    STATUS: ClassVar = {
        "Mode_Op": "$MODE_OP",
        "Peri_Rdy": "$PERI_RDY",
        "StopMess": "$STOPMESS",
        "Alarm_Stop": "$ALARM_STOP",
        "User_Saf": "$USER_SAF",
        "Pro_State1": "$PRO_STATE1",
        "Ov_Pro": "$OV_PRO",
    }
    COMMAND: ClassVar = {"Motion_Id": "HC_SEQ", "Finished_Id": "HC_ACK", "Stopped": "HC_STOP"}
    SLIDE: ClassVar = {"Count": "$EX_AX_NUM", "Mastered": "$AXIS_JUS[7]", "Held": "HC_HELD"}
    OTHERS = (
        "HC_ERR", "HC_OV_OLD", "HC_VER", "$TRAFONAME[]", "$KR_SERIALNO", "$ACT_TOOL", "$ACT_BASE",
    )  # fmt: skip
    PLACES = ("$AXIS_ACT_MEAS", "$POS_ACT", "$TOOL", "$BASE")
    NAMES = (*COMMAND.values(), *STATUS.values(), *SLIDE.values(), *OTHERS, *PLACES)

    def __init__(self, controller: KrlController, faults: Faults, time: CellTime) -> None:
        self._controller, self._faults, self._time = controller, faults, time

    def command(self, values: dict[str, str]) -> bytes:
        """Execute a command; return the state. Raises `KrlError` for an incomplete one."""
        if len(values) < len(RECEIVED):
            raise KrlError(f"{len(values)} of {len(RECEIVED)} values")
        acts: dict[str, Callable[[dict[str, str]], None]] = {
            "1": lambda _: self._start("1", {axis: float(values[axis]) for axis in AXES}, values),
            "2": lambda _: self._controller.write("HC_STOP", "TRUE"),
            "3": lambda _: self._controller.write("HC_STOP", "FALSE"),
            "4": self._lower_override,
            "5": self._restore_override,
            "6": lambda _: self._controller.write("HC_HELD", "TRUE"),
            "7": lambda _: self._controller.write("HC_HELD", "FALSE"),
            "8": lambda _: self._start("2", {"E1": float(values["E1"])}, values),
        }
        if int(values["Life"]) > 0:
            self._controller.write("$TIMER[10]", "-" + values["Life"])
        if values["Type"] in acts:
            acts[values["Type"]](values)
        wrong = int(self._faults.strikes("robot.tag_mismatch"))
        state = self._state(int(values["Id"]) + wrong, limits=values["Type"] == "9")
        document_s = 0.016  # from reading the variables of a state to sending it
        self._time.spend(document_s)
        return state

    def stop(self, values: dict[str, str]) -> bytes:
        """Execute a command of the stop channel; return the reply."""
        if values.get("Brake") != "0":  # any other text brakes
            self._controller.write("HC_STOP", "TRUE")
        return _document("RobotStopState", {"Command": {"Id": values.get("Id", "0")}})

    def client_lost(self) -> None:
        """Brake a motion whose client has gone."""
        started, ended = self._controller.read_all(("HC_SEQ", "HC_ACK"))
        if started != ended:
            self._controller.write("HC_STOP", "TRUE")

    def _start(self, command: str, target: dict[str, float], values: dict[str, str]) -> None:
        for name, text in (
            ("HC_TGT", aggregate("E6AXIS", target)),
            ("HC_VEL", values["Percent"]),
            ("HC_CMD", command),
            ("HC_LIFE", values["Life"]),
            ("HC_SEQ", values["Id"]),
        ):
            self._controller.write(name, text)

    def _lower_override(self, values: dict[str, str]) -> None:
        before = self._controller.read("$OV_PRO")
        self._controller.write("HC_OV_SET", values["Percent"])
        self._controller.write("HC_OV_OLD", before)
        self._controller.write("$OV_PRO", values["Percent"])

    def _restore_override(self, _values: dict[str, str]) -> None:
        before = self._controller.read("HC_OV_OLD")
        if before != "0":
            if self._controller.read("$OV_PRO") == self._controller.read("HC_OV_SET"):
                self._controller.write("$OV_PRO", before)
            self._controller.write("HC_OV_OLD", "0")

    def _state(self, number: int, *, limits: bool) -> bytes:
        texts = dict(zip(self.NAMES, self._controller.read_all(self.NAMES), strict=True))
        ends: dict[str, dict[str, str]] = {}
        for element, end in (("Low", "SOFTN"), ("High", "SOFTP")) if limits else ():
            names = [f"${end}_END[{axis}]" for axis in range(1, 8)]
            found = self._controller.read_all(names)
            ends[element] = dict(zip((*AXES, "E1"), found, strict=True))

        def named(names: dict[str, str]) -> dict[str, str]:
            return {attribute: texts[name] for attribute, name in names.items()}

        axes, pose, tool, base = (raw_members(texts[name]) for name in self.PLACES)
        return _document(
            "RobotState",
            {
                "Command": {"Id": str(number)} | named(self.COMMAND),
                "Pos": {name: axes[name] for name in (*AXES, "E1")}
                | {name: pose[name] for name in (*FRAME, "S", "T")},
                "Status": named(self.STATUS),
                "Tool": {"Number": texts["$ACT_TOOL"]} | {name: tool[name] for name in FRAME},
                "Base": {"Number": texts["$ACT_BASE"]} | {name: base[name] for name in FRAME},
                "Override": {"Old": texts["HC_OV_OLD"]},
                "Slide": named(self.SLIDE),
                "Robot": {
                    "Model": texts["$TRAFONAME[]"].strip('"'),
                    "Serial": texts["$KR_SERIALNO"],
                    "Program": texts["HC_VER"],
                    "Documents": "2",
                },
                "Error": {"Code": texts["HC_ERR"]},
            }
            | ends,
        )


def _document(root: str, elements: dict[str, dict[str, str]]) -> bytes:
    body = ""
    for element, each in elements.items():
        attributes = " ".join(f'{name}="{text}"' for name, text in each.items())
        body += f"<{element} {attributes}/>"
    return f"<{root}>{body}</{root}>".encode("ascii", "replace")


BOMB = (
    b'<!DOCTYPE RobotState [<!ENTITY a "1"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    b'<RobotState><Command Id="&b;"/></RobotState>'
)


class EkiServer(Server):
    """Serves one controller on two ports, 0 for ones that the system chooses."""

    def __init__(self, site: Site, port: int = 0) -> None:
        self._faults, self._time = site.faults, site.time
        self.controller = KrlController(site)
        self._program = EkiProgram(self.controller, site.faults, site.time)
        self._lock = threading.Lock()  # of the submit interpreter, which is one
        stop_port = port + 1 if port else 0
        listener = partial(Listener, limit=1, vanish=self._hang_up)
        self._commands = listener("eki", self._serve_commands, port=port)
        self._stops = listener("eki stop", self._serve_stops, port=stop_port)
        self.port, self.stop_port = self._commands.port, self._stops.port
        address = {"host": HOST, "port": self.port, "stop_port": self.stop_port}
        super().__init__(address, self._commands, self._stops, restore=self.controller.restore)
        self._answers = Answers(site.faults, self._closing)

    def _serve_commands(self, client: socket.socket) -> None:
        with suppress(OSError, Overflow, ValueError):  # the interface hangs up, too
            self._receive_commands(client)
        with self._lock:
            if not self._closing.is_set():
                self._program.client_lost()

    def _receive_commands(self, client: socket.socket) -> None:
        segments, former = Segments(client.sendall), b""
        queues = Queues(RECEIVED)
        while data := client.recv(RECEIVE):
            queues.receive(data)
            while queues.waiting():
                with self._lock:
                    state = self._program.command(queues.take())
                    self._time.catch_up()
                    sent, former = self._with_faults(former, state, segments), state
                    if not self._answers.send(client, segments, sent):
                        return

    def _serve_stops(self, client: socket.socket) -> None:
        queues, there = Queues(("RobotStop/@Id", "RobotStop/@Brake")), True
        cycle_s = 0.06  # of the submit interpreter, with a state in it
        with suppress(ValueError):
            while there:
                select.select([client], [], [])
                self._closing.wait(cycle_s)
                there = queues.poll(client)
                self._receive_stops(client, queues, there)

    def _receive_stops(self, client: socket.socket, queues: Queues, there: bool) -> None:
        while queues.waiting():
            with self._lock:
                answer = self._program.stop(queues.take())
            if there:
                with suppress(OSError):  # the next poll finds that it has gone
                    client.sendall(answer)

    def _hang_up(self) -> None:
        for each in (self._commands, self._stops):
            each.hang_up()

    def _with_faults(self, former: bytes, state: bytes, segments: Segments) -> bytes:
        if self._faults.strikes("robot.xml_bomb"):
            return BOMB
        endless = b'<RobotState><Pos A1="' + b"0" * 20_000
        if self._faults.strikes("robot.no_end"):
            return endless
        again = self._faults.strikes("robot.glued_reply")
        twice_every = 53
        return former + state if again or segments.sent % twice_every == twice_every - 1 else state


serve = EkiServer


# -- its documents in recordings ------------------------------------------------------------------

_ASKED = re.compile(rb'(<(?:RobotCommand|RobotStop|Command)\s+Id=")(-?\d+)(")')


class Eki(Dialect):
    """Commands with an Id, and states that repeat it; Ids of motions are above 0.

    The number and the sign of life are not part of a question.
    """

    END = re.compile(rb"</Robot\w+>")
    LIFE = re.compile(rb' Life="\d+"')

    def split(self, data: bytes) -> tuple[list[bytes], bytes]:
        ends = [0, *(found.end() for found in self.END.finditer(data))]
        return [data[a:b] for a, b in pairwise(ends)], data[ends[-1] :]

    def name(self, message: bytes) -> bytes:
        """Return the document without the Id of a question, and without its sign of life."""
        return _ASKED.sub(self._kept, self.LIFE.sub(b"", message))

    def belongs(self, answer: bytes, asked: bytes) -> bool:
        """Whether both have one Id: a state may come once more, with the next."""
        return self._id(answer) == self._id(asked)

    def answer(self, asked: bytes, recorded: bytes, answer: bytes) -> bytes:
        """Return the state with the Id of this command, where it has the recorded one's."""
        if self._id(answer) != self._id(recorded):
            return answer
        return _ASKED.sub(rb"\g<1>" + self._id(asked) + rb"\g<3>", answer, count=1)

    @staticmethod
    def _id(message: bytes) -> bytes:
        found = _ASKED.search(message)
        return b"" if found is None else found[2]

    @staticmethod
    def _kept(found: re.Match[bytes]) -> bytes:
        return found[0] if int(found[2]) > 0 else found[1] + found[3]


def kuka_eki(_options: Options) -> dict[str, Dialect]:
    return {"": Eki(), "stop": Eki()}
