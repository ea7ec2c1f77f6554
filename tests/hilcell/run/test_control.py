"""The control channel and the locks, between real processes."""

import socket
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

from hilcell.ports import HilcellError
from hilcell.run.control import Control, EngineFile, live_engine, send_command
from hilcell.run.journal import StorageError
from hilcell.run.lock import CellLocked, lock_of_address, lock_of_name, locked
from hilcell.runs import find_run, run_folders


class Desk:
    """An engine that notes what it is told."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.screens = 0
        self.refusal = ""

    def stop(self) -> None:
        self.told.append("stop")

    def post(self, command: str) -> None:
        self.told.append(command)

    def answer(self) -> str:
        self.told.append("answer")
        return self.refusal

    def retake(self, key: str) -> str:
        self.told.append(f"retake {key}")
        return self.refusal

    def watched(self, by: int) -> int:
        self.screens += by
        return self.screens

    def status(self) -> dict[str, object]:
        return {"state": "running", "screens": self.screens}


@pytest.fixture
def desk() -> Desk:
    return Desk()


@pytest.fixture(autouse=True)
def control(tmp_path: Path, desk: Desk) -> Iterator[Control]:
    control = Control(tmp_path, desk)
    yield control
    control.close()


class Screen:
    """A connection that stays open."""

    def __init__(self, folder: Path) -> None:
        file = msgspec.json.decode((folder / "engine.json").read_bytes(), type=EngineFile)
        self.link = socket.socket(socket.AF_UNIX)
        self.link.settimeout(10)
        self.link.connect(file.socket)
        self.lines = self.link.makefile("rb")

    def ask(self, command: str, **facts: str) -> dict[str, Any]:
        return self.raw(msgspec.json.encode({"command": command} | facts) + b"\n")

    def raw(self, line: bytes) -> dict[str, Any]:
        self.link.sendall(line)
        return msgspec.json.decode(self.lines.readline(), type=dict[str, Any])

    def close(self) -> None:
        self.lines.close()
        self.link.close()


@pytest.fixture
def screen(tmp_path: Path, control: Control) -> Iterator[Screen]:
    screen = Screen(tmp_path)
    yield screen
    screen.close()


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.002)


def test_commands_reach_the_engine_and_are_answered(
    tmp_path: Path, desk: Desk, control: Control
) -> None:
    assert live_engine(tmp_path) is not None
    answer = {"ok": True, "state": "running", "screens": 0}
    assert send_command(tmp_path, "pause") == answer
    assert send_command(tmp_path, "status") == answer
    assert send_command(tmp_path, "stop")["ok"] is True
    assert desk.told == ["pause", "stop"]
    control.close()
    assert live_engine(tmp_path) is None


def test_one_connection_carries_many_commands(desk: Desk, screen: Screen) -> None:
    for command in ("pause", "proceed", "abort", "stop", "answer"):
        assert screen.ask(command)["ok"] is True
    assert screen.ask("retake", key="grid/0-0-0")["ok"] is True
    assert desk.told == ["pause", "proceed", "abort", "stop", "answer", "retake grid/0-0-0"]


def test_two_commands_in_one_segment(desk: Desk, screen: Screen) -> None:
    assert screen.raw(b'{"command": "pause"}\n{"command": "abort"}\n')["ok"] is True
    assert screen.lines.readline()
    assert desk.told == ["pause", "abort"]


@pytest.mark.parametrize("command", ["answer", "retake"])
def test_a_refusal_is_told_and_the_connection_stays(
    desk: Desk, screen: Screen, command: str
) -> None:
    desk.refusal = "nothing is asked now"
    assert screen.ask(command) == {"ok": False, "error": "nothing is asked now"}
    assert screen.ask("status")["ok"] is True


def test_screens_are_counted(tmp_path: Path, desk: Desk, screen: Screen) -> None:
    assert screen.ask("attend")["screens"] == 1
    assert screen.ask("attend")["screens"] == 1
    other = Screen(tmp_path)
    assert other.ask("attend")["screens"] == 2
    other.close()
    until(lambda: desk.screens == 1)
    assert desk.told == []  # one still watches
    assert screen.ask("leave")["screens"] == 0
    screen.close()
    assert send_command(tmp_path, "status")["screens"] == 0
    assert desk.told == []  # it left on purpose


def test_the_last_screen_that_is_lost_is_told(desk: Desk, screen: Screen) -> None:
    screen.ask("attend")
    screen.close()
    until(lambda: desk.told == ["lost"])


def test_who_never_attended_is_not_missed(tmp_path: Path, desk: Desk, screen: Screen) -> None:
    screen.ask("status")
    screen.close()
    assert send_command(tmp_path, "status")["ok"] is True
    assert desk.told == []


def test_closing_ends_connections_and_takes_nobody_for_lost_twice(
    desk: Desk, control: Control, screen: Screen
) -> None:
    screen.ask("attend")
    control.close()
    assert screen.lines.readline() == b""
    until(lambda: desk.told == ["lost"])


def test_only_the_owner_may_connect(tmp_path: Path, control: Control) -> None:
    path = Path(
        msgspec.json.decode((tmp_path / "engine.json").read_bytes(), type=EngineFile).socket
    )
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    control.close()
    assert not path.parent.exists()


@pytest.mark.parametrize(
    "line", [b"\n", b"[]\n", b'{"command": "dance"}\n', b'{"command": 1}\n', b"\xff" * 100 + b"\n"]
)
def test_nonsense_is_answered_and_harmless(desk: Desk, screen: Screen, line: bytes) -> None:
    answer = screen.raw(line)
    assert answer["ok"] is False
    assert "commands: status, pause" in answer["error"]
    assert screen.ask("stop")["ok"] is True
    assert desk.told == ["stop"]


def test_a_line_too_long_is_answered_and_ends_the_connection(desk: Desk, screen: Screen) -> None:
    assert screen.raw(b"\xff" * 5000)["ok"] is False
    with suppress(ConnectionResetError):  # what it did not read of the line
        assert screen.lines.readline() == b""
    assert desk.told == []


def test_a_dead_engine_is_told(tmp_path: Path, control: Control) -> None:
    control.close()
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


def test_the_engine_s_file_is_never_seen_half_written(
    tmp_path: Path, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "r"
    folder.mkdir()
    seen: list[bytes] = []
    real = Path.replace

    def replace(beside: Path, target: Path) -> Path:
        seen.append(beside.read_bytes())
        assert not target.exists()
        return real(beside, target)

    monkeypatch.setattr(Path, "replace", replace)
    control = Control(folder, desk)
    assert seen == [(folder / "engine.json").read_bytes()]
    assert [path.name for path in folder.iterdir()] == ["engine.json"]
    control.close()
    assert list(folder.iterdir()) == []


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of temporary files, a new one."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


NO_ROOM = """
import resource, sys, tempfile, threading
from pathlib import Path
from hilcell.run.control import Control
from hilcell.run.journal import StorageError
from hilcell.run.lock import locked
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # names are taken, but nothing stands in them
folder, tempfile.tempdir = Path(sys.argv[1]), sys.argv[2]
try:
    Control(folder, None)
except StorageError as error:
    print(error)
try:
    with locked(folder.parent / ".paper.lock", "cell paper", "mine"):
        print("locked")
except StorageError as error:
    print(error)
print(threading.active_count())
"""


def test_a_full_disk_is_a_storage_fault_and_leaves_nothing(tmp_path: Path, temporary: Path) -> None:
    folder = tmp_path / "r"
    folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", NO_ROOM, folder, temporary],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == [
        (
            f"the engine could not say where it listens: {folder}/engine.json: cannot be written: "
            "File too large; make room or mend the disk, then `hilcell resume r`"
        ),
        f"runs folder {tmp_path} cannot be used: File too large",
        "1",
    ]
    assert list(folder.iterdir()) == []
    assert list(temporary.iterdir()) == []


def test_a_folder_of_temporary_files_that_cannot_be_used_is_named(
    tmp_path: Path, desk: Desk, temporary: Path
) -> None:
    temporary.rmdir()
    with pytest.raises(StorageError, match=f"temporary folder {temporary} cannot be used: No such"):
        Control(tmp_path / "r", desk)


def test_a_socket_under_a_path_too_long_is_told(
    tmp_path: Path, desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    deep = tmp_path / ("x" * 120)
    deep.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(deep))
    with pytest.raises(StorageError, match="path too long; make room there, or name another"):
        Control(tmp_path, desk)
    assert list(deep.iterdir()) == []


def test_an_engine_ends_also_where_its_file_stays(tmp_path: Path, control: Control) -> None:
    """A disk that has become read-only keeps the file; nobody listens behind it."""
    file = tmp_path / "engine.json"
    where = msgspec.json.decode(file.read_bytes(), type=EngineFile)
    file.unlink()
    file.mkdir()
    control.close()
    assert not Path(where.socket).parent.exists()
    assert live_engine(tmp_path) is None
