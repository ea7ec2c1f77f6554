"""The campaigns of unknown halls can fail: a motion beyond its announcement, a hall that is not
ready, and a trap that no step names are said.
"""

from __future__ import annotations

import math
import subprocess
from typing import Any

import pytest

from campaigns import traps, unknown
from tests.whole.announced import Bound, announced, unannounced
from tests.whole.halls import Calibrated, Commissioned
from tests.whole.trapped import TRAPPED

SAID = """step 4 of 11, rail: signs first
it moves, in sequence:
  the robot to its safe pose (A1 1.0, A2 -90.0 deg), unless it stands there
  the slide by 0.5, 5 and 20 mm, and back, at 0.5 to 5 mm/s; each is stopped (needs 630 mm free)
  the slide to its reference, where the homing method has one (needs a rail)
where no speed is given: the slide at 250 mm/s, the robot at 10 %
is the cell clear?
step 5 of 11, robot: each axis
it moves, in sequence:
  the robot to its safe pose (A1 1.0, A2 -90.0 deg), unless it stands there
  each axis alone by 1 deg at 1 %, then all axes by at most 15 deg (needs a robot)
where no speed is given: the slide at 250 mm/s, the robot at 10 %
step 6 of 11, tracker: the beam
step 7 of 11, stations: by the strip
it moves, in sequence:
  the robot to its safe pose (A1 1.0, A2 -90.0 deg), unless it stands there
  the slide to every station (S1 -681 mm of the strip), the robot parked (needs nests)
where no speed is given: the slide at 250 mm/s, the robot at 10 %
"""
LIMITS = {"slide": (0.0, 3000.0)} | {
    name: value
    for n in range(1, 7)
    for name, value in ((f"axis {n}", (-90.0, 90.0)), (f"axis {n} speed", (0.0, 100.0)))
}
MINUTE = {"rail": "01", "robot": "02", "tracker": "03", "stations": "04"}


def at(step: str, second: float) -> str:
    return f"2026-01-01T00:{MINUTE.get(step, '59')}:{second:06.3f}+00:00"


def journal(step: str) -> list[dict[str, Any]]:
    jog = {"action": "rail.jog", "distance_mm": 0.5}
    jogged = {"what": "slide jogged", "key": "0.5 mm", "distance_mm": 0.5}
    jogs = [{"t": at(step, 1.0)} | jog, {"t": at(step, 2.0)} | jogged] if step == "rail" else []
    return [{"t": at(step, 0.0)}, *jogs, {"t": at(step, 30.0)}]


JOURNALS = {f"20260101-0000-commission-{step}-abcd": journal(step) for step in MINUTE}


def stroke(unit: str, far: Any, fastest: Any, began: str) -> dict[str, Any]:
    zero = [0.0] * 6 if isinstance(far, list) else 0.0
    values = {f"begin_{unit}": zero, f"low_{unit}": zero, f"high_{unit}": far}
    return values | {f"fastest_{unit}_s": fastest, "began": began}


def slide(far_mm: float, fastest_mm_s: float, step: str, second: float = 10.0) -> dict[str, Any]:
    strokes = [stroke("mm", far_mm, fastest_mm_s, at(step, second))]
    return {"slide": {"strokes": strokes}, "axes": {"strokes": []}}


def axis_2(far_deg: float, fastest_deg_s: float, step: str) -> dict[str, Any]:
    far, fastest = ([0.0, value, 0.0, 0.0, 0.0, 0.0] for value in (far_deg, fastest_deg_s))
    strokes = [stroke("deg", far, fastest, at(step, 10.0))]
    return {"slide": {"strokes": []}, "axes": {"strokes": strokes}}


def test_an_announcement_is_read() -> None:
    assert announced(SAID) == {
        "rail": (Bound(20.0, 5.0), Bound()),
        "robot": (Bound(), Bound(15.0, 10.0)),
        "tracker": (Bound(), Bound()),
        "stations": (Bound(math.inf, 250.0), Bound(math.inf, 10.0)),
    }


@pytest.mark.parametrize(
    ("travel", "wanted"),
    [
        (slide(20.0, 5.0, "rail"), ""),
        (slide(27.0, 5.0, "rail"), ""),  # 1.2 times, and 3 mm
        (slide(27.1, 5.0, "rail"), "rail: slide moved by 27.100, announced 20"),
        (slide(20.0, 6.1, "rail"), "rail: slide moved at 6.100, at most 6.000"),
        (slide(3.6, 90.0, "rail", 1.5), ""),  # the shortest jog, while no unit is proved
        (slide(0.4, 266.0, "stations"), "stations: slide moved at 266.000, at most 265.000"),
        (slide(3.7, 5.0, "rail", 1.5), "rail: jog 0.5 mm moved 3.700 mm of +0.5 mm"),
        (slide(math.nan, 5.0, "rail"), "rail: slide moved by nan"),
        (slide(0.4, 1.0, "tracker"), "tracker: slide moved by 0.400, announced 0"),
        (slide(0.4, 1.0, "robot"), "robot: slide moved by 0.400, announced 0"),
        (slide(2999.0, 250.0, "stations"), ""),
        (slide(3001.0, 250.0, "stations"), "stations: slide at 0.000 .. 3001.000, limits 0 .. 3"),
        (slide(0.4, 1.0, "between"), "without a run: slide moved by 0.400"),
        (axis_2(15.0, 10.0, "robot"), ""),
        (axis_2(15.1, 10.0, "robot"), "robot: axis 2 moved by 15.100, announced 15"),
        (axis_2(15.0, 10.7, "robot"), "robot: axis 2 moved at 10.700, at most 10.600"),
        (axis_2(0.1, 1.0, "rail"), "rail: axis 2 moved by 0.100, announced 0"),
        (axis_2(91.0, 10.0, "stations"), "stations: axis 2 at 0.000 .. 91.000, limits -90 .. 90"),
    ],
)
def test_a_motion_beyond_its_announcement_is_said(travel: dict[str, Any], wanted: str) -> None:
    said = unannounced(SAID, JOURNALS, travel, LIMITS)
    assert any(each.startswith(wanted) for each in said) if wanted else said == []


def commissioned(*problems: str, code: int = 0) -> Commissioned:
    done = subprocess.CompletedProcess([], code, "", "step 4 of 11, rail: signs\nopposite")
    return Commissioned(done, 20, 15.0, 5.0, [*problems])


@pytest.mark.parametrize(
    ("hall", "cell", "ready"),
    [
        (commissioned(), Calibrated(0.03, 0.1, []), True),
        (commissioned("rail: slide moved"), Calibrated(0.03, 0.1, []), False),
        (commissioned(), Calibrated(math.nan, math.nan, ["run 1: OUT OF TOLERANCE"]), False),
        (commissioned(code=1), None, False),
    ],
)
def test_a_hall_that_is_not_ready_is_said(
    hall: Commissioned, cell: Calibrated | None, ready: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    assert unknown.report([unknown.Case(7, hall, cell)]) == ready
    said = capsys.readouterr().out
    assert f"as announced: {int(ready)} of 1" in said
    assert said.count("seed 7: ") == (not ready)


def test_no_hall_is_no_success() -> None:
    assert not unknown.report([])
    assert not traps.report([])


def test_a_trap_that_is_not_named_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    cases = [
        traps.Case(TRAPPED[0], commissioned(), []),
        traps.Case(TRAPPED[1], commissioned(), ["x"]),
    ]
    assert traps.report(cases[:1])
    assert not traps.report(cases)
    assert f"{TRAPPED[1].trap}: x" in capsys.readouterr().out
