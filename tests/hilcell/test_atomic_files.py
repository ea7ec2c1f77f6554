"""Writing: links are followed, pipes are written to, files appear whole, inputs are safe."""

import os
import stat
import threading
from pathlib import Path

import pytest

from hilcell.atomic_files import CSV, NotWritten, check_output, write_together, write_whole


def test_a_pipe_stays_a_pipe_and_is_written_to(tmp_path: Path) -> None:
    pipe, got = tmp_path / "pipe", list[bytes]()
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()), daemon=True)
    reader.start()
    write_whole(pipe, b"whole")
    reader.join()
    assert got == [b"whole"]
    assert stat.S_ISFIFO(pipe.lstat().st_mode)
    assert list(tmp_path.iterdir()) == [pipe]


def test_a_link_to_a_pipe_stays_too(tmp_path: Path) -> None:
    pipe, link, got = tmp_path / "pipe", tmp_path / "link", list[bytes]()
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()), daemon=True)
    reader.start()
    write_whole(link, b"whole")
    reader.join()
    assert got == [b"whole"]
    assert link.is_symlink()
    assert link.is_fifo()


@pytest.mark.parametrize("there", [True, False])
def test_a_link_is_followed(tmp_path: Path, there: bool) -> None:
    (tmp_path / "far").mkdir()
    target, link = tmp_path / "far" / "out.csv", tmp_path / "link.csv"
    if there:
        target.write_bytes(b"old")
    link.symlink_to(target)
    write_whole(link, b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    assert [path.name for path in target.parent.iterdir()] == ["out.csv"]


def test_modes_are_kept_and_new_files_follow_the_umask(tmp_path: Path) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_bytes(b"")
    old.chmod(0o640)
    before = os.umask(0o027)
    try:
        write_whole(old, b"1")
        write_whole(new, b"2")
        old.chmod(0o604)
        write_whole(old, b"3")
    finally:
        os.umask(before)
    assert stat.S_IMODE(old.stat().st_mode) == 0o604
    assert stat.S_IMODE(new.stat().st_mode) == 0o640


def test_the_longest_name_a_disk_takes_is_taken(tmp_path: Path) -> None:
    write_whole(tmp_path / ("n" * 255), b"x")
    assert (tmp_path / ("n" * 255)).read_bytes() == b"x"


@pytest.mark.parametrize(
    "where",
    [".", "nowhere/out.csv", "file/out.csv", "loop", "n" * 300, "x" + 40 * ("/" + "n" * 250)],
    ids=["a folder", "no folder", "a file", "a loop", "a long name", "a long path"],
)
def test_what_cannot_be_written_is_told_in_one_line(
    tmp_path: Path, where: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_bytes(b"old")
    Path("loop").symlink_to("loop")
    with pytest.raises(NotWritten):
        check_output(Path(where), CSV, "a list")
    with pytest.raises(NotWritten) as told:
        write_whole(Path(where), b"new")
    assert "\n" not in str(told.value)
    assert len(str(told.value)) < 300
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "loop"]


def test_a_protected_file_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rename would: it asks the folder only. Root may write anything, so it is told otherwise."""
    out = tmp_path / "out"
    out.write_bytes(b"old")
    out.chmod(0o444)
    monkeypatch.setattr(os, "access", lambda path, mode: not (mode & os.W_OK))
    with pytest.raises(NotWritten, match="out"):
        write_whole(out, b"new")
    assert out.read_bytes() == b"old"


@pytest.mark.parametrize("kind", ["itself", "soft", "hard"])
def test_what_is_read_is_not_written(tmp_path: Path, kind: str) -> None:
    source = tmp_path / "in.csv"
    source.write_bytes(b"old")
    out = source if kind == "itself" else tmp_path / "out.csv"
    if kind == "soft":
        out.symlink_to(source)
    elif kind == "hard":
        out.hardlink_to(source)
    with pytest.raises(NotWritten, match=out.name):
        write_whole(out, b"new", inputs=[tmp_path / "gone.csv", source])
    assert source.read_bytes() == b"old"


def test_together_means_all_or_none(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "nowhere" / "second"
    first.write_bytes(b"old")
    with pytest.raises(NotWritten, match="nowhere"):
        write_together({first: b"new", second: b"new"})
    assert first.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["first"]


def test_a_dash_is_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("-", "./-"):
        with pytest.raises(NotWritten, match="/dev/stdout"):
            check_output(Path(name), CSV, "a list")
    check_output(tmp_path / "-", CSV, "a list")
