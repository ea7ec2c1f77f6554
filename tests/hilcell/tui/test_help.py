"""The help page against the keys that screens and footers really have."""

from __future__ import annotations

import pytest
from textual.binding import Binding
from textual.pilot import Pilot

from hilcell.tui.app import HilcellApp
from hilcell.tui.keys import ACTIONS, shown
from hilcell.tui.screens.base import BaseScreen
from hilcell.tui.screens.help import HelpPage, help_lines
from hilcell.tui.terminal import UNICODE
from hilcell.tui.text.actions import ACTS, VIEWS, WORDS
from hilcell.tui.text.plots import MOST_TABS
from hilcell.tui.widgets import Choice, Table, TextField
from tests.hilcell.tui.all_screens import isolated
from tests.hilcell.tui.recording_app import DEFAULT_KEYS, RecordingApp, press, run_app, text_of
from tests.hilcell.tui.views import drawn

__all__ = ["isolated"]

WRITTEN = {  # a key in the help: its names
    "▲▼": {"up", "down"},
    "◄ ►": {"left", "right"},
    f"1-{MOST_TABS}": {str(n + 1) for n in range(MOST_TABS)},
}
OTHER_WAYS = {"backspace": "q", "s": "S"}  # of keys that are explained
WIDGETS = (Table, Choice, TextField)


def bound(owner: type) -> set[str]:
    """Return the keys that hilcell binds in a class, without other ways of them."""
    found = set()
    for each in owner.__mro__:
        if each.__module__.startswith("hilcell"):
            bindings = [b for b in vars(each).get("BINDINGS", ()) if isinstance(b, Binding)]
            found |= {key for b in bindings for key in b.key.split(",")}
    return found - OTHER_WAYS.keys()


def explained(screen: type[BaseScreen]) -> set[str]:
    """Return the keys that the help explains for a screen."""
    keys = [key for key, _ in screen.all_fixed_keys()]
    return set().union(*(WRITTEN.get(key, {key if key == "S" else key.lower()}) for key in keys))


@pytest.mark.parametrize("title", HelpPage.SCREENS)
def test_each_key_of_a_screen_is_explained_and_each_explained_one_is_bound(title: str) -> None:
    screen = HelpPage.SCREENS[title]
    assert bound(screen) <= explained(screen)
    elsewhere = set().union(*map(bound, (*WIDGETS, HilcellApp)))
    assert explained(screen) <= bound(screen) | elsewhere


def test_each_action_stands_there_with_the_word_of_its_footer() -> None:
    lines = drawn(help_lines(DEFAULT_KEYS, UNICODE, {})).splitlines()
    starts = [line[:23].split() for line in lines if len(line) > 23]
    for action in ACTIONS:
        word = WORDS.get(action.label, action.label)
        keys = [shown(key) for key in DEFAULT_KEYS[action.name]]
        assert [*keys, *word.split()] in starts, action
    assert {*ACTS, *VIEWS} <= {action.name for action in ACTIONS}


@pytest.mark.usefixtures("isolated")
def test_no_line_of_the_help_is_wider_than_the_screen() -> None:
    async def act(app: RecordingApp, pilot: Pilot[int]) -> None:
        await press(pilot, "question_mark")
        assert "Keys of the run" in text_of(app)
        assert "▲▼        choose a point" in text_of(app)

    run_app(act, "running", size=(80, 70))
    fixed = {title: each.all_fixed_keys() for title, each in HelpPage.SCREENS.items()}
    for width in (22, 39, 59, 79):
        lines = drawn(help_lines(DEFAULT_KEYS, UNICODE, fixed), width).splitlines()
        assert max(map(len, lines)) <= width
