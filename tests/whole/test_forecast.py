"""A run keeps to the steps of its plan, act by act."""

from __future__ import annotations

from tests.whole.conftest import PaperRun


def test_every_step_measures_as_many_points_as_planned(paper: PaperRun) -> None:
    assert paper.end["state"] == "finished", paper.errors
    steps = next(event for event in paper.events if event["kind"] == "plan")["steps"]
    planned = {
        step["name"]: sum(s["measured"] for s in step["spans"]) if step["spans"] else step["points"]
        for step in steps
    }
    measured = dict.fromkeys(planned, 0)
    name = ""
    for event in paper.events:
        if event["kind"] == "event" and event["what"] == "step":
            name = event["name"]
        swept = event["kind"] == "event" and event["what"] == "stream"
        if swept or (event["kind"] == "point" and not event.get("retaken")):
            measured[name] += 1
    assert measured == planned
    assert sum(planned.values()) > sum(step["points"] for step in steps)  # control points
