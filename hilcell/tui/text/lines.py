"""Parts of lines: text at fixed columns, at both ends, on a rule, and bars."""

from __future__ import annotations

import math
from collections.abc import Iterator

from textual.content import Content

BLANK = Content("")


def placed(*parts: tuple[int, Content]) -> Content:
    """Return one line with each part at its column, from 0; a part that is too long moves on."""
    line = Content("")
    for column, part in parts:
        gap = column - line.cell_length
        line = line.append(" " * max(gap, 1 if line.cell_length else 0)).append(part)
    return line


def justified(left: Content, right: Content, width: int) -> Content:
    """Return a line with one text at each end; the right one yields where room is short."""
    room = width - left.cell_length - right.cell_length
    return left.append(" " * room).append(right) if room >= 1 else left


def ruled(title: Content, right: Content, width: int) -> Content:
    """Return a rule with a title on its left and a remark at its end."""
    left = Content.assemble(("─ ", "$stale"), title, " ")
    tail = Content.assemble(" ", right, (" ─", "$stale")) if right.cell_length else BLANK
    room = width - left.cell_length - tail.cell_length
    if room < 1:
        return left.truncate(width, ellipsis=True)
    return left.append(Content.styled("─" * room, "$stale")).append(tail)


def section(title: str, width: int, remark: str = "") -> Content:
    """Return the heading of a part of the screen, on a rule of this width."""
    return ruled(Content.styled(title, "bold $label"), Content.styled(remark, "$label"), width)


def bar(
    share: float, width: int, style: str, mark: float | None = None, guard: float = 0.0
) -> Content:
    """Return a bar filled from 0 to ``share`` of its width, to half a column; NaN fills it.

    ``mark``: the share at which a limit is drawn; ``guard``: how wide the band is before and after
    it, also a share, in which neither pass nor fail is shown. It is hatched.
    """
    halves = math.floor(2 * width * share + 1e-9) if share <= 1.0 else 2 * width
    whole, half = divmod(max(halves, 0), 2)
    filled = "█" * whole + "▌" * half
    line = Content.assemble(
        ("█" * whole, style),
        ("▌" * half, f"{style} on $track"),
        *_ground(len(filled), width, mark, guard),
    )
    if mark is None:
        return line
    at = min(math.floor(width * mark + 1e-9), width - 1)
    over = at < len(filled)
    sign = Content.styled("│", f"$background on {style}" if over else "$foreground on $track")
    return line[:at].append(sign).append(line[at + 1 :])


def _ground(begin: int, width: int, mark: float | None, guard: float) -> Iterator[tuple[str, str]]:
    """Yield what is not filled, from column ``begin``, with the hatched band around the mark."""
    low = high = width
    if mark is not None and 0.0 < guard < math.inf:
        low = min(max(math.floor(width * (mark - guard) + 1e-9), begin), width)
        high = min(max(math.ceil(width * (mark + guard) - 1e-9), low), width)
    yield "░" * (low - begin), "$track on $track"
    yield "▒" * (high - low), "$ask on $track"
    yield "░" * (width - high), "$track on $track"


def signed_bar(share: float, half_width: int, style: str) -> Content:
    """Return a bar from a middle line, to the left where ``share`` is negative; NaN has none."""
    length = min(round(half_width * abs(share)), half_width) if math.isfinite(share) else 0
    filled, rest = "▄" * length, " " * (half_width - length)
    left = (rest, filled) if share < 0 else (" " * half_width, "")
    right = ("", " " * half_width) if share < 0 else (filled, rest)
    ground = f"{style} on $panel"
    return Content.assemble(
        (left[0], "on $panel"), (left[1], ground), ("│", "$label on $panel"),
        (right[0], ground), (right[1], "on $panel"),
    )  # fmt: skip
