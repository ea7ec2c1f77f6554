"""Files appear whole or not at all: written beside their place, then renamed."""

from __future__ import annotations

import os
from pathlib import Path

from hilcell.settings import SettingsError


def write_whole(path: Path, content: bytes) -> None:
    """Write ``content``; raises `SettingsError`, and leaves what was there, where that fails."""
    beside = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        beside.write_bytes(content)
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise SettingsError(str(path), [f"cannot be written: {error}"]) from error
