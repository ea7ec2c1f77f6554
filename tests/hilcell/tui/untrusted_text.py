"""Words that bite: markup, escape sequences, control and direction marks, length, wide letters."""

from __future__ import annotations

from typing import Any, cast

import msgspec

from hilcell.journal.index import RunRow
from hilcell.journal.journal import Record
from hilcell.run.control import Status
from hilcell.tui.session import RunUpdate
from tests.hilcell.tui.sample_runs import PROMPT, fresh

MARK = "PWNED"  # in every payload, to be searched for behind what must not be before it
NASTY = {
    "closing markup": f"[/nope]{MARK}[/]",
    "an action": f"[@click=app.quit]{MARK}[/]",
    "a style": f"[bold red]{MARK}[",
    "a colour": f"\x1b[31m{MARK}\x1b[0m",
    "a title": f"\x1b]0;{MARK}\x07",
    "a C1 colour": f"\x9b31m{MARK}",
    "a C1 title": f"\x9d0;{MARK}\x9c",
    "a clipboard": f"\x1b]52;c;{MARK}\x1b\\",
    "clearing": f"\x1bc\x1b[2J{MARK}\x1b[?1049l",
    "direction": f"\u202e{MARK}\u202c\u2066x\u2069\u061c\u200f",
    "nothing to see": f"\u200b\ufeff{MARK}\u200d",
    "lines": f"{MARK}\n\r\n\x0b\x0c\u2028\u2029\x85end",
    "control": f"\x00\x07\x08\x7f\r{MARK}\t",
    "length": MARK + "x" * 500,  # longer than any line
    "wide": f"漢字かな交じり文の{MARK}한국어" * 3,
    "emoji": f"👩\u200d🔧🇩🇪{MARK}e\u0301\u0301\u0301",
}
# Characters of which none may ever be in what is painted.
FORBIDDEN = (
    {chr(code) for code in (*range(0x20), *range(0x7F, 0xA0))}
    | {chr(code) for code in (*range(0x200B, 0x2010), *range(0x2028, 0x202F))}
    | {chr(code) for code in (0x61C, *range(0x2066, 0x206A), 0xFEFF)}
)
# What the screen itself understands stays as it is; every other word is poisoned.
_KEPT = ("what", "machine", "to", "from", "group", "state", "trigger", "frame", "outcome")


def poisoned(name: str, text: str) -> RunUpdate:
    """Return a made-up run with ``text`` in every word that comes from outside."""
    return poison(fresh(name), text)


def poison(found: RunUpdate, text: str) -> RunUpdate:
    """Return a run with ``text`` in every word of it that comes from outside."""
    records = [_record(record, text) for record in found.records]
    return RunUpdate(records, found.engine, _status(found.status, text), text)


def _record(record: Record, text: str) -> Record:
    body = {name: _value(name, value, text) for name, value in record.body.items()}
    if record.kind == "plan":  # the cell is checked when it is read: only names are free
        body |= {"cell": record.body["cell"], "digest": "d"}
    key = record.key if record.kind == "frame" else f"{record.key}{text}"
    return msgspec.structs.replace(record, key=key if record.key else "", body=body)


def _value(name: str, value: Any, text: str) -> Any:
    if isinstance(value, str):
        return value if name in _KEPT else value + text
    if isinstance(value, list):
        return [_value(name, each, text) for each in value]
    if isinstance(value, dict):
        return {key: _value(key, each, text) for key, each in value.items()}
    return value


def _status(status: Status | None, text: str) -> Status | None:
    if status is None:
        return None
    built = cast("dict[str, Any]", msgspec.to_builtins(status))
    for device in built["devices"].values():
        device |= {"text": text, "reason": text}
    built["interlocks"] = [{"name": text, "blocked": text}, *built["interlocks"]]
    built["retakes"] = [text]
    if built["prompt"] is not None:
        prompt = msgspec.to_builtins(PROMPT)
        built["prompt"] = prompt | {"title": text, "text": text, "place": f"P1{text}"}
    return msgspec.convert(built, Status)


def runs(text: str) -> list[RunRow]:
    """Return a history of such names."""
    return [
        RunRow(name=f"r{number}{text}", begun=f"2026-03-04T08:00{text}", state=f"s{text}",
               procedure=text, cell=text, operator=text, job=text, reason=text, points=3,
               exit=number)
        for number in (0, 1)
    ]  # fmt: skip


def dangerous(text: str) -> set[str]:
    """Return the characters of a painted text that must not be there; lines may end."""
    return (FORBIDDEN & set(text)) - {"\n"}
