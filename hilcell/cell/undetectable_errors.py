"""Errors that no run of a cell can see, each with its size: for `check` and for the report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply
from hilcell.geometry.kinematics import Array


def unseen(cell: Cell, *, turns_over: bool) -> list[str]:
    """Return what no comparison of runs shows; ``turns_over``: nests are seen in both faces."""
    found = []
    useful_ppm = 30.0  # of a certified length that is of use
    scale_ppm = 100.0  # of a weather station that lies, by 10 K or 30 hPa about each
    slip_deg = 0.003  # at random, 1 sigma, at each stop
    layout, centre = cell.layout, cell.grid.centre.matrix()
    T_W_B = layout.nominal_base(cell.reference.rail_mm)
    centre_mm = apply(T_W_B, centre[None, :3, 3])[0]  # of the cube, in {W}
    range_mm = np.linalg.norm(centre_mm - cell.tracker.pose.matrix()[:3, 3])
    scaled_mm = 1e-6 * scale_ppm * np.linalg.norm(centre_mm - layout.floor[0].xyz_mm)
    scaled = f"{scale_ppm:g} ppm move targets by {scaled_mm:.2f} mm"
    slipped_mm = np.radians(slip_deg) * np.linalg.norm(centre[:3, 3])
    at_mm = {nest.name: nest.xyz_mm for nest in layout.standing}
    ways_mm = [at_mm[one] - at_mm[other] for one, other in (each.nests for each in layout.length)]
    # The least scale that a certified length tells by its U (k = 2).
    least_ppm = min((2e6 * each.u_mm / each.length_mm for each in layout.length), default=np.inf)
    if not layout.length:
        unscaled = "a wrong scale of the tracker is not seen"
        found.append(f"no certified length (layout.length): {unscaled}; {scaled}")
    elif not least_ppm <= useful_ppm:
        found.append(
            f"the certified lengths (layout.length) tell scales beyond {least_ppm:.0f} ppm alone, "
            f"by their U (2 u_mm); {scaled}: is u_mm in mm?"
        )
    elif not _differ(ways_mm):
        found.append(
            "the certified lengths lie along one direction: a scale that differs across it is "
            "not seen; a second one (layout.length) at right angles shows it"
        )
    if not turns_over:
        found.append(
            "the tracker is not turned over: a collimation, transit axis or index that is off is "
            f"not seen; 50 µrad move targets by up to {50e-6 * range_mm:.2f} mm"
        )
    if cell.robot.rp_mm is None:
        found.append(
            "the robot's repeatability is not stated (robot.rp_mm, of its data sheet): one "
            "that repeats worse from the first point on, as a brake of axis 2 that slips by "
            f"{slip_deg:g} deg, is not seen; it moves targets by {slipped_mm:.2f} mm (rms)"
        )
    found.append(
        "a reflector that differs from the others in its own place: a prism 0.15 mm long on the "
        "flange moves targets by 0.15 mm; compare them once (hilcell run reflectors, attended), "
        "and whenever one is new"
    )
    found.append(
        "a mount that sits elsewhere on the flange than robot.smr_mm says, by less than 2 mm, from "
        "the first point on: it looks like an error of the tool, and moves the tool by as much"
    )
    found.append(
        "reflectors that are not seated well: dirt of 0.03 mm in each floor nest moves targets by "
        "0.07 mm, and nothing shows it; clean nests and reflectors"
    )
    return found


def _differ(ways_mm: Sequence[Array]) -> bool:
    """Whether two of the vectors (3,) have directions of their own."""
    units = np.array([way / np.linalg.norm(way) for way in ways_mm])
    across_deg = 30.0  # between lengths of two directions
    return bool(np.abs(units @ units.T).min() <= np.cos(np.radians(across_deg)))
