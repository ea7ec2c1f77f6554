"""The kit as pytest's plug-in, in a folder that is no project's."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from hilcell.conformance.kit import promises_of

# Nothing is kept, and plug-ins that these tests do not need are not loaded: half of the time.
ALONE = ("-p", "no:cacheprovider", "-p", "no:hypothesispytest", "-p", "no:randomly")


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


def test_unknown_words_are_refused(tmp_path: Path) -> None:
    done = pytest_of(tmp_path, "--hilcell-driver=arms:kuka-c3")
    assert done.returncode != 0
    assert "rails|robots|trackers:NAME is wanted, found arms:kuka-c3" in done.stdout + done.stderr
    done = pytest_of(tmp_path, "--hilcell-driver=robots:kuka-c4", "-k", "identity-same")
    assert done.returncode == 1
    assert "'kuka-c4' is not installed" in done.stdout


def test_nothing_happens_without_the_option(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text("def test_own(): pass")
    done = pytest_of(tmp_path)
    assert done.returncode == 0
    assert "1 passed" in done.stdout
