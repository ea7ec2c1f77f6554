"""The last digit of a controller that holds still: it flickers from one look to the next.

A run must give the same figures on any machine. So the flicker follows from where and how the robot
landed and from the number of looks since the program last answered, never from the time.
"""

from __future__ import annotations

import hashlib

import numpy as np

from fakes.truth.transforms import Array


def flicker(key: bytes, look: int, size: int) -> Array:
    """Return (size,) between -1 and 1, always the same for one key and look."""
    digest = hashlib.blake2b(b"%d/%b" % (look, key), digest_size=size).digest()
    return np.frombuffer(digest, dtype=np.uint8) / 127.5 - 1.0
