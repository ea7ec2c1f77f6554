"""The table of a short plan: which risks its verdict may take, and how far it may go."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta, field

from hilcell.cell.tables import Angle, Frozen, Size

QUICK_NEST_SAMPLES, QUICK_PROOF_SAMPLES = 5, 2
Share = Annotated[float, Meta(ge=0.001, le=0.5)]


class PlanTable(Frozen, frozen=True, kw_only=True):
    """How `calibrate` spends the robot's time: in full, or as little as its verdict needs.

    ``grid_orientations`` are others than the grid's, A, B, C in {B}: the vertices are measured in
    each of them as well.
    """

    quick: bool = False
    accept_risk: Share = 0.05
    reject_risk: Share = 0.05
    share_above_max: Share = 0.1
    most_targets: Annotated[int, Meta(ge=8, le=1000)] = 96
    bound_mm: Size = 0.06
    most_poses: Annotated[int, Meta(ge=0, le=100)] = 12
    turn_deg: Annotated[float, Meta(ge=0, le=45)] = 15.0
    tilt_deg: Annotated[float, Meta(ge=0, le=45)] = 0.0
    prove_every: Annotated[int, Meta(ge=10, le=1000)] = 100
    unattended_wait_s: Annotated[float, Meta(ge=0, le=86_400)] = 900.0
    grid_orientations: list[tuple[Angle, Angle, Angle]] = field(default_factory=list)
    tilt_poses: Annotated[int, Meta(ge=4, le=100)] = 24

    def samples(self, full: int, quick: int) -> int:
        """Return how many readings are averaged: as many as in full, in a quick plan fewer."""
        return min(full, quick) if self.quick else full

    @property
    def turns(self) -> bool:
        """Whether targets have other orientations than the grid's."""
        return self.tilt_deg > 0.0 or bool(self.grid_orientations)

    @property
    def pose_counts(self) -> tuple[int, int]:
        """Return the least and the most poses that are measured beside the grid's."""
        if self.tilt_deg:
            return self.tilt_poses, self.tilt_poses
        return 0, self.most_poses if self.quick else 0


def coarsest_pitch_mm(cells: Sequence[int], pitch_mm: float) -> float:
    """Return the widest pitch that fills a box of ``cells`` (3,), two along one edge at least.

    Of a grid of one cell no vertex can be left out to judge a model.
    """
    shared = math.gcd(*cells)
    halves = 1 if max(cells) // shared > 1 else 2
    return pitch_mm * shared / halves
