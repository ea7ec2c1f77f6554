"""``hilcell explain``."""

from __future__ import annotations

import json

import pytest

from hilcell.alarms import catalogue
from hilcell.commands.cli import main


def test_a_code_is_explained_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "hc-r31"]) == 0
    head, means, *steps = capsys.readouterr().out.splitlines()
    entry = catalogue()["HC-R31"]
    assert head == f"HC-R31 {entry.title}"
    assert means == entry.means
    assert steps == [f"  {n}. {step}" for n, step in enumerate(entry.do, start=1)]


def test_a_code_is_explained_to_a_program(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "HC-T10", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["code", "title", "means", "do"]
    assert (found["code"], found["title"]) == ("HC-T10", "Beam broken")
    assert len(found["do"]) == 2


def test_an_unknown_code_is_refused_with_those_most_like_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["explain", "HC-R311"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "alarm 'HC-R311' is unknown; the nearest known: HC-R31," in said.err


def test_a_code_is_found_without_its_hyphen(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "hcb10"]) == 0
    assert capsys.readouterr().out.startswith("HC-B10 ")
