"""``make gauges``: how large the product is, and how often it declares the same thing.

No figure has a limit. Those at the start and at the end of a piece of work show what it changed.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("hilcell", "drivers", "procedures", "fakes")
CORE = ("hilcell", "procedures")
SMALL, LARGE = 60, 800  # lines of a module
NOUNS = ("Cell", "Run", "Point", "Frame", "Verdict", "Calibration", "Alarm")
DECODING = re.compile(r"(dec|enc)_hook|decode|encode")


@dataclass(frozen=True)
class Module:
    """One file of the product, parsed."""

    path: Path
    text: str
    tree: ast.Module

    @property
    def room(self) -> str:
        return self.path.parts[0]

    @property
    def lines(self) -> int:
        return len(self.text.splitlines())


def modules() -> list[Module]:
    """Return all modules of the product, their paths below the project's folder."""
    found = []
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            text = path.read_text("utf-8")
            found.append(Module(path.relative_to(ROOT), text, ast.parse(text)))
    return found


def names(module: Module) -> Iterator[str]:
    """Yield the names that a module declares, not those that it imports."""
    for node in module.tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign):
            targets = [each for target in node.targets for each in ast.walk(target)]
            yield from (each.id for each in targets if isinstance(each, ast.Name))
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id


def private_functions(module: Module) -> int:
    """Return how many functions a module declares for itself."""
    return sum(
        isinstance(node, ast.FunctionDef) and node.name.startswith("_") for node in module.tree.body
    )


def any_types(module: Module) -> int:
    """Return how often `Any` is written as a type, outside the hooks that decode files."""
    return sum(
        isinstance(node, ast.Name) and node.id == "Any"
        for top in module.tree.body
        if not DECODING.search(getattr(top, "name", ""))
        for node in ast.walk(top)
    )


def declares(module: Module) -> set[str]:
    """Return the nouns of which a module declares a shape: a class of fields, or a table."""
    found: set[str] = set()
    for node in ast.walk(module.tree):
        if isinstance(node, ast.ClassDef) and any(isinstance(n, ast.AnnAssign) for n in node.body):
            found.update(re.findall("[A-Z][a-z]*", node.name))
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            made = ast.unparse(node.value.func)
            if made.endswith("Table"):
                found.update(each.id.title() for each in node.targets if isinstance(each, ast.Name))
    return found.intersection(NOUNS)


def gauges() -> list[tuple[str, str]]:
    product = modules()
    core = [module for module in product if module.room in CORE]
    lines = sum(module.lines for module in product)
    small = sum(module.lines < SMALL and module.path.name != "__init__.py" for module in product)
    large = [str(module.path) for module in product if module.lines > LARGE]
    tests = sum(
        len(path.read_text("utf-8").splitlines()) for path in (ROOT / "tests").rglob("*.py")
    )
    per_thousand = 1000.0 / lines
    declared = sum(len(list(names(module))) for module in product) * per_thousand
    private = sum(map(private_functions, product)) * per_thousand
    shapes = [declares(module) for module in product]
    rows = [
        ("modules", f"{len(product)}"),
        ("lines of the product", f"{lines}"),
        ("lines of the tests", f"{tests}"),
        ("module-level names per 1000 lines", f"{declared:.1f}"),
        ("private functions per 1000 lines", f"{private:.1f}"),
        ("Any in hilcell and procedures", f"{sum(map(any_types, core))}"),
        (f"modules below {SMALL} lines", f"{small}"),
        (f"modules above {LARGE} lines", ", ".join(large) or "none"),
    ]
    rows += [
        (f"files that declare {noun}", f"{sum(noun in of_module for of_module in shapes)}")
        for noun in NOUNS
    ]
    return rows


if __name__ == "__main__":
    for title, figure in gauges():
        print(f"{title:36} {figure}")
    sys.exit(0)
