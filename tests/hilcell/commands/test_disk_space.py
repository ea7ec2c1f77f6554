"""A run whose disk has too little room is refused before anything moves, and leaves nothing."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from hilcell.alarms.catalogue import entry_of
from hilcell.commands.cli import main
from hilcell.errors import HilcellError
from hilcell.journal.disk_space import bytes_free, bytes_needed, check_space

SMALL = ["unshare", "--map-root-user", "--mount", "sh", "-c"]  # a name space that may mount
MOUNT = "mount -t tmpfs -o size=1m none"


def fake(monkeypatch: pytest.MonkeyPatch, free: int) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))


@pytest.mark.parametrize(
    ("points", "needed"),
    [(0, 20_000_000), (308, 20_000_000), (1666, 20_000_000), (2000, 24_000_000)],
)
def test_the_room_a_run_needs_follows_from_its_points(points: int, needed: int) -> None:
    assert bytes_needed(points) == needed


def test_the_margin_holds_what_was_measured() -> None:
    """1.2 MB of a quick calibration with 308 points, three times."""
    assert bytes_needed(308_000) == pytest.approx(3 * 1.2e9, rel=0.05)


def test_a_run_is_refused_by_one_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(monkeypatch, 24_000_000)
    check_space(tmp_path, 2000)
    fake(monkeypatch, 23_999_999)
    with pytest.raises(HilcellError) as refused:
        check_space(tmp_path, 2000)
    entry = entry_of(refused.value.code)
    assert (entry.code, entry.specific, entry.severity) == ("HC-J15", True, "fault")


def test_the_disk_of_a_folder_yet_to_be_made_is_that_of_the_one_above(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        shutil.disk_usage(tmp_path / "a" / "b")
    assert bytes_free(tmp_path / "a" / "b") > 0


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
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    why: int,
    code: int,
) -> None:
    """Of a full disk both say that there is no room, of any other it is another matter."""
    fake(monkeypatch, 0)

    def refuse(path: str, *_: object) -> None:
        raise OSError(why, os.strerror(why), path)

    monkeypatch.setattr(os, "mkdir", refuse)
    runs = tmp_path / "runs"
    assert main(["run", "home", "--name", "r", "--runs", str(runs)]) == code
    said = {2: "0.0 MB of its disk are free", 7: f"cannot be used: {os.strerror(why)}"}[code]
    assert said in capsys.readouterr().err


def test_nothing_is_made_and_the_words_say_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fake(monkeypatch, 5_300_000)
    runs = tmp_path / "runs"
    assert main(["run", "home", "--name", "r", "--runs", str(runs)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert f"folder of runs {runs}: 5.3 MB of its disk are free, wanted 20.0 MB" in said
    assert "make room, or choose a folder of another disk with --runs" in said
    assert not list(tmp_path.iterdir())
    assert main(["run", "home", "--dry-run", "--runs", str(runs)]) == 0  # it writes nothing


def test_a_real_disk_that_is_small_refuses_a_run(tmp_path: Path) -> None:
    tried = subprocess.run([*SMALL, f"{MOUNT} {tmp_path}"], capture_output=True, check=False)
    if tried.returncode:
        pytest.skip("this user may not mount a disk in memory")
    run = f"{sys.executable} -m hilcell run home --name r --runs {tmp_path}/runs"
    script = f"{MOUNT} {tmp_path} && {run}; echo exit $?; ls -A {tmp_path}"
    done = subprocess.run([*SMALL, script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["exit", "2"]
    assert "1.0 MB of its disk are free, wanted 20.0 MB" in " ".join(done.stderr.split())
