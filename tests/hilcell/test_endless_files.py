"""Files that never end, or are larger than any of their kind, are refused in bounded memory."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.program_text import source_text
from hilcell.calibration.file import read_calibration
from hilcell.cell import settings
from hilcell.cell.settings import SettingsError, read_bytes
from hilcell.compensation.targets import HEADER, read_targets
from hilcell.fit.measurements import read_measurements
from hilcell.fit.robot_file import read_dh
from hilcell.fit.urdf_file import read_urdf
from hilcell.programs.holes import read_holes

READERS: list[Callable[[Path], object]] = [
    read_targets, read_holes, read_measurements, read_dh, read_urdf, read_calibration,
    lambda path: source_text(path, "KRL"),
]  # fmt: skip


@pytest.mark.parametrize("read", READERS)
def test_a_device_without_an_end_is_refused(
    read: Callable[[Path], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(settings, "MOST_BYTES", 2**16)
    with pytest.raises(SettingsError, match="/dev/zero"):
        read(Path("/dev/zero"))


@pytest.mark.parametrize("read", READERS)
def test_a_file_that_is_too_large_is_refused(
    read: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(settings, "MOST_BYTES", 2**16)
    (tmp_path / "large").touch()
    os.truncate(tmp_path / "large", 2**16 + 1)
    with pytest.raises(SettingsError, match="large"):
        read(tmp_path / "large")


def test_a_list_may_come_from_another_program(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    text = f"{','.join(HEADER)}\nH1,1,2,3,0,0,0\n"
    writing = threading.Thread(target=(tmp_path / "pipe").write_text, args=(text,))
    writing.start()
    assert read_targets(tmp_path / "pipe")[0] == ["H1"]
    writing.join()


def test_a_file_of_the_greatest_size_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(settings, "MOST_BYTES", 5)
    (tmp_path / "file").write_bytes(b"12345")
    assert read_bytes(tmp_path / "file") == b"12345"
