"""The errors of a study."""

from __future__ import annotations

from hilcell.errors import HilcellError


class Cluster(HilcellError):
    """The scheduler or its workers cannot be used, or are gone."""

    code = "HC-D01"


class OtherStudy(HilcellError):
    """A folder of results belongs to another study, or is damaged."""

    code = "HC-D02"


class NotInstalled(HilcellError):
    """A package is missing that only studies need."""

    code = "HC-D03"


def missing(error: ImportError) -> NotInstalled:
    """Return the error for a package of studies that cannot be imported."""
    return NotInstalled(
        f"study: {error.name or error} is not installed; in a clone, "
        "`pip install '.[study]'` installs what it needs"
    )
