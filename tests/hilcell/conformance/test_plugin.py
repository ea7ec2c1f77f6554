"""The kit as pytest's plug-in, in a folder that is no project's."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import hilcell
from hilcell.conformance.kit import promises_of
from hilcell.conformance.pytest_options import chosen

CELLS = Path(hilcell.__file__).with_name("cells")

# Nothing is kept, and plug-ins that these tests do not need are not loaded: half of the time.
ALONE = ("-p", "no:cacheprovider", "-p", "no:hypothesispytest", "-p", "no:randomly")


C3 = "robots:kuka-c3"


def pytest_of(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *ALONE, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_a_promise_is_a_test(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text("def test_own(): assert False")
    done = pytest_of(tmp_path, "--hilcell-driver=robots:kuka-c3", "-k", "identity or not-connected")
    assert done.returncode == 0, done.stdout
    assert "4 passed" in done.stdout
    assert f"{len(promises_of('robot')) - 4} deselected" in done.stdout


def test_beside_tests_of_ones_own(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text("def test_own(): assert False")
    done = pytest_of(
        tmp_path, "test_own.py", "--hilcell-driver=robots:kuka-c3", "-k", "own or identity-same"
    )
    assert done.returncode == 1
    assert "1 failed, 1 passed" in done.stdout


def test_unknown_words_are_one_usage_error_of_pytest(tmp_path: Path) -> None:
    done = pytest_of(tmp_path, "--hilcell-driver=robots:nope")
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert done.stdout == ""
    assert done.stderr.count("ERROR: ") == 1
    assert "'nope' is not installed; installed: kuka-c3, kuka-eki, " in done.stderr
    assert "name one of robots that is installed" in done.stderr


@pytest.mark.parametrize(
    ("driver", "cell", "sets", "wanted"),
    [
        ("arms:kuka-c3", "paper", [], "rails|robots|trackers:NAME is wanted, found arms:kuka-c3"),
        (C3, "nope", [], "built in: fixed, hard, lab,"),
        (C3, "nope", [], "name a simulated cell to which kuka-c3 belongs"),
        (C3, "paper", ["robot.speed_percent"], "KEY=VALUE is wanted, found robot.speed_percent"),
        (C3, "paper", ["robot.options.nope=3"], "nope: unknown key; known here: base, host,"),
        (C3, "paper", ["tracker.driver=nope"], "installed: leica-emscon, leica-geocom,"),
        (C3, "paper", ["robot.driver=kuka-eki"], "leave one of them out"),
    ],
)
def test_each_unknown_word_is_refused(driver: str, cell: str, sets: list[str], wanted: str) -> None:
    with pytest.raises(pytest.UsageError, match=re.escape(wanted)):
        chosen(driver, cell, sets)


def test_a_real_cell_is_no_place_for_the_plug_in(tmp_path: Path) -> None:
    cell = tmp_path / "shop.toml"
    cell.write_text((CELLS / "paper.toml").read_text("utf-8").split("[simulation]")[0])
    with pytest.raises(pytest.UsageError, match="cell paper is real: nothing simulates its dev"):
        chosen(C3, str(cell), [])


def test_nothing_happens_without_the_option(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text("def test_own(): pass")
    done = pytest_of(tmp_path)
    assert done.returncode == 0
    assert "1 passed" in done.stdout
