from __future__ import annotations

import os
import stat
from pathlib import Path

import numpy as np
import pytest

from hilcell.journal import stream_file
from hilcell.journal.journal import StorageError
from hilcell.journal.stream_file import FOLDER, StreamFile, read_stream
from hilcell.model.events import StreamRecorded
from hilcell.ports import JointSample, NoReading, StreamBlock

JOINTS_RAD = np.arange(6) / 7.0


def block(first: int, count: int) -> StreamBlock:
    times_s = (first + np.arange(count)) / 100.0
    return StreamBlock(5.0 + times_s, np.outer(times_s, [1.0, 2.0, 3.0]), first, first + 0.5)


def written(folder: Path, *counts: int) -> StreamRecorded:
    with StreamFile(folder, "sweep/A1/up") as file:
        first = 0
        for count in counts:
            file.take([block(first, count)], [JointSample(JOINTS_RAD + first, first, first + 0.25)])
            first += count
        return file.finish()


@pytest.mark.parametrize("rows", [1, 7, 512])
def test_what_was_taken_is_read_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    monkeypatch.setattr(stream_file, "ROWS", rows)
    record = written(tmp_path, 8, 1, 20)
    data = read_stream(tmp_path, record)
    assert (record.samples, record.joint_samples) == (29, 3)
    assert (record.first_device_s, record.last_device_s) == (5.0, 5.28)
    np.testing.assert_array_equal(data.device_s, 5.0 + np.arange(29) / 100.0)
    np.testing.assert_array_equal(data.xyz_mm[:, 1], 2.0 * np.arange(29) / 100.0)
    assert data.window_s[[0, 7, 8, 28]].tolist() == [[0, 0.5], [0, 0.5], [8, 8.5], [9, 9.5]]
    np.testing.assert_array_equal(data.joints_rad[:, 0], [0.0, 8.0, 9.0])
    assert data.asked_s.tolist() == [[0, 0.25], [8, 8.25], [9, 9.25]]
    assert np.isnan(data.stamped_s).all()


def test_the_controller_s_own_times_are_kept(tmp_path: Path) -> None:
    with StreamFile(tmp_path, "k") as file:
        file.take([block(0, 3)], [JointSample(JOINTS_RAD, 1.0, 2.0, 77.5)])
        record = file.finish()
    assert read_stream(tmp_path, record).stamped_s.tolist() == [77.5]


def test_a_stream_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its samples first, then its name: the journal's record of it must survive a loss of power."""
    synced: list[str] = []
    sync = os.fsync

    def seen(file: int) -> None:
        names = sorted(path.suffix for path in (tmp_path / FOLDER).iterdir())
        synced.append(f"{'folder' if stat.S_ISDIR(os.fstat(file).st_mode) else 'file'} {names[0]}")
        sync(file)

    monkeypatch.setattr(os, "fsync", seen)
    record = written(tmp_path, 3)
    assert synced == ["file .part", f"folder {Path(record.file).suffix}"]


def test_without_an_end_there_is_no_file(tmp_path: Path) -> None:
    with StreamFile(tmp_path, "k") as file:
        file.take([block(0, 3)])
        assert [path.suffix for path in (tmp_path / FOLDER).iterdir()] == [".part"]
    assert list((tmp_path / FOLDER).iterdir()) == []


def test_what_a_killed_engine_left_is_removed_by_the_next(tmp_path: Path) -> None:
    kept = written(tmp_path, 3)
    (tmp_path / FOLDER / "old-12345678.stream.part").write_bytes(b"half")
    record = written(tmp_path, 4)
    assert {path.name for path in (tmp_path / FOLDER).iterdir()} == {kept.file, record.file}


def test_a_stream_without_a_sample_is_no_reading(tmp_path: Path) -> None:
    with StreamFile(tmp_path, "k") as file, pytest.raises(NoReading):
        file.finish()


@pytest.mark.parametrize("at", [0, 5, 200, -1])
def test_one_changed_byte_is_found(tmp_path: Path, at: int) -> None:
    record = written(tmp_path, 30)
    path = tmp_path / FOLDER / record.file
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)
    with pytest.raises(StorageError, match=f"{record.file}: .*from the backup"):
        read_stream(tmp_path, record)


@pytest.mark.parametrize("size", [0, 100, -1])
def test_a_file_that_is_too_short_is_found(tmp_path: Path, size: int) -> None:
    record = written(tmp_path, 30)
    path = tmp_path / FOLDER / record.file
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(StorageError, match=record.file):
        read_stream(tmp_path, record)


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / FOLDER).write_text("a file")
    with pytest.raises(StorageError, match="k"), StreamFile(tmp_path, "k"):
        pass
