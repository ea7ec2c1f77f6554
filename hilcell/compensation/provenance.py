"""The stamp of corrected targets: the run that corrected them, the station, the time, warnings.

Targets that were corrected must not be corrected again: the robot's error would be taken off
twice. So each corrected list has a column, each corrected program a comment, and every reader of
targets looks for it first.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from hilcell.ports import HilcellError
from hilcell.sanitize import clean

COLUMN = "corrected_by"
MARK = "hilcell: corrected by "


class CorrectedBefore(HilcellError):
    """Targets that carry the stamp of a correction."""

    code = "HC-C10"


@dataclass(frozen=True, slots=True)
class Stamp:
    """``by`` is the run, or what else corrected; ``written`` is UTC; ``remarks`` are warnings."""

    by: str
    written: str
    station: str = ""
    simulated: bool = False
    remarks: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Return it on one line, without commas."""
        at = f" for {self.station}" if self.station else ""
        parts = [f"{MARK}{self.by}{at} on {self.written}"]
        parts += ["SIMULATION"] if self.simulated else []
        return "; ".join(clean(each.replace(",", " ")) for each in (*parts, *self.remarks))


def refuse_corrected(source: str, texts: Iterable[str]) -> None:
    """Raise `CorrectedBefore` where one of the texts of a file is a stamp, or names its column."""
    stamp = ""
    for text in texts:
        if MARK.strip() in text:
            stamp = text[text.index(MARK.strip()) :]
            break
        if text.strip() == COLUMN:
            stamp = f"it has a column {COLUMN}"
    if stamp:
        raise CorrectedBefore(
            f"{source} was corrected before ({clean(stamp)}); a second correction would move "
            "every target by the error once more: give the nominal targets"
        )
