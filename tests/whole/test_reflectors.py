"""Reflectors compared over wires: a test plays the person who carries them."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.run.control import PromptStatus, order
from tests.whole.bench import sets, simulation
from tests.whole.threaded import Event, ThreadedRun, is_state, never

LONG_MM = 0.15  # the prism of the flange's reflector


def asks_or_ends(event: Event) -> bool:
    return is_state(event, "suspended") or event["kind"] == "end"


def asked(run: ThreadedRun) -> PromptStatus:
    """Wait until the reflector is seen where it is asked for."""
    while True:
        prompt = order(run.folder, "status").prompt
        if prompt is not None and prompt.ready:
            return prompt


def compared(folder: Path, procedure: str, values: dict[str, str]) -> tuple[list[str], Event]:
    """Return what a run asks, and its end, where the flange's reflector has a longer prism."""
    offset_mm, titles = 0.0, list[str]()
    with simulation() as cell:
        words = sets({"simulation.address": cell.control} | values)
        with ThreadedRun(folder, "run", procedure, *words, stands=never) as run:
            while run.until(asks_or_ends)["kind"] != "end":
                titles.append(asked(run).title)
                wanted_mm = LONG_MM if " of flange " in titles[-1] else 0.0
                if wanted_mm != offset_mm:
                    change_mm, offset_mm = wanted_mm - offset_mm, wanted_mm
                    cell.strike("tracker.wrong_offset", change_mm)
                order(run.folder, "answer")
            return titles, run.events[-1]


@pytest.mark.parametrize(
    ("procedure", "values"), [("reflectors", {"layout.nest_samples": "2"}), ("tracker-check", {})]
)
def test_a_prism_that_is_longer_on_the_flange_is_named(
    tmp_path: Path, procedure: str, values: dict[str, str]
) -> None:
    titles, end = compared(tmp_path, procedure, values)
    assert len(titles) == 3 + 2 + 1 + 1  # floor, bars, flange, and all put back
    assert (end["state"], end["exit"]) == ("finished", 1), end
    wrong = [row for row in end["result"]["reflectors"] if not row["holds"]]
    assert [row["place"] for row in wrong] == ["flange"]
    assert wrong[0]["along_mm"] == pytest.approx(LONG_MM, abs=0.03)
    assert LONG_MM > 3 * wrong[0]["U_mm"] > 0.0
