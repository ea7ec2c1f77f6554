"""A table as text: its columns and its rows, before a widget draws them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Column:
    """One column: its header with the unit, its width, and whether numbers stand in it."""

    title: str
    width: int
    right: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One row: what it stands for, its cells, and its tone (a theme's variable)."""

    key: str
    cells: tuple[str, ...]
    tone: str = ""
