"""Set-ups of the tracker in one run: where one ends, and which points came after its last proof.

A tracker that was moved is at a new set-up, with a {W} of its own: its frame is ``world.1``,
``world.2``, that of the first ``world``.
"""

from __future__ import annotations

import numpy as np

from hilcell.geometry.frames import apply, inverse
from hilcell.journal.journal import Record
from hilcell.model.events import StreamRecorded, TrackerMoved, TrackerProven, WorldFramedAgain
from hilcell.model.point import CHECKS
from hilcell.model.records import StateChanged
from hilcell.ports import Array

Three = tuple[float, float, float]
PROOFS = ("world", "control")  # kinds of points
INTERRUPTED = ("paused", "suspended", "checking")  # states in which nobody sees a bump


def world_key(set_up: int) -> str:
    """Return the key of the frame T_W_L of a set-up, counted from 0."""
    return f"world.{set_up}" if set_up else "world"


def carried(xyz_mm: Three, std_mm: Three, T_first: Array, T_own: Array) -> tuple[Three, Three]:
    """Return a reading and its standard deviations as seen from the first set-up.

    ``T_first``, ``T_own`` are T_W_L (4, 4) of the first set-up and of the reading's own.
    """
    T = inverse(T_first) @ T_own
    x, y, z = apply(T, [xyz_mm])[0].tolist()
    u, v, w = np.sqrt(np.square(T[:3, :3]) @ np.square(std_mm)).tolist()
    return (x, y, z), (u, v, w)


class SetUps:
    """``number`` is the present set-up's, ``unproven`` the keys of points and streams since the
    tracker was last proven; ``interrupted`` whether the run has waited since then. ``refuted`` are
    the keys of control points that found it moved.
    """

    def __init__(self) -> None:
        self.number = 0
        self.unproven: dict[str, None] = {}
        self.interrupted = False
        self.refuted: set[str] = set()
        self._proofs: list[str] = []  # control points that have proven nothing yet

    @property
    def open(self) -> bool:
        """Whether points wait for a proof; those of which nothing is built do not."""
        return any(key.partition("/")[0] not in CHECKS for key in self.unproven)

    def take(self, record: Record) -> list[str]:
        """Add one record; return the keys of what has become invalid by it."""
        if record.kind == "point":
            if not record.key.startswith(tuple(f"{kind}/" for kind in PROOFS)):
                self.unproven[record.key] = None
            elif record.key.startswith(f"{PROOFS[1]}/"):
                self._proofs.append(record.key)
        elif record.kind == "frame" and record.key == world_key(self.number):
            self._prove()
        match record.fact if record.kind in ("state", "event") else None:
            case StateChanged(machine="run", to=to):
                self.interrupted |= to in INTERRUPTED
            case StreamRecorded(key=key):
                self.unproven[key] = None
            case TrackerMoved(set_up=number, invalid=invalid):
                self.number = number
                self.refuted.update(self._proofs)
                self._proofs.clear()
                return invalid
            case WorldFramedAgain(invalid=invalid):
                return invalid
            case TrackerProven():
                self._prove()
        return []

    def _prove(self) -> None:
        self.unproven.clear()
        self._proofs.clear()
        self.interrupted = False
