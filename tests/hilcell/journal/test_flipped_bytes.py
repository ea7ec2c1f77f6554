"""A journal with one byte changed is refused with clear words, or holds what was written."""

import random
import shutil
from pathlib import Path

import pytest

from hilcell.journal.journal import Journal, Record, StorageError, read_journal

SAMPLE = 250  # bytes
CHANGES = (0x01, 0x80, 0xFF)


def journal(path: Path, count: int = 12) -> list[Record]:
    """Write a journal of two leaves; return its records."""
    written = Journal(path, "r", create=True)
    for number in range(count):
        written.append("point", f"p/{number}", {"xyz_mm": [1.5, 2.0, 3.0], "note": "x" * 250})
    written.close()
    return read_journal(path)


def killed(path: Path, count: int = 12) -> bytes:
    """Leave the files of an engine that was killed; return the -wal."""
    alive = path.with_name("alive.sqlite")
    written = Journal(alive, "r", create=True)
    for number in range(count):
        written.append("point", f"p/{number}", {"xyz_mm": [1.5, 2.0, 3.0], "note": "x" * 250})
    shutil.copy(alive, path)
    content = alive.with_name("alive.sqlite-wal").read_bytes()
    written.close()
    path.with_name(f"{path.name}-wal").write_bytes(content)
    return content


def places(size: int, count: int | None) -> list[tuple[int, int]]:
    """Return bytes and how to change them: ``count`` drawn ones, or all of them."""
    if count is None:
        return [(at, change) for at in range(size) for change in CHANGES]
    rng = random.Random(67)
    return [(at, rng.choice(CHANGES)) for at in rng.sample(range(size), count)]


def look(path: Path, whole: list[Record]) -> str:
    """Read a damaged journal; return the code of its refusal, or "" where nothing is wrong."""
    try:
        found = read_journal(path)
    except StorageError as error:
        refused = error
    else:
        assert found == whole
        return ""
    assert str(path) in str(refused)
    assert refused.code in ("HC-J02", "HC-J03", "HC-J04")
    if refused.code == "HC-J02":
        assert f"damaged at record {refused.record}: " in str(refused)
        assert refused.facts()["fields"] == {"record": refused.record}
    return refused.code


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("count", [SAMPLE, pytest.param(None, marks=pytest.mark.nightly)])
def test_a_changed_byte_is_noticed_or_changes_nothing(tmp_path: Path, count: int | None) -> None:
    path = tmp_path / "journal.sqlite"
    whole = journal(path)
    content = path.read_bytes()
    refused = 0
    for at, change in places(len(content), count):
        path.write_bytes(content[:at] + bytes([content[at] ^ change]) + content[at + 1 :])
        refused += look(path, whole) != ""
    assert refused > 0.1 * (count or len(content))


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("step", [977, pytest.param(1, marks=pytest.mark.nightly)])
def test_a_file_that_was_cut_off_is_noticed(tmp_path: Path, step: int) -> None:
    path = tmp_path / "journal.sqlite"
    whole = journal(path)
    content = path.read_bytes()
    for size in range(1, len(content), step):
        path.write_bytes(content[:size])
        nothing_lost = not any(content[size:])  # what is missing is read as zeros
        assert look(path, whole) == ("" if nothing_lost else "HC-J02"), size


def test_a_page_that_hides_its_last_records_is_noticed(tmp_path: Path) -> None:
    """The chain of those before them holds: only the page itself says that something is missing."""
    path = tmp_path / "journal.sqlite"
    whole = journal(path, 5)
    content = bytearray(path.read_bytes())
    leaf = next(
        page
        for page in range(4096, len(content), 4096)
        if content[page : page + 5] == b"\x0d\x00\x00\x00\x05"  # a leaf of a table with 5 cells
    )
    content[leaf + 4] = 4
    path.write_bytes(content)
    assert look(path, whole) == "HC-J02"


FRAME = 24 + 4096  # bytes of a -wal, after 32


def test_a_torn_end_is_what_was_never_acknowledged(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    wal = path.with_name(f"{path.name}-wal")
    content = killed(path)
    for size in range(len(content) - FRAME, len(content), 811):
        wal.write_bytes(content[:size])
        assert len(read_journal(path)) == 11
    wal.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert len(read_journal(path)) == 11
