"""The disk space that a run needs, and how much of it is free."""

from __future__ import annotations

import errno
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

from hilcell.errors import HilcellError

LEAST_BYTES = 20_000_000  # of any run


def bytes_needed(points: int) -> int:
    """Return the disk space for a run of so many planned points, with a margin.

    A quick calibration of 308 points wrote a journal of 647 kB, and 1.2 MB in all: with its
    streams, its calibration and the index.
    """
    point_bytes, margin = 4_000, 3
    return max(LEAST_BYTES, margin * point_bytes * points)


def bytes_free(folder: Path) -> int:
    """Return the free disk space for a folder, existing or not; raises `OSError`."""
    return shutil.disk_usage(nearest_existing(folder)).free


def nearest_existing(folder: Path) -> Path:
    """Return the folder, or the nearest above it that exists."""
    whole = folder.absolute()
    return next(each for each in (whole, *whole.parents) if each.exists())


def is_writable(folder: Path) -> bool:
    """Whether a folder can be made and written, apart from the disk space."""
    try:
        Path(tempfile.mkdtemp(prefix=".hilcell-", dir=nearest_existing(folder))).rmdir()
    except OSError as error:
        return error.errno in (errno.ENOSPC, errno.EDQUOT)
    return True


def shortage(folder: Path) -> str:
    """Return that the disk of a folder has less room than any run needs; "" if it has enough."""
    with suppress(OSError):
        if (free := bytes_free(folder)) < LEAST_BYTES:
            return (
                f"; {free / 1e6:.1f} MB of the disk of {folder.absolute()} are free, expected "
                f"{LEAST_BYTES / 1e6:.1f} MB or more"
            )
    return ""


def check_space(runs: Path, points: int) -> None:
    """Raise `HilcellError` for a run without enough disk space."""
    with suppress(OSError):  # refused where the folder is made
        free, needed = bytes_free(runs), bytes_needed(points)
        if free < needed and is_writable(runs):
            raise HilcellError(
                f"folder of runs {runs.absolute()}: {free / 1e6:.1f} MB of its disk are free, "
                f"expected {needed / 1e6:.1f} MB for a run of {points} points; make room, or "
                "choose a folder of another disk with --runs",
                code="HC-J15",
            )
