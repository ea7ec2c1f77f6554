"""Room on the disk for the folder of runs.

A quick calibration of 308 points wrote a journal of 647 kB, and 1.2 MB in all: with its streams,
its calibration and the index.
"""

from __future__ import annotations

import errno
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

from hilcell.errors import HilcellError

POINT_BYTES = 4_000
MARGIN = 3
LEAST_BYTES = 20_000_000
NO_ROOM = {errno.ENOSPC, errno.EDQUOT}


def bytes_needed(points: int) -> int:
    """Return how much room a run of so many planned points needs."""
    return max(LEAST_BYTES, MARGIN * POINT_BYTES * points)


def bytes_free(folder: Path) -> int:
    """Return the room on the disk of a folder, which may be yet to be made; raises `OSError`."""
    return shutil.disk_usage(existing(folder)).free


def existing(folder: Path) -> Path:
    """Return the folder, or the nearest above it that exists."""
    whole = folder.absolute()
    return next(each for each in (whole, *whole.parents) if each.exists())


def can_be_made(folder: Path) -> bool:
    """Whether a folder can be made and written in, were there room for it."""
    try:
        Path(tempfile.mkdtemp(prefix=".hilcell-", dir=existing(folder))).rmdir()
    except OSError as error:
        return error.errno in NO_ROOM
    return True


def check_space(runs: Path, points: int) -> None:
    """Refuse a run that its disk has no room for; raises `HilcellError`."""
    with suppress(OSError):  # a folder that cannot be looked at is refused where it is made
        free, wanted = bytes_free(runs), bytes_needed(points)
        if free < wanted and can_be_made(runs):
            raise HilcellError(
                f"folder of runs {runs.absolute()}: {free / 1e6:.1f} MB of its disk are free, "
                f"wanted {wanted / 1e6:.1f} MB for a run of {points} points; make room, or choose "
                "a folder of another disk with --runs",
                code="HC-J15",
            )
