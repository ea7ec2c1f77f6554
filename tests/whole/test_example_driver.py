"""The package of docs/drivers-guide.md: installed beside hilcell, found, judged, run to the end.

It stands outside of hilcell's own packages, and nothing of them knows it.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import venv
from collections.abc import Callable
from pathlib import Path
from textwrap import indent
from zipfile import ZipFile

import pytest

from hilcell.conformance.promises import promises_of
from hilcell.journal.runs import read_log
from tests.whole.bench import SMALL, end_of, sets

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "docs" / "examples" / "hilcell-meca500"
GUIDE = ROOT / "docs" / "drivers-guide.md"
DRIVER = ("--set", "robot.driver=meca500")
KIT = "--hilcell-driver=robots:meca500"
INSTALL = ("-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-build-isolation")
BLOCK = re.compile(r"^```(?:python|toml)\n(.*?)^```", re.DOTALL | re.MULTILINE)

ALONE = ("-p", "no:cacheprovider", "-p", "no:hypothesispytest", "-p", "no:randomly")
SHORT = {"base_frame.points": "4", "layout.nest_samples": "2"}
DRILL = ("SetBlending(0)", "MoveLin(1780.0, 400.0, 900.0, 0, 75, 0)")

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Unpack the package's wheel into a folder of its own; pip takes long to start."""
    folder = tmp_path_factory.mktemp("site")
    with ZipFile(built(tmp_path_factory.mktemp("dist"), "wheel")) as wheel:
        wheel.extractall(folder)
    return folder


def built(folder: Path, kind: str) -> Path:
    """Build the package into a folder; no network is asked."""
    words = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    done = subprocess.run(words, cwd=PACKAGE, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (archive,) = folder.iterdir()
    return archive


@pytest.fixture
def run(site: Path, tmp_path: Path) -> Run:
    """Return what runs a module of Python beside which the package is installed."""
    return runner(Path(sys.executable), tmp_path, {"PYTHONPATH": str(site)})


def runner(python: Path, folder: Path, environment: dict[str, str]) -> Run:
    def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [python, "-m", *words],
            cwd=folder,
            env=os.environ | {"HILCELL_RUNS": str(folder / "runs")} | environment,
            capture_output=True,
            text=True,
            check=False,
        )

    return run


@pytest.mark.process
def test_its_entry_points_are_those_of_a_driver_of_ones_own(run: Run) -> None:
    doctor = json.loads(run("hilcell", "doctor", "--json").stdout)
    (drivers,) = (each for each in doctor["checks"] if each["check"] == "drivers")
    assert (drivers["state"], "meca500" in drivers["found"]) == ("ok", True)
    checked = run("hilcell", "check", "paper", *DRIVER, "--set", "robot.options.prot=1")
    assert checked.returncode == 2
    assert "robot.options: prot" in checked.stderr


@pytest.mark.process
def test_its_own_tests_pass_beside_the_kit(run: Run) -> None:
    promises = "identity-same or test_meca500"
    done = run("pytest", "-q", *ALONE, "-W", "error", PACKAGE / "tests", KIT, "-k", promises)
    assert done.returncode == 0, done.stdout
    assert re.search(r"\d\d passed", done.stdout)


@pytest.mark.wall
@pytest.mark.nightly
def test_a_recording_of_its_wire_is_a_device(run: Run, tmp_path: Path) -> None:
    words = ("hilcell", "run", "base-frame", "--unattended", *DRIVER, *sets(SHORT))
    first = run(*words, "--record-wire", "--name", "first")
    assert first.returncode == 0, first.stderr
    runs = tmp_path / "runs"
    recorded = {"simulation.simulator": "recorded", "simulation.data": str(runs / "first")}
    again = run(*words, "--name", "again", *sets(recorded))
    assert again.returncode == 0, again.stderr
    joints = [
        [point.joints_deg for point in read_log(runs / name).points.values()]
        for name in ("first", "again")
    ]
    assert any(joints[0])
    assert joints[0] == joints[1]


def test_no_file_of_hilcell_knows_it() -> None:
    named = [
        path
        for room in ("hilcell", "drivers", "procedures", "fakes")
        for path in (ROOT / room).rglob("*")
        if path.suffix in (".py", ".toml") and "meca" in path.read_text("utf-8").lower()
    ]
    assert named == []
    assert "meca500" not in (ROOT / "pyproject.toml").read_text("utf-8").partition("[tool.")[0]


def test_the_guide_quotes_the_package_word_for_word() -> None:
    files = [*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.toml")]
    blocks = BLOCK.findall(GUIDE.read_text("utf-8"))
    assert len(blocks) >= 3
    stated, deep = "\n".join(path.read_text("utf-8") for path in files), (0, 4, 8)
    foreign = [block for block in blocks if not any(indent(block, n * " ") in stated for n in deep)]
    assert foreign == []
    unnamed = [
        path.relative_to(PACKAGE).as_posix()
        for path in files
        if path.name != "__init__.py" and path.name not in GUIDE.read_text("utf-8")
    ]
    assert unnamed == []


@pytest.mark.wall
@pytest.mark.nightly
def test_every_promise_is_held_or_does_not_apply(run: Run) -> None:
    done = run("pytest", "-q", *ALONE, "-rs", KIT)
    assert done.returncode == 0, done.stdout
    assert f"{len(promises_of('robot')) - 2} passed, 2 skipped" in done.stdout
    assert re.search(r"SKIPPED \[2\] .*: it does not sweep", done.stdout)


@pytest.mark.wall
@pytest.mark.nightly
def test_a_cell_with_it_keeps_every_promise(run: Run) -> None:
    done = run("hilcell", "run", "conformance", "--unattended", "--json", *DRIVER)
    assert "Meca500 SIMULATED" in done.stdout
    end = end_of(done)
    assert end["exit"] == 0, end["result"]
    found = {each["promise"]: each["verdict"] for each in end["result"]["conformance"]["robot"]}
    assert {name for name, verdict in found.items() if verdict != "held"} == {"sweep", "moving"}


@pytest.mark.wall
@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_a_release_works_in_an_environment_of_its_own(kind: str, tmp_path: Path) -> None:
    """Build, install, calibrate, correct a program, prepare one: as its user would."""
    archive = built(tmp_path / "dist", kind)
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    # What hilcell needs comes from the environment of these tests: there may be no network.
    (packages,) = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    shared = [path for path in sys.path if path.endswith("site-packages")]
    (packages / "shared.pth").write_text("\n".join([str(ROOT), *shared]) + "\n")
    installed = subprocess.run(
        [python, *INSTALL, archive], capture_output=True, text=True, check=False
    )
    assert installed.returncode == 0, installed.stderr
    run = runner(python, tmp_path, {})
    done = run("hilcell", "run", "--unattended", "--json", *DRIVER, *sets(SMALL))
    assert end_of(done)["exit"] == 0, done.stderr
    (tmp_path / "drill.mxprog").write_text("\n".join(DRILL))
    words = ("hilcell", "compensate", "last", "drill.mxprog", "--station", "S1100")
    accept = "--accept-out-of-tolerance"  # its sign was not checked
    corrected = run(*words, "-o", "out.mxprog", accept)
    assert corrected.returncode == 0, corrected.stderr
    stamp, *lines = (tmp_path / "out.mxprog").read_text().splitlines()
    assert stamp.startswith("// hilcell: corrected by ")
    assert (lines[0], lines[1] == DRILL[1]) == (DRILL[0], False)
    (tmp_path / "holes.csv").write_text(
        "name,x_mm,y_mm,z_mm,nx,ny,nz\nH1,150,100,1100,-0.9659258,0,-0.2588190\n"
    )
    prepared = run(
        "hilcell", "prepare", "holes.csv", "--calibration", "last", "-o", "out", accept,
        *DRIVER, *sets(SMALL),
    )  # fmt: skip
    assert prepared.returncode == 0, prepared.stderr
    assert "MoveJoints(" in (tmp_path / "out" / "S1100.mxprog").read_text()
