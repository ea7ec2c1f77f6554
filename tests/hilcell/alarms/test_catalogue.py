"""The catalogue's own rules, and the manual's page that is written from it."""

from __future__ import annotations

import re
import tomllib
from importlib import resources
from pathlib import Path

import pytest

from hilcell.alarms.catalogue import FILES, SEVERITIES, Entry, catalogue
from hilcell.alarms.page import page

ROOT = Path(__file__).parents[3]
ENTRIES = catalogue()


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.code)
def test_an_entry_is_short_and_complete(entry: Entry) -> None:
    assert re.fullmatch(r"HC-[RSBTCJV]\d\d", entry.code)
    assert entry.severity in SEVERITIES
    assert 0 < len(entry.title) <= 50
    assert len(re.findall(r"[.!?](?: |$)", entry.means)) <= 3
    assert len(entry.means) <= 240
    assert 1 <= len(entry.do) <= 3
    assert all(len(step) <= 110 and step[0].isupper() for step in entry.do)
    assert all(step.endswith((".", "?", "`.")) for step in entry.do)
    assert all(len(when.found + when.operation) < 200 for when in entry.when)
    assert entry.when


def test_codes_and_titles_are_unique() -> None:
    assert len({entry.code for entry in ENTRIES}) == len(ENTRIES)
    assert len({entry.title for entry in ENTRIES}) == len(ENTRIES)


def test_no_key_of_the_files_is_misspelt() -> None:
    """A key that nobody reads would pass silently."""
    known = {"code", "severity", "title", "means", "do", "then", "when", "passes"}
    for name in FILES:
        text = (resources.files("hilcell.alarms") / f"{name}.toml").read_text("utf-8")
        page_of = tomllib.loads(text)
        assert set(page_of) == {"alarm"}
        for row in page_of["alarm"]:
            assert set(row) <= known, row["code"]
            assert all(set(when) <= {"device", "operation", "found"} for when in row["when"])


def test_every_file_beside_the_package_is_read() -> None:
    folder = ROOT / "hilcell" / "alarms"
    assert {path.stem for path in folder.glob("*.toml")} == set(FILES)


def test_only_plain_characters() -> None:
    for entry in ENTRIES:
        assert all(
            text.isascii() and text.isprintable() for text in (entry.title, entry.means, *entry.do)
        )


def test_the_manual_s_page_is_written_from_the_catalogue() -> None:
    """Write it anew with ``python -m hilcell.alarms.page > docs/alarms.md``."""
    assert (ROOT / "docs" / "alarms.md").read_text("utf-8") == page()
    assert all(f"### {entry.code} {entry.title}\n" in page() for entry in ENTRIES)
