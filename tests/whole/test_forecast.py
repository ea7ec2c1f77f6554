"""What a plan says of its steps is what a run then does, act by act."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.whole.bench import SMALL, end_of, events, hilcell, sets

SHORT = SMALL | {"survey.to_mm": "600.0", "survey.step_mm": "200.0", "survey.repeats": "6"}


@pytest.mark.timeout(240)
def test_every_step_measures_what_its_spans_say(tmp_path: Path) -> None:
    words = ("run", "paper", "--json", "--unattended", "--runs", tmp_path)
    done = hilcell(*words, *sets(SHORT), limit_s=170)
    assert end_of(done)["state"] == "finished", done.stderr
    told = events(done.stdout)
    steps = next(event for event in told if event["kind"] == "plan")["steps"]
    planned = {
        step["name"]: sum(s["measured"] for s in step["spans"]) if step["spans"] else step["points"]
        for step in steps
    }
    measured = dict.fromkeys(planned, 0)
    name = ""
    for event in told:
        if event["kind"] == "event" and event["what"] == "step":
            name = event["name"]
        elif event["kind"] == "point" and not event.get("retaken"):
            measured[name] += 1
    assert measured == planned
    assert sum(planned.values()) > sum(step["points"] for step in steps)  # control points
