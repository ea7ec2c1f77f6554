"""Records of the journal as words: names without underscores, figures with their unit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hilcell.calibration.recheck import in_words


def facts_of(body: Mapping[str, Any]) -> str:
    """Return the plain facts of a verdict or an event."""
    known = ("holds", "what")
    return ", ".join(
        _with_unit(name, value)
        for name, value in in_words(body).items()
        if name not in known and not isinstance(value, dict | list)
    )


def _with_unit(name: str, value: object) -> str:
    words = name.removesuffix("_mm").replace("_", " ")
    return f"{words} {_text(value)}{' mm' if name.endswith('_mm') else ''}"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4f}" if isinstance(value, float) else str(value)
