"""The footer of the run's screen: acts on the first row, views on the second.

Every slot has its place and its key; one that would do nothing now is grey, not gone. A slot
changes only its word. STOP is first and alone in white.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from textual.content import Content


@dataclass(frozen=True, slots=True)
class Slot:
    """One action in the footer: how wide its word may become, and the blanks before its key."""

    name: str
    word: int
    gap: int = 1


ACTS = (
    Slot("pause", 6),
    Slot("abort", 5),
    Slot("retake", 10),
    Slot("acknowledge", 11),
    Slot("detach", 7),
)
VIEWS = (
    Slot("sort", 5),
    Slot("bad", 3),
    Slot("find", 4),
    Slot("plots", 5, 2),
    Slot("interlocks", 5),
    Slot("alarms", 6),
    Slot("log", 3),
    Slot("report", 6, 2),
    Slot("history", 4),
    Slot("help", 4),
)
WORDS = {  # by label: shorter here
    "worst first": "worst",
    "as measured": "order",
    "bad only": "bad",
    "filter": "find",
    "interlocks": "locks",
    "history": "runs",
}
PALETTE_KEY, EVERY_ACTION = "^p", "every action"
# These stay, beside STOP, where there is no room for all.
NARROW = ("pause", "acknowledge", "alarms", "help")
FULL_WIDTH = 79


@dataclass(frozen=True, slots=True)
class KeyOf:
    """One slot as it is now: its key, its word, and whether it would do something."""

    key: str
    word: str
    works: bool


def footer_lines(state: Callable[[str], KeyOf], width: int) -> Content:
    """Return both rows; ``state`` tells each action's key, word and whether it works."""
    stop = state("stop")
    first = _stop(stop)
    if width < FULL_WIDTH:
        return first.append(_row([Slot(name, 0) for name in NARROW], state)).truncate(width)
    first = first.append(_row(ACTS, state, padded=True))
    return Content("\n").join([first, Content(" ").append(_row(VIEWS, state))]).truncate(2 * width)


def form_footer(acts: Sequence[KeyOf], views: Sequence[KeyOf], width: int) -> Content:
    """Return the two rows of a form: its own keys, then the actions from there."""
    rows = []
    for keys, pad, gap in ((acts, " ", "  "), (views, "", " ")):
        parts = [
            Content.assemble(
                (f"{pad}{each.key}{pad}", _key_style(works=each.works)),
                (f" {each.word}{gap}", "" if each.works else "$stale"),
            )
            for each in keys
        ]
        rows.append(Content(" ").join([Content(""), Content("").join(parts)]).truncate(width))
    return Content("\n").join(rows)


def _stop(stop: KeyOf) -> Content:
    style = "bold $background on $foreground" if stop.works else "bold $stale"
    return Content.styled(f" {stop.key} {stop.word} ", style)


def _row(slots: Sequence[Slot], state: Callable[[str], KeyOf], *, padded: bool = False) -> Content:
    parts = [Content(" " * slots[0].gap) if padded else Content("")]
    for number, slot in enumerate(slots):
        found = state(slot.name)
        pad = " " if padded else ""
        key = Content.styled(f"{pad}{found.key}{pad}", _key_style(works=found.works))
        word = Content.styled(f" {found.word:<{slot.word}}", "" if found.works else "$stale")
        gap = Content(" " * slot.gap if number else "")
        parts += [gap, key, word]
    return Content("").join(parts)


def _key_style(*, works: bool) -> str:
    return "bold $foreground on $badge" if works else "$stale"
