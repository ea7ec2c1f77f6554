"""The robot's base where it was measured, against where the cell file has it.

Floor nests are known to each other: reflectors of another size in all of them leave their distances
as they are, and lift {W} with all that is measured in it. The base stands where it stood, so it
comes out lower or higher by the difference of the radii.
"""

from __future__ import annotations

import numpy as np

from hilcell.calibration.suspicions import Suspicion
from hilcell.journal.log import Log
from hilcell.ports import Array

NOTICED_BY = "the base's place in the cell file"
INCH_MM = 25.4
BALLS_IN = (0.5, 0.875, 1.5)  # diameters of reflectors as sold
SAME_MM = 3.0  # by which a base that is bolted as usual may be elsewhere


def misplaced_base(log: Log) -> Suspicion | None:
    """Return a base that is not where the cell file says, with the cause that fits."""
    cell = log.cell
    if "circle_rms_mm" not in log.frames.get("base", {}):
        return None
    station = cell.station_named(cell.grid.station)
    stated_mm = cell.layout.nominal_base(station.rail_mm)[:3, 3]
    off_mm = log.matrix("base")[:3, 3] - stated_mm
    size_mm = float(np.linalg.norm(off_mm))
    if size_mm <= cell.layout.base_tolerance_mm:
        return None
    if balls := _balls(off_mm):
        return Suspicion(
            "reflector", float(off_mm[2]), f"mm along z of {{W}}, as of {balls}", NOTICED_BY
        )
    return Suspicion("base misplaced", size_mm, "mm", NOTICED_BY)


def _balls(off_mm: Array) -> str:
    """Return which reflectors in all floor nests leave a base (3,) off so; "" for none."""
    for seated in BALLS_IN:
        for expected in BALLS_IN:
            higher_mm = (expected - seated) * INCH_MM / 2.0
            fits = float(np.linalg.norm(off_mm - [0.0, 0.0, higher_mm])) <= SAME_MM
            if higher_mm and fits:
                return f"{seated:g} in reflectors in floor nests for {expected:g} in"
    return ""
