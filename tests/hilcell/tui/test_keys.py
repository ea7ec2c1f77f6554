"""Keys: the table, files that rebind them, bursts, and the help made of them."""

from __future__ import annotations

import json
import random
import re
import string
import tempfile
import textwrap
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from textual._xterm_parser import XTermParser
from textual.binding import Binding
from textual.events import Key
from textual.keys import Keys, _normalize_key_list
from textual.widgets import Input

from hilcell.cell.settings import SettingsError
from hilcell.sanitize import UNSAFE
from hilcell.tui import keys
from hilcell.tui.app import HilcellApp
from hilcell.tui.keys import (
    ACTIONS,
    BY_NAME,
    ESCAPE,
    NAMED,
    RESERVED,
    Keymap,
    conflicts,
    default_file,
    is_key,
    load_keys,
    named,
    shown,
)
from hilcell.tui.screens.base import BaseScreen, Confirm
from hilcell.tui.screens.help import HelpPage, help_lines
from hilcell.tui.screens.pages import DetailPage
from hilcell.tui.screens.run import RunScreen
from hilcell.tui.screens.start import PlanSummary, StartScreen
from hilcell.tui.terminal import UNICODE
from hilcell.tui.text.actions import ACTS, VIEWS, WORDS
from hilcell.tui.text.plots import MOST_TABS
from hilcell.tui.widgets import Choice, Table, TextField
from tests.hilcell.tui.all_screens import PLAN, isolated
from tests.hilcell.tui.recording_app import (
    DEFAULT_KEYS,
    Press,
    RecordingApp,
    Stage,
    on_screen,
    press,
    run_app,
    settle,
    text_of,
    type_ahead,
)
from tests.hilcell.tui.views import drawn

DEFAULTS = {action.name: action.keys for action in ACTIONS}
FREE = sorted({*string.ascii_letters, *string.digits, *NAMED} - set(RESERVED))
PRINTED = st.characters(exclude_categories=["Cs"]).filter(str.isprintable)
REBOUND = [action.name for action in ACTIONS if action.name != "stop"]


def load(folder: Path, text: str | bytes) -> Keymap:
    file = folder / "keys.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_keys(file)


def file_problems(folder: Path, text: str | bytes) -> str:
    with pytest.raises(SettingsError) as caught:
        load(folder, text)
    assert "keys.toml" in str(caught.value)
    return str(caught.value)


def test_the_defaults_have_no_conflict_and_are_keys() -> None:
    assert conflicts(DEFAULTS) == []
    assert all(is_key(key) for keys in DEFAULTS.values() for key in keys)
    assert len(BY_NAME) == len(ACTIONS)
    for action in ACTIONS:  # none hangs on a function key
        assert any(not (key[:1] == "f" and key[1:].isdigit()) for key in action.keys), action.name
    promised = {
        "pause": "space", "stop": "escape", "abort": "a", "retake": "r", "history": "h", "log": "l",
        "plots": "p", "interlocks": "i", "help": "question_mark", "detach": "d",
    }  # fmt: skip
    assert all(key in DEFAULTS[name] for name, key in promised.items())


def test_the_default_file_is_read_where_it_exists(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_file() == tmp_path / ".config" / "hilcell" / "keys.toml"
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert default_file() == tmp_path / "hilcell" / "keys.toml"
    assert load_keys(None) == DEFAULTS
    default_file().parent.mkdir()
    default_file().write_text('[keys]\nhistory = "H"\n')
    assert load_keys(None) == DEFAULTS | {"history": ("H",)}


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ('history = ["H", "ctrl+y"]\nlog = "L"', {"history": ("H", "ctrl+y"), "log": ("L",)}),
        ('log = "h"\nhistory = "l"', {"log": ("h",), "history": ("l",)}),  # they swap
        ('log = ["f5", "L"]', {"log": ("f5", "L")}),
        ('stop = "s"', {"stop": ("s", ESCAPE)}),  # Esc stops whatever the file says
        ('stop = ["escape", "s"]', {"stop": (ESCAPE, "s")}),
    ],
)
def test_a_file_rebinds_keys(tmp_path: Path, text: str, wanted: Keymap) -> None:
    assert load(tmp_path, f"[keys]\n{text}\n") == DEFAULTS | wanted


@pytest.mark.parametrize(
    ("text", "tokens"),
    [
        ('[keys]\nhistori = "H"', ["keys.histori", "history"]),
        ('[keys]\nxyzzy = "H"', ["keys.xyzzy", "stop, pause"]),
        ("[keys]\nlog = 5", ["keys.log", "5"]),
        ("[keys]\nlog = []", ["keys.log", "[]"]),
        ('[keys]\nlog = ["L", 5]', ["keys.log"]),
        ('[keys]\nlog = "super+l"', ["keys.log", "super+l"]),
        ('[keys]\nlog = ""', ["keys.log", "''"]),
        ('[keys]\nlog = "e\u0301"', ["keys.log"]),  # a letter and an accent: two characters
        ('[keys]\nlog = "\\u202e"', ["keys.log", "\\u202e"]),
        ('[keys]\nlog = "ctrl+é"', ["keys.log", "ctrl+é"]),
        ('[keys]\nlog = "д"\nplots = "д"', ["'д'", "plots and log"]),
        ('[keys]\nlog = " "', ["'space'", "pause and log"]),
        ('[keys]\nlog = "escape"', ["'Esc'", "stop and log"]),
        ('[keys]\nlog = ["f5", "f12"]', ["keys.log", "f5, f12"]),
        ('[keys]\nlog = "q"', ["'q' of log"]),
        ("keys = 5", ["keys:", "5"]),
        ('log = "L"', ["log:"]),
        ("[keys\n", ["TOML"]),
        (b"[keys]\nlog = '\xff'", ["TOML"]),
    ],
)
def test_a_refusal_names_the_problem(tmp_path: Path, text: str | bytes, tokens: list[str]) -> None:
    problems = file_problems(tmp_path, text)
    assert [token for token in tokens if token not in problems] == []


def test_a_file_that_was_named_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(SettingsError):
        load_keys(tmp_path / "none.toml")


def test_all_problems_are_reported_at_once(tmp_path: Path) -> None:
    text = '[keys]\nlog = "h"\nhistori = "H"\nplots = "f1"\nreport = "q"\n[other]\n'
    reported = file_problems(tmp_path, text)
    for part in ("log and history", "histori", "(f1)", "of report", "other:"):
        assert part in reported


def bound(keys: list[str]) -> Keymap:
    keymap: Keymap = {name: (key,) for name, key in zip(REBOUND, keys, strict=True)}
    return keymap | {"stop": (ESCAPE,)}


@given(st.randoms(use_true_random=False))
def test_any_choice_of_different_keys_is_accepted(chance: random.Random) -> None:
    keys = chance.sample(FREE, len(REBOUND))
    assert conflicts(bound(keys)) == []


@given(st.randoms(use_true_random=False))
def test_any_key_used_twice_is_refused(chance: random.Random) -> None:
    keys = chance.sample(FREE, len(REBOUND))
    keymap = bound(keys)
    one, other = chance.sample(REBOUND, 2)
    keymap[one] = (*keymap[one], *keymap[other])
    (reported,) = conflicts(keymap)
    assert one in reported
    assert other in reported
    assert repr(shown(keymap[other][0])) in reported


def test_fixed_keys_cannot_be_taken() -> None:
    assert all(conflicts({"log": (key,)}) for key in RESERVED)


def test_named_keys_are_named_as_the_terminal_library_names_them() -> None:
    signs = "slash question_mark comma full_stop minus plus semicolon colon space"
    assert set(NAMED) <= {key.value for key in Keys} | {*signs.split()}


def test_keys_are_printed_shortly() -> None:
    keys = ("slash", "question_mark", "minus", "colon", "space", ESCAPE, "ctrl+q", "a", "é", "<")
    assert [shown(key) for key in keys] == ["/", "?", "-", ":", "space", "Esc", "^q", "a", "é", "<"]


@given(PRINTED)
def test_every_printed_character_is_a_key_and_is_the_one_that_comes(letter: str) -> None:
    key = named(letter)
    assert is_key(key)
    (event,) = XTermParser().feed(letter)
    assert isinstance(event, Key)
    assert _normalize_key_list(key) == event.key
    if letter != " ":
        assert shown(key) == letter
        assert not UNSAFE.search(shown(key))


@given(st.lists(PRINTED, min_size=1, unique=True))
def test_printed_characters_are_bound_as_they_are_typed(letters: list[str]) -> None:
    text = json.dumps(letters, ensure_ascii=False)
    with tempfile.TemporaryDirectory() as folder:
        keys = [named(letter) for letter in letters]
        taken = {key for action, ks in DEFAULTS.items() if action != "log" for key in ks}
        if set(keys) & {*RESERVED, *taken}:
            file_problems(Path(folder), f"[keys]\nlog = {text}\n")
        else:
            assert load(Path(folder), f"[keys]\nlog = {text}\n")["log"] == tuple(keys)


def test_the_examples_in_the_words_are_good(tmp_path: Path) -> None:
    guide = Path(__file__).parents[3] / "docs" / "first-calibration.md"
    examples = re.findall(r"```toml\n(\[keys\].*?)```", guide.read_text(), re.DOTALL)
    in_code = str(keys.__doc__).partition("keys.toml\n")[2].partition("\n\n")[0]
    examples.append(textwrap.dedent(in_code))
    assert len(examples) == 2
    for number, example in enumerate(examples):
        file = tmp_path / f"{number}.toml"
        file.write_text(example)
        assert load_keys(file) != load_keys(Path("/dev/null"))


__all__ = ["PLAN", "isolated"]

pytestmark = pytest.mark.usefixtures("isolated")


def keys_of_key_order(text: str) -> list[str]:
    return ["space" if letter == " " else letter for letter in text]


def values(app: RecordingApp) -> dict[str, str]:
    return {str(box.id): box.value for box in app.screen.query(Input)}


@on_screen()
async def test_text_goes_into_the_field_that_a_tab_before_it_chose(
    app: Stage, pilot: Press
) -> None:
    name, job = map(keys_of_key_order, ("Harold Smith", "Job 7"))
    type_ahead(app, "tab", *name, "tab", *job, "down", "2")
    await settle(pilot)
    assert isinstance(app.screen, StartScreen)
    entries = {"cell": "paper", "operator": "Harold Smith", "job": "Job 7", "seed": "2", "from": ""}
    assert values(app) == entries


@on_screen()
async def test_a_field_is_edited_in_the_order_typed(app: Stage, pilot: Press) -> None:
    type_ahead(app, "shift+tab", "ctrl+u", *"replax", "backspace", "y", "home", "x", "delete")
    type_ahead(app, "tab", "shift+tab", "end", "2")
    await settle(pilot)
    assert values(app)["cell"] == "xeplay2"


@on_screen()
async def test_a_second_code_from_a_scanner_starts_nothing(app: Stage, pilot: Press) -> None:
    type_ahead(app, "tab", *keys_of_key_order("Ann"), "tab", *keys_of_key_order("JOB-7"), "enter")
    await settle(pilot)
    assert isinstance(app.screen, PlanSummary)
    assert "operator Ann" in text_of(app)
    type_ahead(app, *keys_of_key_order("JOB-8"), "enter")
    await settle(pilot)
    assert isinstance(app.screen, PlanSummary)
    assert "job JOB-7" in text_of(app)


def test_a_detach_in_a_burst_asks() -> None:
    async def act(app: Stage, pilot: Press) -> None:
        type_ahead(app, "w", "d")
        await settle(pilot)
        assert isinstance(app.screen, Confirm)
        assert "detach" in text_of(app)

    assert run_app(act, "running").detached == []


@on_screen("suspended")
async def test_an_enter_in_a_burst_is_no_answer_to_a_prompt(app: Stage, pilot: Press) -> None:
    type_ahead(app, "w", "enter")
    await settle(pilot)
    assert "press it alone" in text_of(app)
    assert app.recorded.asked == []
    await press(pilot, "enter")
    assert app.recorded.asked == [("answer", {})]


@pytest.mark.parametrize("state", ["paused", "fault", "running"])
@on_screen()
async def test_a_scanned_code_moves_nothing_and_leaves_nothing(
    app: Stage, pilot: Press, state: str
) -> None:
    for code in (" \ny", "r\n", "d"):
        type_ahead(app, "f9", *["enter" if key == "\n" else key for key in keys_of_key_order(code)])
        await settle(pilot)
        while not isinstance(app.screen, RunScreen):
            await press(pilot, "q")
    assert app.detached == []
    assert app.engines == []
    assert [word for word, _ in app.recorded.asked if word != "pause"] == []


@on_screen()
async def test_choices_follow_the_keys_before_them(app: Stage, pilot: Press) -> None:
    type_ahead(
        app, "home", "end", *["down"] * 3, "up", *["tab"] * 5, "space", "tab", "right", "down"
    )
    await settle(pilot)
    assert [each.index for each in app.screen.query(Choice)] == [1, 1, 2]


@on_screen("running")
async def test_the_point_under_the_cursor_is_the_one_acted_upon(app: Stage, pilot: Press) -> None:
    rows = app.screen.query_one(Table)
    type_ahead(app, "end", "up", "r")
    await settle(pilot)
    assert isinstance(app.screen, Confirm)
    assert f"grid point {rows.rows[-2].key.removeprefix('grid/')} " in text_of(app)
    type_ahead(app, "n", "home", "enter")
    await settle(pilot)
    assert isinstance(app.screen, DetailPage)
    assert rows.rows[0].key in text_of(app)
    type_ahead(app, "q", "end", "enter", "q", "r")
    await settle(pilot)
    assert isinstance(app.screen, Confirm)
    assert f"grid point {rows.rows[-1].key.removeprefix('grid/')} " in text_of(app)


@on_screen()
async def test_the_run_under_the_cursor_is_the_one_marked(app: Stage, pilot: Press) -> None:
    await press(pilot, "h")
    type_ahead(app, "x", "down", "down", "x", "up", "x", "x")
    await settle(pilot)
    table = app.screen.query_one(Table)
    marks = [table.columns[0].of(run) for run in table.rows]
    assert marks == ["", "", "*", ""]  # of three the first went, the third was taken back


@on_screen("running")
async def test_a_filter_ends_with_its_enter(app: Stage, pilot: Press) -> None:
    type_ahead(app, "slash", *"grad", "backspace", "backspace", *"id", "enter", "end", "r")
    await settle(pilot)
    assert app.screen_stack[-2].query_one(Input).value == "grid"
    assert isinstance(app.screen_stack[-2], RunScreen)
    key = app.screen_stack[-2].query_one(Table).key
    assert f"grid point {key.removeprefix('grid/')} " in text_of(app)


WRITTEN = {  # a key in the help: its names
    "▲▼": {"up", "down"},
    "◄ ►": {"left", "right"},
    f"1-{MOST_TABS}": {str(n + 1) for n in range(MOST_TABS)},
}
OTHER_WAYS = {"backspace": "q", "s": "S"}  # of keys that are explained
WIDGETS = (Table, Choice, TextField)


def bound_of_help(owner: type) -> set[str]:
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
    assert bound_of_help(screen) <= explained(screen)
    elsewhere = set().union(*map(bound_of_help, (*WIDGETS, HilcellApp)))
    assert explained(screen) <= bound_of_help(screen) | elsewhere


def test_each_action_stands_there_with_the_word_of_its_footer() -> None:
    lines = drawn(help_lines(DEFAULT_KEYS, UNICODE, {})).splitlines()
    starts = [line[:23].split() for line in lines if len(line) > 23]
    for action in ACTIONS:
        word = WORDS.get(action.label, action.label)
        keys = [shown(key) for key in DEFAULT_KEYS[action.name]]
        assert [*keys, *word.split()] in starts, action
    assert {*ACTS, *VIEWS} <= {action.name for action in ACTIONS}


@pytest.mark.usefixtures("isolated")
@on_screen("running", size=(80, 70))
async def test_no_line_of_the_help_is_wider_than_the_screen(app: Stage, pilot: Press) -> None:
    await press(pilot, "question_mark")
    assert "Keys of the run" in text_of(app)
    assert "▲▼        choose a point" in text_of(app)
    fixed = {title: each.all_fixed_keys() for title, each in HelpPage.SCREENS.items()}
    for width in (22, 39, 59, 79):
        lines = drawn(help_lines(DEFAULT_KEYS, UNICODE, fixed), width).splitlines()
        assert max(map(len, lines)) <= width
