"""Runs the tests of a break in a copy of the checkout, which is never touched itself."""

from __future__ import annotations

import compileall
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from py_compile import PycInvalidationMode

from tests.mutants.table import Mutant

LIMIT_S = 600.0
TEST_S = 30
PYTEST = (
    sys.executable, "-m", "pytest", "-q", "--timeout", f"{TEST_S}",
    "-p", "no:randomly", "-p", "no:cacheprovider",
)  # fmt: skip
PASSED, FAILED = 0, 1  # exit codes of pytest; all others mean that the tests did not run
IGNORED = shutil.ignore_patterns(".*", "__pycache__", "runs", "dist")


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a break: ``caught``, or why not, and what pytest printed."""

    name: str
    verdict: str
    took_s: float
    output: str

    @property
    def caught(self) -> bool:
        """Whether a test failed because of the break."""
        return self.verdict == "caught"


class Copy:
    """One copy of the checkout, with one break at a time."""

    def __init__(self, root: Path, folder: Path, *options: str) -> None:
        """``options`` are the checkout's own, for every run of pytest."""
        self._options = options
        self._here, self._scratch = folder / "copy", folder / "t"
        shutil.copytree(root, self._here, ignore=IGNORED)
        # Judged by its content, not by its time: a break made within the same second is compiled.
        mode = PycInvalidationMode.CHECKED_HASH
        compileall.compile_dir(self._here, quiet=2, invalidation_mode=mode)

    def judge(self, mutant: Mutant) -> Verdict:
        """Apply a break, run its tests, and take the break back."""
        path = self._here / mutant.file
        sound = path.read_bytes()
        path.write_text(mutant.applied(self._here), "utf-8")
        began_s = time.monotonic()
        try:
            code, output = self.run(mutant.tests, "-x")
        finally:
            path.write_bytes(sound)
        verdict = {FAILED: "caught", PASSED: "SURVIVED", None: "TIMEOUT"}.get(code, "NOT RUN")
        return Verdict(mutant.name, verdict, time.monotonic() - began_s, output)

    def run(self, tests: Sequence[str], *options: str) -> tuple[int | None, str]:
        """Return pytest's exit code, None after `LIMIT_S`, and what it printed."""
        process = subprocess.Popen(
            [*PYTEST, "--basetemp", self._scratch, *self._options, *options, *tests],
            cwd=self._here,
            # Before the installed checkout, in the tests' own processes as well.
            env=os.environ | {"PYTHONPATH": str(self._here)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            output = process.communicate(timeout=LIMIT_S)[0]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return None, process.communicate()[0]
        return process.returncode, output
