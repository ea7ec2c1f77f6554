"""Errors that no run of a cell detects, each with its effect: for `check` and the report."""

from __future__ import annotations

import numpy as np

from hilcell.cell.file import BLOCK, Cell
from hilcell.geometry.frames import apply


def undetectable_errors(cell: Cell, *, two_faces: bool) -> list[str]:
    """Return what no comparison of runs detects; ``two_faces``: nests are measured in both."""
    errors = []
    useful_ppm = 30.0  # largest uncertainty of a useful certified length
    scale_ppm = 100.0  # of a wrong weather station, by 10 K or 30 hPa
    slip_deg = 0.003  # random, 1 sigma, at each stop
    layout, centre = cell.layout, cell.grid.centre.matrix()
    T_W_B = layout.nominal_base(cell.reference.rail_mm)
    centre_mm = apply(T_W_B, centre[None, :3, 3])[0]  # of the cube, in {W}
    range_mm = np.linalg.norm(centre_mm - cell.tracker.pose.matrix()[:3, 3])
    scaled_mm = 1e-6 * scale_ppm * np.linalg.norm(centre_mm - layout.floor[0].xyz_mm)
    scaled = f"{scale_ppm:g} ppm move targets by {scaled_mm:.2f} mm"
    slipped_mm = np.radians(slip_deg) * np.linalg.norm(centre[:3, 3])
    at_mm = {nest.name: nest.xyz_mm for nest in layout.fixed_nests}
    lengths_mm = [at_mm[one] - at_mm[other] for one, other in (bar.nests for bar in layout.length)]
    # The smallest scale error that the U (k = 2) of a certified length reveals.
    least_ppm = min((2e6 * each.u_mm / each.length_mm for each in layout.length), default=np.inf)
    if not layout.length:
        errors.append(
            "no certified length (layout.length): a wrong scale of the tracker is not detected; "
            f"{scaled}"
        )
    elif not least_ppm <= useful_ppm:
        errors.append(
            f"the certified lengths (layout.length) detect scale errors above {least_ppm:.0f} ppm "
            f"only, by their U (2 u_mm); {scaled}: is u_mm in mm?"
        )
    else:
        units = np.array([length / np.linalg.norm(length) for length in lengths_mm])
        across_deg = 30.0  # between lengths of different directions
        if not np.abs(units @ units.T).min() <= np.cos(np.radians(across_deg)):
            errors.append(
                "all certified lengths (layout.length) have one direction: a scale error across it "
                "is not detected; add one at right angles"
            )
    if not two_faces:
        errors.append(
            "the tracker is not turned over: errors of its collimation, transit axis or index are "
            f"not detected; 50 µrad move targets by up to {50e-6 * range_mm:.2f} mm"
        )
    if cell.robot.rp_mm is None:
        errors.append(
            "robot.rp_mm (repeatability, from the data sheet) is missing: worse repeatability from "
            f"the first point on, such as a brake of axis 2 that slips by {slip_deg:g} deg, is not "
            f"detected; it moves targets by {slipped_mm:.2f} mm (rms)"
        )
    if cell.plan.quick:
        share = cell.plan.share_above_max
        errors.append(
            f"a quick plan accepts a station by {BLOCK} targets: an error in {share:.0%} "
            "of the volume at that station alone is missed with a probability of up to "
            f"{(1.0 - share) ** BLOCK:.2f}; calibrate with --full where this matters"
        )
    errors.append(
        "a reflector that differs from the others: a prism 0.15 mm too long on the flange moves "
        "targets by 0.15 mm; compare all reflectors once (hilcell run reflectors, attended), and "
        "each new one"
    )
    errors.append(
        "a reflector mount less than 2 mm from robot.smr_mm from the first point on: the run takes "
        "it for an error of the tool, which moves by as much"
    )
    errors.append(
        "dirt under reflectors: 0.03 mm in each floor nest move targets by 0.07 mm; clean nests "
        "and reflectors"
    )
    return errors
