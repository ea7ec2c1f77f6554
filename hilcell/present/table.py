"""The table: columns, each defined once, and the values of its rows.

Every place that shows or hands on a table takes this one: the terminal, the report, a study's page,
the screen, CSV and XLSX. A cell is a value; its text, unit and rounding are the column's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import takewhile
from operator import attrgetter, itemgetter
from typing import ClassVar, Generic, NamedTuple, Never, TypeVar

from hilcell.language import decimal

T = TypeVar("T")
T_contra = TypeVar("T_contra", contravariant=True)

MINUS = "\N{MINUS SIGN}"


class Named(NamedTuple):
    """A cell that the program calls by a name, which the screen shows in words."""

    name: str
    words: str


Value = str | int | float | Named | None


@dataclass(frozen=True)  # with slots, `Column[T](...)` fails in Python 3.11
class Column(Generic[T_contra]):
    """``of`` gives the value of a row, None where it has none.

    ``form`` is how a figure is shown, as `format` takes it; words have none, and words in
    place of a figure need none. ``small``: keys, for programs rather than people.
    """

    PLAIN_UNITS: ClassVar = {"°": "deg", "°C": "C", "µrad": "urad"}
    UNITS_IN_KEYS: ClassVar = PLAIN_UNITS | {"°C": "c", "%": "percent"}

    name: str
    of: Callable[[T_contra], Value]
    unit: str = ""
    form: str = ""
    small: bool = False

    @property
    def header(self) -> str:
        return f"{self.name} {self.unit}".rstrip()

    @property
    def plain_header(self) -> str:
        """Return name and unit in ASCII, for a terminal: ``turn urad``."""
        return f"{self.name} {self.PLAIN_UNITS.get(self.unit, self.unit)}".rstrip()

    @property
    def key(self) -> str:
        """Return name and unit for programs: ``x_mm``, ``a_deg``."""
        unit = self.UNITS_IN_KEYS.get(self.unit, self.unit)
        return f"{self.name.lower()}_{unit}".rstrip("_")

    def text(self, value: Value, minus: str = MINUS) -> str:
        """Return a value of this column as it is shown, nothing where there is none."""
        if isinstance(value, Named):
            return value.name
        if value is None or isinstance(value, str):
            return value or ""
        text = format(value, self.form)
        if not text.strip("-0."):  # no zero has a sign
            return decimal(text.lstrip("-"))
        return decimal(text.replace("-", minus))


def vector(
    prefix: str, names: Iterable[str], unit: str, attribute: str, form: str = "", first: int = 0
) -> Iterator[Column[object]]:
    """Yield a column for each element, from ``first``, of an attribute, which may be None."""
    of = attrgetter(attribute)

    def element(n: int, row: object) -> Value:
        values = of(row)
        return None if values is None else float(values[n])

    for n, name in enumerate(names, first):
        yield Column(prefix + name, partial(element, n), unit, form)


def listed(*columns: str | tuple[str, str, str]) -> list[Column[Sequence[Value]]]:
    """Return the columns of rows that are sequences: each a name, or its name, unit and form."""
    named = [(each, "", "") if isinstance(each, str) else each for each in columns]
    return [Column(name, itemgetter(n), unit, form) for n, (name, unit, form) in enumerate(named)]


class Table:
    """Rows of values (N rows, one value a column), in the order of ``columns``.

    ``mark`` gives the kind of a row that stands out: "sum", "stop", else "". A table without rows
    is false and is not shown.
    """

    def __init__(
        self,
        columns: Sequence[Column[T]],
        rows: Iterable[T],
        title: str = "",
        note: str = "",
        mark: Callable[[T], str] = lambda row: "",
    ) -> None:
        kept = [*rows]
        self.columns: Sequence[Column[Never]] = columns
        self.rows: list[list[Value]] = [[each.of(row) for each in columns] for row in kept]
        self.marks = [mark(row) for row in kept]
        self.title, self.note = title, note

    def __bool__(self) -> bool:
        return bool(self.rows)

    @property
    def words(self) -> int:
        """Return how many columns at the left are words, the others being figures."""
        return sum(1 for _ in takewhile(lambda column: not column.form, self.columns))

    @property
    def headers(self) -> list[str]:
        return [column.header for column in self.columns]

    @property
    def keys(self) -> list[str]:
        return [column.key for column in self.columns]

    def texts(self, minus: str = MINUS) -> list[list[str]]:
        return [
            [column.text(value, minus) for column, value in zip(self.columns, row, strict=True)]
            for row in self.rows
        ]
