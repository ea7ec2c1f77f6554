"""Reflectors are compared by somebody who carries them: on a simulated cell without wires."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from fakes.in_process import InProcessCell
from hilcell.cell.devices import Devices, connect_all
from hilcell.cell.file import load_cell
from hilcell.journal.log import Log
from hilcell.ports import DeviceError, HilcellError, NoReading
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import MemoryJournal, run_in_process
from hilcell.run.prompts import NO_CHOICES, Prompt, Verification
from procedures.reflectors import REFLECTORS

CELL = load_cell("paper")
LONG_MM = 0.15


def carried(folder: Path, different: str) -> tuple[Log, list[str]]:
    """Return the log of a run in which one place's reflector has a longer prism, and the titles of
    what was asked.
    """
    simulated, titles = InProcessCell(CELL, 1), list[str]()
    tracker = simulated.tracker._truth.tracker  # type: ignore[attr-defined] # the simulated one

    def ask(
        prompt: Prompt,
        verify: Callable[[], Verification],
        cause: NoReading | None,
        choices: Mapping[str, Callable[[], Verification]] = NO_CHOICES,
    ) -> Verification:
        titles.append(prompt.title)
        tracker._offset_mm = LONG_MM if f" of {different} " in prompt.title else 0.0
        return verify()

    journal = MemoryJournal(folder, "2026-01-01T00:00:00.000Z")
    plan = REFLECTORS.plan(CELL, 1)
    more = {
        "cell_file": "paper", "seed": 1, "machine_seed": 1, "speed": None, "unattended": False,
        "operator": "", "job": "", "versions": {}, "settings": {},
    }  # fmt: skip
    journal.append("plan", "", REFLECTORS.inputs(CELL, plan) | more)
    devices = Devices(simulated.rail, simulated.robot, simulated.tracker)
    connect_all(devices, lambda _: None)
    session = CellSession(CELL, devices, simulated.clock, journal, checkpoint=lambda: None, ask=ask)
    REFLECTORS.perform(session)
    return journal.log, titles


@pytest.mark.parametrize("different", ["", "flange", "F2"])
def test_the_one_that_differs_is_named(tmp_path: Path, different: str) -> None:
    log, titles = carried(tmp_path, different)
    assert len(titles) == len(CELL.layout.fixed_nests) + 1 + 1  # each, and all put back
    rows = REFLECTORS.result(log)["reflectors"]
    wrong = [row for row in rows if not row["holds"]]
    assert [row["place"] for row in wrong] == [name for name in [different] if name]
    assert log.verdicts["reflectors"].holds is not bool(different)
    for row in wrong:
        assert row["along_mm"] == pytest.approx(LONG_MM, abs=0.02)


def test_nobody_carries_them_in_an_unattended_run(tmp_path: Path) -> None:
    with pytest.raises(DeviceError) as refused:
        run_in_process(CELL, REFLECTORS, seed=1, machine_seed=1, folder=tmp_path)
    assert refused.value.code == "HC-C16"


def test_one_reflector_has_none_to_be_compared_with() -> None:
    with pytest.raises(HilcellError, match="one reflector"):
        REFLECTORS.plan(load_cell("paper", {"layout.reflectors": "by_hand"}), 1)
