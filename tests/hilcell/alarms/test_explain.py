"""``hilcell explain``."""

from __future__ import annotations

import json

import pytest

from hilcell.alarms import catalogue
from hilcell.commands.cli import main


@pytest.mark.parametrize("typed", ["hc-r31", "hcr31"])
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


def test_an_unknown_code_is_refused_with_those_most_like_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["explain", "HC-R311"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "HC-R31," in said.err
    assert main(["explain", "bogus"]) == 2
    assert "the nearest" not in capsys.readouterr().err
