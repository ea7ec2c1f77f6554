"""A point: the identity of a measurement, and its raw data."""

from __future__ import annotations

from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from hilcell.language import marked, tr
from hilcell.model.events import ReadingTime, Three

if TYPE_CHECKING:
    from hilcell.ports import Air

HELD, LENGTH = "held", "length"  # kinds of points that prove a hold, and the tracker's scale
BACK = "back"  # kind of a nest that was seen in the tracker's second face
FRONT = "front"  # and of the same in the first, just before
STEADY = "steady"  # kind of a nest that is measured time and again: the tracker's drift
REFLECTOR = "reflector"  # kind of a reflector that was carried to the first floor nest
CHECKS = (HELD, LENGTH, BACK, FRONT, STEADY, REFLECTOR)  # of which nothing is built
SEAT = "seat"  # begins the last part of a key of another reflector than the tool point
SIGNS = {1: "+", -1: "-"}  # of an approach's side, in a key
CONTROL = "control"  # group of points that no plan counts
_GROUPS = {  # not named by their fields
    "slide": "frames", "three": "three_points", "base": "base", HELD: CONTROL, LENGTH: CONTROL,
    BACK: CONTROL, FRONT: CONTROL, STEADY: CONTROL, REFLECTOR: CONTROL, "revisit": "revisit",
}  # fmt: skip


class Sent(StrEnum):
    """How a target is sent, in order: nominal, corrected by the paper's method, by the chosen
    model. The value is the key in `PointId.how` and in results.
    """

    BEFORE = "before"
    IDW = "idw"
    CHOSEN = "chosen"

    @property
    def text(self) -> str:
        return HOW[self]

    @property
    def short(self) -> str:
        return "paper" if self is Sent.IDW else self.text


BOTH = (Sent.BEFORE, Sent.CHOSEN)  # that are compared; the paper's method is measured beside them
SIDES = marked({"one_side": "from one side", "random": "from random sides"})
HOLDS = marked({"plain": "drive alone", "strip": "by the strip"})
HOW: dict[str, str] = marked(  # texts of `PointId.how` and `PointId.direction`
    {
        Sent.BEFORE: "as sent",
        Sent.IDW: "paper method",
        Sent.CHOSEN: "corrected",
        **SIDES,
        **HOLDS,
    }
)


class Kind(NamedTuple):
    """Names of a kind of points: singular, short, and plural."""

    one: str
    short: str
    all: str


KINDS = {
    "world": Kind("floor nest", "nest", "floor nests"),
    "control": Kind("check of floor nest", "check", "checks of the floor nests"),
    "length": Kind("scale: nest", "scale", "nests of certified lengths"),
    "back": Kind("second face: nest", "face 2", "nests in the second face"),
    "front": Kind("first face: nest", "face 1", "nests in the first face"),
    "steady": Kind("drift: nest", "drift", "nest of the drift"),
    "reflector": Kind("compared: reflector of", "compare", "reflectors in the same nest"),
    "held": Kind("proof of the hold: nest", "held", "proofs of the hold"),
    "slide": Kind("slide nest", "nest", "slide nests"),
    "three": Kind("slide nest", "nest", "slide nests, one reading"),
    "six": Kind("slide nest, all once more", "nest", "slide nests, all once more"),
    "survey": Kind("rail survey", "survey", "rail survey"),
    "repeat": Kind("approach of the station", "approach", "approaches of the station"),
    "touch": Kind("touched pose", "touch", "touched poses"),
    "base": Kind("base circle", "base", "base circles"),
    "frames": Kind("repeated base circle", "circle", "repeated base circles"),
    "grid": Kind("grid point", "grid", "grid points"),
    "oriented": Kind("turned grid point", "turned", "grid points, turned tool"),
    "pose": Kind("chosen pose", "pose", "chosen poses"),
    "repeatability": Kind("repeated pose", "repeat", "repeated poses"),
    "revisit": Kind("revisited pose", "revisit", "revisited poses"),
    "closing": Kind("closing pose", "closing", "closing poses"),
    "reversal": Kind("reversed pose", "reverse", "reversed poses"),
    "recheck": Kind("re-checked target", "target", "re-checked targets"),
    "target": Kind("target", "target", "targets"),
    "targets": Kind("target", "target", "targets"),
    "sweep": Kind("sweep of", "sweep", "sweeps"),
    "validate": Kind("target", "target", "targets"),
    "commission": Kind("corner of the cube", "corner", "corners of the cube"),
    "sign": Kind("sign check", "sign", "sign check"),
    "iso9283": Kind("ISO 9283 pose", "pose", "ISO 9283 poses"),
    "campaign": Kind("recorded pose", "pose", "recorded poses"),
}


class PointId(msgspec.Struct, frozen=True, omit_defaults=True, dict=True):
    """The identity of a point; a field that does not identify it is empty.

    ``station``: where several stations have the same point; ``side``: +1 for an approach from
    above, -1 from below; ``target``: a reflector missing in the cell file; ``visit``: the
    `Log.visit` of a point valid for one stop of the slide only; ``seat``: 2 or more for a reflector
    other than the tool point.
    """

    kind: str
    station: str = ""
    session: int | None = None
    # how often the nest had been measured before, in the whole run
    pass_number: int | None = msgspec.field(name="turn", default=None)
    vertex: tuple[int, ...] = ()
    pose: str = ""
    place: int | None = None
    how: str = ""
    direction: str = msgspec.field(name="way", default="")
    axis: int | None = None
    number: int | None = None
    side: int = 0
    nest: str = ""
    target: str = ""
    visit: int | None = None
    seat: int | None = None

    @cached_property
    def key(self) -> str:
        """Name for people, files and commands: ``validate/S300/idw/012``."""
        parts = (
            self.station,
            self.visit is not None and f"v{self.visit}",
            self.pass_number is not None and f"{self.session}-{self.pass_number}",
            self.vertex and "-".join(map(str, self.vertex)),
            self.pose,
            self.place is not None and str(self.place),
            self.how,
            self.direction,
            self.axis is not None and self._axis,
            self.number is not None and f"{self.number:03d}{SIGNS.get(self.side, '')}",
            self.nest,
            self.target,
            self.seat is not None and f"{SEAT}{self.seat}",
        )
        return "/".join([self.kind, *[str(part) for part in parts if part]])

    @property
    def group(self) -> str:
        if self.kind in _GROUPS:
            return _GROUPS[self.kind]
        place = "" if self.place is None else str(self.place)
        seat = "" if self.seat is None else "seats"
        return "_".join(
            (self.kind, *filter(None, (place, self.how, self.direction, self._axis, seat)))
        )

    def at_seat(self, seat: int) -> PointId:
        """The same pose's reflector, numbered from 1, the tool point."""
        return msgspec.structs.replace(self, seat=None if seat == 1 else seat)

    @property
    def _axis(self) -> str:
        return "" if self.axis is None else f"axis{self.axis}"

    def text(self, station: str = "") -> str:
        """Label: *corrected target 50 at S300*; targets count from 1. ``station``: where it was
        measured, if the identity does not say it.
        """
        at = self.station or station
        where = tr(" at {station}", station=at) if at else ""
        how = tr(HOW.get(self.how, self.how))
        match self.kind, self.how:
            case "validate", Sent.BEFORE:
                return tr("target {n} {how}{where}", n=self._counted, how=how, where=where)
            case "validate", Sent.IDW:
                return tr("target {n}{where}, {how}", n=self._counted, how=how, where=where)
            case "validate", _:
                return tr("{how} target {n}{where}", n=self._counted, how=how, where=where)
            case "sign", _:
                return tr("sign check {how}{where}", how=how, where=where)
        return f"{tr(self._kind.one)} {self._which}".rstrip() + where

    @property
    def short(self) -> str:
        how = tr(Sent(self.how).short if self.how in list(Sent) else self.how)
        if self.kind in ("validate", "sign"):
            return f"{tr('sign')} {how}" if self.kind == "sign" else f"{how} {self._counted}"
        return f"{tr(self._kind.short)} {self._which}".rstrip()

    @property
    def counted_with(self) -> str:
        """Plural label of its kind: *targets, corrected*."""
        parts = (
            tr(self._kind.all),
            "" if self.place is None else tr("place {place}", place=self.place + 1),
            tr(HOW.get(self.how, self.how)),
            tr(HOW.get(self.direction, self.direction)),
            "" if self.axis is None else tr("axis {axis}", axis=self.axis),
            "" if self.seat is None else tr("other reflectors"),
        )
        return ", ".join(filter(None, parts))

    @property
    def part(self) -> str:
        """Label of its group within a step: *corrected targets at S300*; "" for none."""
        if self.group == CONTROL:
            return tr("floor nests") if self.kind == CONTROL else tr("slide nests")
        how = tr(HOW.get(self.how, self.how))
        targets = tr("{how} targets", how=how) if self.kind == "validate" else ""
        at = tr(" at {station}", station=self.station) if self.station else ""
        return f"{targets}{at}".lstrip()

    @property
    def _kind(self) -> Kind:
        return KINDS.get(self.kind, Kind(self.kind, self.kind, self.kind))

    @property
    def _counted(self) -> str:
        seat = "" if self.seat is None else tr(", seat {seat}", seat=self.seat)
        side = SIGNS.get(self.side, "")
        return ("" if self.number is None else f"{self.number + 1}{side}") + seat

    @property
    def _which(self) -> str:
        parts = (
            self.nest,
            self.target,
            self.pose,
            "-".join(map(str, self.vertex)),
            tr(HOW.get(self.direction, self.direction)),
            tr(HOW.get(self.how, self.how)),
            "" if self.axis is None else f"A{self.axis}",
            "" if self.place is None else f"{self.place + 1}",
            self._counted,
        )
        return " ".join(filter(None, parts))


class Readings(msgspec.Struct, frozen=True, omit_defaults=True):
    """Times of the readings of a point. ``began``: the rail reading that admitted the robot's
    motion, with its age at the command.
    """

    tracker: ReadingTime
    rail: ReadingTime
    robot: ReadingTime | None = None
    began: ReadingTime | None = None

    @property
    def settled_s(self) -> float | None:
        """Time that slide and robot had been at rest; None where neither has moved."""
        both = (self.rail, self.robot)
        ends_s = [each.ended_s for each in both if each is not None and each.ended_s is not None]
        return self.tracker.taken_s - max(ends_s) if ends_s else None


class Point(msgspec.Struct, frozen=True, kw_only=True):
    """One acknowledged measurement, raw, with everything needed to evaluate it later.

    ``xyz_mm``: mean of ``samples``, in the frame of the tracker's first set-up; ``nominal_mm``:
    nominal target in {W}; ``nominal_deg``: its angles A, B, C, where orientation was measured;
    joints in deg; ``elapsed_s``: the cell's time since a series began. The controller's pose is in
    its record.
    """

    id: PointId
    key: str
    group: str
    station: str
    reflector: str
    xyz_mm: Three
    std_mm: Three
    samples: int
    session: int
    frame: str
    temperature_c: float | None = None
    pressure_mbar: float | None = None
    humidity_percent: float | None = None
    retaken: bool = False
    nominal_mm: Three | None = None
    nominal_deg: Three | None = None
    smr_mm: Three | None = None
    commanded_deg: tuple[float, ...] | None = None
    joints_deg: tuple[float, ...] | None = None
    rail_mm: float | None = None
    strip_mm: float | None = None
    readings: Readings | None = None
    elapsed_s: float | None = None
    set_up: int = 0  # at which it was measured

    @property
    def air(self) -> Air | None:
        """Air at the tracker; None without a weather station."""
        measured = (self.temperature_c, self.pressure_mbar, self.humidity_percent)
        known = [each for each in measured if each is not None]
        if len(known) < len(measured):
            return None
        from hilcell.ports import Air  # loads arrays, which most readers do without

        return Air(*known)
