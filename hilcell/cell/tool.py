"""A tool of the cell file: where the tip that works is on the flange, and how far it stands off."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Annotated

from msgspec import Meta

from hilcell.cell.tables import Name, Pose

REFLECTOR = "reflector"  # the tool whose tip is the reflector's centre, {T}
STANDOFF_MORE_MM = 20.0  # beyond the drill's length, at least
MOST_STANDOFF_MM = 1000.0
MOST_TOOLS = 32
Deviation = Annotated[float, Meta(ge=0, le=10)]
Drill = Annotated[float, Meta(gt=0, le=MOST_STANDOFF_MM - STANDOFF_MORE_MM)]
Standoff = Annotated[float, Meta(gt=0, le=MOST_STANDOFF_MM)]
Number = Annotated[int, Meta(ge=1, le=MOST_TOOLS)]


class ToolTable(Pose, frozen=True, kw_only=True):
    """A tool: the frame of its tip in the flange, z along the drill, out of the spindle.

    ``number`` is the controller's own, where it has numbers. ``measured`` says how the tip was
    measured against the reflector, ``u_mm`` is 1 sigma of that. ``drill_mm`` is how far the drill
    is in front of all else, ``standoff_mm`` how far the tip is kept from the part between holes.
    """

    name: Name
    measured: Annotated[str, Meta(min_length=1)]
    u_mm: Deviation
    drill_mm: Drill
    number: Number | None = None
    standoff_mm: Standoff | None = None

    def __post_init__(self) -> None:
        if self.standoff_mm is not None and not self.standoff_mm >= self.least_standoff_mm:
            raise ValueError(
                f"standoff_mm {self.standoff_mm:g} must be at least drill_mm + "
                f"{STANDOFF_MORE_MM:g}, {self.least_standoff_mm:g}"
            )
        if not self.drill_mm <= self.reach_mm:
            raise ValueError(
                f"drill_mm {self.drill_mm:g}: the tip is {self.reach_mm:.1f} mm in front of the "
                "flange along its z, expected at least drill_mm: z (a_deg, b_deg, c_deg) points "
                "along the drill, out of the spindle"
            )

    @property
    def reach_mm(self) -> float:
        """Return how far the tip is in front of the flange's centre, along its own z."""
        T = self.matrix()
        return float(T[:3, 3] @ T[:3, 2])

    @property
    def least_standoff_mm(self) -> float:
        """Return the drill's length and some more."""
        return self.drill_mm + STANDOFF_MORE_MM


def tool_problems(tools: Sequence[ToolTable], reflector: object) -> Iterator[str]:
    """Yield what is wrong with tools; ``reflector`` is the number of that one, if it has any."""
    names = Counter(each.name for each in tools)
    numbers = Counter(each.number for each in tools if each.number is not None)
    for key, counts in (("names", names), ("numbers", numbers)):
        for value, count in counts.items():
            if count > 1:
                yield f"tool: {key} must differ, found {value} {count} times"
    for n, each in enumerate(tools):
        if each.name == REFLECTOR:
            yield f"tool[{n}].name: {REFLECTOR!r} is the tool of the reflector's centre"
        if each.number is not None and each.number == reflector:
            yield f"tool[{n}].number: {each.number} is the reflector's (robot.options.tool)"
