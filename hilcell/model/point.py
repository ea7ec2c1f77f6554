"""A point: which measurement it is, as data, and what was measured, raw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from hilcell.model.events import ReadingTime, Three

if TYPE_CHECKING:
    from hilcell.ports import Air

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


class Readings(msgspec.Struct, frozen=True, omit_defaults=True):
    """The times of the readings that make a point.

    ``began`` is the rail's by which the robot's motion to it began, aged as it was at the command.
    """

    tracker: ReadingTime
    rail: ReadingTime
    robot: ReadingTime | None = None
    began: ReadingTime | None = None

    @property
    def settled_s(self) -> float | None:
        """Return how long slide and robot had been at rest; None where neither has moved."""
        both = (self.rail, self.robot)
        ends_s = [each.ended_s for each in both if each is not None and each.ended_s is not None]
        return self.tracker.taken_s - max(ends_s) if ends_s else None


class Point(msgspec.Struct, frozen=True, kw_only=True):
    """One acknowledged measurement, raw, with all that is needed to use it later.

    ``xyz_mm`` is the mean of ``samples``, as seen from the tracker's first set-up, ``nominal_mm``
    the nominal target in {W} and ``nominal_deg`` its angles A, B, C, where the orientation was
    measured; joints in deg. Its record also says the controller's pose.
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
    set_up: int = 0  # at which it was measured

    @property
    def air(self) -> Air | None:
        """Return the air at the tracker, or None where no weather station measured it."""
        if (
            self.temperature_c is None
            or self.pressure_mbar is None
            or self.humidity_percent is None
        ):
            return None
        from hilcell.ports import Air  # loads arrays, which most readers do without

        return Air(self.temperature_c, self.pressure_mbar, self.humidity_percent)
