"""Export of one cell's record: files with a signed manifest, written completely or not at all."""

from __future__ import annotations

import hashlib
import re
import secrets
import shutil
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import Connection, Table, select

from hilcell import __version__
from hilcell.atomic_files import NotWritten, as_not_written
from hilcell.cell.settings import did_you_mean
from hilcell.errors import HilcellError
from hilcell.plant.archive import CHANGED, read_rows, run_rows
from hilcell.plant.audit import FORM, MANIFEST, RECORD, SIGNATURE, FileEntry, Manifest, fingerprint
from hilcell.plant.database import PlantError
from hilcell.plant.record import rows_digest
from hilcell.plant.tables import DECISION, DOCUMENT, PARTS, POINT, RUN, Row
from hilcell.sanitize import clean

Add = Callable[[str, bytes], object]


def export(
    connection: Connection,
    cell: str,
    serial: str | None,
    place: Path,
    key: Ed25519PrivateKey,
    archive: Path | None = None,
) -> Manifest:
    """Write the record of a cell to a folder, or to a .zip file if ``place`` ends so.

    ``serial`` is required if several cells have that name; points of old runs are read from the
    folder ``archive``. Raises `NotWritten`, `PlantError`, and
    `HilcellError` for an unknown cell.
    """
    source = _Source(connection, archive)
    serials = source.serials(cell, serial)
    files: dict[str, FileEntry] = {}
    runs = simulated = 0
    changed: list[str] = []
    with _atomic_output(place) as put:

        def add(name: str, content: bytes) -> None:
            files[name] = FileEntry(len(content), hashlib.sha256(content).hexdigest())
            put(name, content)

        query = select(RUN).where(RUN.c.cell == cell, RUN.c.serial.in_(serials))
        for run in read_rows(connection, query.order_by(RUN.c.ended, RUN.c.revision), cell):
            folder = f"runs/{_safe(run['name'])}-{run['revision']}-{run['digest'].hex[:12]}"
            rows = source.add_run(run, folder, add)
            if rows_digest(rows) != run["digest"]:
                changed.append(run["name"])
            runs, simulated = runs + 1, simulated + run["simulated"]
        if changed:
            raise PlantError(_changed_text(changed))
        own = (DECISION.c.cell == cell, DECISION.c.serial.in_(serials))
        decisions = read_rows(connection, select(DECISION).where(*own).order_by(DECISION.c.n), cell)
        if decisions:
            add("decisions.json", _json([dict(each) for each in decisions]))
        manifest = Manifest(
            form=FORM, cell=cell, serials=serials, runs=runs, simulated_runs=simulated,
            made=datetime.now(UTC).isoformat(timespec="seconds"),
            software=f"hilcell {__version__}", key=fingerprint(key.public_key()), files=files,
        )  # fmt: skip
        content = _json(manifest)
        put(MANIFEST, content)
        put(SIGNATURE, key.sign(content))
    return manifest


@dataclass(frozen=True, eq=False)
class _Source:
    connection: Connection
    archive: Path | None

    def serials(self, cell: str, serial: str | None) -> list[str]:
        query = select(RUN.c.cell, RUN.c.serial).distinct().order_by(RUN.c.cell, RUN.c.serial)
        known = self.connection.execute(query).all()
        serials = [row.serial for row in known if row.cell == cell]
        selected = [each for each in serials if serial in (None, each)]
        if len(selected) == 1:
            return selected
        if serials:
            raise HilcellError(
                f"cell {clean(cell)}: expected --serial with one of "
                f"{', '.join(map(clean, serials))}, got {clean(serial or 'none')}"
            )
        names = sorted({row.cell for row in known})
        raise HilcellError(f"unknown cell {cell[:80]!r}{did_you_mean(cell, names)}")

    def add_run(self, run: Row, folder: str, add: Add) -> dict[Table, list[Row]]:
        """Add the files of one revision of a run; return its rows."""
        tables = run_rows(self.connection, run, self.archive)
        add(f"{folder}/{RECORD}", _json(dict(run)))
        for table in PARTS:
            rows = tables[table]
            if table is DOCUMENT:
                for row in rows:
                    add(f"{folder}/documents/{_safe(row['name'])}", self._document(run, row))
            elif rows:
                parts = [
                    {name: each for name, each in row.items() if name != "digest"} for row in rows
                ]
                add(f"{folder}/{table.name}s.json", _json(parts))
        points = sum(not row["superseded"] for row in tables[POINT])
        if points != run["points"]:
            raise PlantError(
                f"run {clean(run['name'])}: expected {run['points']} points, got {points}: "
                f"{CHANGED}"
            )
        return tables

    @staticmethod
    def _document(run: Row, row: Row) -> bytes:
        content: bytes = row["text"].encode()
        if hashlib.sha256(content).hexdigest() != row["sha256"]:
            raise PlantError(
                f"run {clean(run['name'])}: its {clean(row['name'])} differs from the shipped one: "
                f"{CHANGED}"
            )
        return content


def _changed_text(names: list[str]) -> str:
    most_named = 3  # runs, in a message
    more = f" and {len(names) - most_named} more" if len(names) > most_named else ""
    named = ", ".join(map(clean, names[:most_named])) + more
    are = "1 run is" if len(names) == 1 else f"{len(names)} runs are"
    return f"{are} not as shipped: {named}: {CHANGED}"


def _json(values: object) -> bytes:
    return msgspec.json.format(msgspec.json.encode(values), indent=1) + b"\n"


def _safe(name: str) -> str:
    """Return a valid file name for any system: ``name`` comes from another PC."""
    longest = 60
    return re.sub(r"[^A-Za-z0-9._-]", "_", name)[:longest].strip(".") or "_"


@contextmanager
def _atomic_output(place: Path) -> Iterator[Add]:
    """Yield a function that adds a file; all files appear together, or none."""
    if place.is_symlink() or place.exists():
        raise NotWritten(f"{clean(str(place))} already exists; expected a new folder or file")
    others = (".tar", ".gz", ".tgz", ".bz2", ".xz", ".7z", ".rar")
    if place.suffix.lower() in others:
        raise NotWritten(f"expected a folder or a .zip file, got {clean(str(place))}")
    part = place.with_name(f".{secrets.token_hex(8)}.part")
    try:
        with as_not_written(place):
            if place.suffix.lower() == ".zip":
                with zipfile.ZipFile(part, "x", zipfile.ZIP_DEFLATED) as archive:
                    yield archive.writestr
            else:
                part.mkdir()
                yield partial(_write, part)
            part.rename(place)
    finally:
        shutil.rmtree(part, ignore_errors=True)
        with suppress(OSError):
            part.unlink()


def _write(folder: Path, name: str, content: bytes) -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("xb") as file:
        file.write(content)
