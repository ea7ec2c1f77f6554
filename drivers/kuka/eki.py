"""Documents of `eki_krl`: commands to a KUKA controller and its answers, as XML over TCP.

Nothing on the wire states a length: a document ends with the closing tag of its root. Each command
carries all values, because EthernetKRL keeps a queue for each value, and one that is left out
shifts all that follow. Each answer is a state of the controller, with the Id of the command that it
answers: motions have ids above 0, all other commands below. Only Finished_Id says that a motion has
ended.

A state is a flat document of elements with attributes, perhaps behind `<?xml ..?>`, which says
nothing more. So no document type, entity or comment is ever needed: a document that has one is
refused before it is parsed. Controllers differ in capitals, and write booleans as words or as 0, 1.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from xml.parsers import expat

from drivers.kuka import krl
from drivers.kuka.health import AXES, SLIDE

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
BOOLEANS = {
    "HC_STOP", "HC_HELD", "$AXIS_JUS[7]", "$PERI_RDY", "$STOPMESS", "$ALARM_STOP", "$USER_SAF",
}  # fmt: skip
STRUCTURES = {
    "$AXIS_ACT": "Pos",
    "$AXIS_ACT_MEAS": "Pos",
    "$POS_ACT": "Pos",
    "$TOOL": "Tool",
    "$BASE": "Base",
}


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


class EkiError(ValueError):
    """Bytes that are no document of the controller's program."""


@dataclass(frozen=True, slots=True)
class State:
    """One answer: attributes as text, by element; names are without capitals."""

    elements: Mapping[str, Mapping[str, str]]

    def text(self, element: str, attribute: str) -> str:
        """Return an attribute."""
        try:
            return self.elements[element.casefold()][attribute.casefold()]
        except KeyError:
            raise EkiError(f"{element}/@{attribute} is missing") from None

    def single(self, name: str) -> krl.Value:
        """Return a single variable of the controller."""
        value = krl.parse(self.text(*SINGLE[name]))
        return bool(value) if name in BOOLEANS and value in (0, 1) else value

    def numbers(self, name: str, components: Sequence[str]) -> list[float]:
        """Return components of a structure."""
        element = STRUCTURES[name]
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
    places = dict(zip((*AXES, SLIDE), (*axes, e1), strict=True))
    for name, value in places.items():
        if not math.isfinite(value):
            raise EkiError(f"{name} {value} is not finite")
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
            raise EkiError(f"{len(each)} bytes without {end}, {LONGEST} are possible")
    *whole, rest = pieces[::2]
    return [begun.lstrip() + close for begun, close in zip(whole, pieces[1::2], strict=True)], rest


def parse(document: bytes, root: str) -> tuple[int, State]:
    """Return the Id and the contents of an answer; raises `EkiError`."""
    if prolog := re.match(rb"<\?xml\s[^<>]{0,100}\?>\s*", document):
        document = document[prolog.end() :]
    if not document.isascii() or re.search(rb"<[!?]", document):
        raise EkiError(f"a declaration, or bytes that are no ASCII: {document[:60]!r}")
    elements: dict[str, dict[str, str]] = {}
    path: list[str] = []

    def begin(tag: str, attributes: dict[str, str]) -> None:
        tag = tag.casefold()
        path.append(tag)
        if len(path) > 2 or path[0] != root.casefold() or tag in elements:
            raise EkiError(f"{'/'.join(path)[:80]} is out of place")
        elements[tag] = {name.casefold(): value for name, value in attributes.items()}
        if len(elements[tag]) != len(attributes):
            raise EkiError(f"{tag[:80]} has an attribute twice")

    parser = expat.ParserCreate()
    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _tag: path.pop()
    try:
        parser.Parse(document, True)
    except expat.ExpatError as error:
        raise EkiError(f"no XML: {error}: {document[:60]!r}") from error
    state = State(elements)
    number = state.text("Command", "Id")
    if not re.fullmatch(r"-?[0-9]{1,10}", number):
        raise EkiError(f"Command/@Id {number[:20]!r} is no whole number")
    return int(number), state
