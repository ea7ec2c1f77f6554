"""A column of a table is one definition: name, unit, the value of a row, and its rounding.

The report shows it as text, exports hand on the value itself under a key.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Generic, TypeVar

T = TypeVar("T")
Value = str | int | float | None
KEY = "key"  # name of a column of points' keys, which is small and grey

_UNITS_IN_KEYS = {"°": "deg", "°C": "c", "%": "percent"}


@dataclass(frozen=True)  # with slots, `Column[T](...)` fails in Python 3.11
class Column(Generic[T]):
    """``of`` gives the value of a row, None where it has none.

    ``form`` is how a figure is shown, as `format` takes it; words have none, and words in
    place of a figure need none.
    """

    name: str
    of: Callable[[T], Value]
    unit: str = ""
    form: str = ""

    @property
    def header(self) -> str:
        """Return name and unit for people."""
        return f"{self.name} {self.unit}".rstrip()

    @property
    def key(self) -> str:
        """Return name and unit for programs: ``x_mm``, ``a_deg``."""
        unit = _UNITS_IN_KEYS.get(self.unit, self.unit)
        return f"{self.name.lower()}_{unit}".rstrip("_")

    def text(self, row: T) -> str:
        """Return the value as it is shown, nothing where there is none."""
        value = self.of(row)
        if value is None or isinstance(value, str):
            return value or ""
        text = format(value, self.form)
        if not text.strip("-0."):  # no zero has a sign
            return text.lstrip("-")
        return text.replace("-", "\N{MINUS SIGN}")


@dataclass(frozen=True, slots=True)
class Sheet:
    """One table as text: the first ``words`` columns are words, the others figures."""

    title: str
    headers: list[str]
    rows: list[list[str]]
    words: int = 1
    note: str = ""


def sheet(
    title: str, columns: Sequence[Column[T]], rows: Iterable[T], note: str = ""
) -> Sheet | None:
    """Return a table of rows; nothing where there is none."""
    texts = [[column.text(row) for column in columns] for row in rows]
    words = sum(1 for _ in takewhile(lambda column: not column.form, columns))
    return Sheet(title, [each.header for each in columns], texts, words, note) if texts else None


def present(*sheets: Sheet | None) -> list[Sheet]:
    """Return those tables that there are."""
    return [each for each in sheets if each is not None]
