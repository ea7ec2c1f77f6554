"""The folder of runs: what is a run there, and what is not."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from hilcell.errors import HilcellError
from hilcell.index import read_index
from hilcell.runs import JOURNAL, find_run, run_folders
from tests.hilcell.test_index import written


def test_entries_that_lead_nowhere_are_no_runs(tmp_path: Path) -> None:
    runs = tmp_path
    for name in ("1", "2"):
        written(runs / name)
    rows = read_index(runs)
    (runs / "loop").symlink_to("loop")
    (runs / "broken").symlink_to("nowhere")
    (runs / "endless").symlink_to("x" * 300)
    (runs / "3").mkdir()
    (runs / "3" / JOURNAL).symlink_to(JOURNAL)
    assert read_index(runs) == rows
    assert len(run_folders(runs)) == 2
    assert find_run(runs, "last").name in ("1", "2")
    for name in ("loop", str(runs / "loop")):
        with pytest.raises(HilcellError, match="is not in"):
            find_run(runs, name)


LOCKED = """
import json, os, sys
from pathlib import Path
from hilcell.index import read_index
from hilcell.run import control, log  # nothing more can be loaded once rights are given away
from hilcell.runs import find_run, read_log
from hilcell.tui.opening import run_to_open
run_to_open(Path("."), "")
os.getuid() or os.setuid(65534)  # root may look everywhere
runs = Path(sys.argv[1])
print(json.dumps([[row.name, row.state, row.reason] for row in read_index(runs)]))
print(find_run(runs, "last").name)
try:
    read_log(find_run(runs, str(runs / "2")))
except Exception as error:
    print(f"{type(error).__name__}: {error}")
print(run_to_open(runs, ""))
try:
    control.send_command(runs / "2", "pause")
except Exception as error:
    print(f"{type(error).__name__}: {error}")
"""


def test_a_run_that_must_not_be_looked_into_is_listed_with_its_reason() -> None:
    with tempfile.TemporaryDirectory() as name:
        runs = Path(name)
        runs.chmod(0o755)  # for other users
        written(runs / "1")
        locked = written(runs / "2")
        locked.chmod(0)
        done = subprocess.run(
            [sys.executable, "-c", LOCKED, runs], capture_output=True, text=True, check=False
        )
        locked.chmod(0o755)
        listed, last, told, live, refused = done.stdout.splitlines()
        why = f"journal {locked / JOURNAL}: cannot be read: Permission denied"
        assert [row[:2] for row in json.loads(listed)] == [["1", "finished"], ["2", "unreadable"]]
        assert json.loads(listed)[1][2] == why
        assert last == "1"
        assert told == f"StorageError: {why}"
        assert live == "None"
        found = "whether its engine is running cannot be told: Permission denied"
        assert refused == f"HilcellError: run 2: {found}"
