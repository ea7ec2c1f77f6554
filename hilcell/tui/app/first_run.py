"""Which run to show first: the one asked for, else the one that is live, else none."""

from __future__ import annotations

import importlib
from pathlib import Path

from hilcell.journal.engine_file import live_engine
from hilcell.journal.runs import find_run, run_folders

LATER = (
    "hilcell.tui.engine.session",
    "hilcell.tui.text.plot",
    "hilcell.tui.text.series",
    "hilcell.journal.index",
    *(
        f"hilcell.tui.screens.{name}"
        for name in ("run", "pages", "log", "plots", "history", "start", "report", "compare")
    ),
)


def run_to_open(runs: Path, name: str) -> Path | None:
    """Return the folder of the run to show; raises `HilcellError` where the name means none.

    Loads, in the caller's thread, everything that reads a journal.
    """
    for module in LATER:
        importlib.import_module(module)
    if name:
        return find_run(runs, name)
    live = [folder for folder in run_folders(runs) if live_engine(folder) is not None]
    return live[-1] if live else None
