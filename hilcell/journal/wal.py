"""Damage in the -wal of a run that was killed, which SQLite takes for its end.

SQLite reads a -wal up to the first frame whose checksum does not hold, and says nothing: after a
loss of power that is the torn end of what was never acknowledged. But each commit is synchronised
before the next one begins. So a bad frame with a later commit behind it was whole once, and what
follows was acknowledged. In the last commit, and in the head of the frame
before it, damage looks like a torn end.

Format: https://sqlite.org/fileformat2.html#walformat. A checksum goes on from that of the frame
before, so each frame is judged by the stored one of its neighbour.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Words = NDArray[np.uint32]

HEADER, FRAME = 32, 24  # bytes
SUMMED = 24, 8  # bytes of the header, and of a frame's, that their checksums cover
BIG_ENDIAN = 0x377F0683  # magic number of checksums over such words
PAGES = [1 << power for power in range(9, 17)]
USUAL_PAGE = 4096  # where the header does not say


class Damage(NamedTuple):
    """Which frame is bad, 0 for the header, and how many commits after its own are lost."""

    frame: int
    lost: int


def damage_of(wal: Path) -> Damage | None:
    """Return the damage of a -wal that hides acknowledged records, if there is any.

    A file that is written meanwhile may look damaged once, but not twice alike.
    """
    first = _read(wal)
    second = _read(wal) if first is not None else None
    if first is None or second is None or first.frame != second.frame:
        return None
    return second


def _read(wal: Path) -> Damage | None:
    content = b""
    with suppress(OSError):  # reading the journal itself reports the cause
        content = wal.read_bytes()
    return _damage(content) if len(content) > HEADER else None


def _damage(content: bytes) -> Damage | None:
    import numpy as np  # a list of runs that have ended does without

    magic, _, page, *_ = head = np.frombuffer(content[:HEADER], ">u4").astype(np.uint32)
    order = ">u4" if magic == BIG_ENDIAN else "<u4"
    size = FRAME + int(page if page in PAGES else USUAL_PAGE)
    raw = np.frombuffer(content, np.uint8, (len(content) - HEADER) // size * size, HEADER)
    frames = raw.reshape(-1, size)
    if not len(frames):
        return None
    heads = frames[:, :FRAME].copy().view(">u4").astype(np.uint32)
    start = np.frombuffer(content[: SUMMED[0]], order).astype(np.uint32)
    nought = np.zeros((1, 2), dtype=np.uint32)
    sound = bool((_sums(start[None], nought)[0] == head[6:]).all())
    own = (heads[:, 2:4] == (head[4:6] if sound else heads[0, 2:4])).all(axis=1)
    commits = own & (heads[:, 1] != 0)
    if not sound:
        return Damage(0, int(commits.sum()) - 1) if commits.sum() > 1 else None
    words = np.hstack([frames[:, : SUMMED[1]], frames[:, FRAME:]]).view(order).astype(np.uint32)
    before = np.vstack([head[None, 6:], heads[:-1, 4:]])
    good = own & (_sums(words, before) == heads[:, 4:]).all(axis=1)
    bad = int(np.argmin(good))
    lost = int(commits[bad + 1 :].sum()) - int(not commits[bad])  # its own commit may come later
    return Damage(bad + 1, lost) if not good[bad] and lost > 0 else None


def _sums(words: Words, before: Words) -> Words:
    """Return the checksums (N, 2) of words (N, 2K), going on from those ``before`` (N, 2).

    Two words a, b make x' = x + a + y and y' = y + b + x', modulo 2^32, of x and y.
    """
    import numpy as np

    step, power = np.array([[1, 1], [1, 2]], dtype=np.uint32), np.eye(2, dtype=np.uint32)
    weights = np.zeros((words.shape[1], 2), dtype=np.uint32)
    for at in range(words.shape[1] - 2, -1, -2):
        weights[at], weights[at + 1] = power.sum(axis=1), power[:, 1]
        power = power @ step
    return before @ power.T + words @ weights
