"""A box of lines with its title in the border, and the lines that are fitted into it."""

from __future__ import annotations

from collections.abc import Sequence

from textual.content import Content

SINGLE, DOUBLE = tuple("┌─┐│└┘"), tuple("╔═╗║╚╝")
Shape = tuple[str, ...]
LEAST_BESIDE = 8  # columns of a text beside its head
BORDERS = 4  # columns: a border and a space at either side


def framed(
    lines: Sequence[Content], columns: int, title: Content, note: str, style: str, shape: Shape
) -> list[Content]:
    """Return a box around ``lines``, each cut or filled to ``columns`` - `BORDERS`."""
    corner, across, right, side, low, low_right = shape
    title = title.truncate(columns - 4, ellipsis=True)
    room = columns - 3 - title.cell_length
    end = f" {note} {across}" if note and len(note) + 3 <= room else ""
    top = Content.assemble(
        (f"{corner}{across}", style),
        title,
        (f"{across * max(room - len(end), 0)}{end}{right}", style),
    )
    body = [
        Content.assemble((f"{side} ", style), fitted(line, columns - BORDERS), (f" {side}", style))
        for line in lines
    ]
    return [top, *body, Content.styled(f"{low}{across * (columns - 2)}{low_right}", style)]


def fitted(line: Content, width: int) -> Content:
    """Return a line of exactly ``width`` columns."""
    return line.truncate(width, ellipsis=True, pad=True)


def ends(left: Content, right: Content, width: int) -> Content:
    """Return a line with one text at each end; the left one is cut where room is short."""
    room = width - right.cell_length
    if not right.cell_length or room < 1:
        return fitted(left, width)
    return fitted(left, room - 1).append(" ").append(right)


def wrapped(text: str, width: int, style: str = "", most: int = 0) -> list[Content]:
    """Return a text in lines of at most ``width``; more than ``most`` end with an ellipsis."""
    lines = Content(text).wrap(width)
    if most and len(lines) > most:
        rest = Content(" ").join(lines[most - 1 :]).truncate(width, ellipsis=True)
        lines = [*lines[: most - 1], rest]
    return [line.rstrip().stylize(style) if style else line.rstrip() for line in lines]


def hanging(head: Content, text: str, width: int, style: str = "", most: int = 0) -> list[Content]:
    """Return a text after its head; lines after the first stand under the first one's text.

    Where there is no room beside the head, the text stands under it.
    """
    indent = head.cell_length
    if width - indent < LEAST_BESIDE:
        return [head, *wrapped(text, width, style, most)]
    first, *rest = wrapped(text, width - indent, style, most)
    return [head.append(first), *(line.pad_left(indent) for line in rest)]
