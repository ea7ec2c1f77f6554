"""The map of the volume in characters: |e| seen from above, from the side and along the rail.

The views share their axes as in a drawing. A cell shows its worst point; blank is not measured.
Size and brightness of the shapes grow with |e|, so that the map is read in grey, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from textual.content import Content

from hilcell.ports import Array
from hilcell.tui.layout import section

AXES, UP = "xyz", 2
ACROSS, ALONG, ROWS = 38, 13, 8  # cells of a view: along the rail's axis, across it, and high
LEAST_COLUMNS, LEAST_ROWS = 8, 2
LEGEND = 15  # columns
FRAME = 2
GAP = 2
RULED = 4  # columns of a heading's rule beside its words, twice with a remark
NO_POINT = -1
CORRECTED, RAW = (0.05, 0.1, 0.2), (0.2, 0.5, 1.0, 2.0)  # mm, upper bounds of the grades
SHAPES, LETTERS = "·•○●■", ".:o*#"
STYLES = ("$live 70%", "$live", "$label", "bold $foreground", "bold $fault")
NEWEST, NEWEST_LETTER = "◄", "<"
Ints = NDArray[np.int64]
Lines = list[Content]


@dataclass(frozen=True, slots=True)
class Grades:
    """Upper bounds (mm) of the grades but the last, which is beyond them all."""

    bounds: tuple[float, ...]
    limited: bool  # whether the last bound is the limit

    @classmethod
    def of(cls, limit_mm: float | None) -> Grades:
        """Return the grades below a limit, or those of errors that have none."""
        if limit_mm is None:
            return cls(RAW, limited=False)
        return cls((*(each for each in CORRECTED if each < limit_mm), limit_mm), limited=True)

    def grade(self, errors: Array) -> Ints:
        """Return the grade (N,) of errors (N,); NaN is beyond every bound."""
        found: Ints = np.sum(~(errors[:, None] <= np.array(self.bounds)), axis=1)
        return found

    def shape(self, grade: int, *, plain: bool) -> str:
        """Return the shape of a grade: the last two are those of the limit."""
        return (LETTERS if plain else SHAPES)[self._at(grade)]

    def style(self, grade: int) -> str:
        """Return its style; only what is over a limit has the colour of a fault."""
        at = self._at(grade)
        return STYLES[at - (at == len(STYLES) - 1 and not self.limited)]

    def _at(self, grade: int) -> int:
        return grade if grade < len(self.bounds) - 1 else grade + len(CORRECTED) + 1 - len(
            self.bounds)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """Targets (N, 3) in {W} with |e| (N,), the newest's number or -1, and the map's corners."""

    targets_mm: Array
    errors_mm: Array
    low_mm: Array
    high_mm: Array
    limit_mm: float | None
    rail: int = 1  # the axis of {W} along which the rail runs: x or y
    newest: int = NO_POINT
    planned: int = 0
    title: str = "|e|"
    stations: tuple[tuple[str, float], ...] = ()  # their middle along the rail, mm
    station: str = ""  # the current one
    counts: Ints = field(init=False)

    def __post_init__(self) -> None:
        """Count the targets of each grade."""
        grades = Grades.of(self.limit_mm)
        found = np.bincount(grades.grade(self.errors_mm), minlength=len(grades.bounds) + 1)
        object.__setattr__(self, "counts", found)


def map_lines(of: Volume, width: int, height: int, *, plain: bool) -> Lines:
    """Return the map in at most so many rows; the views that have no room are left out."""
    beside = width >= ACROSS + FRAME + GAP + LEGEND
    columns = ACROSS if beside else width - FRAME
    legend = _legend(of, plain=plain)
    lines = [_heading(of, width), *([] if beside else _flowing(legend, width))]
    room = height - len(lines)
    both = room >= 2 * (FRAME + 3) + 1
    rows = min(ROWS, (room - 1) // 2 - FRAME if both else room - FRAME - 1)
    if columns >= LEAST_COLUMNS and rows >= LEAST_ROWS:
        first = _above(of, columns, rows, plain=plain)
        lines += [_beside(each, legend, n) for n, each in enumerate(first)] if beside else first
        lines.append(_stations(of, columns))
        if both:
            lines += _sides(of, columns, rows, plain=plain, along=beside)
    return [line.truncate(width) for line in lines[: max(height, 1)]]


def _above(of: Volume, columns: int, rows: int, *, plain: bool) -> Lines:
    along, across = of.rail, 1 - of.rail
    size_m = float(of.high_mm[along] - of.low_mm[along]) / 1000.0
    cells = _view(of, (along, across), columns, rows, plain=plain)
    return _framed(cells, f"from above: {AXES[across]} up", f"{size_m:.2f} m, {_rail(of)}")


def _sides(of: Volume, columns: int, rows: int, *, plain: bool, along: bool) -> Lines:
    """Return the view from the side, and beside it that along the rail."""
    cells = _view(of, (of.rail, UP), columns, rows, plain=plain)
    side = _framed(cells, "from the side: z up", _rail(of))
    if not along:
        return side
    end = _view(of, (1 - of.rail, UP), ALONG, rows, plain=plain)
    third = _framed(end, "z up", f"{AXES[1 - of.rail]} ►")
    return [_padded(each, columns + FRAME + GAP).append(third[n]) for n, each in enumerate(side)]


def _rail(of: Volume) -> str:
    return f"{'rail ' * bool(of.stations)}{AXES[of.rail]} ►"


def _heading(of: Volume, width: int) -> Content:
    count = f"{len(of.errors_mm)} of {of.planned}" if of.planned else str(len(of.errors_mm))
    for title, remark in ((f"map: {of.title}", f"{count} targets"), (f"map: {count}", "")):
        if len(title) + len(remark) + RULED * (1 + bool(remark)) <= width:
            return section(title, remark).lines(width)[0]
    return section("map").lines(width)[0]


def _legend(of: Volume, *, plain: bool) -> Lines:
    """Return a line for each grade with its count."""
    grades = Grades.of(of.limit_mm)
    lines = []
    for grade, count in enumerate(of.counts.tolist()):
        last = grade == len(grades.bounds)
        bound = f"{'>' if last else '≤'} {grades.bounds[grade - last]:.2f}"
        shape = grades.shape(grade, plain=plain)
        lines.append(
            Content.assemble((shape, grades.style(grade)), (f" {bound} ", "$label"), f"{count:>4}")
        )
    newest = NEWEST_LETTER if plain else NEWEST
    return [*lines, Content.assemble((newest, "bold $live"), (" newest", "$label"))]


def _flowing(legend: Lines, width: int) -> Lines:
    """Return the legend in rows of as many entries as fit."""
    rows: Lines = []
    for each in legend:
        if rows and rows[-1].cell_length + GAP + each.cell_length <= width:
            rows[-1] = rows[-1].append(" " * GAP).append(each)
        else:
            rows.append(each)
    return rows


def _view(of: Volume, axes: tuple[int, int], columns: int, rows: int, *, plain: bool) -> Lines:
    """Return the cells of a view: ``axes`` are those to the right and up."""
    right, up = axes
    grades = Grades.of(of.limit_mm)
    size_mm = np.maximum(of.high_mm - of.low_mm, 1e-9)
    share = np.clip((of.targets_mm - of.low_mm) / size_mm, 0.0, 1.0 - 1e-9)
    column = np.floor(share[:, right] * columns).astype(int)
    row = np.floor((1.0 - 1e-9 - share[:, up]) * rows).astype(int)
    cells = np.full((rows, columns), NO_POINT)
    np.maximum.at(cells, (row, column), grades.grade(of.errors_mm))
    at = (int(row[of.newest]), int(column[of.newest])) if of.newest != NO_POINT else None
    return [
        Content.assemble(
            *(
                (NEWEST_LETTER if plain else NEWEST, "bold $live")
                if (n, m) == at
                else (" ", "")
                if grade == NO_POINT
                else (grades.shape(grade, plain=plain), grades.style(grade))
                for m, grade in enumerate(line)
            )
        )
        for n, line in enumerate(cells.tolist())
    ]


def _framed(cells: Lines, top: str, bottom: str) -> Lines:
    width = cells[0].cell_length
    head = f"┌─ {top} "
    foot = f" {bottom} ─┘"
    lines = [_edge(f"{head}{'─' * (width + 1 - len(head))}┐", top, width + FRAME)]
    lines += [Content.assemble(("│", "$stale"), each, ("│", "$stale")) for each in cells]
    lines.append(_edge(f"└{'─' * (width + 1 - len(foot))}{foot}", bottom, width + FRAME))
    return lines


def _edge(text: str, words: str, width: int) -> Content:
    """Return an edge of a frame with words in it; without them, where they do not fit."""
    if len(text) > width:
        inner = "─" * (width - FRAME)
        return Content.styled(f"{text[0]}{inner}{text[-1]}", "$stale")
    before, _, after = text.partition(words)
    return Content.assemble((before, "$stale"), (words, "$label"), (after, "$stale"))


def _stations(of: Volume, columns: int) -> Content:
    """Return the stations' names under their middle."""
    low_mm, high_mm = float(of.low_mm[of.rail]), float(of.high_mm[of.rail])
    line = Content("")
    for name, at_mm in of.stations:
        share = (at_mm - low_mm) / max(high_mm - low_mm, 1e-9)
        text = f"─ {name} ─"
        start = FRAME // 2 + round(share * columns) - len(text) // 2
        start = max(min(start, columns + FRAME - len(text)), 0)
        style = "bold $foreground" if name == of.station else "$label"
        if line.cell_length <= start:
            line = _padded(line, start).append(Content.styled(text, style))
    return line


def _beside(line: Content, legend: Sequence[Content], row: int) -> Content:
    """Return a row of a view with one of the legend beside it."""
    if row == 0:
        return line.append(Content.styled(f"{' ' * GAP}|e| in mm", "$label"))
    if row <= len(legend):
        return line.append(" " * GAP).append(legend[row - 1])
    if row == len(legend) + 1:
        return line.append(Content.styled(f"{' ' * GAP}blank: not yet", "$label"))
    return line


def _padded(line: Content, width: int) -> Content:
    return line.append(" " * max(width - line.cell_length, 0))
