"""One break of the product, made where its module is imported; no file is changed.

A break names a function, a method, a class attribute or a constant, and gives the Python text in it
that is replaced. Texts are compared as syntax trees: comments, line breaks, brackets, quotes and
the place in the file do not matter.

The trap: a break whose text is no longer there breaks nothing, and would count as caught or
survived by chance. So the text must occur exactly once.
"""

from __future__ import annotations

import ast
import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType, ModuleType

VARIABLE = "HILCELL_BREAK"  # the break of this process and of those that it starts
BLOCKS = ("body", "orelse", "finalbody", "handlers")
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


class RottenError(Exception):
    """The break cannot be made: its target or its text is not in the code."""


@dataclass(frozen=True, slots=True)
class Patch:
    """``old`` in ``name`` of ``module`` becomes ``new``; without ``old`` all of its body does.

    Both are an expression, statements, or arguments of a call; an empty ``new`` deletes ``old``.
    """

    module: str
    name: str
    old: str
    new: str

    def code(self, source: str, path: str) -> CodeType:
        """Return the module's code with the break in it; raises `RottenError`."""
        tree = ast.parse(source)
        places = list(_named(tree.body, self.name.split(".")))
        if not places:
            raise RottenError(f"{self.module} has no {self.name}")
        before = ast.dump(tree)
        spot, new = self._replaced(places)
        spot.put(new)
        if ast.dump(tree) == before:
            raise RottenError(f"{self.new!r} changes nothing")
        try:
            return compile(ast.fix_missing_locations(tree), path, "exec", dont_inherit=True)
        except SyntaxError as error:
            raise RottenError(f"{self.new!r} does not compile there: {error.msg}") from error

    def _replaced(self, places: Sequence[ast.AST]) -> tuple[_Spot, Sequence[ast.AST]]:
        """Return where the old text is, and what replaces it."""
        if not self.old:
            if len(places) > 1:
                raise RottenError(f"{self.name} is defined {len(places)} times, expected once")
            return _whole(places[0], self.new)
        old, new = _readings(self.old), _readings(self.new)
        for kind in (kind for kind in old if kind in new):
            spots = [spot for place in places for spot in _occurrences(place, old[kind])]
            if len(spots) == 1:
                return spots[0], new[kind]
            if spots:
                raise RottenError(f"{self.old!r} occurs {len(spots)} times, expected once")
        raise RottenError(f"{self.name} has no {self.old!r}")

    def environment(self) -> dict[str, str]:
        """Return what tells a process of this break: see `install`."""
        return {VARIABLE: json.dumps(asdict(self))}


def install() -> None:
    """Make the break that the environment tells of, in this process, once its module is imported.

    Processes that are started get it by `site/sitecustomize.py`.
    """
    sys.meta_path.insert(0, _Finder(Patch(**json.loads(os.environ[VARIABLE]))))


@dataclass(frozen=True)
class _Finder:
    patch: Patch

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the broken module's spec, None for all others."""
        if name != self.patch.module:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.origin is not None:
            spec.loader = _Loader(self.patch, spec.origin)
        return spec


class _Loader(SourceFileLoader):
    def __init__(self, patch: Patch, path: str) -> None:
        super().__init__(patch.module, path)
        self._patch = patch

    def get_code(self, fullname: str) -> CodeType:
        """Compile the broken source: what is compiled already is sound."""
        return self._patch.code(self.get_source(fullname) or "", self.path)


@dataclass(frozen=True, slots=True)
class _Spot:
    """Nodes in a field of their parent: some of a list, or the only one."""

    parent: ast.AST
    field: str
    start: int
    count: int

    def put(self, new: Sequence[ast.AST]) -> None:
        """Replace the nodes; a traceback shows the line of the first one."""
        held = getattr(self.parent, self.field)
        at = held[self.start] if isinstance(held, list) else held
        for node in new:
            for each in ast.walk(node):
                ast.copy_location(each, at)
        if isinstance(held, list):
            held[self.start : self.start + self.count] = new
            if self.field == "body" and not held:
                held.append(ast.copy_location(ast.Pass(), at))
        else:
            setattr(self.parent, self.field, new[0])


def _named(body: Sequence[ast.AST], names: Sequence[str]) -> Iterator[ast.AST]:
    """Yield the definitions of a dotted name: several of a property with its setter."""
    for node in body:
        if names[0] in _names(node):
            yield from [node] if len(names) == 1 else _named(getattr(node, "body", ()), names[1:])
        elif not isinstance(node, SCOPES):
            for block in BLOCKS:
                yield from _named(getattr(node, block, ()), names)


def _names(node: ast.AST) -> list[str]:
    """Return the names that a statement defines."""
    if isinstance(node, SCOPES):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    names = [each for target in targets for each in getattr(target, "elts", [target])]
    return [each.id for each in names if isinstance(each, ast.Name)]


def _whole(place: ast.AST, text: str) -> tuple[_Spot, Sequence[ast.AST]]:
    """Return the body of a function, or the value of a constant, and what replaces it."""
    kind, field = ("statements", "body") if isinstance(place, SCOPES) else ("expression", "value")
    new = _readings(text).get(kind)
    if new is None:
        raise RottenError(f"{text!r} is no {kind}")
    held = getattr(place, field)
    return _Spot(place, field, 0, len(held) if isinstance(held, list) else 1), new


def _occurrences(place: ast.AST, old: Sequence[ast.AST]) -> Iterator[_Spot]:
    """Yield where a text occurs within a definition."""
    wanted = [ast.dump(node) for node in old]
    for parent in ast.walk(place):
        for field, held in ast.iter_fields(parent):
            nodes = held if isinstance(held, list) else [held]
            for start in range(len(nodes) - len(old) + 1):
                here = nodes[start : start + len(old)]
                if all(
                    type(node) is type(other) and ast.dump(node) == dumped
                    for node, other, dumped in zip(here, old, wanted, strict=True)
                ):
                    yield _Spot(parent, field, start, len(old))


def _readings(text: str) -> dict[str, Sequence[ast.AST]]:
    """Return a text as an expression, as statements, as arguments of a call: all that it can be.

    Raises `RottenError` where it is none of them.
    """
    found: dict[str, Sequence[ast.AST]] = {}
    if text.strip() and isinstance(alone := _parsed(f"({text}\n)"), ast.Expr):
        found["expression"] = [alone.value]
    with suppress(SyntaxError):
        found["statements"] = ast.parse(text).body
    call = _parsed(f"f({text}\n)")
    if isinstance(call, ast.Expr) and isinstance(call.value, ast.Call):
        found["arguments"] = [*call.value.args, *call.value.keywords]
    if not found:
        raise RottenError(f"{text!r} is no Python")
    return found


def _parsed(text: str) -> ast.stmt | None:
    with suppress(SyntaxError):
        return ast.parse(text).body[0]
    return None
