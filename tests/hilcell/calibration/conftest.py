"""What several tests of a calibration begin with."""

from __future__ import annotations

import pytest

from hilcell.journal.journal import read_journal
from hilcell.journal.log import Log
from hilcell.journal.runs import JOURNAL
from tests.whole.golden import GoldenRuns


@pytest.fixture
def log(golden: GoldenRuns) -> Log:
    """The log of a small run of all stages, which the test may change."""
    return Log(read_journal(golden["small"].folder / JOURNAL))
