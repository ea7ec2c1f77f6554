"""What the kit says about a device on which a promise cannot be judged."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hilcell.conformance.acts import TrackerActs
from hilcell.conformance.verdicts import Broken
from hilcell.conformance.wire_faults import stop_at_once


def test_a_measurement_that_takes_no_time_cannot_be_stopped() -> None:
    acts = SimpleNamespace(
        visit=lambda *_: None, travel=lambda _: None, lasting=TrackerActs.lasting
    )
    bench: Any = SimpleNamespace(present=lambda: None, connected=object, acts=acts)
    wanted = r"a measurement of 30 readings ended after 0\.\d\d s; wanted more than 0\.7 s"
    with pytest.raises(Broken, match=wanted):
        stop_at_once(bench)
