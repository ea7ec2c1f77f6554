"""`check` as a command, in this process."""

import pytest

from hilcell.commands.cli import main


@pytest.mark.parametrize(
    "setting", ["touch.station=NIX", 'targets={file="targets.csv", station="NIX"}']
)
def test_stations_of_other_procedures_are_known(
    capsys: pytest.CaptureFixture[str], setting: str
) -> None:
    assert main(["check", "paper", "--set", setting]) == 2
    assert "station 'NIX' is unknown; known here: S300, S1100" in capsys.readouterr().err
