"""A KUKA controller for tests behind two EthernetKRL channels: the variables of `KukaPeer`."""

from __future__ import annotations

import re
import socket
from collections.abc import Callable, Iterator

from tests.drivers.kuka.kuka_peer import KukaPeer
from tests.drivers.peers import Server

STATUS = (
    ("Mode_Op", "$MODE_OP"), ("Peri_Rdy", "$PERI_RDY"), ("StopMess", "$STOPMESS"),
    ("Alarm_Stop", "$ALARM_STOP"), ("User_Saf", "$USER_SAF"), ("Pro_State1", "$PRO_STATE1"),
    ("Ov_Pro", "$OV_PRO"),
)  # fmt: skip
ANSWER = b'<RobotStopState><Command Id="%d"/></RobotStopState>'


class EkiPeer(KukaPeer):
    """One client a channel; ``spoil`` changes the bytes of an answer to a command's Id."""

    def __init__(self, **changed: str) -> None:
        super().__init__(HE_VER="2", **changed)
        self.commands: list[dict[str, str]] = []
        self.spoil: Callable[[int, bytes], list[bytes]] = lambda _number, answer: [answer]
        self.stop_server = Server(self._serve_stops)

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self.stop_server.close()

    def _serve(self, connection: socket.socket) -> None:
        for document in _documents(connection, b"</RobotCommand>"):
            values = dict(re.findall(r'(\w+)="([^"]*)"', document))
            number = int(values["Id"])
            with self._lock:
                self.commands.append(values)
                self._act(values)
                answer = self._state(number, limits=values["Type"] == "9")
            for piece in self.spoil(number, answer):
                connection.sendall(piece)

    def _serve_stops(self, connection: socket.socket) -> None:
        for document in _documents(connection, b"</RobotStop>"):
            with self._lock:
                if 'Brake="1"' in document:
                    self._write("HC_STOP", b"TRUE")
            connection.sendall(ANSWER % int(re.findall(r'Id="(-?\d+)"', document)[0]))

    def _act(self, values: dict[str, str]) -> None:
        axes = ", ".join(f"A{n} {values[f'A{n}']}" for n in range(1, 7))
        writes = {
            "1": {"HC_TGT": f"{{{axes}}}", "HC_LIFE": values["Life"], "HC_SEQ": values["Id"]},
            "2": {"HC_STOP": "TRUE"},
            "3": {"HC_STOP": "FALSE"},
            "4": {"HC_OV_OLD": self.variables["$OV_PRO"], "$OV_PRO": values["Percent"]},
            "6": {"HC_HELD": "TRUE"},
            "5": {"$OV_PRO": self.variables["HC_OV_OLD"], "HC_OV_OLD": "0"},
        }.get(values["Type"], {})
        for name, text in writes.items():
            self._write(name, text.encode())

    def _state(self, number: int, *, limits: bool) -> bytes:
        ends = " ".join(
            f"<{element} "
            + " ".join(
                f'{axis}="{self.variables.get(f"${end}_END[{n}]", "0.0")}"'
                for n, axis in enumerate(("A1", "A2", "A3", "A4", "A5", "A6", "E1"), start=1)
            )
            + "/>"
            for element, end in (("Low", "SOFTN"), ("High", "SOFTP"))
            if limits
        )
        acknowledged = self._read("HC_ACK")
        get = self.variables.__getitem__
        status = " ".join(f'{name}="{get(variable)}"' for name, variable in STATUS)
        motions = f'Motion_Id="{get("HC_SEQ")}" Finished_Id="{acknowledged}"'
        tool, base = (_attributes(get(name)) for name in ("$TOOL", "$BASE"))
        model = get("$TRAFONAME[]").strip('"')
        robot = f'Model="{model}" Serial="{get("$KR_SERIALNO")}" Program="{get("HC_VER")}"'
        axes, pose = (_attributes(self._read(name) or "") for name in ("$AXIS_ACT", "$POS_ACT"))
        return (
            f'<RobotState><Command Id="{number}" {motions} Stopped="{get("HC_STOP")}"/>'
            f'<Pos {axes} {pose}/><Status {status}/><Tool Number="{get("$ACT_TOOL")}" {tool}/>'
            f'<Base Number="{get("$ACT_BASE")}" {base}/>'
            f'<Slide Count="{get("$EX_AX_NUM")}" Mastered="TRUE" Held="{get("HC_HELD")}"/>'
            f'<Override Old="{get("HC_OV_OLD")}"/>'
            f'<Robot {robot} Documents="{get("HE_VER")}"/>{ends}'
            f'<Error Code="{get("HC_ERR")}"/></RobotState>'
        ).encode()


def _documents(connection: socket.socket, end: bytes) -> Iterator[str]:
    pending = b""
    while piece := connection.recv(4096):
        *whole, pending = (pending + piece).split(end)
        for document in whole:
            yield document.decode()


def _attributes(structure: str) -> str:
    return " ".join(f'{n}="{v}"' for n, v in re.findall(r"([A-Z]\d?) (-?[^\s,}]+)", structure))
