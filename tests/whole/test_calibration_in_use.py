"""Programs are corrected by a calibration that may be used: verified, current, for this visit."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.file import read_calibration, write_calibration
from hilcell.geometry.frames import zyx_from_pose
from hilcell.journal.runs import CALIBRATION
from tests.hilcell.commands.workplace import read_corrected
from tests.hilcell.lists import write_targets
from tests.whole.bench import SMALL, command, corrected, ran
from tests.whole.golden import GoldenRuns

SRC = "DEF HOLES( )\r\nPTP HOME\r\nLIN XP1\r\n"
SRC += "LIN {X 150.0,Y 100.0,Z 1100.0,A 0.0,B 75.0,C 0.0}\r\nEND"
DAT = "DEFDAT HOLES\r\nDECL E6POS XP1={X -100,Y 50.25,Z 1300.0,A 0,B 75,C 0,S 6,T 19}\r\nENDDAT\r\n"
HEAD = "name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n"


def test_from_sign_check_to_program(tmp_path: Path, golden: GoldenRuns) -> None:
    """A program is released only by a calibration whose sign was checked."""
    checked, runs = golden["sign-check"], tmp_path / "runs"
    sign = checked.result["sign"]
    assert sign["corrected_mm"] < 0.5 * sign["before_mm"]
    verdicts = {e["key"]: e["holds"] for e in checked.events if e["kind"] == "verdict"}
    assert verdicts["sign"] is True
    file = checked.copied_to(runs) / CALIBRATION
    source, out = tmp_path / "holes.src", tmp_path / "corrected"
    source.write_bytes(SRC.encode())
    source.with_suffix(".dat").write_bytes(DAT.encode())
    use = ("last", source, "S1100", out, "--runs", runs)
    accepted = (*use, "--accept-out-of-tolerance")
    done = corrected(*use)
    assert done.returncode == 2
    assert "its correction was never validated" in done.stderr
    done = corrected(*accepted)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert "SIMULATED" in done.stderr
    src, dat = (out.with_suffix(end).read_bytes() for end in (".src", ".dat"))
    stamp = b"; hilcell: corrected by sign-check for S1100 on 20"
    assert src.startswith(b"DEF HOLES( )\r\n" + stamp)
    assert src.splitlines()[1].endswith(b"Z; SIMULATION; OUT OF TOLERANCE (accepted)")
    assert b"\r\nPTP HOME\r\nLIN XP1\r\nLIN {X 1" in src
    assert src.endswith(b",A 0.0,B 75.0,C 0.0}\r\nEND")
    assert dat.startswith(b"DEFDAT HOLES\r\n" + stamp)
    assert dat.endswith(b",A 0,B 75,C 0,S 6,T 19}\r\nENDDAT\r\n")
    assert dat != DAT.encode()
    values, made = json.loads(file.read_text()), read_calibration(file)
    assert values["provenance"]["sign_checked"] is True
    values["provenance"]["sign_checked"] = False
    file.write_text(json.dumps(values))
    out.with_suffix(".src").unlink()
    done = corrected(*accepted)
    assert done.returncode == 2
    assert "was changed after it was written" in done.stderr
    provenance = msgspec.structs.replace(made.provenance, sign_checked=False)
    write_calibration(msgspec.structs.replace(made, provenance=provenance), file)
    done = corrected(*accepted)
    assert done.returncode == 2
    assert "sign check" in done.stderr
    assert not out.with_suffix(".src").exists()


# -- superseded -------------------------------------------------------------------------------

SAME_MACHINE = ("--seed", "2", "--machine-seed", "1")


def statuses(runs: Path) -> dict[str, str]:
    listed = json.loads(command("runs", "--json", "--runs", runs).stdout)["runs"]
    return {each["run"]: each["standing"]["state"] for each in listed}


def middle_of(run: Path) -> Path:
    """Write one target in the middle of the calibrated cube."""
    made = read_calibration(run / CALIBRATION)
    middle_mm = (np.array(made.validity.low_mm) + np.array(made.validity.high_mm)) / 2
    pose = np.array(made.stations["S1100"].T_W_B) @ made.poses_at(middle_mm[None])
    write_targets(run.parent / "targets.csv", ["H1"], zyx_from_pose(pose))
    return run.parent / "targets.csv"


@pytest.mark.process
def test_a_base_that_was_bolted_again_is_for_a_person_to_decide(
    golden: GoldenRuns, tmp_path: Path
) -> None:
    golden["small"].copied_to(tmp_path)
    bolted_again = SMALL | {"simulation.sizes.mounting.bolted_mm": "2.2"}
    second = ran(tmp_path, "calibrate", bolted_again, *SAME_MACHINE, name="second")
    assert second.end["exit"] == 1
    (suspicion,) = second.result["suspicions"]
    assert suspicion["cause"] == "changed since"
    assert "base" in suspicion["unit"]
    assert abs(suspicion["size"]) > 0.5
    assert statuses(tmp_path) == {"small": "current", "second": "suspected"}
    use = ("second", middle_of(second.folder), "S1100", tmp_path / "out.csv", "--runs", tmp_path)
    assert corrected(*use).returncode == 2
    why = ("--reason", "the base was bolted again")
    assert command("revoke", "small", "--runs", tmp_path, *why).returncode == 0
    assert statuses(tmp_path) == {"small": "revoked", "second": "current"}
    assert corrected(*use).returncode == 0


@pytest.mark.process
@pytest.mark.nightly  # by day the test above, in which all but the base agrees
def test_a_calibration_that_agrees_supersedes(golden: GoldenRuns, tmp_path: Path) -> None:
    golden["small"].copied_to(tmp_path)
    second = ran(tmp_path, "calibrate", SMALL, *SAME_MACHINE, name="second")
    assert (second.end["exit"], second.result["suspicions"]) == (0, [])
    assert statuses(tmp_path) == {"small": "superseded", "second": "current"}


# -- touched ----------------------------------------------------------------------------------


def test_a_program_is_corrected_for_the_visit(golden: GoldenRuns, tmp_path: Path) -> None:
    small, runs = golden["small"].folder, tmp_path / "runs"
    values = SMALL | {"touch.calibration": str(small), "touch.station": "S300"}
    run = ran(runs, "touch", values, "--seed", "1", name="T")
    assert run.done.returncode == 0, run.done.stderr
    touch = run.result["touch"]["S300"]
    assert touch["poses"] == 8
    assert np.linalg.norm(touch["shift_mm"]) < 4 * touch["u_before_mm"] < 0.5
    assert touch["u_after_mm"] < touch["u_before_mm"]
    before, touched = (read_calibration(each / CALIBRATION) for each in (small, run.folder))
    assert [(each.run, each.what) for each in touched.provenance.updates] == [("T", "touch")]
    assert touched.provenance.run == before.provenance.run == "small"
    assert touched.uncertainty is not None
    (line,) = touched.uncertainty.stations["S300"]
    assert (line.name, line.applies) == ("Touched base", "always")
    assert touched.stations["S1100"] == before.stations["S1100"]
    shown = command("show", "T", "--runs", runs)
    assert "Calibration small was used" in shown.stderr
    assert "--station S300 holds until the slide moves" in shown.stderr
    targets, out = tmp_path / "t.csv", tmp_path / "o.csv"
    targets.write_text(HEAD + "H1,0,-800,1200,0,75,0\n")
    sent = []
    for calibration in (small, run.folder):
        done = corrected(calibration, targets, "S300", out)
        assert done.returncode == 0, done.stderr
        sent.append(read_corrected(out)[1][0, :3])
    np.testing.assert_allclose(sent[1] - sent[0], touch["shift_mm"], atol=0.02)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"touch.station": "S7"}, "'S7'"),
        ({"touch.poses": "0"}, "nothing would be touched"),
    ],
)
def test_an_impossible_touch_is_refused(
    golden: GoldenRuns, tmp_path: Path, settings: dict[str, str], says: str
) -> None:
    values = SMALL | {"touch.calibration": str(golden["small"].folder)} | settings
    done = ran(tmp_path, "touch", values).done
    assert done.returncode == 2
    assert says in done.stderr
    assert list(tmp_path.iterdir()) == []
