"""A real browser without a screen: what the page looks like, on screen and on paper."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--hide-scrollbars", "--no-pdf-header-footer",
)  # fmt: skip
LIMIT_S = 60.0


def found() -> str:
    """Return the browser of this machine; empty where there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), "")


def browser() -> str:
    """Return the browser; a report that nobody has looked at in one is not tested."""
    return found() or pytest.skip(
        f"no browser found ({', '.join(NAMES)}): install chromium, "
        "on Debian and Ubuntu `apt-get install chromium`"
    )


def browse(page: Path, *words: str) -> None:
    """Open a page, do what ``words`` say, and end with every process that was started."""
    profile = page.with_name("profile")
    command = [browser(), *QUIET, f"--user-data-dir={profile}", *words, page.as_uri()]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    try:
        output, _ = process.communicate(timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        output, _ = process.communicate()
        raise AssertionError(f"the browser did not end within {LIMIT_S} s:\n{output}") from None
    assert process.returncode == 0, output
