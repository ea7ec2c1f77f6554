"""The plant's own key, by which it signs what it hands out: Ed25519, in PEM files as openssl makes.

`openssl genpkey -algorithm ed25519 -out plant.key` makes one, and `openssl pkey -in plant.key
-pubout -out plant.pub` the public key that proves its signatures.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Callable
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    load_pem_private_key,
    load_pem_public_key,
)

from hilcell.clean import clean
from hilcell.errors import HilcellError

MOST_BYTES = 65536
_WRONG = (ValueError, UnsupportedAlgorithm)


class BadKey(HilcellError):
    """A key that cannot be used."""

    code = "HC-J23"


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
