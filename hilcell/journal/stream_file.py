"""The samples of a stream: a file of their own beside the journal, and one record in it.

A sweep's samples are appended to a file, which is made durable when the stream has ended; only then
its digest is journalled. A file without a record is left from a kill: the next stream removes
unfinished ones, and files are read by their records only.

The file is a sequence of arrays in numpy's .npy format (version 1.0), each of dtype `SAMPLES` or
`JOINTS`, in the order in which they came; times are the cell's clock's, but for ``device_s``, which
is NaN where a robot's controller states none.
"""

from __future__ import annotations

import errno
import hashlib
import io
import os
import re
import secrets
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hilcell.identification.axis_motion import SweepStream
from hilcell.journal.disk_space import shortage
from hilcell.journal.journal import RESTORE_ADVICE, StorageError, is_regular_file
from hilcell.model.events import StreamRecorded
from hilcell.ports import JointSample, NoReading, StreamBlock

FORM = 1  # of the file; increase it whenever its arrays change
FOLDER = "streams"
ROWS = 512  # rows that are gathered before an array is written
SAMPLES = np.dtype(
    [("device_s", "<f8"), ("xyz_mm", "<f8", (3,)), ("after_s", "<f8"), ("by_s", "<f8")]
)
JOINTS = np.dtype(
    [("joints_rad", "<f8", (6,)), ("before_s", "<f8"), ("after_s", "<f8"), ("device_s", "<f8")]
)
JOINT_ROW = struct.Struct("<9d")  # of `JOINTS`: one comes at a time
Rows = NDArray[np.void]


class StreamFile:
    """A stream being written; without `finish` it is discarded."""

    UNFINISHED = ".part"

    def __init__(self, run_folder: Path, key: str) -> None:
        """``run_folder`` is the journal's."""
        self._key, self._folder = key, run_folder / FOLDER
        name = re.sub(r"[^A-Za-z0-9_-]+", "-", key)[:60]
        self._path = self._folder / f"{name}-{secrets.token_hex(4)}.stream"
        self._waiting = {SAMPLES: bytearray(), JOINTS: bytearray()}
        self._counts = {SAMPLES: 0, JOINTS: 0}
        self._first_s: float | None = None
        self._last_s = self._gap_s = 0.0
        self._digest = hashlib.sha256()

    def __enter__(self) -> Self:
        try:
            self._folder.mkdir(exist_ok=True)
            for left in self._folder.glob(f"*{self.UNFINISHED}"):
                left.unlink()
            self._file = self._part.open("xb")
        except OSError as error:
            raise self._failed(error) from error
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Discard what was not finished."""
        self._file.close()
        self._part.unlink(missing_ok=True)

    def take(self, blocks: Iterable[StreamBlock], joints: Iterable[JointSample] = ()) -> None:
        """Append samples; raises `StorageError`."""
        for block in blocks:
            rows = np.zeros(len(block.device_s), SAMPLES)
            rows["device_s"], rows["xyz_mm"] = block.device_s, block.xyz_mm
            rows["after_s"], rows["by_s"] = block.arrived_after_s, block.arrived_by_s
            self._append(SAMPLES, rows.tobytes())
            if self._first_s is None:
                self._first_s = self._last_s = float(block.device_s[0])
            steps_s = np.diff(block.device_s, prepend=self._last_s)
            self._gap_s = max(self._gap_s, float(steps_s.max()))
            self._last_s = float(block.device_s[-1])
        for sample in joints:
            times_s = sample.before_s, sample.after_s, sample.device_s
            self._append(JOINTS, JOINT_ROW.pack(*sample.joints_rad.tolist(), *times_s))

    def finish(self) -> StreamRecorded:
        """Make the file durable under its name; return its record.

        Raises `NoReading` where there is no sample, and `StorageError`.
        """
        if self._first_s is None:
            raise NoReading("HC-T40", "Tracker", "stream", "no sample came")
        try:
            for kind in self._waiting:
                self._write(kind)
            self._file.flush()
            os.fsync(self._file.fileno())
            self._part.replace(self._path)
            opened = os.open(self._folder, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(opened)  # of the rename
            finally:
                os.close(opened)
        except OSError as error:
            raise self._failed(error) from error
        return StreamRecorded(
            key=self._key,
            file=self._path.name,
            sha256=self._digest.hexdigest(),
            samples=self._counts[SAMPLES],
            joint_samples=self._counts[JOINTS],
            first_device_s=self._first_s,
            last_device_s=self._last_s,
            longest_gap_s=self._gap_s,
            set_up=0,
            form=FORM,
        )

    @property
    def _part(self) -> Path:
        return self._path.with_name(self._path.name + self.UNFINISHED)

    def _append(self, kind: np.dtype[np.void], rows: bytes) -> None:
        self._counts[kind] += len(rows) // kind.itemsize
        self._waiting[kind] += rows
        if len(self._waiting[kind]) >= ROWS * kind.itemsize:
            try:
                self._write(kind)
            except OSError as error:
                raise self._failed(error) from error

    def _write(self, kind: np.dtype[np.void]) -> None:
        if not self._waiting[kind]:
            return
        data = io.BytesIO()
        rows = np.frombuffer(bytes(self._waiting[kind]), kind)
        np.lib.format.write_array(data, rows, version=(1, 0))
        self._waiting[kind].clear()
        self._digest.update(data.getvalue())
        self._file.write(data.getvalue())

    def _failed(self, error: OSError) -> StorageError:
        return StorageError(
            f"stream {self._path}: {self._key} could not be stored: {error.strerror}"
            f"{shortage(self._path.parent)}; make room or repair the disk, then resume the run",
            code="HC-J01",
        )


def read_stream(run_folder: Path, record: StreamRecorded) -> SweepStream:
    """Return a recorded stream, in the tracker's frame; raises `StorageError` for another file."""
    path = run_folder / FOLDER / Path(record.file).name
    if record.form != FORM:
        raise StorageError(
            f"stream {path}: form {record.form}, expected {FORM}; open it with the version that "
            "wrote it",
            code="HC-J03",
        )
    try:
        if not is_regular_file(path):  # opening a pipe may never end
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        data = path.read_bytes()
    except OSError as error:
        raise StorageError(f"stream {path}: cannot be read: {error.strerror}") from error
    if hashlib.sha256(data).hexdigest() != record.sha256:
        raise StorageError(
            f"stream {path}: it differs from the one that was written: changed or damaged, "
            f"and its results cannot be trusted; {RESTORE_ADVICE}",
            code="HC-J02",
        )
    found: dict[object, list[Rows]] = {kind: [np.zeros(0, kind)] for kind in (SAMPLES, JOINTS)}
    source = io.BytesIO(data)
    while source.tell() < len(data):
        rows = np.lib.format.read_array(source, allow_pickle=False)
        found[rows.dtype].append(rows)
    samples, joints = (np.concatenate(found[kind]) for kind in (SAMPLES, JOINTS))
    return SweepStream(
        samples["device_s"],
        samples["xyz_mm"],
        np.column_stack([samples["after_s"], samples["by_s"]]),
        joints["joints_rad"],
        np.column_stack([joints["before_s"], joints["after_s"]]),
        joints["device_s"],
    )
