"""The traps of a hall, each in one where it bites: what `hilcell commission` must say of it.

Either the cell file then has the true values, or the step refuses. In both cases nothing moves
beyond what was announced.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tests.whole.halls import Commissioned, commissioned, unknown_hall


class Trapped(NamedTuple):
    """A trap in the hall of a seed, the step that names it, and its words."""

    trap: str
    seed: int
    step: str
    words: str
    refused: bool = False
    proof: str = "the values are the true ones"


TRAPPED = [
    Trapped("drive-sign", 2, "rail", "opposite directions"),
    Trapped("strip-sign", 2, "rail", "opposite directions"),
    Trapped("scale-0.9", 4, "rail", "scale: DIFFERS"),
    Trapped("scale-10", 3, "rail", "mm: DIFFERS"),
    Trapped("speed-rpm", 6, "rail", "speed_unit = rpm"),
    Trapped("speed-0.1", 6, "rail", "speed_unit = 0.1 counts/s"),
    Trapped(
        "nests-exchanged",
        3,
        "tracker",
        "in the order of the beam",
        proof="recognised by distances: the places are the true ones",
    ),
    Trapped("tracker-upside-down", 3, "tracker", "upside down"),
    Trapped("other-smr", 3, "tracker", "reflectors of 0.5 in", refused=True, proof="refused"),
    Trapped("coupled-axis-3", 3, "controller", "axis 3 turns with axis 2 (coupled, -1)"),
    Trapped(
        "wrong-tool",
        3,
        "base",
        "enter the measured place as the tool",
        refused=True,
        proof="refused: a person changes the controller's tool",
    ),
    Trapped("no-self-stop", 3, "self-stop", "DIFFERS", refused=True, proof="refused"),
    Trapped("nodes-exchanged", 3, "devices", "node 112: drive (CiA 402)"),
]


def trapped(row: Trapped, folder: Path) -> tuple[Commissioned, list[str]]:
    """Commission a hall with a trap; return what that was, and what is wrong with it."""
    with unknown_hall(folder / "hall", row.seed, trap=row.trap) as hall:
        found = commissioned(hall, folder / "mycell.toml", ready=not row.refused)
    problems = list(found.problems)
    if row.words not in found.said(row.step):
        problems.append(f"step {row.step} does not say {row.words!r}")
    if row.refused and found.done.returncode != 1:
        problems.append(f"exit code {found.done.returncode}, not 1")
    return found, problems
