"""The packages that hilcell itself brings alarms in; other makes may be installed beside it."""

from importlib.metadata import distribution

from hilcell.alarms.catalogue import GROUP


def packages_of_hilcell() -> list[str]:
    """Return their names, the core's first."""
    points = distribution("hilcell").entry_points.select(group=GROUP)
    return ["hilcell.alarms", *sorted(point.module for point in points)]
