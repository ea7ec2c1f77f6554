"""The control channel and the locks, between real processes."""

import socket
import stat
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from hilcell.ports import HilcellError
from hilcell.run.control import Control, EngineFile, live_engine, send_command
from hilcell.run.journal import StorageError
from hilcell.run.lock import CellLocked, lock_of_address, lock_of_name, locked
from hilcell.runs import find_run, run_folders


def engine(folder: Path, posted: list[str]) -> Control:
    return Control(folder, posted.append, lambda: {"state": "running"})


def test_commands_reach_the_queue_and_are_answered(tmp_path: Path) -> None:
    posted: list[str] = []
    control = engine(tmp_path, posted)
    assert live_engine(tmp_path) is not None
    assert send_command(tmp_path, "pause") == {"ok": True, "state": "running"}
    assert send_command(tmp_path, "status")["state"] == "running"
    control.close()
    assert posted == ["pause"]
    assert live_engine(tmp_path) is None


def test_only_the_owner_may_connect(tmp_path: Path) -> None:
    control = engine(tmp_path, [])
    path = Path(
        msgspec.json.decode((tmp_path / "engine.json").read_bytes(), type=EngineFile).socket
    )
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    control.close()
    assert not path.parent.exists()


@pytest.mark.parametrize("line", [b"\n", b"[]\n", b'{"command": "dance"}\n', b"\xff" * 5000])
def test_nonsense_is_answered_and_harmless(tmp_path: Path, line: bytes) -> None:
    posted: list[str] = []
    control = engine(tmp_path, posted)
    file = msgspec.json.decode((tmp_path / "engine.json").read_bytes(), type=EngineFile)
    with socket.socket(socket.AF_UNIX) as link:
        link.settimeout(5)
        link.connect(file.socket)
        link.sendall(line)
        answer = link.recv(4096)
    assert b'"ok":false' in answer
    assert send_command(tmp_path, "stop")["ok"] is True
    control.close()
    assert posted == ["stop"]


def test_a_dead_engine_is_told(tmp_path: Path) -> None:
    with pytest.raises(HilcellError, match="no engine is running; `hilcell show`"):
        send_command(tmp_path, "pause")
    (tmp_path / "engine.json").write_text('{"pid": 1, "socket": "/nowhere/control"}')
    assert live_engine(tmp_path) is None


HOLD = """
import sys
from pathlib import Path
from hilcell.run.journal import StorageError
from hilcell.run.lock import locked
with locked(Path(sys.argv[1]), "cell paper", "other"):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_another_process_holds_the_cell_until_it_dies(tmp_path: Path) -> None:
    path = lock_of_name(tmp_path, "paper")
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert other.stdout is not None
    assert other.stdin is not None
    assert other.stdout.readline() == b"held\n"
    with (
        pytest.raises(CellLocked, match=rf"locked by run other \(pid {other.pid}\)"),
        locked(path, "cell paper", "mine"),
    ):
        pass
    other.kill()
    other.communicate()
    with locked(path, "cell paper", "mine"):
        pass


def test_addresses_have_locks_of_their_own(tmp_path: Path) -> None:
    assert lock_of_address("robot 10.0.0.1:7000") != lock_of_address("robot 10.0.0.2:7000")


@pytest.mark.parametrize("folder", ["/etc/passwd", "/proc/x", "x" * 300])
def test_a_folder_that_cannot_be_used_is_named(folder: str) -> None:
    with (
        pytest.raises(StorageError, match=f"runs folder {folder} cannot be used: "),
        locked(lock_of_name(Path(folder), "paper"), "cell paper", "mine"),
    ):
        pass


@pytest.mark.parametrize("folder", ["/etc/passwd", "x" * 300])
def test_runs_are_not_looked_for_where_none_can_be(folder: str) -> None:
    with pytest.raises(StorageError, match="cannot be used"):
        run_folders(Path(folder))


def test_a_run_of_an_endless_name_is_not_there(tmp_path: Path) -> None:
    assert run_folders(tmp_path / "none") == []
    with pytest.raises(HilcellError, match="is not in"):
        find_run(tmp_path, "x" * 5000)
