"""The catalogue's own rules, the manual's page that is written from it, and ``hilcell explain``."""

from __future__ import annotations

import importlib
import json
import re
import tomllib
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

import pytest

from hilcell.alarms.catalogue import SEVERITIES, CatalogueError, Entry, catalogue, entries_of
from hilcell.alarms.page import page
from hilcell.commands.cli import main
from tests.hilcell.alarms.rooms import packages_of_hilcell
from tests.hilcell.cell.packages import install

catalogue_module = importlib.import_module("hilcell.alarms.catalogue")
ROOT = Path(__file__).parents[3]
packages = catalogue_module.packages  # of what is installed
PACKAGES = packages_of_hilcell()
ENTRIES = [entry for package in PACKAGES for entry in entries_of(package)]


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Leave out the catalogues of other makes that are installed beside hilcell."""
    installed = [*PACKAGES]
    monkeypatch.setattr(catalogue_module, "packages", lambda: installed)
    catalogue.cache_clear()
    yield installed
    catalogue.cache_clear()


def test_every_entry_is_complete_and_short() -> None:
    for entry in ENTRIES:
        assert re.fullmatch(r"HC-[RSBTCJVD]\d\d", entry.code)
        assert entry.severity in SEVERITIES
        assert 0 < len(entry.title) <= 50
        assert 0 < len(entry.means) <= 240
        assert 1 <= len(entry.do) <= 3
        assert len(entry.checked_by) == len(entry.do)
        for text in (entry.title, entry.means, *entry.do):
            assert text.isascii()
            assert text.isprintable()


def test_titles_are_unique() -> None:
    assert len({entry.title for entry in ENTRIES}) == len(ENTRIES)


def test_no_key_of_the_files_is_misspelt() -> None:
    """A key that nobody reads would pass silently."""
    known = {*Entry.__dataclass_fields__}
    files = [file for package in PACKAGES for file in resources.files(package).iterdir()]
    pages = [tomllib.loads(f.read_text("utf-8")) for f in files if f.name.endswith(".toml")]
    assert len(pages) >= 9
    for each in pages:
        assert set(each) == {"alarm"}
        for row in each["alarm"]:
            assert set(row) <= known, row["code"]


ROW = """[[alarm]]
code = "{}"
title = "Other make"
means = "It has ended."
do = ["Look."]
"""


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, installed: list[str]) -> Path:
    """Return the folder of a plant's own catalogue, installed beside the others."""
    folder = tmp_path / "plant_alarms"
    folder.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    installed.append("plant_alarms")
    return folder


def test_a_second_make_brings_its_own_entries(plant: Path) -> None:
    (plant / "tracker.toml").write_text(ROW.format("HC-T90"))
    assert catalogue()["HC-T90"].title == "Other make"
    assert len(catalogue()) == len(ENTRIES) + 1
    assert "| HC-T90 | Other make | " in page()


def test_codes_of_another_form_stand_in_the_page(plant: Path) -> None:
    (plant / "tracker.toml").write_text(ROW.format("LINE-7"))
    assert "| LINE-7 | Other make | " in page()


def test_a_code_is_nobody_s_twice(plant: Path) -> None:
    (plant / "tracker.toml").write_text(ROW.format("HC-T10"))
    with pytest.raises(CatalogueError, match=r"plant_alarms: HC-T10 .*drivers\.alarms"):
        catalogue()


def test_the_package_that_takes_a_code_of_hilcell_is_the_one_that_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder := tmp_path / "aaa_alarms").mkdir()
    (folder / "mine.toml").write_text(ROW.format("HC-T10"))
    install(tmp_path, "[hilcell.alarms]\naaa = aaa_alarms\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(catalogue_module, "packages", packages)
    with pytest.raises(CatalogueError, match="aaa_alarms: HC-T10"):
        catalogue()


@pytest.mark.parametrize(
    "text",
    [
        "[[alarm",
        "[[alarm]]\ncode = 1\n",
        "[alarms]\n",
        ROW.format("HC-T90") + 'by = ["somebody"]\n',
        ROW.format("HC-T90") + 'by = ["you", "controller"]\n',
    ],
)
def test_a_catalogue_that_cannot_be_read_says_whose_it_is(plant: Path, text: str) -> None:
    (plant / "tracker.toml").write_text(text)
    with pytest.raises(CatalogueError, match="plant_alarms"):
        catalogue()


def test_an_entry_that_cannot_be_read_is_named(plant: Path) -> None:
    row = ROW.format("LINE-8").replace("title", "titel")
    (plant / "tracker.toml").write_text(ROW.format("LINE-7") + row)
    with pytest.raises(CatalogueError, match=r"tracker\.toml, alarm 2: .*`title`"):
        catalogue()


def test_the_manual_s_page_is_written_from_the_catalogue() -> None:
    """Write it again with ``python -m hilcell.alarms.page > docs/alarms.md``."""
    assert (ROOT / "docs" / "alarms.md").read_text("utf-8") == page()


# -- ``hilcell explain`` --------------------------------------------------------------------------


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
