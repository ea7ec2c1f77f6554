"""Point identities: see `hilcell.model.point`."""

from hilcell.model.point import BACK, CHECKS, CONTROL, HELD, LENGTH, REFLECTOR, SEAT, PointId

__all__ = ["BACK", "CHECKS", "CONTROL", "HELD", "LENGTH", "REFLECTOR", "SEAT", "PointId"]
