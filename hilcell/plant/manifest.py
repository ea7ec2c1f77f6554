"""The manifest of an exported record: every file by its size and SHA-256, and a signature over it.

``manifest.sig`` holds the 64 bytes of an Ed25519 signature of ``manifest.json`` as it lies there,
so openssl verifies it as well.
"""

from __future__ import annotations

from pathlib import PurePosixPath

import msgspec

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


def sound(name: str) -> bool:
    """Whether a file's name leads to a place within the record, on any system."""
    parts = name.split("/")
    plain = not any(each in name for each in ("\\", ":", "\0"))
    return plain and PurePosixPath(name).parts == tuple(parts) and ".." not in parts
