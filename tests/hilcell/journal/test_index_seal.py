"""A row of the index that is damaged is read again from its journal, and never believed.

The row of a revoked calibration decides that nobody corrects by it: with every bit of it flipped,
one after the other, the calibration stays revoked.
"""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from hilcell.journal.index import NAME
from tests.hilcell.commands.finished_runs import MADE, finished, text_of
from tests.hilcell.journal.test_index import settled
from tests.whole.bench import command

STEP = 41  # bits from one flip to the next of the part: prime, so all places in a byte come


@pytest.fixture
def revoked(tmp_path: Path) -> Path:
    """Return the folder of a run that is revoked, and in the index so."""
    finished(tmp_path, "1-made", MADE)
    assert command("revoke", "1-made", "--runs", tmp_path, "--reason", "a nest").returncode == 0
    settled(tmp_path / "1-made")
    assert text_of(tmp_path / "1-made") == "revoked: a nest"
    return tmp_path / "1-made"


def stored(index: Path) -> tuple[int, int]:
    """Return where in the index's file its row is, from its name to its seal: bytes."""
    with closing(sqlite3.connect(index)) as base:
        ((name, stamp, row, seal),) = base.execute("SELECT * FROM run").fetchall()
    content = name.encode() + stamp.encode() + row + seal
    start = index.read_bytes().rindex(content)
    return start, start + len(content)


def flips(folder: Path, step: int) -> list[str | None]:
    """Return the statuses that were found with one bit of the row flipped."""
    index = folder.parent / NAME
    sound = index.read_bytes()
    first, last = stored(index)
    found = []
    for bit in range(8 * first, 8 * last, step):
        damaged = bytearray(sound)
        damaged[bit // 8] ^= 1 << bit % 8
        index.write_bytes(damaged)
        found.append(text_of(folder))
    return found


def test_a_flipped_bit_of_a_row_changes_no_standing(revoked: Path) -> None:
    assert set(flips(revoked, STEP)) == {"revoked: a nest"}


@pytest.mark.nightly
def test_no_flipped_bit_of_a_row_changes_a_standing(revoked: Path) -> None:
    assert set(flips(revoked, 1)) == {"revoked: a nest"}


def test_a_row_that_was_changed_with_care_is_no_row(revoked: Path) -> None:
    with closing(sqlite3.connect(revoked.parent / NAME)) as base, base:
        base.execute("UPDATE run SET row = CAST(replace(CAST(row AS TEXT), 'a nest', '') AS BLOB)")
    assert text_of(revoked) == "revoked: a nest"
    with closing(sqlite3.connect(revoked.parent / NAME)) as base, base:
        base.execute("UPDATE run SET seal = NULL")
    assert text_of(revoked) == "revoked: a nest"
