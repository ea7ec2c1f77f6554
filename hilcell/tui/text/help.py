"""The help page: the meaning of each line of the screen, and of each key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from textual.content import Content

from hilcell.journal.point_words import procedure_words
from hilcell.tui.keys import ACTIONS, Keymap, shown
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.footer import EVERY_ACTION, PALETTE_KEY, WORDS
from hilcell.tui.text.frame import hanging, wrapped
from hilcell.tui.text.run import STATES

LINES = (
    ("state", "the block on top: shape, word and colour say the same"),
    ("LIVE / HISTORIC", "an engine is at work, or the run is over"),
    ("SIMULATION", "no machine moves: the cell is a simulated one"),
    ("step", "the step, its part, how many of the part's points are measured"),
    ("bar", "time worked, time left; pauses do not count"),
    ("lamps", "each device's last reading and its age; grey is too old to be trusted"),
    ("air", "temperature at the tracker, and its change since the first point"),
    ("interlocks", "locked, free or waiting, and in short why; all of it on their page"),
    ("|e| dx dy dz", "actual - nominal in {W}, of the newest or the chosen point; grey is old"),
    ("PASS, FAIL", "a finished run: its worst station decides; UNDECIDED: neither is shown"),
    ("last rows", "the worst alarm, or the next step; acts; views; a grey key does nothing"),
    ("points", "all points; up and down choose, Enter opens one"),
    ("as sent", "before the correction; paper method: corrected as the paper does"),
    ("corrected", "by the correction that is used; this alone is held against the tolerance"),
    ("point's state", "in, ok; OUT: over its limit; noisy: its readings scatter too much"),
    ("waits, again", "the point is to be re-measured; it was re-measured"),
)
STORY = f"""\
A first calibration: choose {procedure_words("calibrate")}, type your name, then Enter twice.
When it is DONE: look at the largest errors and find their cause, then write the report.
After a FAULT: read the alarm, put it right, then resume. Measured points are kept."""
KEYS, WORD, NAME = 10, 13, 18  # columns


def help_lines(
    keymap: Keymap, glyphs: Glyphs, fixed: Mapping[str, Sequence[tuple[str, str]]], width: int
) -> Content:
    """Return the whole help; ``fixed``: by screen, the keys that cannot be rebound."""
    keys = [
        (" ".join(shown(key) for key in keymap[each.name]), each.label, each.help)
        for each in ACTIONS
    ]
    keys.append((PALETTE_KEY, EVERY_ACTION, "the palette: every action by its name"))
    parts: list[Content] = []
    for line in STORY.splitlines():
        parts += wrapped(line, width)
    parts += _title("Keys")
    for key, label, text in keys:
        parts += _entry(key, KEYS, f"{WORDS.get(label, label):<{WORD}}{text}", width)
    for title, pairs in fixed.items():
        parts += _title(f"Keys of {title}")
        for key, text in pairs:
            parts += _entry(key, KEYS, text, width)
    parts += _title("What the screen says")
    for name, text in LINES:
        parts += _entry(name, NAME, text, width)
    parts += _title("States")
    states = "  ".join(f"{glyphs.states[key]} {word}" for key, (word, _) in STATES.items())
    return Content("\n").join([*parts, *wrapped(states, width)])


def _title(title: str) -> list[Content]:
    return [Content(""), Content.styled(title, "bold")]


def _entry(name: str, indent: int, text: str, width: int) -> list[Content]:
    return hanging(Content.styled(f"{name:<{indent - 1}} ", "bold"), text, width)
