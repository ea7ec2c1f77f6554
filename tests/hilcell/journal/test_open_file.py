"""A file that others damage between a check and the note of how far it was written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hilcell.journal.journal import OpenFile


def replace(path: Path) -> None:
    path.rename(path.with_suffix(".old"))
    path.write_bytes(b"x" * 100)


def cut(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("harm", [replace, Path.unlink, cut])
def test_harm_right_before_a_note_is_noticed_by_the_next_check(
    tmp_path: Path, harm: Callable[[Path], None]
) -> None:
    path = tmp_path / "journal"
    path.write_bytes(b"x")
    file = OpenFile(path)
    assert file.lost() == ""
    harm(path)
    file.note()
    assert file.lost()


def test_a_file_may_come_and_grow(tmp_path: Path) -> None:
    file = OpenFile(tmp_path / "journal")
    for size in (1, 2):
        file.path.write_bytes(b"x" * size)
        file.note()
        assert file.lost() == ""
    cut(file.path)
    assert file.lost()
