"""The fewest stations that reach all holes: a minimum set cover, solved exactly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilcell.geometry.kinematics import Array
from hilcell.ports import HilcellError


class CoverError(HilcellError):
    """Holes that no set of stations covers."""

    code = "HC-C10"


def fewest(ok: NDArray[np.bool_], burden: Array) -> NDArray[np.int_]:
    """Return the columns of ``ok`` (N, S), a least number of them, that reach every row.

    ``burden`` (S,), 0..1 each, decides only between sets of equal number: its sum is made less
    than one station costs. Raises `CoverError` where a row is reached by none.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp  # slow to load, seldom needed

    rows = np.unique(ok, axis=0)
    if not rows.any(axis=1).all():
        raise CoverError("set cover: some holes are reached from no station")
    cost = 1.0 + burden / (2.0 * len(burden))
    found = milp(
        cost,
        constraints=LinearConstraint(rows.astype(float), lb=1.0),
        integrality=np.ones(len(cost), dtype=int),
        bounds=Bounds(0, 1),
        options={"mip_rel_gap": 0.0},
    )
    chosen = np.flatnonzero(found.x > 0.5) if found.success else np.array([], dtype=int)
    if not ok[:, chosen].any(axis=1).all():
        raise CoverError(f"set cover: not solved: {found.message}")
    return chosen
