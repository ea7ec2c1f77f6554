"""The first step: what a person has written and a device cannot have is refused by its key."""

from pathlib import Path
from queue import Queue

import pytest

from hilcell.cell.settings import SettingsError
from hilcell.commission.cell_text import CellText
from hilcell.commission.dialogue import TypedDialogue
from hilcell.commission.first_steps import WhichDevices


@pytest.mark.parametrize(
    ("driver", "option"),
    [("kuka-c3", "port = 70000"), ("kuka-eki", 'port = "x"'), ("ur-rtde", "dashboard_port = -1")],
)
def test_an_impossible_port_is_refused_by_its_key(driver: str, option: str, tmp_path: Path) -> None:
    cell = tmp_path / "hall.toml"
    cell.write_text(
        f'serial = "1"\n[robot]\ndriver = "{driver}"\n'
        f'[robot.options]\nhost = "127.0.0.1"\n{option}\n'
    )
    dialogue = TypedDialogue(Queue(), lambda _: None)
    with pytest.raises(SettingsError) as refused:
        WhichDevices(cell, CellText.read(cell), dialogue).perform()
    assert refused.value.source == "robot.options"
    assert refused.value.problems[0].startswith(f"{option.partition(' ')[0]}: ")
