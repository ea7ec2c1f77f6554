"""The campaign of kills can fail: journals that are wrong, of which it says what is."""

from __future__ import annotations

import math
from typing import Any

import pytest

from campaigns.kills import Case, Killed, problems, report


def point(key: str, x_mm: float = 0.0) -> dict[str, Any]:
    return {"kind": "point", "key": key, "id": {"kind": "grid"}, "xyz_mm": [x_mm, 0.0, 0.0]}


def move(key: str) -> dict[str, Any]:
    return {"kind": "intent", "key": key, "action": "robot.move"}


def end(mean_mm: float, state: str = "finished") -> dict[str, Any]:
    figures = {"before": {"mean": 1.0}, "idw": {"mean": 0.2}, "chosen": {"mean": mean_mm}}
    return {"kind": "end", "state": state, "result": {"validation": {"S1100": figures}}}


WHOLE = [point("a"), point("b"), end(0.1)]


@pytest.mark.parametrize(
    ("acknowledged", "journal", "wanted"),
    [
        (["a", "b"], [point("a"), point("b"), end(0.1)], ""),
        (["a", "b"], [point("a"), end(0.1)], "b was acknowledged, and is lost"),
        (["a"], [point("a"), end(0.1)], "b is in one of both runs"),
        (["a"], [point("a"), point("a"), point("b"), end(0.1)], "a stands 2 times"),
        (["a"], [point("a"), {"kind": "event", "invalid": ["a"]}, *WHOLE], ""),
        (["a"], [point("a"), {"kind": "event", "invalid": ["b"]}, *WHOLE], "a stands 2 times"),
        (["a"], [point("a"), point("a") | {"retaken": True}, point("b"), end(0.1)], ""),
        (["a"], [point("a"), point("b", 0.3), end(0.1)], "a point lies 0.300 mm off"),
        (["a"], [move("a"), move("a"), *WHOLE], ""),
        (["a"], [*[move("a")] * 3, *WHOLE], "2 points were measured again by 1 kills"),
        (["a"], [point("a", math.nan), point("b"), end(0.1)], "a point lies nan mm off"),
        (["a"], [point("a"), point("b"), end(0.2)], "S1100.chosen is 0.2, uninterrupted 0.1"),
        (["a"], [point("a"), point("b"), end(math.nan)], "S1100.chosen is nan"),
        (["a"], [point("a"), point("b"), end(0.1, "faulted")], "the run did not finish"),
    ],
)
def test_what_a_kill_must_not_do_is_said(
    monkeypatch: pytest.MonkeyPatch,
    acknowledged: list[str],
    journal: list[dict[str, Any]],
    wanted: str,
) -> None:
    monkeypatch.setattr("campaigns.kills.judge", lambda events: [])
    said = problems(Killed(1, acknowledged, journal), WHOLE)
    assert any(text.startswith(wanted) for text in said) if wanted else said == []
    assert report({"at random": [Case("seed 1", 1, 2, said)]}) == (not wanted)
