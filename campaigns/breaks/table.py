"""The table of deliberate breaks, `rows/*.toml`, and whether they can be made in this checkout."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from campaigns.breaks.patch import Patch, RottenError

ROOT = Path(__file__).parents[2]
ROWS = Path(__file__).with_name("rows")


@dataclass(frozen=True, slots=True, kw_only=True)
class Break:
    """One break: ``old`` in ``target`` becomes ``new``; one of ``tests`` must then fail.

    ``target`` is a dotted name, ``hilcell.run.mover.Mover.park_robot``. ``breaks`` says which
    property of safety or accuracy is lost.
    """

    name: str
    target: str
    old: str = ""
    new: str
    breaks: str
    tests: tuple[str, ...]

    def patch(self, root: Path = ROOT) -> Patch:
        """Return the change that can be made; raises `RottenError` where it cannot."""
        file, name = self._found(root)
        module = ".".join(file.relative_to(root).with_suffix("").parts)
        patch = Patch(module.removesuffix(".__init__"), name, self.old, self.new)
        patch.code(file.read_text("utf-8"), str(file))
        for test in self.tests:
            _check_test(test, root)
        return patch

    def _found(self, root: Path) -> tuple[Path, str]:
        """Return the file of the target's module, and the name in it."""
        words = self.target.split(".")
        for count in range(len(words) - 1, 0, -1):
            path = root.joinpath(*words[:count])
            for file in (path.with_suffix(".py"), path / "__init__.py"):
                if file.is_file():
                    return file, ".".join(words[count:])
        raise RottenError(f"no module of {self.target}")


def _check_test(test: str, root: Path) -> None:
    file, _, function = test.partition("::")
    path = root / file
    if not path.is_file() or (function and f"def {function}(" not in path.read_text("utf-8")):
        raise RottenError(f"no test {test}")


def breaks(rows: Path = ROWS) -> list[Break]:
    return [
        Break(**row | {"tests": tuple(row["tests"])})
        for file in sorted(rows.glob("*.toml"))
        for row in tomllib.loads(file.read_text("utf-8"))["break"]
    ]
