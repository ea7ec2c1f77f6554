"""Which keys of a cell differ from those of the same cell at another time, in words."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from hilcell.cell.file import Cell


def differences(before: Cell, now: Cell, *, without: str = "") -> str:
    """Return the keys that differ, each with both values; the table ``without`` is left out."""
    frozen, given = msgspec.to_builtins(before), msgspec.to_builtins(now)
    for values in (frozen, given):
        values.pop(without, None)
    keys = list(_different(frozen, given))
    named = 3  # the others are counted
    more = f", and {len(keys) - named} more" if len(keys) > named else ""
    return ", ".join(keys[:named]) + more


def _different(before: object, now: object, key: str = "") -> Iterator[str]:
    """Yield each key that differs, with both values."""
    if isinstance(before, dict) and isinstance(now, dict):
        for name in sorted(before.keys() | now.keys()):
            inner = f"{key}.{name}" if key else str(name)
            yield from _different(before.get(name), now.get(name), inner)
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for number, (one, other) in enumerate(zip(before, now, strict=True), 1):
            yield from _different(one, other, f"{key}[{number}]")
    elif before != now:
        yield f"{key} {_short(before)} -> {_short(now)}"


def _short(value: object) -> str:
    text = f"{value}"
    return text if len(text) <= 40 else f"{text[:37]}..."
