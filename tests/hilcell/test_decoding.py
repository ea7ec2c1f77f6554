"""Types first used by several threads at once."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DIRECT = re.compile(r"msgspec\.convert\(|Decoder\(|decode\([^\n]*type=(?!dict\[str, (Any|str)\])")
AT_ONCE = """
import os, sys, threading
from hilcell.cell.file import Cell, with_rail
from hilcell.cell.source import parsed, read_source
from hilcell.decoding import typed

values = with_rail(parsed(read_source("paper"), "paper"))

def at_once():
    sys.setswitchinterval(1e-6)
    begin = threading.Barrier(3)

    def use():
        begin.wait()
        cells.append(typed(values, Cell))

    cells, users = [], [threading.Thread(target=use) for _ in range(3)]
    for each in users:
        each.start()
    for each in users:
        each.join()
    return cells == [typed(values, Cell)] * 3

for _ in range(60):  # each as fresh as this process, which itself uses no type
    pid = os.fork()
    if not pid:
        os._exit(not at_once())
    if os.waitpid(pid, 0)[1]:
        sys.exit(1)
"""


@pytest.mark.process
def test_threads_may_use_a_type_for_the_first_time_at_once() -> None:
    """With msgspec alone some of them died: sixty in a row do not live by chance."""
    assert subprocess.run([sys.executable, "-c", AT_ONCE], check=False).returncode == 0


def test_nothing_else_has_msgspec_learn_a_type() -> None:
    rooms = ("hilcell", "drivers", "procedures", "fakes")
    files = {file for room in rooms for file in (ROOT / room).rglob("*.py")}
    files.remove(ROOT / "hilcell" / "decoding.py")
    found = [str(file) for file in files if DIRECT.search(file.read_text("utf-8"))]
    assert found == [str(ROOT / "hilcell" / "journal" / "log.py")]  # which learns it first
