"""Which rows of the run's screen go first where there are fewer than 24.

First the scale under the tolerance bar, then the status line without an alarm, the run's names, and
two rows of the large digits; the table gives up the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

from hilcell.tui.text.footer import FULL_WIDTH
from hilcell.tui.text.newest import FULL_ROWS, SMALL_ROWS

FULL = 24


@dataclass(frozen=True, slots=True)
class Rows:
    """The rows that are shown: run's names, newest point, alarm with next step, footer."""

    identity: bool
    point: int
    status: bool
    footer: int

    @property
    def fixed(self) -> int:
        """Return how many rows stand above and under the middle of the screen."""
        return 5 + self.identity + self.footer


def rows_for(height: int, width: int, *, alarm: bool) -> Rows:
    """Return the rows of a terminal of this size; an alarm never goes."""
    footer = 2 if width >= FULL_WIDTH else 1
    missing = FULL - height - (2 - footer)
    point = FULL_ROWS if missing < 1 else FULL_ROWS - 1 if missing < 4 else SMALL_ROWS
    return Rows(identity=missing < 3, point=point, status=alarm or missing < 2, footer=footer)
