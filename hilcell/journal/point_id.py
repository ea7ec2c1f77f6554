"""Which measurement a point is, as data; its key is formatted here and nowhere else."""

from __future__ import annotations

import msgspec

HELD, LENGTH = "held", "length"  # kinds of points that prove a hold, and the tracker's scale
BACK = "back"  # kind of a nest that was seen in the tracker's second face
REFLECTOR = "reflector"  # kind of a reflector that was carried to the first floor nest
CHECKS = (HELD, LENGTH, BACK, REFLECTOR)  # of which nothing is built
SEAT = "seat"  # begins the last part of a key of another reflector than the tool point
SIDES = {1: "+", -1: "-"}  # of an approach, in a key
CONTROL = "control"  # group of points that no plan counts
_GROUPS = {  # not named by their fields
    "slide": "frames", "three": "three_points", "base": "base", HELD: CONTROL, LENGTH: CONTROL,
    BACK: CONTROL, REFLECTOR: CONTROL, "revisit": "revisit",
}  # fmt: skip


class PointId(msgspec.Struct, frozen=True, omit_defaults=True):
    """The identity of a point. A field that does not identify it stays empty.

    ``station`` is set where the same thing is measured at several stations; ``side`` is +1 for an
    approach from above, -1 from below; ``target`` is a reflector that the cell file does not know.
    ``visit`` is the `Log.visit` of a point that holds for one stop of the slide only. ``seat`` is 2
    or more where it is not the tool point that is measured, but another reflector on the flange.
    """

    kind: str
    station: str = ""
    session: int | None = None
    turn: int | None = None  # how often the nest had been measured before, in the whole run
    vertex: tuple[int, ...] = ()
    pose: str = ""
    place: int | None = None
    how: str = ""
    way: str = ""
    axis: int | None = None
    number: int | None = None
    side: int = 0
    nest: str = ""
    target: str = ""
    visit: int | None = None
    seat: int | None = None

    @property
    def key(self) -> str:
        """Return the point's name for people, files and commands: ``validate/S300/idw/012``."""
        parts = (
            self.station,
            self.visit is not None and f"v{self.visit}",
            self.turn is not None and f"{self.session}-{self.turn}",
            self.vertex and "-".join(map(str, self.vertex)),
            self.pose,
            self.place is not None and str(self.place),
            self.how,
            self.way,
            self.axis is not None and self._axis,
            self.number is not None and f"{self.number:03d}{SIDES.get(self.side, '')}",
            self.nest,
            self.target,
            self.seat is not None and f"{SEAT}{self.seat}",
        )
        return "/".join([self.kind, *[str(part) for part in parts if part]])

    @property
    def group(self) -> str:
        """Return the name under which points are counted: ``validate_idw``."""
        if self.kind in _GROUPS:
            return _GROUPS[self.kind]
        place = "" if self.place is None else str(self.place)
        seat = "" if self.seat is None else "seats"
        return "_".join((self.kind, *filter(None, (place, self.how, self.way, self._axis, seat))))

    def at_seat(self, seat: int) -> PointId:
        """Return the identity of the same pose's reflector, numbered from 1, the tool point."""
        return msgspec.structs.replace(self, seat=None if seat == 1 else seat)

    @property
    def _axis(self) -> str:
        return "" if self.axis is None else f"axis{self.axis}"
