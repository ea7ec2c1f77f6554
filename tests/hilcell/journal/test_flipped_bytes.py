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
        assert look(path, whole) == "HC-J02", size


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


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("count", [12, pytest.param(1000, marks=pytest.mark.nightly)])
def test_a_byte_changed_after_a_kill_cuts_off_no_records_in_silence(
    tmp_path: Path, count: int
) -> None:
    """SQLite ends its -wal at the first frame that is bad, as after a loss of power."""
    path = tmp_path / "journal.sqlite"
    wal = path.with_name(f"{path.name}-wal")
    content = killed(path, 30)
    whole = read_journal(path)
    assert len(whole) == 30
    for at, change in places(len(content) - 2 * FRAME, count):  # the last commit may be torn
        wal.write_bytes(content[:at] + bytes([content[at] ^ change]) + content[at + 1 :])
        for _ in range(2):  # what was refused once is still there
            with pytest.raises(StorageError, match="records after it are lost") as refused:
                read_journal(path)
        with pytest.raises(StorageError, match="records after it are lost"):
            Journal(path, "r", create=False)
        assert refused.value.code == "HC-J02"
        assert wal.stat().st_size == len(content)
    wal.write_bytes(content)
    assert read_journal(path) == whole


def test_the_refusal_counts_what_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    wal = path.with_name(f"{path.name}-wal")
    content = bytearray(killed(path, 30))
    at = content.index(b"p/24")  # in the page as it was when this record was the newest
    content[at] ^= 1
    wal.write_bytes(content)
    with pytest.raises(StorageError, match="damaged at record 25: 5 records after it are lost"):
        read_journal(path)


def test_a_torn_end_is_what_was_never_acknowledged(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    wal = path.with_name(f"{path.name}-wal")
    content = killed(path)
    for size in range(len(content) - FRAME, len(content), 811):
        wal.write_bytes(content[:size])
        assert len(read_journal(path)) == 11
    wal.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert len(read_journal(path)) == 11


def test_frames_of_before_a_checkpoint_are_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    written = Journal(path, "r", create=True)
    for part in range(3):  # each shorter than what its -wal held before
        for number in range(12 - 4 * part):
            written.append("point", f"p/{part}/{number}", {"note": "x" * 250})
        written.read_back()
    assert len(read_journal(path)) == 24
    written.close()
