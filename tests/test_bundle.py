"""The archive for a PC without a network: what it pins, what it refuses, and that it installs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path
from sysconfig import get_platform

import pytest

ROOT = Path(__file__).parents[1]
INSTALL = ROOT / ".ci" / "bundle" / "install.sh"
# A namespace without a network but its own loopback, in which the devices are simulated.
ALONE = ("unshare", "--map-root-user", "--net", "sh", "-euc", 'ip link set lo up; exec "$@"', "sh")


def pins(lock: str) -> dict[str, set[str]]:
    """Return the hashes by ``name==version ; condition`` of a lock file."""
    found: dict[str, set[str]] = {}
    for line in Path(ROOT, lock).read_text("utf-8").splitlines():
        if "==" in line:
            now = found.setdefault(line.rstrip(" \\"), set())
        elif line.strip().startswith("--hash="):
            now.add(line.strip(" \\"))
    return found


def test_what_a_run_needs_is_pinned_as_the_tests_have_it() -> None:
    # What only tests need may be asked for with a wider condition there.
    tested = {name.partition(" ")[0]: hashes for name, hashes in pins("requirements.lock").items()}
    run = {name.partition(" ")[0]: hashes for name, hashes in pins("requirements-run.lock").items()}
    assert {name for name in run if name not in tested} == {f"pip=={_pip(run)}"}
    assert all(tested[name] == hashes for name, hashes in run.items() if name in tested)
    assert all(run.values())


def _pip(run: dict[str, set[str]]) -> str:
    return next(name.removeprefix("pip==") for name in run if name.startswith("pip=="))


@pytest.fixture
def unpacked(tmp_path: Path) -> Path:
    """Return a folder that looks like an unpacked archive, for this python."""
    made_for = f"python{sys.version_info.major}.{sys.version_info.minor} {get_platform()}"
    shutil.copy(INSTALL, tmp_path)
    Path(tmp_path, "made-for").write_text(f"9.9.9 {made_for}\n")
    Path(tmp_path, "SHA256SUMS").write_text("0" * 64 + "  wheels/one.whl\n")
    return tmp_path


def install(folder: Path, python: str = sys.executable) -> subprocess.CompletedProcess[str]:
    """Try to install what is refused: there is no folder of it afterwards."""
    done = subprocess.run(
        ["sh", folder / "install.sh", folder / "prefix"],
        env=os.environ | {"PYTHON": python},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert not Path(folder, "prefix").exists()
    return done


@pytest.mark.process
def test_a_damaged_archive_and_another_python_are_refused(unpacked: Path) -> None:
    assert "damaged" in install(unpacked).stderr
    assert "/nonexistent/python3" in install(unpacked, python="/nonexistent/python3").stderr
    Path(unpacked, "made-for").write_text("9.9.9 python3.99 linux-mips\n")
    assert "python3.99 linux-mips" in install(unpacked).stderr


@pytest.mark.wall
@pytest.mark.nightly
def test_installs_and_runs_without_a_network(tmp_path: Path) -> None:
    made = subprocess.run(
        ["make", "--no-print-directory", "bundle"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    with tarfile.open(ROOT / made.stdout.splitlines()[-1]) as archive:
        archive.extractall(tmp_path, filter="data")
    (folder,) = tmp_path.iterdir()
    bare = {"PATH": "/usr/sbin:/usr/bin:/bin", "HOME": str(tmp_path), "PYTHON": sys.executable}

    def alone(*words: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*ALONE, *words], cwd=tmp_path, env=bare, capture_output=True, text=True, check=False
        )

    # There is no network: else an installation from it would pass as one from the archive.
    assert "lo" in alone("ip", "-brief", "link").stdout
    assert len(alone("ip", "-brief", "link").stdout.splitlines()) == 1
    installed = alone("sh", folder / "install.sh", "a prefix")
    assert installed.returncode == 0, installed.stderr
    ran = alone(tmp_path / "a prefix" / "bin" / "hilcell", "run", "home", "--unattended", "--json")
    assert ran.returncode == 0, ran.stderr
    assert '"state":"finished"' in ran.stdout.splitlines()[-1]
