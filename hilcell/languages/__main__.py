"""Keep the catalogues: ``python -m hilcell.languages`` lists what is missing, outdated or unused.

With ``--write`` the files get every key of the code, in its order, new ones without a translation.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import NamedTuple, get_args

from babel.messages.pofile import normalize, read_po
from jinja2 import Environment, nodes

from hilcell.alarms.catalogue import entries_of
from hilcell.alarms.catalogue import packages as packages_of_alarms
from hilcell.cell.devices import load_entry
from hilcell.journal.labels import procedure_label, step_label
from hilcell.language import packages
from hilcell.model.records import RunState

# Which arguments of a call are shown; of `marked`, every text in what it is given.
ARGUMENTS = {"tr": (0,), "marked": (0,), "Action": (2, 3), "Kind": (0, 1, 2)}
COLUMNS = {"Column": (0,)}  # of the screen
HEADER = 'msgid ""\nmsgstr ""\n"Content-Type: text/plain; charset=utf-8\\n"\n"Language: {}\\n"\n'
ALIKE = 0.7  # of an outdated key and the one in its place


def keys_of(package: str) -> list[str]:
    """Return the English texts of a package of catalogues, as ``drivers.languages``, each once."""
    root = package.partition(".")[0]
    folder = Path(str(import_module(root).__file__)).parent
    found = [key for file in sorted(folder.rglob("*.py")) for key in _texts_in(file)]
    found += [key for file in sorted(folder.rglob("*.j2")) for key in _texts_of_page(file)]
    for each in packages_of_alarms():
        if each.partition(".")[0] == root:
            for entry in sorted(entries_of(each), key=lambda entry: entry.code):
                found += [entry.title, entry.means, *entry.do]
    for point in entry_points(group="hilcell.procedures"):
        if point.module.partition(".")[0] == root:
            procedure = load_entry("procedures", point.name)
            found += [procedure_label(point.name), procedure.summary]
            found += [
                step_label(step.name, has_rail=rail)
                for step in procedure.steps
                for rail in (True, False)
            ]
    found += get_args(RunState) if root == "hilcell" else ()
    return [*dict.fromkeys(found)]


def _texts_in(file: Path) -> Iterator[str]:
    """Yield the keys of a module, in the order of its lines."""
    arguments = ARGUMENTS | (COLUMNS if "tui" in file.parts else {})
    calls = [
        node for node in ast.walk(ast.parse(file.read_text("utf-8"))) if isinstance(node, ast.Call)
    ]
    for call in sorted(calls, key=lambda node: (node.lineno, node.col_offset)):
        name = call.func.value if isinstance(call.func, ast.Subscript) else call.func
        if isinstance(name, ast.Name):
            for n in arguments.get(name.id, ()):
                yield from _constants(call.args[n])


def _texts_of_page(file: Path) -> Iterator[str]:
    """Yield the keys of a template."""
    for call in Environment(autoescape=True).parse(file.read_text("utf-8")).find_all(nodes.Call):
        if isinstance(call.node, nodes.Name) and call.node.name == "tr":
            yield from (each.value for each in call.args if isinstance(each, nodes.Const))


def _constants(node: ast.AST) -> Iterator[str]:
    """Yield the texts of an expression: of a dictionary those of its values."""
    if isinstance(node, ast.Constant):
        if isinstance(node.value, str) and any(map(str.isalpha, node.value)):
            yield node.value
    elif isinstance(node, ast.Dict):
        for value in node.values:
            yield from _constants(value)
    else:
        for child in ast.iter_child_nodes(node):
            yield from _constants(child)


class Catalogue(NamedTuple):
    """The texts of a package in one language, and what its file lacks or has too much."""

    file: Path
    texts: Mapping[str, str]
    keys: list[str]

    @classmethod
    def of(cls, package: str, language: str) -> Catalogue:
        file = Path(str(import_module(package).__file__)).with_name(f"{language}.po")
        texts: dict[str, str] = {}
        if file.is_file():
            with file.open("rb") as content:
                entries = read_po(content, language, abort_invalid=True)
            texts = {str(each.id): str(each.string) for each in entries if each.id}
        return cls(file, texts, keys_of(package))

    @property
    def missing(self) -> list[str]:
        return [key for key in self.keys if not self.texts.get(key)]

    @property
    def unused(self) -> list[str]:
        return [key for key in self.texts if key not in self.keys]

    def outdated(self, key: str) -> str:
        """Return the key that was probably the missing one's before its English was edited."""
        return next(iter(get_close_matches(key, self.unused, 1, ALIKE)), "")

    def content(self, language: str) -> str:
        """Return the file with every key of the code, and none besides."""
        entries = (
            f"\nmsgid {normalize(key, width=100)}\n"
            f"msgstr {normalize(self.texts.get(key, ''), width=100)}\n"
            for key in self.keys
        )
        return HEADER.format(language) + "".join(entries)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m hilcell.languages", description=__doc__)
    parser.add_argument("language", nargs="?", default="de", help="code of the language")
    parser.add_argument("--write", action="store_true", help="write the catalogues")
    args = parser.parse_args()
    lacks = 0
    for package in packages():
        catalogue = Catalogue.of(package, args.language)
        for key in catalogue.missing:
            before = catalogue.outdated(key)
            word = f"outdated: {before!r}, now" if before else "missing:"
            print(f"{catalogue.file}: {word} {key!r}")
        for key in catalogue.unused:
            print(f"{catalogue.file}: unused: {key!r}")
        lacks += len(catalogue.missing) + len(catalogue.unused)
        if args.write:
            catalogue.file.write_text(catalogue.content(args.language), "utf-8")
    return 1 if lacks else 0


if __name__ == "__main__":
    sys.exit(main())
