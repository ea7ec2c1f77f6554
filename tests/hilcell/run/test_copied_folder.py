"""A run's folder that was copied while its engine lives: the engine is the original's alone."""

from __future__ import annotations

import shutil
from contextlib import closing
from pathlib import Path

from hilcell.journal.runs import live_engine
from hilcell.run.control import Control, EngineClient
from tests.hilcell.run.test_control import Recorder


def test_a_copied_folder_has_no_engine(tmp_path: Path) -> None:
    """To resume it, or to stop it, would move the original's machine."""
    run, copy, moved = tmp_path / "run", tmp_path / "copy", tmp_path / "moved"
    run.mkdir()
    with closing(Control(run, Recorder())):
        shutil.copytree(run, copy)
        assert live_engine(run) is not None
        assert live_engine(copy) is None
        assert EngineClient.of_run(copy) is None
        run.rename(moved)
        assert live_engine(moved) is not None
