"""What every test of lines to engines has: short patience, and an eye on what is left open."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from hilcell.run import client
from hilcell.tui.engine import feed as feeds

PERIOD_S = 0.02
ANSWER_S = 0.2  # instead of the seconds that an operator has
LIMIT_S = 10.0


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for silent engines as long as a test may."""
    monkeypatch.setattr(client, "ANSWER_S", ANSWER_S)
    monkeypatch.setattr(feeds, "REOPEN_S", 0.5)


@pytest.fixture(autouse=True)
def nothing_left_open() -> Iterator[None]:
    """Let what was leaked be found: what is left open, and what only a collection would close."""
    before = open_sockets()
    yield
    assert open_sockets() <= before
    gc.collect()


def open_sockets() -> set[str]:
    found = set()
    for file in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # the one that lists them
            found.add(str(file.readlink()))
    return {target for target in found if target.startswith("socket:")}
