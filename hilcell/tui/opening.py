"""Which run to show first: the one asked for, else the one that is live, else none."""

from __future__ import annotations

from pathlib import Path

from hilcell.run.control import live_engine
from hilcell.runs import find_run, run_folders


def run_to_open(runs: Path, name: str) -> Path | None:
    """Return the folder of the run to show; raises `HilcellError` where the name means none.

    Loads, in the caller's thread, everything that reads a journal.
    """
    import hilcell.tui.screens.run
    import hilcell.tui.session  # noqa: F401 - loaded here so that the screen need not wait

    if name:
        return find_run(runs, name)
    with_engine = [folder for folder in run_folders(runs) if (folder / "engine.json").is_file()]
    live = [folder for folder in with_engine if live_engine(folder) is not None]
    return live[-1] if live else None
