"""Records of the journal as words: names without underscores, figures with their unit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hilcell.calibration.recheck import in_words

UNITS = {
    "mm": " mm", "s": " s", "c": " °C", "k": " K", "deg": "°", "urad": " µrad", "percent": " %",
}  # fmt: skip


def facts_of(body: Mapping[str, Any]) -> str:
    """Return the plain facts of a verdict or an event."""
    known = ("holds", "what")
    return ", ".join(
        _with_unit(name, value)
        for name, value in in_words(body).items()
        if name not in known and not isinstance(value, dict | list | None)
    )


def _with_unit(name: str, value: object) -> str:
    words, _, last = name.rpartition("_")
    unit = UNITS.get(last, "") if words else ""
    return f"{(words if unit else name).replace('_', ' ')} {_text(value)}{unit}"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4f}" if isinstance(value, float) else str(value)
