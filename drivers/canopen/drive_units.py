"""The units and signs of a drive; conversion at the edge of its bus.

Inside the driver positions are counts that rise with the slide's travel, speeds counts/s and
accelerations counts/s^2; a count is the drive's own unit of position (6064h). A drive has its units
of speed (6081h, 6099h, 606Ch, 606Fh) and acceleration (6083h to 6085h, 609Ah), which some state in
60A9h and 60AAh, coded as CiA 303-2: power of ten, numerator, denominator.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import ClassVar

PER_MINUTE = 60.0
METRE, DEGREE, REVOLUTION, INCREMENT, RPM = 0x01, 0x41, 0xB4, 0xB5, 0xC0  # numerators
SECOND, MINUTE, SQUARE_SECOND = 0x03, 0x47, 0x57  # denominators
VELOCITY_ENCODER = 0x6090  # counts a turn: increments, revolutions


@dataclass(frozen=True, slots=True)
class Unit:
    """A power of ten of counts, turns of the motor or mm, per second or minute."""

    FORM: ClassVar = re.compile(
        r"(?:(1|10+|0\.0*1) )?(counts/s|rps|rpm|mm/s|counts/s\^2|rps/s|rpm/s|mm/s\^2)"
    )
    OF_ACCELERATION: ClassVar = ("counts/s^2", "rps/s", "rpm/s", "mm/s^2")
    FORMS: ClassVar = (
        '"counts/s", "rpm", "rps", "mm/s", or for accelerations "counts/s^2", "rpm/s", "rps/s", '
        '"mm/s^2", each behind a power of ten if it has one: "0.1 counts/s"'
    )

    text: str
    factor: float
    base: str  # counts, rps, rpm or mm

    @classmethod
    def of(cls, text: str) -> Unit:
        """Return the unit of a text such as "0.1 counts/s"; raises `ValueError`."""
        match = cls.FORM.fullmatch(text)
        if match is None:
            raise ValueError(f"unit {text!r}; expected {cls.FORMS}")
        return cls(text, float(match[1] or 1), match[2].partition("/")[0])

    @classmethod
    def stated(cls, code: int, *, of_acceleration: bool = False) -> Unit | None:
        """Return the unit that 60A9h or 60AAh states; None for another one."""
        power = (code >> 24 ^ 0x80) - 0x80
        base = {
            (INCREMENT, SECOND): "counts/s",
            (REVOLUTION, MINUTE): "rpm",
            (REVOLUTION, SECOND): "rps",
            (METRE, SECOND): "mm/s",
            (INCREMENT, SQUARE_SECOND): "counts/s^2",
            (RPM, SECOND): "rpm/s",
            (REVOLUTION, SQUARE_SECOND): "rps/s",
            (METRE, SQUARE_SECOND): "mm/s^2",
        }.get((code >> 16 & 0xFF, code >> 8 & 0xFF))
        if base is None or (base in cls.OF_ACCELERATION) != of_acceleration:
            return None
        power += 3 if base.startswith("mm") else 0
        return cls.of(f"{10.0**power:.9f}".rstrip("0").rstrip(".") + f" {base}")

    @property
    def of_turns(self) -> bool:
        return self.base in ("rps", "rpm")

    def same_as(self, other: Unit) -> bool:
        return (self.factor, self.base) == (other.factor, other.base)

    def counts(self, counts_per_mm: float, counts_per_turn: float) -> float:
        """Return how many counts/s, or counts/s^2, it is."""
        per_base = {
            "counts": 1.0,
            "mm": abs(counts_per_mm),
            "rps": counts_per_turn,
            "rpm": counts_per_turn / PER_MINUTE,
        }[self.base]
        return self.factor * per_base

    def per_second(self) -> str:
        """Return the unit of acceleration that belongs to this one of speed."""
        return self.text + ("/s" if self.of_turns else "^2")


def unit_problems(speed: str, acceleration: str) -> Iterator[str]:
    """Return why two options are no units; an empty one is not given."""
    for key, text, per_second in (
        ("speed_unit", speed, False),
        ("acceleration_unit", acceleration, True),
    ):
        match = Unit.FORM.fullmatch(text)
        if text and (match is None or (match[2] in Unit.OF_ACCELERATION) != per_second):
            yield f"{key}: {text!r}; expected {Unit.FORMS}"


@dataclass(frozen=True, slots=True)
class DriveUnits:
    """Signs and units of one drive: ``speed`` in counts/s, ``acceleration`` in counts/s^2."""

    sense: int = 1  # -1: it counts down where the slide moves up
    speed: float = 1.0
    acceleration: float = 1.0

    def position(self, drive_counts: int) -> int:
        """Convert a position from or to the drive."""
        return self.sense * drive_counts

    def velocity(self, of_drive: int) -> float:
        return self.sense * self.speed * of_drive

    def of_speed(self, counts_s: float) -> int:
        """Return a speed for the drive, at least one of its units."""
        return max(1, round(counts_s / self.speed))

    def of_acceleration(self, counts_s2: float) -> int:
        return max(1, round(counts_s2 / self.acceleration))


@dataclass(frozen=True, slots=True)
class Stated:
    """Units that a drive reports: 60A8h, 60A9h, 60AAh, and the counts of a turn by 6090h."""

    position_code: int | None
    speed_code: int | None
    acceleration_code: int | None  # of a drive that states its unit of speed
    counts_per_turn: float | None

    @classmethod
    def read(cls, read: Callable[[int, int], int | None], turn: tuple[int, int]) -> Stated:
        """``read`` returns an object's value, None where the drive lacks it; ``turn`` is the object
        of the counts of a turn: 6090h:01, divided by 6090h:02, or a maker's own.
        """
        increments = read(*turn)
        turns = read(0x6090, 2) if turn[0] == VELOCITY_ENCODER else 1
        per_turn = increments / turns if increments and turns else None
        speed = read(0x60A9, 0)
        return cls(read(0x60A8, 0), speed, None if speed is None else read(0x60AA, 0), per_turn)

    @property
    def speed(self) -> Unit | None:
        return None if self.speed_code is None else Unit.stated(self.speed_code)

    @property
    def acceleration(self) -> Unit | None:
        code = self.acceleration_code
        return None if code is None else Unit.stated(code, of_acceleration=True)

    @property
    def turn_counts(self) -> float | None:
        """Counts of a turn; those of an encoder where positions are increments or not stated."""
        code = self.position_code
        numerator = INCREMENT if code is None else code >> 16 & 0xFF
        if code is not None and numerator == DEGREE:
            return 360.0 / 10.0 ** ((code >> 24 ^ 0x80) - 0x80)
        return self.counts_per_turn if numerator == INCREMENT else None

    @property
    def counts_per_mm(self) -> float | None:
        """Counts of a mm, where positions are in metres; else None."""
        code = self.position_code
        if code is None or code >> 16 & 0xFF != METRE:
            return None
        return float(10.0 ** (-3 - ((code >> 24 ^ 0x80) - 0x80)))

    def contradictions(
        self,
        speed: Unit | None,
        acceleration: Unit | None,
        counts_per_mm: float,
        counts_per_turn: float,
    ) -> Iterator[tuple[str, str, str]]:
        """Return object, value and expected value of each that contradicts an option.

        Units that are None and ``counts_per_turn`` 0 are not given.
        """
        small = 1e-3
        for where, key, given, code, unit in (
            ("60A9h", "speed_unit", speed, self.speed_code, self.speed),
            ("60AAh", "acceleration_unit", acceleration, self.acceleration_code, self.acceleration),
        ):
            if given is not None and unit is not None and not given.same_as(unit):
                yield where, unit.text, f'{key} = "{given.text}"'
            if given is None and unit is None and code is not None:
                yield where, f"0x{code:08X}", f"{key}, as the drive's manual names it"
        turn, mm = self.turn_counts, self.counts_per_mm
        if turn and counts_per_turn and not abs(turn / counts_per_turn - 1) <= small:
            yield "6090h", f"{turn:g} counts a turn", f"counts_per_turn = {counts_per_turn:g}"
        if mm and not abs(abs(counts_per_mm) / mm - 1) <= small:
            yield "60A8h", f"{mm:g} counts a mm", f"counts_per_mm = {counts_per_mm:g}"
