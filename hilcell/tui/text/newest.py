"""Rows 7 to 12 of the run's screen: the newest point, or the chosen one.

|e| alone is large; dx dy dz stand beside it with a signed bar each, |e| against its limit under it.
A value that is old is grey and says so. ``FULL_ROWS`` rows in all, fewer where there is less room.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from textual.content import Content

from hilcell.geometry.sequential import Outcome
from hilcell.journal.calibration_facts import OUTCOMES
from hilcell.journal.log import Log, Point
from hilcell.journal.point_words import point_words
from hilcell.journal.ways_sent import AS_SENT, WAYS
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.plots.scale import step_at_least
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.deviation import Deviation, deviation_of
from hilcell.tui.text.devices import short_age
from hilcell.tui.text.digits import figure, large
from hilcell.tui.text.lines import bar, placed, ruled, signed_bar

DeviationOf = Callable[[Log, Point], Deviation | None]
FULL_ROWS, SMALL_ROWS = 6, 3
STALE_S = 30.0  # two points of a run are rarely so far apart
RAW_SCALE_MM = 2.0
FIGURES_AT, COMPONENTS_AT, BARS_AT, SCALE_AT = 5, 27, 42, 71
HALF_BAR = 13
TOLERANCE_AT, TO_LIMIT, PAST_LIMIT = 20, 44, 11
SAID: dict[Outcome, tuple[str, str, str]] = {  # role, shape's name, words
    "accepted": ("passed", "fresh", OUTCOMES["accepted"]),
    "undecided": ("ask", "warned", OUTCOMES["undecided"].upper()),
    "rejected": ("fault", "warned", OUTCOMES["rejected"].upper()),
}
WAS: dict[Outcome, str] = {
    "accepted": "was in tol.",
    "undecided": "was undecided",
    "rejected": "was out of tol.",
}


@dataclass(frozen=True, slots=True)
class Shown:
    """The point that is drawn: its deviation, its name, and whether it is too old to be bright."""

    name: str
    deviation: Deviation | None
    remark: str  # its age, or why there are no digits
    stale: bool = False
    word: str = ""  # where there is no limit: why


def newest_shown(view: RunView, deviation: DeviationOf = deviation_of) -> Shown:
    """Return the newest point of a live run; never one of an earlier step in bright digits."""
    point = view.newest
    if point is None:
        return Shown("no point measured yet", None, "")
    age_s = view.newest_age_s
    age = f"{short_age(age_s)} ago" if age_s <= STALE_S else f"{short_age(age_s)} old"
    old = view.newest_is_old or not age_s <= STALE_S or view.stale
    which = "last point" if view.newest_is_old else "newest point"
    return _shown(view, point, which, age, deviation, stale=old)


def chosen_shown(
    view: RunView, key: str, deviation: DeviationOf = deviation_of, *, chosen: bool = True
) -> Shown:
    """Return the point under the table's cursor; not ``chosen``: the cursor only stood there."""
    point = view.log.points.get(key)
    if point is None:
        return Shown("no point measured yet", None, "")
    which = "chosen point" if chosen else "last point"
    return _shown(view, point, which, "", deviation, stale=False)


def _shown(
    view: RunView, point: Point, which: str, remark: str, deviation: DeviationOf, *, stale: bool
) -> Shown:
    found = deviation(view.log, point)
    word = f"{WAYS.get(point.id.how, AS_SENT)}: no limit"
    return Shown(f"{which}: {point_words(point.id, point.station)}", found, remark, stale, word)


def point_lines(shown: Shown, glyphs: Glyphs, width: int, rows: int = FULL_ROWS) -> Content:
    """Return the rows, at most ``rows`` of them; digits are one line where three have no room."""
    found, remark = shown.deviation, Content.styled(shown.remark, "$label")
    if shown.stale and shown.remark:
        remark = Content.styled(f"{glyphs.warned} {shown.remark}", "$ask")
    lines = [ruled(Content.styled(shown.name, "bold $label"), remark, width)]
    if found is None:
        none = "" if shown.remark == "" else " no nominal place, so no deviation"
        lines.append(Content.styled(none, "$label"))
        lines += [Content("")] * (rows - len(lines))
    elif rows >= FULL_ROWS - 1 and width > COMPONENTS_AT + 13:
        lines += _large_lines(shown, found, glyphs, width)
        lines += [_tolerance_line(shown, found, glyphs, width), _scale_line(found, width)]
    else:
        lines += [_one_line(shown, found, width), _tolerance_line(shown, found, glyphs, width)]
    return Content("\n").join(line.truncate(width) for line in lines[:rows])


def _style(shown: Shown, found: Deviation) -> str:
    if shown.stale:
        return "$stale"
    return "$foreground" if found.limit_mm is None else f"${SAID[found.outcome][0]}"


def _signed(value_mm: float) -> str:
    return f"{value_mm:+z.3f}".replace("-", "−") if math.isfinite(value_mm) else "-.---"


def _large_lines(shown: Shown, found: Deviation, glyphs: Glyphs, width: int) -> list[Content]:
    digits = large(figure(found.norm_mm), _style(shown, found), glyphs)
    scale_mm = _scale_mm(found)
    text = "bold $stale" if shown.stale else "bold"
    fill = "$stale" if shown.stale else "$foreground"
    units, scales = ("|e|", "mm", ""), (f"±{scale_mm:g}", "mm", "")
    lines = []
    for row, (name, value_mm) in enumerate(zip(("dx", "dy", "dz"), found.error_mm, strict=True)):
        component = Content.assemble(
            (f"{name} ", "$label"), (f"{_signed(value_mm):>6}", text), (" mm", "$label")
        )
        parts = [(1, Content.styled(units[row], "$label")), (FIGURES_AT, digits[row])]
        parts.append((COMPONENTS_AT, component))
        if width > SCALE_AT + 4:
            parts.append((BARS_AT, signed_bar(value_mm / scale_mm, HALF_BAR, fill)))
            parts.append((SCALE_AT, Content.styled(scales[row], "$label")))
        lines.append(placed(*parts))
    return lines


def _scale_mm(found: Deviation) -> float:
    """Return the full scale of the signed bars; it grows so that no bar is cut."""
    least_mm = RAW_SCALE_MM if found.limit_mm is None else found.limit_mm / 2
    known = (abs(each) for each in found.error_mm if math.isfinite(each))
    return step_at_least(max([least_mm, *known]))


def _one_line(shown: Shown, found: Deviation, width: int) -> Content:
    dx, dy, dz = map(_signed, found.error_mm)
    text = "$stale" if shown.stale else "$label"
    return Content.assemble(
        " ",
        (f"|e| {figure(found.norm_mm)} mm", f"bold {_style(shown, found)}"),
        (f"   dx {dx}  dy {dy}  dz {dz}", text),
    ).truncate(width)


def _tolerance_line(shown: Shown, found: Deviation, glyphs: Glyphs, width: int) -> Content:
    if found.limit_mm is None:
        return Content.styled(f" {glyphs.stale} {shown.word}", "$stale" if shown.stale else "")
    role, shape, words = SAID[found.outcome]
    said = Content.styled(f"{getattr(glyphs, shape)} {words}", f"bold ${role}")
    if shown.stale:
        said = Content.styled(f"{glyphs.stale} {WAS[found.outcome]}", "$stale")
    room = min(TO_LIMIT + PAST_LIMIT, width - TOLERANCE_AT)
    if room < PAST_LIMIT:
        return placed((1, said))
    mark = TO_LIMIT / (TO_LIMIT + PAST_LIMIT)
    share, guard = (mark * each / found.limit_mm for each in (found.norm_mm, found.U_mm))
    drawn = bar(share, room, _style(shown, found), mark, guard)
    return placed((1, said), (TOLERANCE_AT, drawn))


def _scale_line(found: Deviation, width: int) -> Content:
    """Return the quarters of the limit under the bar, and U of the error beside them."""
    if found.limit_mm is None:
        return Content("")
    digits = 2 if math.isclose(100 * found.limit_mm / 4 % 1, 0, abs_tol=1e-9) else 3
    ticks = [(TOLERANCE_AT, Content.styled("0", "$label"))]
    for quarter in (1, 2, 3):
        text = f"{found.limit_mm * quarter / 4:.{digits}f}"
        ticks.append((TOLERANCE_AT + quarter * TO_LIMIT // 4, Content.styled(text, "$label")))
    limit = Content.assemble((f"{found.limit_mm:.{digits}f}", "bold"), (" limit", "$label"))
    ticks.append((TOLERANCE_AT + TO_LIMIT, limit))
    U = Content.styled(f"U {found.U_mm:.3f} mm", "$label")
    return placed((1, U), *ticks).truncate(width)
