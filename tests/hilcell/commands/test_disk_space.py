"""A run whose disk has too little room is refused before anything moves; one whose disk becomes
full says so, and how much room it needs.
"""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from hilcell.alarms.catalogue import entry_of
from hilcell.errors import HilcellError
from hilcell.journal.disk_space import bytes_needed, check_space
from tests.hilcell.commands.full_disk import files_limited_to
from tests.whole.bench import command


def fake(monkeypatch: pytest.MonkeyPatch, free: int) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))


@pytest.mark.parametrize(
    ("points", "needed"),
    [(0, 20_000_000), (308, 20_000_000), (1666, 20_000_000), (2000, 24_000_000)],
)
def test_the_room_a_run_needs_follows_from_its_points(points: int, needed: int) -> None:
    assert bytes_needed(points) == needed


def test_a_run_is_refused_by_one_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(monkeypatch, 24_000_000)
    check_space(tmp_path, 2000)
    fake(monkeypatch, 23_999_999)
    with pytest.raises(HilcellError) as refused:
        check_space(tmp_path, 2000)
    entry = entry_of(refused.value.code)
    assert (entry.code, entry.specific, entry.severity) == ("HC-J15", True, "fault")


def test_a_folder_that_cannot_be_looked_at_is_refused_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreadable(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(shutil, "disk_usage", unreadable)
    check_space(tmp_path, 10**9)


@pytest.mark.parametrize(
    ("why", "code"), [(errno.EROFS, 7), (errno.ENOENT, 7), (errno.ENOSPC, 2), (errno.EDQUOT, 2)]
)
def test_a_folder_that_cannot_be_made_is_said_before_its_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, why: int, code: int
) -> None:
    """Of a full disk both say that there is no room, of any other it is another matter."""
    fake(monkeypatch, 0)

    def refuse(path: str, *_: object) -> None:
        raise OSError(why, os.strerror(why), path)

    monkeypatch.setattr(os, "mkdir", refuse)
    done = command("run", "home", "--name", "r", "--runs", tmp_path / "runs")
    assert done.returncode == code
    assert (os.strerror(why) in done.stderr) is (code == 7)


def test_nothing_is_made_where_there_is_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake(monkeypatch, 5_300_000)
    runs = tmp_path / "runs"
    done = command("run", "home", "--name", "r", "--runs", runs)
    assert done.returncode == 2
    assert all(word in done.stderr for word in ("5.3 MB", "20.0 MB", "--runs"))
    assert not list(tmp_path.iterdir())
    assert command("run", "home", "--dry-run", "--runs", runs).returncode == 0  # writes nothing


def test_a_disk_that_becomes_full_is_named_with_the_room_that_is_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs, words = tmp_path / "runs", ("5.3 MB", str(tmp_path), "20.0 MB")
    with monkeypatch.context() as patched, files_limited_to(60_000):
        free = iter([10**9])  # as it begins
        patched.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=next(free, 5_300_000)))
        done = command("run", "home", "--name", "r", "--runs", runs)
        watched = command("watch", "r", "--runs", runs)
        refused = command("resume", "r", "--runs", runs)
    assert (done.returncode, watched.returncode, refused.returncode) == (7, 0, 2)
    for each in (done, watched, refused):
        assert all(word in each.stderr for word in words)
    assert "process has died" not in done.stderr
    assert command("resume", "r", "--runs", runs).returncode == 0
