"""A rail whose backlash has grown is reported by the survey."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.whole.bench import command, end_of, events, sets, simulation

SHORT = {"survey.step_mm": "500.0", "layout.nest_samples": "1"}


def test_a_backlash_that_has_grown_is_reported(tmp_path: Path) -> None:
    with simulation() as cell:
        assert cell.ask(do="fault", name="rail.backlash", value=0.3)["ok"]
        words: list[str | Path] = ["--unattended", "--runs", tmp_path, "--json"]
        to = sets(SHORT | {"simulation.address": cell.control})
        done = command("run", "rail-survey", *words, *to)
    assert done.returncode == 1, done.stderr
    (verdict,) = [e for e in events(done.stdout) if e.get("key") == "backlash"]
    assert not verdict["holds"]
    found = end_of(done)["result"]["rail_survey"]["backlash_mm"]["value"]
    assert abs(found) == pytest.approx(0.5, abs=0.05)
