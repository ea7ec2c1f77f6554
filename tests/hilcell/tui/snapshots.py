"""Text snapshots: what the terminal showed once, compared with what it shows now.

They are plain files in ``snapshots/``, one a screen. To write them again after a wanted change:

    HILCELL_SNAPSHOTS=write pytest tests/hilcell/tui/test_snapshots.py

and read the difference before it is committed.
"""

from __future__ import annotations

import difflib
import os
from pathlib import Path

FOLDER = Path(__file__).with_name("snapshots")
SWITCH = "HILCELL_SNAPSHOTS"


def differences(seen: dict[str, str], prefix: str) -> str:
    """Return a unified diff of all screens whose names begin so; nothing where all are alike.

    ``seen`` maps names to texts. A file that no screen stands for any more is a difference, too.
    """
    if os.environ.get(SWITCH) == "write":
        _write(seen, prefix)
    known = {path.stem: path.read_text("utf-8") for path in FOLDER.glob(f"{prefix}*.txt")}
    names = sorted(known.keys() | seen.keys())
    return "\n".join(_diff(name, known.get(name, ""), seen.get(name, "")) for name in names).strip()


def _diff(name: str, known: str, seen: str) -> str:
    lines = difflib.unified_diff(
        known.splitlines(), seen.splitlines(), f"{name} as kept", f"{name} now", lineterm=""
    )
    return "\n".join(lines)


def _write(seen: dict[str, str], prefix: str) -> None:
    FOLDER.mkdir(exist_ok=True)
    for path in FOLDER.glob(f"{prefix}*.txt"):
        if path.stem not in seen:
            path.unlink()
    for name, text in seen.items():
        (FOLDER / f"{name}.txt").write_text(text, "utf-8")
