"""The sheet for the shop floor: which station, which program, which holes, under which conditions.

One HTML file that opens offline, needs no script and prints on A4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

from hilcell import __version__
from hilcell.clean import harmless
from hilcell.present.renderers import environment
from hilcell.present.table import Column, Table


@dataclass(frozen=True, slots=True)
class SheetHole:
    """A hole: nominal place (mm, {W}), how far its command is from it, its 95 % bound or None.

    ``turn95_deg`` bounds its orientation, None where that is not corrected.
    """

    name: str
    place_mm: tuple[float, float, float]
    correction_mm: float
    bound95_mm: float | None
    turn95_deg: float | None = None


HOLES: tuple[Column[SheetHole], ...] = (
    Column("hole", attrgetter("name")),
    Column("x", lambda hole: hole.place_mm[0], "mm", ".2f"),
    Column("y", lambda hole: hole.place_mm[1], "mm", ".2f"),
    Column("z", lambda hole: hole.place_mm[2], "mm", ".2f"),
    Column("corrected by", attrgetter("correction_mm"), "mm", ".3f"),
)


@dataclass(frozen=True, slots=True)
class SheetStation:
    """A station: where the slide is held, by the strip, and the holes there in order of visit.

    ``program`` is what is chosen on the controller, or the list where there is none; ``remark``
    says in words what comes on top of the bounds.
    """

    name: str
    rail_mm: float
    strip_mm: float
    strip_tolerance_mm: float
    program: str
    files: Sequence[str]
    holes: Sequence[SheetHole]
    remark: str = ""

    @property
    def largest_mm(self) -> float | None:
        """Return the largest bound, None where none can be stated."""
        bounds = [hole.bound95_mm for hole in self.holes]
        stated = [bound for bound in bounds if bound is not None]
        return max(stated) if stated and len(stated) == len(bounds) else None


@dataclass(frozen=True, slots=True)
class Sheet:
    """All that the sheet says; ``facts``, ``checks`` and ``invalid`` are words for it, in order.

    ``no_bounds`` says why no bounds are stated, "" where they are. ``footer`` stands on each page
    in print.
    """

    title: str
    simulated: bool
    has_rail: bool
    facts: Sequence[tuple[str, str]]
    checks: Sequence[str]
    stations: Sequence[SheetStation]
    no_bounds: str
    warnings: Sequence[str]
    invalid: Sequence[str]
    footer: str = ""

    BOUND = Column[SheetHole]("95 % bound", attrgetter("bound95_mm"), "mm", ".3f")

    TURN = Column[SheetHole]("95 % bound", attrgetter("turn95_deg"), "°", ".4f")

    @property
    def has_turns(self) -> bool:
        """Return whether every hole has a bound of its orientation."""
        return all(hole.turn95_deg is not None for each in self.stations for hole in each.holes)

    def holes(self, station: SheetStation) -> Table:
        """Return the table of a station, without bounds that nobody states."""
        columns = [
            *HOLES,
            *([] if self.no_bounds else [self.BOUND]),
            *([self.TURN] if self.has_turns else []),
        ]
        return Table(columns, station.holes)

    @property
    def footer_css(self) -> str:
        """Return the footer as the inside of a CSS string: no character acts there."""
        return "".join(
            each if each.isascii() and each.isalnum() else f"\\{ord(each):06x}"
            for each in harmless(self.footer)
        )


def sheet_html(sheet: Sheet) -> str:
    """Return the page."""
    page = environment("hilcell.report").get_template("sheet.html.j2")
    return page.render(sheet=sheet, version=__version__)
