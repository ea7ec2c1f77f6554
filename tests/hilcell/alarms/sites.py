"""Every place in the source that builds an error, and what it can say, by walking the syntax.

A small reader of the source: constants, f-strings, names assigned in the function, arguments that
the module passes, attributes that it sets. What it cannot know becomes `HOLE`, or the samples that
a test gives for it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

from hilcell.alarms.finding import DEVICES, Finding, findings_of

ROOT = Path(__file__).parents[3]
ROOMS = ("hilcell", "drivers", "procedures")
HOLE = "7"
DEEP = 6
MOST = 400

Function = ast.FunctionDef
Samples = Mapping[str, list[str]]


@dataclass(frozen=True)
class Site:
    """One call that builds an error: where it stands, and all that it can say."""

    path: str
    function: str
    line: int
    kind: str
    findings: tuple[Finding, ...]

    def __str__(self) -> str:
        return f"{self.path}:{self.line} {self.kind} in {self.function}"


class Module:
    """One module's syntax, with what is needed to follow a name."""

    def __init__(self, path: Path) -> None:
        self.path = path.relative_to(ROOT).as_posix()
        self.tree = ast.parse(path.read_text("utf-8"))

    @cached_property
    def classes(self) -> dict[str, list[str]]:
        found = [node for node in ast.walk(self.tree) if isinstance(node, ast.ClassDef)]
        return {node.name: [ast.unparse(base) for base in node.bases] for node in found}

    @cached_property
    def functions(self) -> list[tuple[Function, str]]:
        """Return all functions with the class that each belongs to, inner ones left out."""
        inside = [(node, "") for node in self.tree.body if isinstance(node, Function)]
        for each in ast.walk(self.tree):
            if isinstance(each, ast.ClassDef):
                inside += [(node, each.name) for node in each.body if isinstance(node, Function)]
        return inside

    def constants(self, name: str) -> Iterator[ast.expr]:
        """Yield what the module itself, or the one that it imports from, assigns to ``name``."""
        for node in self.tree.body:
            if isinstance(node, ast.Assign):
                yield from _assigned(node, name)
            elif isinstance(node, ast.ImportFrom) and node.module is not None:
                source = ROOT / f"{node.module.replace('.', '/')}.py"
                if source.is_file() and any(each.name == name for each in node.names):
                    yield from Module(source).constants(name)

    def imports(self) -> Iterator[str]:
        """Yield the paths that the imports name, whether or not there is such a module."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                yield f"{node.module.replace('.', '/')}.py"
                yield from (f"{node.module.replace('.', '/')}/{a.name}.py" for a in node.names)

    def named(self, name: str) -> list[Function]:
        return [node for node, _ in self.functions if node.name == name]

    def calls(self, name: str) -> Iterator[tuple[ast.Call, Function]]:
        for function, _ in self.functions:
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and _last(node.func) == name:
                    yield node, function


class Reader:
    """Tells what an expression of a module can be, as texts."""

    def __init__(self, module: Module, samples: Samples) -> None:
        self.module, self.samples = module, samples
        self._open: set[str] = set()  # attributes that are being followed

    def texts(self, node: ast.expr, function: Function, deep: int = DEEP) -> list[str]:
        """Return all texts that an expression can be; `HOLE` for what is not known."""
        known = self.samples.get(ast.unparse(node))
        if known is not None:
            return known
        return self._written(node, function, deep) or self._followed(node, function, deep) or [HOLE]

    def _written(self, node: ast.expr, function: Function, deep: int) -> list[str]:
        match node:
            case ast.Constant(value=str(text)):
                return [text]
            case ast.JoinedStr(values=parts) | ast.Tuple(elts=parts):
                return self._joined(parts, function, deep)
            case ast.FormattedValue(value=value):
                return self.texts(value, function, deep)
            case ast.BinOp(left=left, op=ast.Add(), right=right) if _is_text(left):
                return self._joined([left, right], function, deep)
            case ast.BoolOp(values=either):
                return self._either(either, function, deep)
            case ast.IfExp(body=yes, orelse=no):
                return self._either([yes, no], function, deep)
        return []

    def _followed(self, node: ast.expr, function: Function, deep: int) -> list[str]:
        if deep > 0:
            match node:
                case ast.Name(id=name):
                    return self._named(name, function, deep)
                case ast.Attribute(value=ast.Name(id="self"), attr=name):
                    return self._attribute(name, deep)
                case ast.Call(func=called) if self.module.named(_last(called)):
                    return self._returned(_last(called), deep)
        return []

    def _joined(self, parts: list[ast.expr], function: Function, deep: int) -> list[str]:
        found = [self.texts(part, function, deep) for part in parts]
        return sorted({"".join(each) for each in product(*found)})[:MOST]

    def _either(self, nodes: list[ast.expr], function: Function, deep: int) -> list[str]:
        followed = {f"self.{name}" for name in self._open}
        new = [node for node in nodes if ast.unparse(node) not in followed]
        return _union(self.texts(node, function, deep - 1) for node in new)

    def _named(self, name: str, function: Function, deep: int) -> list[str]:
        values = list(_assigned(function, name)) or list(self.module.constants(name))
        if values:
            return self._either(values, function, deep)
        arguments = [arg.arg for arg in function.args.args]
        return self._passed(function, name, deep) if name in arguments else []

    def _passed(self, function: Function, name: str, deep: int) -> list[str]:
        """Return what the module's own calls of ``function`` pass as ``name``, and its default."""
        wanted = [arg.arg for arg in function.args.args if arg.arg != "self"]
        default = dict(zip(reversed(wanted), reversed(function.args.defaults), strict=False))
        found = [self.texts(default[name], function, deep - 1)] if name in default else []
        for call, caller in self.module.calls(function.name):
            given = dict(zip(wanted, call.args, strict=False))
            given |= {word.arg: word.value for word in call.keywords if word.arg}
            if name in given:
                found.append(self.texts(given[name], caller, deep - 1))
        return _union(found)

    def _attribute(self, name: str, deep: int) -> list[str]:
        self._open.add(name)
        found = [
            self.texts(value, function, deep - 1)
            for function, _ in self.module.functions
            for value in _assigned(function, f"self.{name}")
        ]
        self._open.remove(name)
        return [text for text in _union(found) if text]

    def _returned(self, name: str, deep: int) -> list[str]:
        return _union(
            self.texts(node.value, function, deep - 1)
            for function in self.module.named(name)
            for node in ast.walk(function)
            if isinstance(node, ast.Return) and node.value is not None
        )


def modules() -> list[Module]:
    return [Module(path) for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]


def loaded(everything: list[Module], roots: tuple[str, ...]) -> set[str]:
    """Return the paths of all modules that those whose path begins with a root import."""
    by_path = {module.path: module for module in everything}
    found: set[str] = set()
    todo = [path for path in by_path if path.startswith(roots)]
    while todo:
        path = todo.pop()
        if path in by_path and path not in found:
            found.add(path)
            todo += by_path[path].imports()
    return found


def sites(samples: Mapping[str, Samples]) -> list[Site]:
    """Return every error that the source builds; ``samples`` by the end of a module's path."""
    everything = modules()
    kinds = _family(everything)
    found = []
    for module in everything:
        known = {**samples.get("", {}), **samples.get(module.path, {})}
        reader = Reader(module, known)
        for function, owner in module.functions:
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and (kind := _kind(node, function, owner, kinds)):
                    said = tuple(_findings(reader, node, function, kind))
                    found.append(Site(module.path, function.name, node.lineno, kind, said))
    return found


def _family(everything: list[Module]) -> dict[str, str]:
    """Return every class of errors by name: "device", "settings" or "plain"."""
    bases = {name: each for module in everything for name, each in module.classes.items()}
    kinds = {"DeviceError": "device", "SettingsError": "settings", "HilcellError": "plain"}
    for _ in range(DEEP):
        for name, parents in bases.items():
            for parent in parents:
                if parent in kinds:
                    kinds.setdefault(name, kinds[parent])
    # These are told by their own words only, which their super().__init__ builds.
    return {name: kind for name, kind in kinds.items() if name not in ("Aborted", "ConnectFailed")}


def _kind(node: ast.Call, function: Function, owner: str, kinds: dict[str, str]) -> str:
    if isinstance(node.func, ast.Name):
        name = node.func.id
        if name in kinds:
            return kinds[name]
        chosen = [ast.unparse(value) for value in _assigned(function, name)]
        return "device" if any(known in each for each in chosen for known in kinds) else ""
    super_call = ast.unparse(node.func) == "super().__init__" and function.name == "__init__"
    return "device" if super_call and owner in ("Aborted",) else ""


def _findings(reader: Reader, node: ast.Call, function: Function, kind: str) -> Iterator[Finding]:
    if kind == "plain":
        for text in reader.texts(node.args[0], function):
            yield from findings_of(text)
    elif kind == "settings":
        source = reader.texts(node.args[0], function)
        for name in source:
            yield from findings_of(f"{name}: 1 problem\n  {HOLE}")
    else:
        parts = [reader.texts(each, function) for each in node.args[:3]]
        for device, operation, found in product(*parts):
            if found:
                assert device in DEVICES, f"{reader.module.path}:{node.lineno}: device {device!r}"
                yield from findings_of(
                    "", {"device": device, "operation": operation, "found": found}
                )


def _assigned(tree: ast.AST, name: str) -> Iterator[ast.expr]:
    """Yield what is assigned to ``name`` (or ``self.name``) in a tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.NamedExpr | ast.AnnAssign):
            if node.value is not None and ast.unparse(node.target) == name:
                yield node.value
        elif isinstance(node, ast.Assign):
            for target in node.targets:
                yield from _matched(target, node.value, name)


def _matched(target: ast.expr, value: ast.expr, name: str) -> Iterator[ast.expr]:
    if isinstance(target, ast.Tuple) and isinstance(value, ast.IfExp):
        yield from _matched(target, value.body, name)
        yield from _matched(target, value.orelse, name)
    elif isinstance(target, ast.Tuple):
        values = value.elts if isinstance(value, ast.Tuple) else [value] * len(target.elts)
        for each, part in zip(target.elts, values, strict=True):
            yield from _matched(each, part, name)
    elif ast.unparse(target) == name:
        yield value


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def _last(node: ast.expr) -> str:
    """Return the name that is called: of ``self.f`` it is ``f``."""
    return ast.unparse(node).rpartition(".")[2]


def _union(found: Iterator[list[str]] | list[list[str]]) -> list[str]:
    return sorted({text for each in found for text in each})[:MOST]
