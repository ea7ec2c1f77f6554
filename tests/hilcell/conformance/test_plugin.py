"""The kit as pytest's plug-in, in a folder that is no project's."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import hilcell
from hilcell.conformance.port_tests import chosen
from hilcell.conformance.promises import promises_of

CELLS = Path(hilcell.__file__).with_name("cells")
C3 = "robots:kuka-c3"


@pytest.mark.process
def test_a_promise_is_a_test_beside_those_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text("def test_own(): assert False")
    words = "test_own.py", f"--hilcell-driver={C3}", "-k", "own or identity or not-connected"
    plain = "-p", "no:cacheprovider", "-p", "no:hypothesispytest", "-p", "no:randomly"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *plain, *words],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stdout
    assert "1 failed, 4 passed" in done.stdout
    assert f"{len(promises_of('robot')) - 4} deselected" in done.stdout


@pytest.mark.parametrize(
    ("driver", "cell", "sets", "named"),
    [
        ("arms:kuka-c3", "paper", [], "arms:kuka-c3"),
        ("robots:nope", "paper", [], "kuka-c3, kuka-eki, "),
        (C3, "nope", [], "fixed, hard, lab,"),
        (C3, "paper", ["robot.speed_percent"], "robot.speed_percent"),
        (C3, "paper", ["robot.options.nope=3"], "nope"),
        (C3, "paper", ["tracker.driver=nope"], "leica-emscon, leica-geocom,"),
        (C3, "paper", ["robot.driver=kuka-eki"], "robot.driver"),
    ],
)
def test_each_unknown_word_is_refused(driver: str, cell: str, sets: list[str], named: str) -> None:
    with pytest.raises(pytest.UsageError, match=re.escape(named)):
        chosen(driver, cell, sets)


def test_a_real_cell_is_no_place_for_the_plug_in(tmp_path: Path) -> None:
    cell = tmp_path / "shop.toml"
    cell.write_text((CELLS / "paper.toml").read_text("utf-8").split("[simulation]")[0])
    with pytest.raises(pytest.UsageError, match="real"):
        chosen(C3, str(cell), [])
