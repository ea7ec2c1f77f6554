"""`completion`: a real bash completes commands, options, names and files by it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hilcell.commands.cli import main
from tests.hilcell.commands.finished_runs import MADE, finished

BIN = Path(sys.executable).parent
ASK = """
source ./completion
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"
"$(complete -p hilcell | sed 's/.*-F \\([^ ]*\\).*/\\1/')"
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def completed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    assert main(["completion", "bash"]) == 0
    Path(tmp_path, "completion").write_text(capsys.readouterr().out, "utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["rep"], ["report"]),
        (["run", "axis"], ["axis-sweeps"]),
        (["run", "--cell", "six"], ["six-r"]),
        (["run", "--unatt"], ["--unattended"]),
        (["check", "mi"], ["mine.toml"]),
        (["plan", "ho"], ["holes.csv"]),
        (["show", "la"], ["last"]),
        (["show", "1-m"], ["1-made"]),
        (["runs", "--cell", "pap"], ["paper"]),
        (["runs", "--cell", "six"], []),
        (["explain", "HC-J0"], [f"HC-J0{number}" for number in range(1, 10)]),
    ],
)
def test_bash_completes(completed: Path, words: list[str], wanted: list[str]) -> None:
    Path(completed, "holes.csv").touch()
    Path(completed, "mine.toml").touch()
    finished(completed, "1-made", MADE)
    answer = subprocess.run(
        ["bash", "-c", ASK, "bash", "hilcell", *words],
        cwd=completed, env={"PATH": f"{BIN}:/usr/bin:/bin", "HILCELL_RUNS": str(completed)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert answer.stdout.split() == wanted, answer.stderr


@pytest.mark.parametrize("shell", ["zsh", "fish", "tcsh"])
def test_other_shells_have_theirs(capsys: pytest.CaptureFixture[str], shell: str) -> None:
    assert main(["completion", shell]) == 0
    assert "compensate" in capsys.readouterr().out
