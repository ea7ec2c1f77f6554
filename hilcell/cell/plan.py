"""The table of a short plan: which risks its verdict may take, and how far it may go."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from hilcell.cell.tables import Frozen

Share = Annotated[float, Meta(ge=0.001, le=0.5)]


class PlanTable(Frozen, frozen=True, kw_only=True):
    """How `calibrate` spends the robot's time: in full, or as little as its verdict needs."""

    quick: bool = False
    accept_risk: Share = 0.05
    reject_risk: Share = 0.05
    share_above_max: Share = 0.1
    most_targets: Annotated[int, Meta(ge=8, le=1000)] = 96
