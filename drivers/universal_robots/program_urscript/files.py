"""URScript programs on disk: one file ``NAME.script``."""

from __future__ import annotations

from pathlib import Path

from drivers.program_text import source_text
from drivers.universal_robots.program_urscript.program import Program
from drivers.universal_robots.program_urscript.reader import read_program


def load_program(path: Path) -> Program:
    """Read a program; raises `SettingsError`."""
    return read_program(path.name, source_text(path, "URScript"))
