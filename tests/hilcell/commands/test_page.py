"""The manual's page of commands: what the signatures say, and nothing else."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import pytest

from hilcell import errors
from hilcell.arguments import Signature, arguments_of, option, parse_seed
from hilcell.commands.cli import EXITS, GROUPS, OWN_EXITS, PLANT
from hilcell.commands.manual import page

ROOT = Path(__file__).parents[3]


def test_the_manual_s_page_is_written_from_the_signatures() -> None:
    """Write it again with ``make docs``."""
    assert (ROOT / "docs/cli.md").read_text("utf-8") == page()


def test_every_command_and_option_stands_in_it() -> None:
    text = page()
    commands = [each for group in GROUPS.values() for each in group.items()]
    for name, (takes, _) in [*commands, *((f"plant {name}", each) for name, each in PLANT.items())]:
        section = text.partition(f"### hilcell {name}\n")[2].partition("\n### ")[0]
        fields = [each for each in arguments_of(takes) if not each.positional]
        for given in (each for field in fields for each in field.names):
            assert f"`{given}" in section or f", {given}" in section


class Sample(Signature):
    """Try."""

    word: str = option("a|b", "A|B", positional=True)
    runs: int = option("how often (default: by day (or night) 3)", "N", parse_seed, default=3)
    shape: Literal["round", "flat"] = option("its shape", default="flat")
    two: str = option("one (default: x); other (default: y)", default="")
    form: Literal["csv", "json"] = option(switches={"csv": "rows", "json": "all"})
    output: str = option("where", "OUT", flags=("-o", "--output"))
    quick: bool = option("hurry", default=False)


def test_a_section_has_usage_and_defaults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hilcell.commands.cli.GROUPS", {"some": {"try": (Sample, "x:y")}})
    text = page()
    assert "hilcell try A|B (--csv | --json) -o OUT [OPTIONS]\n" in text
    rows = re.findall(r"^\| `(.*)` \| (.*) \| (.*) \|$", text, re.MULTILINE)
    assert rows == [
        ("A\\|B", "a\\|b", "required"),
        ("--runs N", "how often", "by day (or night) 3"),
        ("--shape {round,flat}", "its shape", "flat"),
        ("--two TWO", "one (default: x); other (default: y)", ""),
        ("--csv", "rows", "one of these"),
        ("--json", "all", "one of these"),
        ("-o, --output OUT", "where", "required"),
        ("--quick", "hurry", ""),
    ]


def test_a_default_in_words_is_the_one_that_counts() -> None:
    """``(default: 1)`` of a number is the field's own default."""
    takes = [each for group in GROUPS.values() for each, _ in group.values()]
    takes += [each for each, _ in PLANT.values()]
    stated = {
        (each.__name__, field.name): (float(words[1]), field.default)
        for each in takes
        for field in arguments_of(each)
        if (words := re.search(r"\(default: ([\d.]+)\)", field.help))
    }
    assert len(stated) > 5
    assert {key: pair for key, pair in stated.items() if pair[0] != pair[1]} == {}


def test_exit_codes_of_other_commands_are_of_commands_that_exist() -> None:
    commands = {name for group in GROUPS.values() for name in group}
    assert OWN_EXITS.keys() <= commands - {"run", "resume"}


def test_exit_codes_are_those_of_runs() -> None:
    words = {
        errors.EXIT_OK: "in tolerance",
        errors.EXIT_OUT_OF_TOLERANCE: "out of tolerance",
        errors.EXIT_REFUSED: "refused",
        errors.EXIT_FAULT: "fault",
        errors.EXIT_ABORTED: "aborted",
        errors.EXIT_INTERNAL: "internal",
        errors.EXIT_LOCKED: "locked",
        errors.EXIT_STORAGE: "storage",
    }
    assert len(words) == len(EXITS)
    assert [code for code, word in words.items() if word not in EXITS[code]] == []
