"""``files``: programs and settings for the controllers of devices, as their drivers have them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec

from hilcell import __version__
from hilcell.atomic_files import NotWritten, as_not_written, write_together
from hilcell.cell.devices import GROUPS, installed, load_entry
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError, did_you_mean
from hilcell.commands.console import print_answer, print_data, print_json, print_message
from hilcell.commands.signatures import Files
from hilcell.ports import ControllerSide, HilcellError, NeedsFiles
from hilcell.sanitize import counted

PAGE = "README.md"


def files(args: Files) -> int:
    if not args.driver:
        return _list(args)
    if not args.output:
        raise SettingsError("files", ["expected a folder: -o FOLDER"])
    side = _controller_side(args.driver, args.cell)
    folder = Path(args.output)
    contents = {folder / each.name: each.contents for each in side.files}
    contents[folder / PAGE] = page(side, args.driver, args.cell).encode()
    with as_not_written(folder):
        folder.mkdir(parents=True, exist_ok=True)
        there = [path for path in contents if path.exists()]
        changed = [path.name for path in there if path.read_bytes() != contents[path]]
    if changed and not args.force:
        found = f"{folder}: changed by somebody, or of another version: {', '.join(changed)}"
        raise NotWritten(f"{found}; --force replaces them, or name another folder")
    write_together(contents)
    facts = {
        "driver": args.driver,
        "version": side.version,
        "files": sorted(map(str, contents)),
        "lacks": [*side.lacks],
    }
    files = f"{counted(len(side.files), 'file')} of {side.version}"
    text = f"{folder}: {files}; the steps are in {folder / PAGE}"
    for each in side.lacks:
        text += f"\nto be filled in: {each} (or write the files with --cell)"
    print_answer(facts, text, as_json=args.json)
    return 0


def page(side: ControllerSide, driver: str, cell: str) -> str:
    """Return the page for the person at the controller, in Markdown."""
    origin = f"Files of hilcell {__version__} for driver `{driver}`"
    origin += f" and cell `{cell}`" if cell else ""
    rows = [f"| `{each.name}` | {_folder(each.folder)} |" for each in side.files]
    steps = [f"{number}. {step}" for number, step in enumerate(side.steps, start=1)]
    return "\n".join(
        [
            f"# {side.title}",
            "",
            f"{origin}. Version: {side.version}.",
            "",
            "| file | copy to |",
            "|---|---|",
            *rows,
            "",
            *steps,
            "",
            "hilcell is not a safety function: keep the E-stop within reach.",
            "",
        ]
    )


def _folder(name: str) -> str:
    return f"`{name}`" if name else "nowhere: to read only"


def _list(args: Files) -> int:
    if args.output or args.cell:
        raise SettingsError("files", [f"expected a driver: {', '.join(dict(_sides()))}"])
    rows = {
        name: {"title": side.title, "version": side.version, "files": [f.name for f in side.files]}
        for name, side in _sides()
    }
    if args.json:
        print_json(rows)
    else:
        for name, row in rows.items():
            print_data(f"{name}: {row['title']} ({row['version']}): {', '.join(row['files'])}")
        print_message("`hilcell files DRIVER -o FOLDER` writes them, with the steps")
    return 0


def _sides() -> Iterator[tuple[str, ControllerSide]]:
    """Yield the installed drivers with files; others are not reported."""
    for group in GROUPS.values():
        for name in installed(group):
            kind = load_entry(group, name)
            if isinstance(kind, NeedsFiles):
                yield name, kind.controller_side({})


def _controller_side(driver: str, where: str) -> ControllerSide:
    """Return a driver's files for the options of a cell; raises `SettingsError`."""
    tables = {name: table for table, group in GROUPS.items() for name in installed(group)}
    if driver not in tables:
        hint = did_you_mean(driver, list(tables)) or f"; installed: {', '.join(sorted(tables))}"
        raise SettingsError("files", [f"{driver!r} is not installed{hint}"])
    table = tables[driver]
    kind = load_entry(GROUPS[table], driver)
    if not isinstance(kind, NeedsFiles):
        raise HilcellError(f"driver {driver} needs no files on its device's controller")
    if not where:
        return kind.controller_side({})
    shared = getattr(load_cell(where, {}), table)
    if shared.driver != driver:
        raise SettingsError(where, [f"{table}.driver: expected {driver!r}, got {shared.driver!r}"])
    return kind.controller_side(msgspec.to_builtins(shared) | shared.options)
