"""A controller of Universal Robots before its first run: settings, abilities, address; reads only.

The secondary client sends robot states unasked, big-endian: ``size i32, type u8``, type 16, with
sub-packages ``size i32, type u8`` (maker's page "Client interfaces"). Cartesian Info (4) has twelve
doubles, the last six the TCP's offset in m and rad; Configuration Data (6) begins with the lower
and upper limit of each joint in rad.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import closing

import numpy as np

from drivers.device_errors import ROBOT, ProtocolError
from drivers.supervision import Deadline, ignore_stop
from drivers.universal_robots.rtde import (
    INPUTS,
    OUTPUTS,
    VERSION,
    Dashboard,
    Kind,
    Packages,
    Recipe,
    UrLink,
    encode,
)
from drivers.wires import TcpLink
from hilcell.geometry.frames import from_rotvec, matrix
from hilcell.ports import Ability, Array, DeviceError

STATE, CARTESIAN, CONFIGURATION = 16, 4, 6
_HEAD, _SIX_LIMITS, _CARTESIAN = struct.Struct(">iB"), struct.Struct(">12d"), struct.Struct(">12d")
LARGEST = 65536  # bytes of a message
ANSWER_S = 3.0
QUESTIONS = ("get robot model", "get serial number", "is in remote control", "PolyscopeVersion")


def settings_of(parts: dict[int, bytes]) -> tuple[Array | None, Array | None]:
    """Return joint limits (6, 2) in rad and the tool (4, 4) in mm, of a state's sub-packages."""
    limits = tool = None
    if len(part := parts.get(CONFIGURATION, b"")) >= _SIX_LIMITS.size:
        limits = np.array(_SIX_LIMITS.unpack_from(part)).reshape(6, 2)
    if len(part := parts.get(CARTESIAN, b"")) >= _CARTESIAN.size:
        offset = np.array(_CARTESIAN.unpack_from(part)[6:])
        tool = matrix(from_rotvec(offset[3:]), 1000.0 * offset[:3])
    for name, values in (("joint limits", limits), ("TCP offset", tool)):
        if values is not None and not np.all(np.abs(values) <= 1e5):
            raise ProtocolError(f"{name} {values.ravel().tolist()}")
    return limits, tool


def sub_packages(message: bytes) -> dict[int, bytes]:
    """Return the sub-packages of a robot state, by type; raises `ProtocolError`."""
    found: dict[int, bytes] = {}
    while message:
        if len(message) < _HEAD.size:
            raise ProtocolError(f"{len(message)} bytes after the last sub-package")
        size, kind = _HEAD.unpack_from(message)
        if not _HEAD.size <= size <= len(message):
            raise ProtocolError(f"a sub-package of {size} bytes in {len(message)}")
        found[kind], message = message[_HEAD.size : size], message[size:]
    return found


def controller_settings(host: str, port: int) -> tuple[Array | None, Array | None]:
    """Read joint limits (6, 2), rad, and tool (4, 4), mm, from the secondary client.

    Raises `DeviceError`.
    """
    deadline, received = Deadline(ANSWER_S), b""
    with closing(TcpLink(ROBOT, host, port, ignore_stop)) as link:
        try:
            while True:
                while len(received) >= _HEAD.size:
                    size, kind = _HEAD.unpack_from(received)
                    if not _HEAD.size <= size <= LARGEST:
                        raise ProtocolError(f"a message of {size} bytes")
                    if len(received) < size:
                        break
                    message, received = received[_HEAD.size : size], received[size:]
                    if kind == STATE:
                        return settings_of(sub_packages(message))
                piece = link.receive(LARGEST, deadline)
                if not piece:
                    raise ProtocolError(f"no robot state within {ANSWER_S:g} s")
                received += piece
        except ProtocolError as error:
            raise link.broken("read the settings", f"{error}; is this the script port?") from error


def panel_answers(host: str, port: int) -> dict[str, str | None]:
    """Return the dashboard's answers; None where this PolyScope does not have the question."""
    with closing(Dashboard(host, port, ignore_stop)) as panel:
        return {question: panel.answer_to(question) for question in QUESTIONS}


def abilities(
    answers: dict[str, str | None], settings: Sequence[object | None], types: dict[str, str]
) -> list[Ability]:
    """Return the table of dashboard answers, settings of the secondary client, and RTDE fields."""
    rows = [
        Ability(ROBOT.name, question, "has not", "mandatory", UrLink.POLYSCOPE)
        if answer is None and question.startswith("get")
        else Ability(ROBOT.name, question, "has", "mandatory", answer)
        if answer is not None
        else Ability(ROBOT.name, question, "has not", "optional", "a CB3 is always remote")
        for question, answer in answers.items()
    ]
    rows += [
        Ability(ROBOT.name, name, "has not", "optional", "not compared with the cell file")
        if value is None
        else Ability(ROBOT.name, name, "has", "optional")
        for name, value in zip(("joint limits", "TCP offset"), settings, strict=True)
    ]
    for name, kind in types.items():
        if kind == "NOT_FOUND":
            row = Ability(ROBOT.name, name, "has not", "mandatory", UrLink.POLYSCOPE)
        elif kind == "IN_USE":
            row = Ability(ROBOT.name, name, "read only", "mandatory", "another client writes it")
        else:
            row = Ability(ROBOT.name, name, "has", "mandatory", kind)
        rows.append(row)
    return rows


def field_types(host: str, port: int, rate_hz: float) -> dict[str, str]:
    """Return the types of the RTDE fields that the driver uses; nothing is started or written."""
    with closing(TcpLink(ROBOT, host, port, ignore_stop)) as link:
        try:
            packages = _packages(link)
            link.send(encode(Kind.VERSION, struct.pack(">H", VERSION)), "version")
            if _answer(packages, Kind.VERSION) != b"\x01":
                raise ProtocolError(f"protocol version {VERSION} is refused")
            found: dict[str, str] = {}
            head = struct.pack(">d", rate_hz)
            for kind, names, start in ((Kind.OUTPUTS, OUTPUTS, head), (Kind.INPUTS, INPUTS, b"")):
                link.send(Recipe.request(kind, names, start), "fields")
                recipe = Recipe.from_answer(names, _answer(packages, kind))
                found |= dict(zip(recipe.names, recipe.types, strict=True))
        except ProtocolError as error:
            raise link.broken("read the fields", f"{error}; is rtde_port that of RTDE?") from error
    return found


def _packages(link: TcpLink) -> Iterator[tuple[int, bytes]]:
    stream, deadline = Packages(), Deadline(ANSWER_S)
    while piece := link.receive(LARGEST, deadline):
        yield from stream.feed(piece)


def _answer(packages: Iterator[tuple[int, bytes]], kind: Kind) -> bytes:
    for found, payload in packages:
        if found == kind:
            return payload
    raise ProtocolError(f"no answer to a package of type {kind}")


def describe_silence(host: str, rtde_port: int) -> str:
    """Return how a host without a dashboard server answers at the port of RTDE, "" for not."""
    try:
        TcpLink(ROBOT, host, rtde_port, ignore_stop).close()
    except DeviceError:
        return ""
    return (
        f"{host} answers at the port of RTDE ({rtde_port}), but has no dashboard server: allow it "
        "in the security settings; PolyScope X, which has none, is not supported"
    )
