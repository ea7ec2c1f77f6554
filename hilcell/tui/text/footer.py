"""The footer of the run's screen: acts on the first row, views on the second.

Every slot has its place and its key; one that would do nothing now is grey, not gone. A slot
changes only its word. STOP is first and alone in white.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from textual.content import Content

# By name: how wide the word of a slot may become.
ACTS = {"pause": 6, "abort": 5, "retake": 10, "acknowledge": 11, "detach": 7}
VIEWS = {
    "sort": 5, "bad": 3, "find": 5, "plots": 5, "interlocks": 5,
    "alarms": 6, "log": 4, "report": 6, "history": 4, "help": 4,
}  # fmt: skip
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

    def drawn(self, word: int = 0, pad: str = "") -> Content:
        """Return key and word, the word in a room of so many columns."""
        style = "bold $foreground on $badge" if self.works else "$stale"
        key, shown = f"{pad}{self.key}{pad}", f" {self.word:<{word}}"
        return Content.assemble((key, style), (shown, "" if self.works else "$stale"))


def footer_lines(state: Callable[[str], KeyOf], width: int) -> Content:
    """Return both rows; ``state`` tells each action's key, word and whether it works."""
    stop = state("stop")
    style = "bold $background on $foreground" if stop.works else "bold $stale"
    first = Content.styled(f" {stop.key} {stop.word} ", style)
    if width < FULL_WIDTH:
        return first.append(_row(state, dict.fromkeys(NARROW, 0))).truncate(width)
    rows = first.append(" ").append(_row(state, ACTS, " ")), Content(" ").append(_row(state, VIEWS))
    return Content("\n").join(rows).truncate(2 * width)


def _row(state: Callable[[str], KeyOf], slots: Mapping[str, int], pad: str = "") -> Content:
    return Content(" ").join(state(name).drawn(word, pad) for name, word in slots.items())


def form_footer(acts: Sequence[KeyOf], views: Sequence[KeyOf], width: int) -> Content:
    """Return the two rows of a form: its own keys, then the actions from there."""
    rows = (
        Content("  ").join(each.drawn(pad=" ") for each in acts),
        Content(" ").join(each.drawn() for each in views),
    )
    return Content("\n").join(Content(" ").append(row).truncate(width) for row in rows)
