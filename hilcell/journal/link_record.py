"""Losses on the rail's wire, and when they are too many."""

from __future__ import annotations

import msgspec

HELD_BY_SDO = "the drive sent no PDO at the end, SDO confirmed that the slide is held"
LOSSY = 0.005  # share of the frames on the rail's wire


class LinkRecord(msgspec.Struct, frozen=True):
    """Counts and losses of the rail's wire in one session, or in several together."""

    frames: int
    bad_lines: int
    refused: int
    malformed: int
    held_by_sdo: int = 0

    def followed_by(self, later: LinkRecord) -> LinkRecord:
        """Return the counts of both; how the slide was held is of the later end."""
        return LinkRecord(
            self.frames + later.frames,
            self.bad_lines + later.bad_lines,
            self.refused + later.refused,
            self.malformed + later.malformed,
            later.held_by_sdo,
        )

    @property
    def lost_share(self) -> float:
        """Return how much was lost, as a share of all."""
        lost = self.bad_lines + self.refused + self.malformed
        return lost / max(1, self.frames + lost)

    @property
    def warning(self) -> str:
        """Return the warning that so much was lost; "" where the link is well."""
        if self.lost_share < LOSSY:
            return ""
        return (
            f"the rail's CAN link loses {100 * self.lost_share:.2f} %, a healthy one less than "
            f"{100 * LOSSY:.1f} %: check its plugs, the shield, the two terminators and the "
            "gateway's cable"
        )

    @property
    def text(self) -> str:
        """Return it in words."""
        return (
            f"{self.frames} frames, {self.bad_lines} bad lines, {self.refused} refused, "
            f"{self.malformed} malformed ({100 * self.lost_share:.2f} % lost)"
            f"{f'; {HELD_BY_SDO}' if self.held_by_sdo else ''}"
        )
