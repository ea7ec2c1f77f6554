"""The shapes that the screen is drawn with: Unicode, or plain ASCII for old terminals."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Glyphs:
    """One set of shapes; every one of them is a single column wide."""

    states: dict[str, str]
    fresh: str
    moving: str
    stale: str
    lost: str
    full: str
    empty: str
    mark: str
    rule: str
    over_left: str
    over_right: str
    degree: str
    plus_minus: str
    delta: str
    dot: str
    plain: bool


UNICODE = Glyphs(
    states={
        "idle": "○", "checking": "◌", "running": "■", "pausing": "▽", "paused": "▲",
        "suspended": "◆", "stopping": "▼", "done": "●", "intolerant": "▣", "aborted": "□",
        "fault": "✖", "gone": "◇", "silent": "◎", "unreadable": "▤", "looking": "◔",
    },
    fresh="●", moving="◐", stale="○", lost="✖", full="█", empty="░", mark="▼", rule="─",
    over_left="◀", over_right="▶", degree="°", plus_minus="±", delta="Δ", dot="·", plain=False,
)  # fmt: skip

ASCII = Glyphs(
    states={
        "idle": "-", "checking": "~", "running": "#", "pausing": "=", "paused": "^",
        "suspended": "?", "stopping": "V", "done": "*", "intolerant": "!", "aborted": "o",
        "fault": "X", "gone": "/", "silent": "%", "unreadable": "$", "looking": ":",
    },
    fresh="*", moving="~", stale="o", lost="X", full="#", empty=".", mark="V", rule="-",
    over_left="<", over_right=">", degree=" deg", plus_minus="+-", delta="d", dot="|", plain=True,
)  # fmt: skip

_PLAIN = str.maketrans(
    {
        "─": "-", "│": "|", "┌": "+", "┐": "+", "└": "+", "┘": "+", "├": "+", "┤": "+", "┬": "+",
        "┴": "+", "┼": "+", "°": " ", "±": "~", "·": "|", "…": "~", "⚠": "!", "→": ">",
    }
)  # fmt: skip


def to_ascii(text: str) -> str:
    """Return ``text`` in ASCII: known shapes by their like, everything else as ``?``."""
    return text.translate(_PLAIN).encode("ascii", "replace").decode()
