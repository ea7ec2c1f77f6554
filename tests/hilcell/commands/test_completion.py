"""`completion`: a real bash completes commands, options, names and files by it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.hilcell.commands.finished_runs import MADE, finished
from tests.whole.bench import command

BIN = Path(sys.executable).parent
ASK = """
source ./completion
hilcell() {  # nothing is run meanwhile: the table of runs is asked for once
  [ -e "listed $*" ] || command hilcell "$@" > "listed $*"
  cat "listed $*"
}
while read -r line; do
  COMP_WORDS=($line); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMP_LINE="$line"; COMPREPLY=()
  "$(complete -p hilcell | sed 's/.*-F \\([^ ]*\\).*/\\1/')"
  echo "${COMPREPLY[@]}"
done
"""
ANSWERS = {
    "rep": ["report"],
    "run axis": ["axis-sweeps"],
    "run --cell six": ["six-r"],
    "run --unatt": ["--unattended"],
    "check mi": ["mine.toml"],
    "plan ho": ["holes.csv"],
    "show la": ["last"],
    "show 1-m": ["1-made"],
    "runs --cell pap": ["paper"],
    "runs --cell six": [],
    "explain HC-J0": [f"HC-J0{number}" for number in range(1, 10)],
}


@pytest.mark.process
def test_bash_completes(tmp_path: Path) -> None:
    Path(tmp_path, "completion").write_text(command("completion", "bash").stdout, "utf-8")
    Path(tmp_path, "holes.csv").touch()
    Path(tmp_path, "mine.toml").touch()
    finished(tmp_path, "1-made", MADE)
    done = subprocess.run(
        ["bash", "-c", ASK], input="".join(f"hilcell {words}\n" for words in ANSWERS),
        cwd=tmp_path, env={"PATH": f"{BIN}:/usr/bin:/bin", "HILCELL_RUNS": str(tmp_path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert [line.split() for line in done.stdout.splitlines()] == list(ANSWERS.values())


@pytest.mark.parametrize("shell", ["zsh", "fish", "tcsh"])
def test_other_shells_have_theirs(shell: str) -> None:
    assert "compensate" in command("completion", shell).stdout


def test_the_parser_is_as_it_was() -> None:
    assert command("completion", "zsh").returncode == 0
    assert '"calibrate"' in command("run", "calibrat").stderr
