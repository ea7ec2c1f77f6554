"""What a run says on a plain terminal while it waits."""

from typing import Any

import pytest

from hilcell.commands.run_output import ProgressOutput
from hilcell.journal.journal import Record

HINT = "hilcell resume goes on, ctrl-C stops"
PROMPT = {"title": "Seat the reflector in P1", "text": "Take it and seat it."}


@pytest.mark.parametrize(
    ("to", "facts", "words"),
    [
        ("paused", {}, "paused: " + HINT),
        ("paused", {"reason": "the screen was lost"}, "paused: the screen was lost; " + HINT),
        (
            "suspended",
            {"reason": "P1 is to be measured", "prompt": PROMPT},
            "suspended: Seat the reflector in P1. Take it and seat it. When it is done, " + HINT,
        ),
    ],
)
def test_a_run_that_waits_says_for_what(
    to: str, facts: dict[str, Any], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    output = ProgressOutput("r", 3)
    body = {"machine": "run", "from": "running", "to": to} | facts
    output.take(Record(1, "2026-01-01T00:00:00+00:00", "state", "", body))
    assert " ".join(capsys.readouterr().err.split()) == words


def test_the_bar_counts_each_point_once_and_never_beyond_its_total(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with ProgressOutput("r", 2) as output:
        output.skip_measured(["base/1"])
        for key in ("grid/1", "grid/1", "grid/2"):
            body = {"group": "grid", "station": "S1"}
            output.take(Record(1, "2026-01-01T00:00:00+00:00", "point", key, body))
    assert "3/3" in capsys.readouterr().err
