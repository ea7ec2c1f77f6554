"""The ways in which a target is sent, and their words."""

from __future__ import annotations

from enum import StrEnum


class Sent(StrEnum):
    """How a target is sent, in the order of sending: as it is, corrected by the paper's method, by
    the chosen model. The value is the key in `PointId.how` and in results.
    """

    BEFORE = "before"
    IDW = "idw"
    CHOSEN = "chosen"

    @property
    def text(self) -> str:
        """Return the way in words."""
        return TEXTS[self]

    @property
    def short(self) -> str:
        """Return it in few letters."""
        return "paper" if self is Sent.IDW else self.text


TEXTS: dict[str, str] = {
    Sent.BEFORE: "as sent",
    Sent.IDW: "paper method",
    Sent.CHOSEN: "corrected",
}
BOTH = (Sent.BEFORE, Sent.CHOSEN)  # that are compared; the paper's method is measured beside them
