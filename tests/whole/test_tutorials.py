"""The scripts of docs/tutorials run, and print what they say."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

TUTORIALS = Path(__file__).parents[2] / "docs/tutorials"


def printed(name: str) -> str:
    done = subprocess.run(
        [sys.executable, TUTORIALS / name], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def numbers(pattern: str, text: str) -> list[float]:
    found = re.search(pattern, text)
    assert found is not None, text
    return [float(each) for each in found.groups()]


def test_every_tutorial_is_tested() -> None:
    text = Path(__file__).read_text("utf-8")
    assert [each.name for each in TUTORIALS.glob("*.py") if f'"{each.name}"' not in text] == []


@pytest.mark.process
def test_a_robot_is_identified_and_its_poses_corrected() -> None:
    text = printed("identify_a_robot.py")
    (nominal,) = numbers(r"\n  nominal +([\d.]+)", text)
    (mdh,) = numbers(r"\n  mdh +([\d.]+)", text)
    assert nominal > 0.4
    assert mdh < 0.05
    assert re.search(r"\nchosen: (mdh|elastic|tool|gp)\n", text)
    bound, inside = numbers(r"95 % bound: ([\d.]+) mm in the mean, (\d+)% of 200 inside", text)
    assert bound < 0.1
    assert inside >= 92
    (a2,) = numbers(r"a2 +270\.000 -> +([\d.]+) mm", text)
    assert a2 == pytest.approx(270.73, abs=0.05)
    sent, corrected = numbers(r"poses: ([\d.]+) mm as sent, ([\d.]+) corrected", text)
    assert sent > 0.4
    assert corrected < 0.03
    assert numbers(r"(\d+)% of 100 inside", text)[0] >= 95


@pytest.mark.process
def test_a_run_is_opened_and_shown_as_tables() -> None:
    text = printed("look_into_a_run.py")
    assert text.startswith("run tutorial: calibrate of cell paper, finished\n282 points: ")
    assert len(re.findall(r"^  \S+ +accepted ", text, re.MULTILINE)) == 13
    sent, corrected = numbers(r"S1100: ([\d.]+) mm as sent, ([\d.]+) mm corrected", text)
    assert sent > 5 * corrected
    assert "tables: run, points, frames, results, before and after\n" in text
    count, mean = numbers(r"validate_chosen S1100 +(\d+) +([\d.]+)", text)
    assert (count, round(mean, 2)) == (8, corrected)
    assert "95 % bounds of the corrected targets: median 0.1" in text


@pytest.mark.process
def test_a_driver_measures_fails_and_stops() -> None:
    text = re.sub(r"127\.0\.0\.1:\d+", "ADDRESS", printed("write_a_driver.py"))
    assert text.splitlines() == [
        "connected: LINES, serial 4711",
        "measured: [1000.02  199.99   50.01] mm, 1 sigma [0.005 0.006 0.006] mm",
        (
            "HC-T11: NoReading: Tracker: measure: reflector 19.98 mm from its expected place, "
            "expected <= 5.0 mm; seat the reflector, then resume"
        ),
        "HC-T02: DeviceError: Tracker: measure: ADDRESS: no answer within 1 s",
        "Stopped: a stop was asked for",
    ]
