"""A run on desk devices, unattended: `tests.hilcell.run.bed`."""

from pathlib import Path

import pytest

from tests.hilcell.run.bed import Bed


@pytest.fixture
def bed(tmp_path: Path) -> Bed:
    return Bed(tmp_path)
