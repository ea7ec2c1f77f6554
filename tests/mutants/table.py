"""The table of deliberate breaks, `table.toml`, and the rules that keep it true.

The trap: a break whose text is no longer in its file breaks nothing and would count as caught
or survived by chance. So the text must occur exactly once, and what replaces it must compile.
"""

from __future__ import annotations

import ast
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLE = Path(__file__).with_name("table.toml")


class TableError(Exception):
    """A row of the table that names no text, no file or no test of this checkout."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """One break: ``old`` in ``file`` becomes ``new``; one of ``tests`` must then fail.

    ``breaks`` says which property of safety or accuracy is lost.
    """

    name: str
    file: str
    old: str
    new: str
    breaks: str
    tests: tuple[str, ...]

    def applied(self, root: Path) -> str:
        """Return the broken text of the file below ``root``; raises `TableError`."""
        path = root / self.file
        if not path.is_file():
            raise TableError(f"{self.name}: no file {self.file}")
        text = path.read_text("utf-8")
        if text.count(self.old) != 1:
            raise TableError(
                f"{self.name}: {self.file} has the text {self.old!r} {text.count(self.old)} "
                "times, wanted once; give the row the text as it is now, with the same break"
            )
        broken = text.replace(self.old, self.new)
        try:
            ast.parse(broken)
        except SyntaxError as error:
            raise TableError(f"{self.name}: {self.file} is no Python then: {error}") from error
        return broken

    def check(self, root: Path) -> None:
        """Raise `TableError` where the break cannot be made, or a test is not there."""
        self.applied(root)
        for test in self.tests:
            file, _, function = test.partition("::")
            path = root / file
            if not path.is_file() or (
                function and f"def {function}(" not in path.read_text("utf-8")
            ):
                raise TableError(f"{self.name}: no test {test}")


def mutants(table: Path = TABLE) -> list[Mutant]:
    """Return the breaks of the table, in its order."""
    rows = tomllib.loads(table.read_text("utf-8"))["mutant"]
    return [Mutant(**row | {"tests": tuple(row["tests"])}) for row in rows]
