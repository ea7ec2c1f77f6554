"""Terminals that lack characters: nothing fails for it, and JSON says the same everywhere."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import msgspec
import pytest

from hilcell.commands.cli import main
from hilcell.commands.encoding import in_ascii, never_fail_to_encode
from hilcell.commands.output import print_json, print_message
from hilcell.commands.run_output import JsonOutput
from hilcell.journal.journal import Record
from tests.hilcell.commands.terminal import Terminal
from tests.hilcell.report.journals import Writer, validated_run

OPERATOR = "Jürgen \N{CJK UNIFIED IDEOGRAPH-4E2D}\N{GRINNING FACE}"


@pytest.mark.parametrize(
    ("text", "ascii_text", "latin"),
    [
        ("3 µm/(m·K) ±0.01 mm, 20 °C", "3 um/(m*K) +-0.01 mm, 20 degC", None),
        ("3 \N{GREEK SMALL LETTER MU}m", "3 um", "3 um"),
        ("a → b ≤ c … Δx", "a -> b <= c ... dx", "a -> b <= c ... dx"),
        ("Jürgen Groß", "Jurgen Gross", None),
        ("┏━┳━┓│┃├─┼╇╡", "+-+-+||+-+++", "+-+-+||+-+++"),
        ("mm²", "mm2", None),
        ("\N{CJK UNIFIED IDEOGRAPH-4E2D}", "\\u4e2d", "\\u4e2d"),
        ("name \udcff", "name ?", "name ?"),
        ("\N{REPLACEMENT CHARACTER}", "?", "?"),
    ],
)
def test_what_a_terminal_lacks_is_replaced_by_what_is_similar(
    monkeypatch: pytest.MonkeyPatch, text: str, ascii_text: str, latin: str | None
) -> None:
    for encoding, wanted in (("ascii", ascii_text), ("iso-8859-1", latin or text)):
        terminal = Terminal(encoding, monkeypatch)
        never_fail_to_encode((sys.stdout, None))
        print(text)
        assert terminal.read("stdout") == f"{wanted}\n"


def test_a_stream_that_is_closed_or_no_file_is_left_alone() -> None:
    closed = io.TextIOWrapper(io.BytesIO())
    closed.close()
    never_fail_to_encode((closed, io.StringIO()))


@pytest.mark.parametrize("text", [OPERATOR, '"\\\n\x7f', ""])
def test_json_is_ascii_and_says_the_same(text: str) -> None:
    found = in_ascii(msgspec.json.encode({"operator": text}).decode())
    assert found.isascii()
    assert json.loads(found) == {"operator": text}


def test_json_is_whole_in_any_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal("ascii", monkeypatch)
    print_json({"operator": OPERATOR})
    sys.stdout.flush()
    JsonOutput("r").print_record(Record(1, "2026-01-01T00:00:00+00:00", "state", OPERATOR, {}))
    one, other = map(json.loads, terminal.read("stdout").splitlines())
    assert (one["operator"], other["key"]) == (OPERATOR, OPERATOR)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    validated_run(folder / "r").ended()
    validated_run(folder / "t").ended()
    Writer(folder / "s").began().ended().rename(folder / OPERATOR)
    return folder


COMMANDS = [
    ("ascii", "runs"), ("ascii", "runs --json"), ("ascii", "show r --json"),
    ("ascii", "show Jürgen"), ("ascii", "compare r t"), ("ascii", "run home --dry-run"),
    ("iso-8859-1", "show Jürgen"),
]  # fmt: skip


@pytest.mark.parametrize(("encoding", "words"), COMMANDS)
def test_no_command_fails_for_a_narrow_terminal(
    runs: Path, monkeypatch: pytest.MonkeyPatch, encoding: str, words: str
) -> None:
    terminal = Terminal(encoding, monkeypatch)
    assert main([*words.split(), "--runs", str(runs)]) == 0, terminal.read("stderr")
    printed = terminal.read("stdout")
    if "--json" in words:
        assert json.loads(printed)
    else:
        borders = {line[0] + line[-1] for line in printed.splitlines()}
        assert borders <= {"++", "||"}


def test_messages_of_a_run_are_replaced_too(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal("ascii", monkeypatch)
    never_fail_to_encode((sys.stdout, sys.stderr))
    print_message("shift ±0.1 mm, 3 µrad")
    assert terminal.read("stderr") == "shift +-0.1 mm, 3 urad\n"
