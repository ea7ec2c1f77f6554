"""A format of robot programs that is no format is refused in words."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.cell.settings import SettingsError
from hilcell.compensation import programs


def test_a_format_that_reads_no_program_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "load_entry", lambda _group, _name: lambda _path: ["P1"])
    with pytest.raises(SettingsError, match=r"format 'src': expected a .*\.Program, got list"):
        programs.load_program(Path("part.src"))
