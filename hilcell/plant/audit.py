"""Exported records: signed by the plant's own key, verified with its public key alone.

The key is Ed25519, in PEM files as openssl makes: `openssl genpkey -algorithm ed25519 -out
plant.key` makes one, and `openssl pkey -in plant.key -pubout -out plant.pub` the public key that
proves its signatures.

The manifest has every file of a record by its size and SHA-256. ``manifest.sig`` holds the 64 bytes
of the signature of ``manifest.json`` as it lies there, so openssl verifies it as well. That is
verified before a word of the manifest is believed, and no database is asked. Then each file must be
there, be a plain file and have its digest, and nothing else may be there.
"""

from __future__ import annotations

import hashlib
import os
import stat
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Protocol

import msgspec
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    load_pem_private_key,
    load_pem_public_key,
)

from hilcell.clean import clean
from hilcell.errors import HilcellError
from hilcell.typed import decoded

MOST_BYTES = 65536
_WRONG = (ValueError, UnsupportedAlgorithm)

_SPOILED = (
    zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError, UnicodeError
)  # fmt: skip
DIFFERS, MISSING, EXTRA = "differs", "is missing", "is not in the manifest"


class BadKey(HilcellError):
    """A key that cannot be used."""

    code = "HC-J23"


class NotProven(HilcellError):
    """A record whose manifest was not signed by the key, or is none."""

    code = "HC-J24"


# -- keys -----------------------------------------------------------------------------------------


def read_private_key(path: Path, ask: Callable[[], bytes | None]) -> Ed25519PrivateKey:
    """Return the key of a file; raises `BadKey`.

    ``ask`` returns the passphrase of an encrypted one, or None where nobody can be asked.
    """
    make = "`openssl genpkey -algorithm ed25519 -out FILE` makes one"
    content = _content(path, make)
    if b"PUBLIC KEY" in content:
        raise _bad(path, "it is a public key, wanted the private one", f"name that one; {make}")
    others = stat.S_IRWXG | stat.S_IRWXO
    if os.name == "posix" and (mode := stat.S_IMODE(path.stat().st_mode)) & others:
        raise _bad(
            path, f"others than its owner may use it (mode {mode:04o})", "`chmod 600` that file"
        )
    try:
        key: object = load_pem_private_key(content, None)
    except TypeError:
        key = _decrypted(path, content, ask())
    except _WRONG:
        raise _bad(path, "it is no private key in PEM", make) from None
    if not isinstance(key, Ed25519PrivateKey):
        raise _bad(path, "it is another kind of key, wanted Ed25519", make)
    return key


def read_public_key(path: Path) -> Ed25519PublicKey:
    """Return the key of a file; raises `BadKey`."""
    publish = "`openssl pkey -in KEYFILE -pubout -out FILE` makes it"
    content = _content(path, publish)
    if b"PRIVATE KEY" in content:
        raise _bad(path, "it is a private key, wanted the public one", publish)
    try:
        key = load_pem_public_key(content)
    except _WRONG:
        raise _bad(path, "it is no public key in PEM", publish) from None
    if not isinstance(key, Ed25519PublicKey):
        raise _bad(path, "it is another kind of key, wanted Ed25519", publish)
    return key


def fingerprint(key: Ed25519PublicKey) -> str:
    """Return by what people tell keys apart: the SHA-256 of its 32 bytes."""
    return f"SHA256:{hashlib.sha256(key.public_bytes_raw()).hexdigest()}"


def _decrypted(path: Path, content: bytes, passphrase: bytes | None) -> object:
    if passphrase is None:
        raise _bad(path, "it is encrypted", "export in a terminal, which asks for its passphrase")
    try:
        return load_pem_private_key(content, passphrase)
    except (*_WRONG, TypeError):  # the last of an empty one
        raise _bad(path, "its passphrase is another", "repeat the command") from None


def _content(path: Path, act: str) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise _bad(path, f"it cannot be read: {error.strerror}", act) from None
    if len(content) > MOST_BYTES:
        raise _bad(path, "it is too long to be a key", act)
    return content


def _bad(path: Path, why: str, act: str) -> BadKey:
    return BadKey(f"key {clean(str(path))}: {why}; {act}")


# -- manifests ------------------------------------------------------------------------------------

FORM = 3  # of a manifest
MANIFEST, SIGNATURE = "manifest.json", "manifest.sig"
RECORD = "run.json"


class FileEntry(msgspec.Struct, frozen=True):
    """A file as it was signed."""

    bytes: int
    sha256: str


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The cell, the time (UTC) and the key of an export, and its ``files`` by name."""

    form: int
    cell: str
    serials: list[str]
    runs: int
    simulated_runs: int
    made: str
    software: str
    key: str
    files: dict[str, FileEntry]


class Source(Protocol):
    """The files of a record: their sizes by name, None where there is no plain file."""

    name: str
    sizes: dict[str, int | None]

    def open(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Open a file to read it."""


@dataclass(frozen=True)
class Finding:
    """A file that is not as it was signed."""

    file: str
    what: str


class _Head(msgspec.Struct):
    form: int


def verify(place: Path, key: Ed25519PublicKey) -> tuple[Manifest, list[Finding]]:
    """Return the manifest, and every file that differs, is missing or is extra.

    Raises `NotProven` where the manifest is not signed by the key, or nothing can be read.
    """
    with _opened(place) as source:
        manifest = _manifest(source, key)
        wanted = manifest.files
        found = [
            Finding(name, what)
            for name, entry in wanted.items()
            if (what := _difference(source, name, entry))
        ]
        known = {MANIFEST, SIGNATURE, *wanted}
        found += [Finding(name, EXTRA) for name in source.sizes if name not in known]
    return manifest, sorted(found, key=lambda each: each.file)


def _manifest(source: Source, key: Ed25519PublicKey) -> Manifest:
    content = _read(source, MANIFEST, 2**28)  # bytes of a million files
    signature = _read(source, SIGNATURE, 64)
    try:
        key.verify(signature, content)
    except InvalidSignature:
        raise NotProven(
            f"{source.name}: {MANIFEST} was changed, or signed by another key than "
            f"{fingerprint(key)}; nothing in this record is proven"
        ) from None
    try:
        form = decoded(content, _Head).form
        if form != FORM:
            raise NotProven(
                f"{source.name}: {MANIFEST} of form {form}, expected {FORM}; verify it with the "
                "hilcell that exported it"
            )
        manifest = decoded(content, Manifest)
    except (msgspec.DecodeError, RecursionError) as error:
        raise NotProven(f"{source.name}: {MANIFEST} is none that is known: {error}") from None
    if manifest.key != fingerprint(key):
        raise NotProven(f"{source.name}: {MANIFEST} names another key than that which signed it")
    outside = [name for name in manifest.files if not sound(name)]
    if outside:
        raise NotProven(
            f"{source.name}: {MANIFEST} names {len(outside)} files that are not within the record, "
            f"the first {clean(outside[0])!r}; nothing was read there"
        )
    return manifest


def sound(name: str) -> bool:
    """Whether a file's name leads to a place within the record, on any system."""
    parts = name.split("/")
    plain = not any(each in name for each in ("\\", ":", "\0"))
    return plain and PurePosixPath(name).parts == tuple(parts) and ".." not in parts


def _read(source: Source, name: str, most: int) -> bytes:
    size = source.sizes.get(name)
    if size is None:
        why = "is no plain file" if name in source.sizes else "is missing"
        raise NotProven(f"{source.name}: {name} {why}; nothing in this record is proven")
    if size > most:
        raise NotProven(f"{source.name}: {name} has {size} bytes, wanted at most {most}")
    with _as_not_proven(f"{source.name}: {name}"), source.open(name) as file:
        return file.read(most)


def _difference(source: Source, name: str, entry: FileEntry) -> str:
    """Return how a file differs from what was signed; "" where it does not."""
    if name not in source.sizes:
        return MISSING
    size = source.sizes[name]
    if size is None:
        return "is no plain file"
    if size != entry.bytes:
        return f"{DIFFERS}: {size} bytes, signed were {entry.bytes}"
    digest = hashlib.sha256()
    at_a_time = 2**20
    try:
        with source.open(name) as file:
            while chunk := file.read(at_a_time):
                digest.update(chunk)
    except (OSError, *_SPOILED) as error:
        return f"cannot be read: {clean(str(error))}"
    return "" if digest.hexdigest() == entry.sha256 else f"{DIFFERS}: another SHA-256"


class _Folder:
    """The files of a folder; links are not followed."""

    def __init__(self, place: Path) -> None:
        self.name, self._place = clean(str(place)), place
        self.sizes: dict[str, int | None] = {}
        for folder, folders, files in os.walk(place, onerror=_refuse):
            for name in [*folders, *files]:
                path = Path(folder, name)
                found = path.lstat()
                if not stat.S_ISDIR(found.st_mode):
                    size = found.st_size if stat.S_ISREG(found.st_mode) else None
                    self.sizes[path.relative_to(place).as_posix()] = size

    def open(self, name: str) -> AbstractContextManager[IO[bytes]]:
        return (self._place / name).open("rb")


class _Archive:
    """The files of an archive; one that is in it twice, or packed by LZMA, is no plain file."""

    _PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)  # no error of their own

    def __init__(self, archive: zipfile.ZipFile, name: str) -> None:
        self.name, self._archive = name, archive
        self.sizes: dict[str, int | None] = {}
        for each in archive.infolist():
            if not each.is_dir():
                plain = each.filename not in self.sizes and each.compress_type in self._PACKED
                self.sizes[each.filename] = each.file_size if plain else None

    def open(self, name: str) -> AbstractContextManager[IO[bytes]]:
        return self._archive.open(name)


@contextmanager
def _opened(place: Path) -> Iterator[Source]:
    name = clean(str(place))
    with _as_not_proven(name):
        kind = place.stat().st_mode
        if not (stat.S_ISDIR(kind) or stat.S_ISREG(kind)):  # a device may never end
            raise NotProven(f"{name}: it is neither a folder nor a file")
        files = _Folder(place) if stat.S_ISDIR(kind) else zipfile.ZipFile(place)
    if isinstance(files, _Folder):
        yield files
        return
    with files:
        yield _Archive(files, name)


@contextmanager
def _as_not_proven(what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise NotProven(f"{what}: cannot be read: {error.strerror or error}") from None
    except _SPOILED as error:
        words = f"it is neither an exported folder nor its archive: {clean(str(error))}"
        raise NotProven(f"{what}: {words}") from None


def _refuse(error: OSError) -> None:
    raise error
