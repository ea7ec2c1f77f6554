"""The keys: one table of actions, rebound by a TOML file, checked for conflicts.

    # ~/.config/hilcell/keys.toml
    [keys]
    history = ["h", "ctrl+y"]
    log = ["l", "д"]

A key is any printed character, a word for one, or `ctrl+` with a letter from a to z. Terminals,
multiplexers and keyboard layouts eat keys: no action depends on a function key alone, and Esc
stops whatever a file says.

Keys may come in bursts, from a scanner or over a slow connection. Widgets and screens pass keys on
as messages: `wait_until_processed` and `wait_until_built` let one key take effect before the next
is read.
"""

from __future__ import annotations

import asyncio
import os
import string
import tomllib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hilcell.cell.settings import SettingsError, did_you_mean

if TYPE_CHECKING:
    from textual.message_pump import MessagePump

ESCAPE = "escape"


@dataclass(frozen=True, slots=True)
class Action:
    """One thing that a key does."""

    name: str
    keys: tuple[str, ...]
    label: str
    help: str
    everywhere: bool = False  # works in text boxes, too


ACTIONS = (
    Action("stop", (ESCAPE,), "STOP", "stop everything now; never asks", everywhere=True),
    Action("pause", ("space",), "pause/go on", "pause after the point in flight, or go on"),
    Action("abort", ("a",), "abort", "end the run after the point in flight; asks"),
    Action("retake", ("r",), "re-measure", "re-measure the chosen point; asks"),
    Action("acknowledge", ("k",), "acknowledge", "acknowledge the alarms that were read"),
    Action("bad", ("b",), "bad only", "show only points that are out, noisy or re-measured"),
    Action("sort", ("w",), "worst first", "order points: as measured, or worst first"),
    Action("find", ("slash",), "filter", "show only rows with the words typed"),
    Action("alarms", ("e",), "alarms", "every alarm, what it means and what to do"),
    Action("plots", ("p",), "plots", "errors before and after, sorted, repeatability, strip"),
    Action("interlocks", ("i",), "interlocks", "what may move, and why not"),
    Action("log", ("l",), "log", "every record of the journal"),
    Action("report", ("o",), "report", "write the report and show its figures"),
    Action("history", ("h",), "history", "earlier runs; two can be compared"),
    Action("mark", ("x",), "mark", "in the history: mark a run to be compared"),
    Action("compare", ("c",), "compare two", "in the history: the drift between two runs"),
    Action("new", ("n",), "new run", "choose cell and procedure and start a run"),
    Action("commission", ("C",), "commission", "prove a cell's signs and places, write its file"),
    Action("again", ("u",), "repeat step", "in commissioning: perform the chosen step alone"),
    Action("onward", ("f",), "from here", "in commissioning: the chosen step and all after it"),
    Action("detach", ("d",), "detach", "leave the screen; the run goes on"),
    Action("theme", ("t",), "theme", "the next theme"),
    Action("help", ("question_mark",), "help", "explain this screen", everywhere=False),
    Action("quit", ("ctrl+q", "ctrl+c"), "quit", "leave; over a live run it asks", everywhere=True),
)
BY_NAME = {action.name: action for action in ACTIONS}
CHOICE_KEYS = ("1", "2", "3")  # answers to a prompt, in its order
# Keys with a fixed meaning: to move, to choose, to go back, to open the palette.
RESERVED = (
    "enter", "tab", "shift+tab", "up", "down", "left", "right", "pageup", "pagedown", "home",
    "end", "backspace", "q", "ctrl+p", "y", *CHOICE_KEYS,
    "ctrl+h", "ctrl+i", "ctrl+j", "ctrl+m",  # what terminals send for Backspace, Tab and Enter
)  # fmt: skip
NAMED = (
    "space", "slash", "question_mark", "comma", "full_stop", "minus", "plus", "semicolon", "colon",
    "insert", "delete", *(f"f{number}" for number in range(1, 25)),
)  # fmt: skip
_SHOWN = {
    "slash": "/", "question_mark": "?", "comma": ",", "full_stop": ".", "minus": "-", "plus": "+",
    "semicolon": ";", "colon": ":", ESCAPE: "Esc",
}  # fmt: skip
_NAMES = {" ": "space"} | {sign: name for name, sign in _SHOWN.items() if name in NAMED}

Keymap = dict[str, tuple[str, ...]]


def default_file() -> Path:
    base = os.environ.get("XDG_CONFIG_HOME", "")
    return (Path(base) if base else Path.home() / ".config") / "hilcell" / "keys.toml"


def load_keys(path: Path | None) -> Keymap:
    """Return the keys of every action; raises `SettingsError` with all problems of the file.

    Without a path the default file is read where it exists.
    """
    file = path or default_file()
    defaults = {action.name: action.keys for action in ACTIONS}
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        if path is None and isinstance(error, FileNotFoundError | NotADirectoryError):
            return defaults
        raise SettingsError(str(file), [f"cannot be read: {error.strerror}"]) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SettingsError(str(file), [f"cannot be read as TOML: {error}"]) from error
    problems = [f"{name}: only [keys] is known" for name in table if name != "keys"]
    keys, keymap = table.get("keys", {}), dict(defaults)
    if not isinstance(keys, dict):
        problems.append(f"keys: expected a table, got {keys!r}")
        keys = {}
    for name, value in keys.items():
        if name not in BY_NAME:
            hint = did_you_mean(name, BY_NAME) or f"; actions: {', '.join(BY_NAME)}"
            problems.append(f"keys.{name}: no such action{hint}")
            continue
        keymap[name] = _keys_of(name, value, problems)
    keymap["stop"] = tuple(dict.fromkeys((*keymap["stop"], ESCAPE)))
    problems += conflicts(keymap)
    if problems:
        raise SettingsError(str(file), problems)
    return keymap


def _keys_of(name: str, value: object, problems: list[str]) -> tuple[str, ...]:
    keys = [value] if isinstance(value, str) else value
    if not (isinstance(keys, list) and keys and all(isinstance(key, str) for key in keys)):
        problems.append(f"keys.{name}: expected a key or a list of keys, got {value!r}")
        return ()
    problems.extend(
        f"keys.{name}: {key!r} is no key; write a, A, é, ctrl+a, f5, space, slash"
        for key in keys
        if not is_key(key)
    )
    if all(key[:1] == "f" and key[1:].isdigit() for key in keys):
        problems.append(
            f"keys.{name}: function keys alone ({', '.join(keys)}) are eaten by some terminals; "
            "add another key"
        )
    return tuple(map(named, keys))


def is_key(key: str) -> bool:
    """Whether a word names a key: of any layout, one printed character."""
    if key.startswith("ctrl+"):
        return key.removeprefix("ctrl+") in tuple(string.ascii_lowercase)
    return (len(key) == 1 and key.isprintable()) or key in (*NAMED, ESCAPE)


def named(key: str) -> str:
    """Return the word for a character that has one, so that no key has two names."""
    return _NAMES.get(key, key)


def conflicts(keymap: Keymap) -> list[str]:
    users: dict[str, list[str]] = {}
    for name, keys in keymap.items():
        for key in dict.fromkeys(keys):
            users.setdefault(key, []).append(name)
    problems = [
        f"key {shown(key)!r} means {' and '.join(names)}; give each a key of its own"
        for key, names in users.items()
        if len(names) > 1
    ]
    return problems + [
        f"key {shown(key)!r} of {names[0]} has a fixed meaning; choose another"
        for key, names in users.items()
        if key in RESERVED
    ]


def shown(key: str) -> str:
    return _SHOWN.get(key, key.replace("ctrl+", "^"))


LONGEST_S = 0.2  # a widget that is being removed may process nothing
BUILT_S = 2.0  # a screen that is left too early is never built


async def wait_until_processed(nodes: Iterable[MessagePump]) -> None:
    """Wait until each in turn has processed its messages, at most `LONGEST_S` each."""
    for node in nodes:
        taken = asyncio.Event()
        if node.call_later(taken.set):
            await _soon(taken, LONGEST_S)


async def wait_until_built(built: asyncio.Event) -> None:
    """Wait until a screen is built, at most `BUILT_S`, so that keys are always taken again."""
    await _soon(built, BUILT_S)


async def _soon(event: asyncio.Event, limit_s: float) -> None:
    with suppress(TimeoutError):
        await asyncio.wait_for(event.wait(), limit_s)
