"""The help page: the meaning of each line of the screen, and of each key."""

from __future__ import annotations

from textual.content import Content

from hilcell.tui.keys import ACTIONS, Keymap, shown
from hilcell.tui.terminal.capabilities import Glyphs
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
    ("|e| dx dy dz", "actual - nominal in the world {W}, and |e| against its limit"),
    ("", "of the newest point, or of the one chosen with up and down; grey is old"),
    ("PASS, FAIL", "a finished run: its worst station decides; w, b, / or Enter: the points"),
    ("last rows", "the worst alarm, or the next step; acts; views; a grey key does nothing"),
    ("points", "all points; up and down choose, Enter opens one"),
    ("as sent", "before the correction; paper method: by the paper's; corrected: by the"),
    ("", "correction that is used, which alone is held against the tolerance"),
    ("point's state", "in, ok; OUT: over its limit; noisy: its readings scatter too much"),
    ("", "waits: to be re-measured; again: re-measured"),
)
STORY = (
    "A first calibration: choose `calibrate`, type your name, Enter shows the plan, Enter starts.",
    "When it is DONE: look at the largest errors and find their cause, then write the report.",
    "After a FAULT: read the alarm, put it right, then resume. Measured points are kept.",
)


def help_lines(keymap: Keymap, glyphs: Glyphs) -> Content:
    """Return the whole help."""
    parts: list[Content] = [Content(line) for line in STORY]
    parts += [Content(""), Content.styled("Keys", "bold")]
    for action in ACTIONS:
        keys = " ".join(shown(key) for key in keymap[action.name])
        parts.append(Content.assemble((f"{keys:<12}", "bold"), action.help))
    parts += [
        Content.assemble((f"{'^p':<12}", "bold"), "the palette: every action by its name"),
        Content.assemble((f"{'q':<12}", "bold"), "back to the run"),
        Content(""),
        Content.styled("What the screen says", "bold"),
    ]
    parts += [Content.assemble((f"{name:<18}", "bold"), text) for name, text in LINES]
    parts += [Content(""), Content.styled("States", "bold")]
    states = "  ".join(f"{glyphs.states[key]} {word}" for key, (word, _) in STATES.items())
    return Content("\n").join([*parts, Content(states)])
