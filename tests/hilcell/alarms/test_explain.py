"""``hilcell explain``."""

from __future__ import annotations

import json

import pytest

from hilcell.alarms import catalogue
from hilcell.commands.cli import main


@pytest.mark.parametrize("typed", ["hc-r31", "hcr31", "r31", "HC R31"])
def test_a_code_is_explained_in_words(typed: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", typed]) == 0
    said = capsys.readouterr().out
    entry = catalogue()["HC-R31"]
    assert said.startswith("HC-R31 ")
    assert all(text in said for text in (entry.title, entry.means, *entry.do))


def test_a_code_is_explained_to_a_program(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "HC-T10", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["code", "title", "means", "do"]
    assert found["code"] == "HC-T10"


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("HC-R311", "HC-R31 "),
        ("HC-T1O", "HC-T10 "),
        ("HC-T1", "HC-T10 "),
        ("T1", "HC-T10 "),
        ("R311", "HC-R31 "),
    ],
)
def test_an_unknown_code_is_refused_with_those_most_like_it(
    typed: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explain", typed]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert f"did you mean {meant}" in said.err


@pytest.mark.parametrize("typed", ["bogus", "3", "30", "T", "HC-"])
def test_codes_are_described_where_none_is_like_an_unknown_one(
    typed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explain", typed]) == 2
    assert "a code like HC-T10" in capsys.readouterr().err
