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
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path, PurePosixPath
from typing import IO, NamedTuple, Self

import msgspec
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, load_pem_public_key

from hilcell.decoding import decoded
from hilcell.errors import HilcellError
from hilcell.sanitize import clean

_WRONG = (ValueError, UnsupportedAlgorithm)
_SPOILED = (
    zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError, UnicodeError
)  # fmt: skip


class BadKey(HilcellError):
    """A key that cannot be used."""

    code = "HC-J23"

    def __init__(self, path: Path, why: str, act: str) -> None:
        super().__init__(f"key {clean(str(path))}: {why}; {act}")


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
        raise BadKey(path, "it is a public key, expected the private one", f"name that one; {make}")
    others = stat.S_IRWXG | stat.S_IRWXO
    if os.name == "posix" and (mode := stat.S_IMODE(path.stat().st_mode)) & others:
        raise BadKey(
            path, f"others than its owner may use it (mode {mode:04o})", "`chmod 600` that file"
        )
    try:
        key: object = load_pem_private_key(content, None)
    except TypeError:
        key = _decrypted(path, content, ask())
    except _WRONG:
        raise BadKey(path, "it is no private key in PEM", make) from None
    if not isinstance(key, Ed25519PrivateKey):
        raise BadKey(path, "it is another kind of key, expected Ed25519", make)
    return key


def read_public_key(path: Path) -> Ed25519PublicKey:
    """Return the key of a file; raises `BadKey`."""
    publish = "`openssl pkey -in KEYFILE -pubout -out FILE` makes it"
    content = _content(path, publish)
    if b"PRIVATE KEY" in content:
        raise BadKey(path, "it is a private key, expected the public one", publish)
    try:
        key = load_pem_public_key(content)
    except _WRONG:
        raise BadKey(path, "it is no public key in PEM", publish) from None
    if not isinstance(key, Ed25519PublicKey):
        raise BadKey(path, "it is another kind of key, expected Ed25519", publish)
    return key


def fingerprint(key: Ed25519PublicKey) -> str:
    """Return the SHA-256 of a key's 32 bytes, by which people tell keys apart."""
    return f"SHA256:{hashlib.sha256(key.public_bytes_raw()).hexdigest()}"


def _decrypted(path: Path, content: bytes, passphrase: bytes | None) -> object:
    if passphrase is None:
        raise BadKey(path, "it is encrypted", "export in a terminal, which asks for its passphrase")
    try:
        return load_pem_private_key(content, passphrase)
    except (*_WRONG, TypeError):  # the last of an empty one
        raise BadKey(path, "its passphrase is another", "repeat the command") from None


def _content(path: Path, act: str) -> bytes:
    most_bytes = 65536
    try:
        with path.open("rb") as file:
            content = file.read(most_bytes + 1)
    except OSError as error:
        raise BadKey(path, f"it cannot be read: {error.strerror}", act) from None
    if len(content) > most_bytes:
        raise BadKey(path, "it is too long to be a key", act)
    return content


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


class _Head(msgspec.Struct):
    form: int


class _Record(NamedTuple):
    """The files of a record: their sizes by name, None where there is no plain file."""

    name: str
    sizes: dict[str, int | None]
    open: Callable[[str], AbstractContextManager[IO[bytes]]]

    @classmethod
    @contextmanager
    def opened(cls, place: Path) -> Iterator[Self]:
        name = clean(str(place))
        with ExitStack() as stack:
            with _as_not_proven(name):
                kind = place.stat().st_mode
                if stat.S_ISDIR(kind):
                    record = cls(
                        name, cls._in_folder(place), lambda file: (place / file).open("rb")
                    )
                elif stat.S_ISREG(kind):
                    archive = stack.enter_context(zipfile.ZipFile(place))
                    record = cls(name, cls._in_archive(archive), archive.open)
                else:  # a device may never end
                    raise NotProven(f"{name}: it is neither a folder nor a file")
            yield record

    @staticmethod
    def _in_folder(place: Path) -> dict[str, int | None]:
        """Return the sizes of a folder's files; links are not followed."""
        sizes: dict[str, int | None] = {}

        def refuse(error: OSError) -> None:
            raise error

        for folder, folders, files in os.walk(place, onerror=refuse):
            for path in (Path(folder, name) for name in [*folders, *files]):
                there = path.lstat()
                if not stat.S_ISDIR(there.st_mode):
                    size = there.st_size if stat.S_ISREG(there.st_mode) else None
                    sizes[path.relative_to(place).as_posix()] = size
        return sizes

    @staticmethod
    def _in_archive(archive: zipfile.ZipFile) -> dict[str, int | None]:
        """Return the sizes of its files; one that is in it twice, or packed by LZMA, has None."""
        packed = (
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
            zipfile.ZIP_BZIP2,
        )  # no error of their own
        sizes: dict[str, int | None] = {}
        for each in archive.infolist():
            if not each.is_dir():
                plain = each.filename not in sizes and each.compress_type in packed
                sizes[each.filename] = each.file_size if plain else None
        return sizes

    def manifest(self, key: Ed25519PublicKey) -> Manifest:
        """Return what the key has signed; raises `NotProven`."""
        content = self._read(MANIFEST, 2**28)  # bytes of a million files
        signature = self._read(SIGNATURE, 64)
        try:
            key.verify(signature, content)
        except InvalidSignature:
            raise NotProven(
                f"{self.name}: {MANIFEST} was changed, or signed by another key than "
                f"{fingerprint(key)}; nothing in this record is proven"
            ) from None
        try:
            form = decoded(content, _Head).form
            if form != FORM:
                raise NotProven(
                    f"{self.name}: {MANIFEST} of form {form}, expected {FORM}; verify it with the "
                    "hilcell that exported it"
                )
            manifest = decoded(content, Manifest)
        except (msgspec.DecodeError, RecursionError) as error:
            raise NotProven(f"{self.name}: {MANIFEST} is none that is known: {error}") from None
        if manifest.key != fingerprint(key):
            raise NotProven(f"{self.name}: {MANIFEST} names another key than that which signed it")
        outside = [name for name in manifest.files if not sound(name)]
        if outside:
            raise NotProven(
                f"{self.name}: {MANIFEST} names {len(outside)} files that are not within the "
                f"record, the first {clean(outside[0])!r}; nothing was read there"
            )
        return manifest

    def _read(self, name: str, most: int) -> bytes:
        size = self.sizes.get(name)
        if size is None:
            why = "is no plain file" if name in self.sizes else "is missing"
            raise NotProven(f"{self.name}: {name} {why}; nothing in this record is proven")
        if size > most:
            raise NotProven(f"{self.name}: {name} has {size} bytes, expected at most {most}")
        with _as_not_proven(f"{self.name}: {name}"), self.open(name) as file:
            return file.read(most)

    def difference(self, name: str, entry: FileEntry) -> str:
        """Return how a file differs from what was signed; "" where it does not."""
        if name not in self.sizes:
            return "is missing"
        size = self.sizes[name]
        if size is None:
            return "is no plain file"
        if size != entry.bytes:
            return f"differs: {size} bytes, signed were {entry.bytes}"
        digest = hashlib.sha256()
        try:
            with self.open(name) as file:
                while chunk := file.read(2**20):
                    digest.update(chunk)
        except (OSError, *_SPOILED) as error:
            return f"cannot be read: {clean(str(error))}"
        return "" if digest.hexdigest() == entry.sha256 else "differs: another SHA-256"


def verify(place: Path, key: Ed25519PublicKey) -> tuple[Manifest, dict[str, str]]:
    """Return the manifest, and by name what is wrong with files: changed, missing or extra.

    Raises `NotProven` where the manifest is not signed by the key, or nothing can be read.
    """
    with _Record.opened(place) as source:
        manifest = source.manifest(key)
        extra = source.sizes.keys() - manifest.files - {MANIFEST, SIGNATURE}
        found = dict.fromkeys(extra, "is not in the manifest") | {
            name: what
            for name, entry in manifest.files.items()
            if (what := source.difference(name, entry))
        }
    return manifest, dict(sorted(found.items()))


def sound(name: str) -> bool:
    """Whether a file's name leads to a place within the record, on any system."""
    parts = name.split("/")
    plain = not any(each in name for each in ("\\", ":", "\0"))
    return plain and PurePosixPath(name).parts == tuple(parts) and ".." not in parts


@contextmanager
def _as_not_proven(what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise NotProven(f"{what}: cannot be read: {error.strerror or error}") from None
    except _SPOILED as error:
        raise NotProven(
            f"{what}: it is neither an exported folder nor its archive: {clean(str(error))}"
        ) from None
