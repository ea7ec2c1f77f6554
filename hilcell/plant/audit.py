"""Exported records: signed with the plant's private key, verified with its public key alone.

Keys are Ed25519 in PEM files: `openssl genpkey -algorithm ed25519 -out plant.key` creates a key,
`openssl pkey -in plant.key -pubout -out plant.pub` its public key.

The manifest lists every file of a record with its size and SHA-256. ``manifest.sig`` is the
signature (64 bytes) of ``manifest.json``, which openssl verifies as well. The signature is verified
before the manifest is read; then each file must exist, be a regular file and match its digest, and
there must be no other files. No database is needed.
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
_CORRUPT = (
    zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError, UnicodeError
)  # fmt: skip


class BadKey(HilcellError):
    """A key that cannot be used."""

    code = "HC-J23"

    def __init__(self, path: Path, why: str, act: str) -> None:
        super().__init__(f"key {clean(str(path))}: {why}; {act}")


class NotVerified(HilcellError):
    """A record without a valid manifest that the key has signed."""

    code = "HC-J24"


# -- keys -----------------------------------------------------------------------------------------


def read_private_key(path: Path, ask: Callable[[], bytes | None]) -> Ed25519PrivateKey:
    """Return the key of a file; raises `BadKey`.

    ``ask`` returns the passphrase of an encrypted key, or None without a terminal.
    """
    create = "`openssl genpkey -algorithm ed25519 -out FILE` creates one"
    content = _content(path, create)
    if b"PUBLIC KEY" in content:
        raise BadKey(path, "expected a private key, got a public key", create)
    others = stat.S_IRWXG | stat.S_IRWXO
    if os.name == "posix" and (mode := stat.S_IMODE(path.stat().st_mode)) & others:
        raise BadKey(path, f"other users may read it (mode {mode:04o})", "`chmod 600` that file")
    try:
        key: object = load_pem_private_key(content, None)
    except TypeError:
        key = _decrypted(path, content, ask())
    except _WRONG:
        raise BadKey(path, "expected a private key in PEM", create) from None
    if not isinstance(key, Ed25519PrivateKey):
        raise BadKey(path, "expected an Ed25519 key", create)
    return key


def read_public_key(path: Path) -> Ed25519PublicKey:
    """Return the key of a file; raises `BadKey`."""
    publish = "`openssl pkey -in KEYFILE -pubout -out FILE` writes it"
    content = _content(path, publish)
    if b"PRIVATE KEY" in content:
        raise BadKey(path, "expected a public key, got a private key", publish)
    try:
        key = load_pem_public_key(content)
    except _WRONG:
        raise BadKey(path, "expected a public key in PEM", publish) from None
    if not isinstance(key, Ed25519PublicKey):
        raise BadKey(path, "expected an Ed25519 key", publish)
    return key


def fingerprint(key: Ed25519PublicKey) -> str:
    """Return the SHA-256 of a key's 32 bytes."""
    return f"SHA256:{hashlib.sha256(key.public_bytes_raw()).hexdigest()}"


def _decrypted(path: Path, content: bytes, passphrase: bytes | None) -> object:
    if passphrase is None:
        raise BadKey(path, "it is encrypted", "export in a terminal, which asks for the passphrase")
    try:
        return load_pem_private_key(content, passphrase)
    except (*_WRONG, TypeError):  # TypeError: an empty passphrase
        raise BadKey(path, "wrong passphrase", "repeat the command") from None


def _content(path: Path, act: str) -> bytes:
    most_bytes = 65536
    try:
        with path.open("rb") as file:
            content = file.read(most_bytes + 1)
    except OSError as error:
        raise BadKey(path, f"it cannot be read: {error.strerror}", act) from None
    if len(content) > most_bytes:
        raise BadKey(path, f"expected at most {most_bytes} bytes", act)
    return content


# -- manifests ------------------------------------------------------------------------------------

FORM = 3  # of a manifest
MANIFEST, SIGNATURE = "manifest.json", "manifest.sig"
RECORD = "run.json"


class FileEntry(msgspec.Struct, frozen=True):
    """A signed file."""

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
    """The files of a record: their sizes by name, None for other than regular files."""

    name: str
    sizes: dict[str, int | None]
    open: Callable[[str], AbstractContextManager[IO[bytes]]]

    @classmethod
    @contextmanager
    def opened(cls, place: Path) -> Iterator[Self]:
        name = clean(str(place))
        with ExitStack() as stack:
            with _as_not_verified(name):
                kind = place.stat().st_mode
                if stat.S_ISDIR(kind):
                    record = cls(
                        name, cls._in_folder(place), lambda file: (place / file).open("rb")
                    )
                elif stat.S_ISREG(kind):
                    archive = stack.enter_context(zipfile.ZipFile(place))
                    record = cls(name, cls._in_archive(archive), archive.open)
                else:  # a device may never end
                    raise NotVerified(f"{name}: expected a folder or a file")
            yield record

    @staticmethod
    def _in_folder(place: Path) -> dict[str, int | None]:
        """Return the sizes of a folder's files; links are not followed."""
        sizes: dict[str, int | None] = {}

        def refuse(error: OSError) -> None:
            raise error

        for folder, folders, files in os.walk(place, onerror=refuse):
            for path in (Path(folder, name) for name in [*folders, *files]):
                status = path.lstat()
                if not stat.S_ISDIR(status.st_mode):
                    size = status.st_size if stat.S_ISREG(status.st_mode) else None
                    sizes[path.relative_to(place).as_posix()] = size
        return sizes

    @staticmethod
    def _in_archive(archive: zipfile.ZipFile) -> dict[str, int | None]:
        """Return the sizes of its files, None for duplicates and for LZMA (errors of its own)."""
        methods = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)
        sizes: dict[str, int | None] = {}
        for each in archive.infolist():
            if not each.is_dir():
                plain = each.filename not in sizes and each.compress_type in methods
                sizes[each.filename] = each.file_size if plain else None
        return sizes

    def manifest(self, key: Ed25519PublicKey) -> Manifest:
        """Return the manifest that the key has signed; raises `NotVerified`."""
        content = self._read(MANIFEST, 2**28)  # bytes of a million files
        signature = self._read(SIGNATURE, 64)
        try:
            key.verify(signature, content)
        except InvalidSignature:
            raise NotVerified(
                f"{self.name}: {MANIFEST} was changed, or signed by another key than "
                f"{fingerprint(key)}; nothing in this record is verified"
            ) from None
        try:
            form = decoded(content, _Head).form
            if form != FORM:
                raise NotVerified(
                    f"{self.name}: {MANIFEST}: expected form {FORM}, got {form}; verify it with "
                    "the version of hilcell that exported it"
                )
            manifest = decoded(content, Manifest)
        except (msgspec.DecodeError, RecursionError) as error:
            raise NotVerified(f"{self.name}: invalid {MANIFEST}: {error}") from None
        if manifest.key != fingerprint(key):
            raise NotVerified(f"{self.name}: {MANIFEST} names a key that did not sign it")
        outside = [name for name in manifest.files if not is_inside(name)]
        if outside:
            raise NotVerified(
                f"{self.name}: {MANIFEST} names {len(outside)} files outside the record, the first "
                f"{clean(outside[0])!r}; none was read"
            )
        return manifest

    def _read(self, name: str, most: int) -> bytes:
        size = self.sizes.get(name)
        if size is None:
            why = "is no regular file" if name in self.sizes else "is missing"
            raise NotVerified(f"{self.name}: {name} {why}; nothing in this record is verified")
        if size > most:
            raise NotVerified(f"{self.name}: {name}: expected at most {most} bytes, got {size}")
        with _as_not_verified(f"{self.name}: {name}"), self.open(name) as file:
            return file.read(most)

    def difference(self, name: str, entry: FileEntry) -> str:
        """Return how a file differs from the signed one, or ""."""
        if name not in self.sizes:
            return "is missing"
        size = self.sizes[name]
        if size is None:
            return "is no regular file"
        if size != entry.bytes:
            return f"differs: expected {entry.bytes} bytes, got {size}"
        digest = hashlib.sha256()
        try:
            with self.open(name) as file:
                while chunk := file.read(2**20):
                    digest.update(chunk)
        except (OSError, *_CORRUPT) as error:
            return f"cannot be read: {clean(str(error))}"
        return "" if digest.hexdigest() == entry.sha256 else "differs: another SHA-256"


def verify(place: Path, key: Ed25519PublicKey) -> tuple[Manifest, dict[str, str]]:
    """Return the manifest, and the problem of each changed, missing or extra file.

    Raises `NotVerified` where the manifest is not signed by the key, or nothing can be read.
    """
    with _Record.opened(place) as record:
        manifest = record.manifest(key)
        extra = record.sizes.keys() - manifest.files - {MANIFEST, SIGNATURE}
        problems = dict.fromkeys(extra, "is not in the manifest") | {
            name: difference
            for name, entry in manifest.files.items()
            if (difference := record.difference(name, entry))
        }
    return manifest, dict(sorted(problems.items()))


def is_inside(name: str) -> bool:
    """Whether a file's name is a path within the record, on any system."""
    parts = name.split("/")
    plain = not any(each in name for each in ("\\", ":", "\0"))
    return plain and PurePosixPath(name).parts == tuple(parts) and ".." not in parts


@contextmanager
def _as_not_verified(what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise NotVerified(f"{what}: cannot be read: {error.strerror or error}") from None
    except _CORRUPT as error:
        raise NotVerified(
            f"{what}: expected an exported folder or archive: {clean(str(error))}"
        ) from None
