"""Before work at a station its base is touched, and programs are corrected for this visit."""

from pathlib import Path

import numpy as np
import pytest

from hilcell.calibration.file import read_calibration
from hilcell.journal.runs import CALIBRATION
from tests.hilcell.commands.workplace import read_corrected
from tests.whole.bench import SMALL, command, end_of, events, sets
from tests.whole.golden import GoldenRuns
from tests.whole.trace import judge

HEAD = "name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n"


def test_a_program_is_corrected_for_the_visit(golden: GoldenRuns, tmp_path: Path) -> None:
    small, runs = golden["small"].folder, tmp_path / "runs"
    words = SMALL | {"touch.calibration": str(small), "touch.station": "S300"}
    done = command(
        "run", "touch", "--seed", "1", "--json", "--name", "T", "--runs", runs, *sets(words)
    )
    assert done.returncode == 0, done.stderr
    assert judge(events(done.stdout)) == []
    found = end_of(done)["result"]["touch"]["S300"]
    assert found["poses"] == 8
    assert np.linalg.norm(found["shift_mm"]) < 4 * found["u_before_mm"] < 0.5
    assert found["u_after_mm"] < found["u_before_mm"]
    before, touched = (
        read_calibration(small / CALIBRATION),
        read_calibration(runs / "T" / CALIBRATION),
    )
    assert [(each.run, each.what) for each in touched.provenance.updates] == [("T", "touch")]
    assert touched.provenance.run == before.provenance.run == "small"
    assert touched.uncertainty is not None
    (line,) = touched.uncertainty.stations["S300"]
    assert (line.name, line.counts) == ("Touched base", "always")
    assert touched.stations["S1100"] == before.stations["S1100"]
    shown = command("show", "T", "--runs", runs)
    assert "Calibration small was used" in shown.stderr
    assert "--station S300 holds until the slide moves" in shown.stderr
    targets = tmp_path / "t.csv"
    targets.write_text(HEAD + "H1,0,-800,1200,0,75,0\n")
    sent = []
    for run in (small, runs / "T"):
        out = tmp_path / "o.csv"
        done = command("compensate", run, targets, "--station", "S300", "-o", out)
        assert done.returncode == 0, done.stderr
        sent.append(read_corrected(out)[1][0, :3])
    np.testing.assert_allclose(sent[1] - sent[0], found["shift_mm"], atol=0.02)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"touch.station": "S7"}, "station 'S7' is unknown"),
        ({"touch.poses": "0"}, "nothing would be touched"),
    ],
)
def test_what_cannot_be_touched_is_refused(
    golden: GoldenRuns, tmp_path: Path, settings: dict[str, str], says: str
) -> None:
    words = SMALL | {"touch.calibration": str(golden["small"].folder)} | settings
    done = command("run", "touch", "--json", "--runs", tmp_path, *sets(words))
    assert done.returncode == 2
    assert says in done.stderr
    assert list(tmp_path.iterdir()) == []
