"""The help page, made of the keys that the screens really have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from hilcell.journal.labels import procedure_label
from hilcell.language import marked, tr
from hilcell.tui.keys import ACTIONS, Keymap, shown
from hilcell.tui.layout import BLANK, Cell, Col, Grid, Lines, Stack, Text
from hilcell.tui.run_view import RunView
from hilcell.tui.screens.base import BaseScreen
from hilcell.tui.screens.commissioning import CommissionScreen
from hilcell.tui.screens.pages import HistoryPage, LogPage, PlotPage, TextPage
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import StartScreen
from hilcell.tui.terminal import Glyphs
from hilcell.tui.text.actions import EVERY_ACTION, PALETTE_KEY, WORDS
from hilcell.tui.text.run import STATES

LINES = marked(
    (
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
        ("corrected", "by the correction that is used; this alone is compared with the tolerance"),
        ("point's state", "in, ok; OUT: over its limit; noisy: its readings scatter too much"),
        ("waits, again", "the point is to be re-measured; it was re-measured"),
    )
)
STORY = marked(
    "A first calibration: choose {procedure}, type your name, then Enter twice.\n"
    "When it is DONE: look at the largest errors and find their cause, then write the report.\n"
    "After a FAULT: read the alarm, remedy its cause, then resume. Measured points are kept."
)


def help_lines(
    keymap: Keymap, glyphs: Glyphs, fixed: Mapping[str, Sequence[tuple[str, str]]]
) -> Lines:
    """Return the whole help; ``fixed``: by screen, the keys that cannot be rebound."""
    keys: list[Sequence[Cell]] = [
        (
            (" ".join(shown(key) for key in keymap[each.name]), "bold"),
            tr(WORDS.get(each.label, each.label)),
            tr(each.help),
        )
        for each in ACTIONS
    ]
    keys.append(
        ((PALETTE_KEY, "bold"), tr(EVERY_ACTION), tr("the palette: every action by its name"))
    )
    text = Col(grows=True, wraps=True)
    story = tr(STORY, procedure=procedure_label("calibrate"))
    parts: list[Lines | Text] = [*story.splitlines(), BLANK, (tr("Keys"), "bold")]
    parts.append(Grid(keys, Col(9), Col(12), text))
    for title, pairs in fixed.items():
        parts += [BLANK, (tr("Keys of {title}", title=tr(title)), "bold")]
        parts.append(Grid((((key, "bold"), tr(words)) for key, words in pairs), Col(9), text))
    parts += [BLANK, (tr("What the screen shows"), "bold")]
    parts.append(Grid((((tr(name), "bold"), tr(words)) for name, words in LINES), Col(17), text))
    states = "  ".join(f"{glyphs.states[key]} {tr(word)}" for key, (word, _) in STATES.items())
    return Stack(*parts, BLANK, (tr("States"), "bold"), states)


class HelpPage(TextPage):
    """The meaning of the keys and of the lines."""

    SCREENS: ClassVar[dict[str, type[BaseScreen]]] = {  # by their titles
        marked("the run"): RunScreen,
        marked("a new run"): StartScreen,
        marked("the plots"): PlotPage,
        marked("the runs"): HistoryPage,
        marked("the log"): LogPage,
        marked("commissioning"): CommissionScreen,
        marked("other pages"): TextPage,
    }

    title_text = marked("Help")
    footer = ("stop", "quit")

    def text(self, view: RunView | None) -> Lines:
        fixed = {title: each.all_fixed_keys() for title, each in self.SCREENS.items()}
        return help_lines(self.application.keymap, self.application.glyphs, fixed)
