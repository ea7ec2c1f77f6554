"""Rows 7 to 12 of the run's screen: the newest point, or the chosen one.

|e| alone is large; dx dy dz stand beside it with a signed bar each, |e| against its limit under it.
A value that is old is grey and says so. ``FULL_ROWS`` rows in all, fewer where there is less room.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from textual.content import Content

from hilcell.journal.log import Log
from hilcell.model.outcome import Outcome
from hilcell.model.point import HOW, Point, Sent
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import (
    BLANK,
    Bar,
    Cell,
    Col,
    Drawing,
    Grid,
    Lines,
    Rule,
    SignedBar,
    Stack,
    Ticks,
    ends,
)
from hilcell.tui.plots import step_at_least
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.deviation import Deviation, deviation_of
from hilcell.tui.text.devices import short_age
from hilcell.tui.text.digits import figure, large

DeviationOf = Callable[[Log, Point], Deviation | None]
RAW_SCALE_MM = 2.0
LEAST_LARGE = 41  # columns
FULL_ROWS, SMALL_ROWS = 6, 3
STALE_S = 30.0  # two points of a run are rarely so far apart
TO_LIMIT = 0.8  # of the tolerance bar
SAID: dict[Outcome, tuple[str, str, str, str]] = {  # role, shape's name, words, those of an old one
    Outcome.ACCEPTED: ("passed", "fresh", Outcome.ACCEPTED.words, "was in tol."),
    Outcome.UNDECIDED: ("ask", "warned", Outcome.UNDECIDED.words.upper(), "was undecided"),
    Outcome.REJECTED: ("fault", "warned", Outcome.REJECTED.words.upper(), "was out of tol."),
}


def _signed(value_mm: float) -> str:
    return f"{value_mm:+z.3f}".replace("-", "−") if math.isfinite(value_mm) else "-.---"


@dataclass(frozen=True, slots=True)
class Shown:
    """The point that is drawn: its deviation, its name, and whether it is too old to be bright."""

    name: str
    deviation: Deviation | None
    remark: str  # its age, or why there are no digits
    stale: bool = False
    word: str = ""  # where there is no limit: why

    @classmethod
    def of(
        cls,
        log: Log,
        point: Point,
        which: str,
        deviation: DeviationOf,
        remark: str = "",
        *,
        stale: bool = False,
    ) -> Shown:
        """Return a point by its place in the run and its name."""
        name = f"{which}: {point.id.words(point.station)}"
        word = f"{HOW.get(point.id.how, Sent.BEFORE.text)}: no limit"
        return cls(name, deviation(log, point), remark, stale, word)

    @property
    def tone(self) -> str:
        """Return the style of |e|."""
        if self.stale or self.deviation is None:
            return "$stale"
        judged = self.deviation.limit_mm is not None
        return f"${SAID[self.deviation.outcome][0]}" if judged else "$foreground"

    def large(self, found: Deviation, glyphs: Glyphs) -> Lines:
        """Return |e| large, and its components with a signed bar each."""
        # The full scale of the signed bars grows so that no bar is cut.
        least_mm = RAW_SCALE_MM if found.limit_mm is None else found.limit_mm / 2
        known_mm = (abs(each) for each in found.error_mm if math.isfinite(each))
        scale_mm = step_at_least(max([least_mm, *known_mm]))
        text = "bold $stale" if self.stale else "bold"
        fill = "$stale" if self.stale else "$foreground"
        rows: list[list[Cell]] = []
        for name, value_mm, digits, unit, scale in zip(
            ("dx", "dy", "dz"),
            found.error_mm,
            large(figure(found.norm_mm), self.tone, glyphs),
            ("|e|", "mm", ""),
            (f"±{scale_mm:g}", "mm", ""),
            strict=True,
        ):
            component = Content.assemble(
                (f"{name} ", "$label"), (f"{_signed(value_mm):>6}", text), (" mm", "$label")
            )
            bar = SignedBar(value_mm / scale_mm, fill)
            rows.append(["", (unit, "$label"), digits, component, bar, (scale, "$label")])
        columns = Col(), Col(3), Col(21), Col(14), Col(28), Col()
        return Grid(rows, *columns)

    def one_line(self, found: Deviation) -> Content:
        """Return |e| and its components in one line."""
        dx, dy, dz = map(_signed, found.error_mm)
        return Content.assemble(
            " ",
            (f"|e| {figure(found.norm_mm)} mm", f"bold {self.tone}"),
            (f"   dx {dx}  dy {dy}  dz {dz}", "$stale" if self.stale else "$label"),
        )

    def tolerance(self, found: Deviation, glyphs: Glyphs) -> list[list[Cell]]:
        """Return what is said of the limit with |e| against it, and under it the scale and U."""
        if found.limit_mm is None:
            words = (f"{glyphs.stale} {self.word}", "$stale" if self.stale else "")
            return [["", words, ""], ["", "", ""]]
        role, shape, word, was = SAID[found.outcome]
        said = (f"{getattr(glyphs, shape)} {word}", f"bold ${role}")
        if self.stale:
            said = (f"{glyphs.stale} {was}", "$stale")
        share, guard = (TO_LIMIT * each / found.limit_mm for each in (found.norm_mm, found.U_mm))
        bar = Bar(share, self.tone, TO_LIMIT, guard)
        digits = 2 if math.isclose(100 * found.limit_mm / 4 % 1, 0, abs_tol=1e-9) else 3
        ticks = [(0.0, Content.styled("0", "$label"))]
        for quarter in (1, 2, 3):
            text = f"{found.limit_mm * quarter / 4:.{digits}f}"
            ticks.append((TO_LIMIT * quarter / 4, Content.styled(text, "$label")))
        limit = Content.assemble((f"{found.limit_mm:.{digits}f}", "bold"), (" limit", "$label"))
        ticks.append((TO_LIMIT, limit))
        U = (f"U {found.U_mm:.3f} mm", "$label")
        return [["", said, bar], ["", U, Ticks(tuple(ticks))]]


def rows_for(height: int) -> int:
    """Return the rows of the newest point on a terminal of this height."""
    return FULL_ROWS if height >= 24 else FULL_ROWS - 1 if height >= 21 else SMALL_ROWS


def newest_shown(view: RunView, deviation: DeviationOf = deviation_of) -> Shown:
    """Return the newest point of a live run; never one of an earlier step in bright digits."""
    point = view.newest
    if point is None:
        return Shown("no point measured yet", None, "")
    age_s = view.newest_age_s
    age = f"{short_age(age_s)} ago" if age_s <= STALE_S else f"{short_age(age_s)} old"
    old = view.newest_is_old or not age_s <= STALE_S or view.stale
    which = "last point" if view.newest_is_old else "newest point"
    return Shown.of(view.log, point, which, deviation, age, stale=old)


def chosen_shown(
    view: RunView, key: str, deviation: DeviationOf = deviation_of, *, chosen: bool = True
) -> Shown:
    """Return the point under the table's cursor; not ``chosen``: the cursor only stood there."""
    point = view.log.points.get(key)
    if point is None:
        return Shown("no point measured yet", None, "")
    which = "chosen point" if chosen else "last point"
    return Shown.of(view.log, point, which, deviation)


def point_lines(shown: Shown, glyphs: Glyphs, rows: int = FULL_ROWS) -> Lines:
    """Return the rows, at most ``rows`` of them; digits are one line where three have no room."""
    found, remark = shown.deviation, Content.styled(shown.remark, "$label")
    if shown.stale and shown.remark:
        remark = Content.styled(f"{glyphs.warned} {shown.remark}", "$ask")
    head = Rule(Content.styled(shown.name, "bold $label"), remark)
    if found is None:
        none = "no nominal place, so no deviation" if shown.remark else ""
        return Stack(head, (f" {none}", "$label"), *[BLANK] * (rows - 2))
    said = shown.tolerance(found, glyphs)
    columns = Col(), Col(17), Col(10, grows=True, most=55)
    small = Stack(head, ends(shown.one_line(found), ""), Grid(said[:1], *columns))
    if rows < FULL_ROWS - 1:
        return small
    whole = Stack(head, shown.large(found, glyphs), Grid(said[: rows - 4], *columns))
    state = whole.state, small.state
    return Drawing(state, lambda width, _: (small if width < LEAST_LARGE else whole).lines(width))
