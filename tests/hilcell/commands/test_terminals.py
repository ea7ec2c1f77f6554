"""Any terminal: no character and no wrong line makes a command fail otherwise than in words."""

from __future__ import annotations

import io
import json
import os
import sys
from pathlib import Path

import msgspec
import pytest

from hilcell.commands.cli import main
from hilcell.commands.console import in_ascii, never_fail_to_encode, print_json, print_message
from hilcell.commands.run_output import JsonOutput
from hilcell.journal.journal import Record
from tests.hilcell.report.journals import Writer, validated_run
from tests.whole.bench import command


class Terminal:
    """Both streams of a process, in one encoding, strict as stdout is in most locales."""

    def __init__(self, encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self.encoding = encoding
        self.streams = {
            name: io.TextIOWrapper(io.BytesIO(), encoding=encoding) for name in ("stdout", "stderr")
        }
        for name, stream in self.streams.items():
            monkeypatch.setattr(sys, name, stream)

    def read(self, name: str) -> str:
        stream = self.streams[name]
        stream.flush()
        stream.seek(0)
        return stream.buffer.read().decode(self.encoding)


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


WRONG = [
    [""], ["rnn"], ["\x1b[31m"], ["\udcff"], ["--\x1b[31m"], ["runs", "\x1b[31m"],
    ["run", "--zseed", "x"], ["run", "--seed"], ["run", "--seed=-1"], ["run", "--seed=1.5"],
    ["run", f"--seed={'9' * 30}"], ["run", "--dry-run", "--seed=\N{ARABIC-INDIC DIGIT THREE}"],
    ["run", "--speed=nan"], ["run", "--machine-seed=nan"], ["run", "--set=x"], ["run", "--set==1"],
    ["run", "--set=rail.speed_mm_s=nan"], ["run", "--set=nosuch.key=1"], ["run", "--set=a=1\nb=2"],
    ["run", "--cell=nope"], ["run", "--cell=/dev/null"], ["run", "--cell=/"],
    ["run", "--cell=\N{GRINNING FACE}.toml"], ["run", "--name=../x"], ["run", "--name=last"],
    ["run", "%s{}"], ["run", "x" * 300], ["sim", "--ports=rail=65536"], ["sim", "--ports=x"],
    ["check"], ["check", "\n"], ["check", "é"], ["compare", "nosuch"], ["compare", "last", "é"],
    ["show", "nosuch"], ["show", "x" * 300], ["resume", "\udcff"], ["pause", "nosuch"],
    ["stop", "\x1b[31m"], ["revoke", "nosuch", "--reason=x"], ["explain", "%s{}"],
    ["plan", "holes.csv", "--max-age=1e300"], ["fit", "--json"], ["export", "-"],
]  # fmt: skip
PLACES: dict[str, tuple[str, dict[str, str], list[str]]] = {  # encoding, variables set, and unset
    "C": ("ascii", {"LC_ALL": "C", "PYTHONUTF8": "0"}, []),
    "ISO-8859-1": ("iso-8859-1", {"PYTHONIOENCODING": "iso-8859-1"}, []),
    "dumb": ("utf-8", {"TERM": "dumb"}, []),
    "no home": ("utf-8", {}, ["HOME", "XDG_CONFIG_HOME", "TERM"]),
    "narrow": ("utf-8", {"COLUMNS": "12", "LINES": "3"}, []),
}


@pytest.mark.parametrize("place", PLACES)
def test_a_wrong_line_is_refused_in_words(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoding, given, taken = PLACES[place]
    monkeypatch.chdir(tmp_path)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    for name in taken:
        monkeypatch.delenv(name, raising=False)
    for line in WRONG:
        terminal = Terminal(encoding, monkeypatch)
        try:
            code = main(line)
        except SystemExit as ended:
            code = int(ended.code or 0)
        printed = terminal.read("stderr")
        assert (code, bool(printed)) == (2, True), (line, printed)
        assert "Traceback" not in printed, (line, printed)
        assert "\x1b" not in printed


NEAREST = [
    ("rn", '"run"'),
    ("calibrate", "hilcell run calibrate"),
    ("zzz", "zzz"),
    ("--verison", '"--version"'),
    ("compensate --stationn x", '"--station"'),
    ("run --oprator=Ann", '"--operator"'),
    ("run home --dry", '"--dry-run"'),
    ("show last --chek", '"--check"'),
    ("completion --sel", "--sel"),
    ("show", "RUN"),
    ("run calibrat", '"calibrate"'),
    ("check papr", '"paper"'),
]


@pytest.mark.parametrize(("words", "nearest"), NEAREST)
def test_the_nearest_word_is_named(words: str, nearest: str) -> None:
    done = command(*words.split())
    assert (done.returncode, done.stdout) == (2, "")
    assert nearest in done.stderr


def test_words_after_two_dashes_are_no_options() -> None:
    done = command("explain", "--", "--HC-R31")
    assert done.returncode == 2
    assert "'--HC-R31'" in done.stderr


def test_without_words_the_first_steps_are_shown() -> None:
    done = command()
    assert (done.returncode, done.stdout) == (2, "")
    for step in ("hilcell run", "hilcell show last", "hilcell check", "hilcell tui"):
        assert step in done.stderr


# -- names are anybody's: whatever a folder is called, a terminal obeys nothing of it --------------


NAMES = ["one\x1b[31mred\x9b2J\u202e\x07", os.fsdecode(b"one\xff\xfe")]
NAMING = [
    ("runs", 0),
    ("runs --json", 0),
    ("show one", 0),
    ("show one --json", 0),
    ("show o", 2),
    ("compare one one", 2),
    ("resume one", 2),
    ("stop one", 2),
    ("watch one", 0),
    ("watch one --json", 0),
    ("report one -o FILE", 0),
    ("report one -o FOLDER", 2),
    ("export one --csv -o FILE", 0),
    ("compensate one x.csv --station S1100 -o FILE", 2),
]


@pytest.mark.parametrize(("words", "code"), NAMING)
@pytest.mark.parametrize("name", NAMES, ids=["escapes", "no text"])
def test_no_command_repeats_what_a_terminal_obeys(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes], name: str, words: str, code: int
) -> None:
    runs = tmp_path / "runs"
    Writer(runs / "other").began().ended()
    Writer(tmp_path / "made").began().ended().rename(runs / name)
    places = {"FILE": str(tmp_path / "file"), "FOLDER": str(runs / name)}
    arguments = [places.get(word, word) for word in words.split()]
    assert main([*arguments, "--runs", str(runs)]) == code
    printed, reported = capfdbinary.readouterr()
    assert b"Traceback" not in reported
    for text in (printed, reported):
        assert b"\x1b" not in text
        assert b"\xff" not in text
    if "--json" not in words:  # there it is data, which nobody shows as it comes
        assert not {"\x9b", "\x07", "\u202e"} & {*(printed + reported).decode()}
    elif "export" not in words:
        assert json.loads(printed.splitlines()[-1])


def test_lines_stay_lines(capsys: pytest.CaptureFixture[str]) -> None:
    print_message("paper: 2 problems\n  a\x1b\n  b")
    assert capsys.readouterr().err == "paper: 2 problems\n  a\N{REPLACEMENT CHARACTER}\n  b\n"
