"""Reflectors of another radius than the tracker is set to, by the shift of all readings."""

from __future__ import annotations

RADII_MM = {"1.5 in": 19.05, "0.875 in": 11.1125, "0.5 in": 6.35}  # of usual reflectors
RADIUS_MM = 1.0  # by which a shift along the beams may miss a difference of radii
PAIRS = {
    f"{one} where the tracker is set to {other}": RADII_MM[other] - RADII_MM[one]
    for one in RADII_MM
    for other in RADII_MM
    if one != other
}
SHIFTS_MM = (0.0, *PAIRS.values())  # of readings, by which those of a reflector become right


def reflectors_of(shift_mm: float) -> str:
    """Return which reflectors a shift of every reading along its beam proves; "" for none."""
    fits = [words for words, of_mm in PAIRS.items() if abs(of_mm - shift_mm) <= RADIUS_MM]
    return " or ".join(fits)
