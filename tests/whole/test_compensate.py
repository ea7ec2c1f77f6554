"""A program is released only by a calibration whose sign the cell has proven."""

import json
from pathlib import Path

import msgspec

from hilcell.calibration.file import read_calibration, write_calibration
from tests.whole.bench import command
from tests.whole.golden import GoldenRuns

SRC = "DEF HOLES( )\r\nPTP HOME\r\nLIN XP1\r\n"
SRC += "LIN {X 150.0,Y 100.0,Z 1100.0,A 0.0,B 75.0,C 0.0}\r\nEND"
DAT = "DEFDAT HOLES\r\nDECL E6POS XP1={X -100,Y 50.25,Z 1300.0,A 0,B 75,C 0,S 6,T 19}\r\nENDDAT\r\n"


def test_from_sign_check_to_program(tmp_path: Path, golden: GoldenRuns) -> None:
    checked = golden["sign-check"]
    sign = checked.result["sign"]
    assert sign["corrected_mm"] < 0.5 * sign["before_mm"]
    verdicts = {e["key"]: e["holds"] for e in checked.events if e["kind"] == "verdict"}
    assert verdicts["sign"] is True
    checked.copied_to(tmp_path / "runs")
    source, out = tmp_path / "holes.src", tmp_path / "corrected"
    source.write_bytes(SRC.encode())
    (tmp_path / "holes.dat").write_bytes(DAT.encode())
    words: tuple[str | Path, ...] = (
        "compensate", "last", source, "--station", "S1100", "-o", out
    )  # fmt: skip
    done = command(*words, "--runs", tmp_path / "runs")
    assert done.returncode == 2
    assert "its correction was never validated" in done.stderr
    words = (*words, "--accept-out-of-tolerance")
    done = command(*words, "--runs", tmp_path / "runs")
    assert done.returncode == 0, done.stderr
    assert "SIMULATED" in done.stderr
    assert done.stdout == ""
    src, dat = (tmp_path / f"corrected{end}" for end in (".src", ".dat"))
    stamp = b"; hilcell: corrected by sign-check for S1100 on 20"
    assert src.read_bytes().startswith(b"DEF HOLES( )\r\n" + stamp)
    line = src.read_bytes().splitlines()[1]
    assert line.endswith(b"Z; SIMULATION; OUT OF TOLERANCE (accepted)")
    assert b"\r\nPTP HOME\r\nLIN XP1\r\nLIN {X 1" in src.read_bytes()
    assert dat.read_bytes().startswith(b"DEFDAT HOLES\r\n" + stamp)
    assert src.read_bytes().endswith(b",A 0.0,B 75.0,C 0.0}\r\nEND")
    assert dat.read_bytes().endswith(b",A 0,B 75,C 0,S 6,T 19}\r\nENDDAT\r\n")
    assert dat.read_bytes() != DAT.encode()
    (file,) = (tmp_path / "runs").glob("*/calibration.json")
    values = json.loads(file.read_text())
    assert values["provenance"]["sign_checked"] is True
    values["provenance"]["sign_checked"] = False
    proven = read_calibration(file)
    file.write_text(json.dumps(values))
    src.unlink()
    done = command(*words, "--runs", tmp_path / "runs")
    assert done.returncode == 2
    assert "was changed after it was written" in done.stderr
    provenance = msgspec.structs.replace(proven.provenance, sign_checked=False)
    write_calibration(msgspec.structs.replace(proven, provenance=provenance), file)
    done = command(*words, "--runs", tmp_path / "runs")
    assert done.returncode == 2
    assert "sign check" in done.stderr
    assert not src.exists()
