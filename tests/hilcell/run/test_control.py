"""The control channel and the locks, between real processes."""

from __future__ import annotations

import math
import shutil
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hilcell.run.control as client_module
from hilcell.journal.journal import StorageError
from hilcell.journal.runs import EngineFile, live_engine
from hilcell.model.events import AlarmsAcknowledged
from hilcell.ports import HilcellError
from hilcell.run.cell_lock import CellLocked, lock_of_name, locked
from hilcell.run.control import (
    COMMANDS,
    TIMELESS,
    Command,
    Control,
    EngineClient,
    Request,
    Status,
    order,
)
from tests.hilcell.run.bed import Screen, until
from tests.hilcell.run.rig import hang

pytestmark = pytest.mark.waits


class Recorder:
    """An engine that notes what it is told."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.screens = 0
        self.refusal = ""

    def stop(self) -> None:
        self.told.append("stop")

    def post(self, command: str) -> None:
        self.told.append(command)

    def proceed_refusal(self, since: int) -> str:
        self.told.append(f"gone on since {since}")
        return self.refusal

    def answer(self, choice: str) -> str:
        self.told.append(f"answer {choice}".rstrip())
        return self.refusal

    def retake(self, key: str) -> str:
        self.told.append(f"retake {key}")
        return self.refusal

    def acknowledge(self, made: AlarmsAcknowledged) -> str:
        self.told.append(f"acknowledge {made}")
        return self.refusal

    def watched(self, by: int) -> int:
        self.screens += by
        return self.screens

    def status(self) -> Status:
        self.answers()
        return Status(state="running", screens=self.screens)

    def answers(self) -> None:
        """Take as long as a test wants."""


@pytest.fixture
def desk() -> Recorder:
    return Recorder()


@pytest.fixture(autouse=True)
def control(tmp_path: Path, desk: Recorder) -> Iterator[Control]:
    control = Control(tmp_path, desk)
    yield control
    control.close()


@pytest.fixture
def screen(tmp_path: Path, control: Control) -> Iterator[Screen]:
    screen = Screen(tmp_path)
    yield screen
    screen.close()


def test_commands_reach_the_engine_and_are_answered(
    tmp_path: Path, desk: Recorder, control: Control
) -> None:
    assert live_engine(tmp_path) is not None
    command: Command
    for command in ("pause", "status", "stop"):
        assert order(tmp_path, command) == Status(state="running")
    assert desk.told == ["pause", "stop"]
    control.close()
    assert live_engine(tmp_path) is None


def test_one_connection_carries_many_commands(desk: Recorder, screen: Screen) -> None:
    for command in ("pause", "proceed", "abort", "stop", "answer"):
        assert screen.ask(command)["ok"] is True
    assert screen.ask("retake", key="grid/0-0-0")["ok"] is True
    assert desk.told == ["pause", "proceed", "abort", "stop", "answer", "retake grid/0-0-0"]


def test_an_acknowledgement_reaches_the_engine_or_is_refused(
    desk: Recorder, tmp_path: Path, screen: Screen
) -> None:
    read = b'{"command": "acknowledge", "codes": ["HC-T10"], "until": 7}\n'
    assert screen.raw(read)["ok"] is True
    assert desk.told == [f"acknowledge {AlarmsAcknowledged(codes=[*('HC-T10',)], until=7)}"]
    desk.refusal = "it has not been written"
    assert screen.raw(read) == {"ok": False, "error": "it has not been written"}
    client = client_module.EngineClient.of_run(tmp_path)
    assert client is not None
    with closing(client), pytest.raises(HilcellError, match="not been written"):
        client.ask("acknowledge", codes=("HC-R31", "HC-T10"), until=8)
    assert (
        desk.told[-1] == f"acknowledge {AlarmsAcknowledged(codes=[*('HC-R31', 'HC-T10')], until=8)}"
    )


@pytest.mark.parametrize("command", ["answer", "retake"])
def test_a_refusal_is_told_and_the_connection_stays(
    desk: Recorder, screen: Screen, command: str
) -> None:
    desk.refusal = "nothing is asked now"
    assert screen.ask(command) == {"ok": False, "error": "nothing is asked now"}
    assert screen.ask("status")["ok"] is True


def test_screens_are_counted(tmp_path: Path, desk: Recorder, screen: Screen) -> None:
    assert screen.ask("attend")["screens"] == 1
    assert screen.ask("attend")["screens"] == 1
    other = Screen(tmp_path)
    assert other.ask("attend")["screens"] == 2
    other.close()
    until(lambda: desk.screens == 1)
    assert desk.told == []  # one still watches
    assert screen.ask("leave")["screens"] == 0
    screen.close()
    assert order(tmp_path, "status").screens == 0
    assert desk.told == []  # it left on purpose


def test_the_last_screen_that_is_lost_is_told(desk: Recorder, screen: Screen) -> None:
    screen.ask("attend")
    screen.close()
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
    "line",
    [
        b"\n",
        b"[]\n",
        b'{"command": "dance"}\n',
        b'{"command": 1}\n',
        b'{"command": "\xd6"}\n',
        b"\xff" * 100 + b"\n",
    ],
)
def test_nonsense_is_answered_and_harmless(desk: Recorder, screen: Screen, line: bytes) -> None:
    answer = screen.raw(line)
    assert answer["ok"] is False
    assert screen.ask("stop")["ok"] is True
    assert desk.told == ["stop"]


def test_a_dead_engine_is_told(tmp_path: Path, control: Control) -> None:
    control.close()
    with pytest.raises(HilcellError, match="engine"):
        order(tmp_path, "pause")
    (tmp_path / "engine.json").write_bytes(b'{"pid": 1, "socket": "\xd6"}')
    assert live_engine(tmp_path) is None
    (tmp_path / "engine.json").write_text('{"pid": 1, "socket": "/nowhere/control"}')
    assert live_engine(tmp_path) is None


@pytest.mark.parametrize("command", COMMANDS)
def test_only_orders_grow_old(command: Command) -> None:
    request = Request.within(-1.0, command)
    assert bool(request.before) is (command in {"pause", "proceed", "abort", "answer", "retake"})
    assert bool(request.too_late()) is (command not in TIMELESS)
    assert Request.within(1e6, command).too_late() == ""
    assert Request(command).too_late() == ""  # of a client that says no time


@given(st.floats(-1e9, 1e9).filter(lambda ahead_s: abs(ahead_s) > 1e6))
def test_an_order_is_taken_until_its_time(ahead_s: float) -> None:
    refused = Request.within(ahead_s, "proceed").too_late()
    assert bool(refused) is (ahead_s < 0)


@given(st.text() | st.sampled_from(["nan", "inf", "-inf", "1e999", "", "soon"]))
def test_a_time_that_is_none_is_refused(text: str) -> None:
    try:
        number = math.isfinite(float(text))
    except ValueError:
        number = False
    refused = Request("proceed", before=text).too_late()
    assert refused or number


@pytest.mark.parametrize("command", ["pause", "proceed", "abort", "answer", "retake"])
def test_an_order_that_comes_late_does_nothing(
    desk: Recorder, screen: Screen, command: str
) -> None:
    for before in ("0.0", "nan", "soon"):
        assert screen.ask(command, before=before)["ok"] is False
    assert desk.told == []


def test_a_stop_never_comes_late(desk: Recorder, screen: Screen) -> None:
    assert screen.ask("stop", before="0.0")["ok"] is True
    assert screen.ask("stop", before="soon")["ok"] is True
    assert desk.told == ["stop", "stop"]
    assert screen.ask("attend", before="0.0")["screens"] == 1
    assert screen.ask("leave", before="0.0")["screens"] == 0


def test_an_order_that_waits_behind_a_slow_answer_grows_old(
    desk: Recorder, screen: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    entered, release = threading.Event(), threading.Event()
    monkeypatch.setattr(desk, "answers", hang(entered, release))
    first, second = (
        msgspec.json.encode(request)
        for request in (Request("status"), Request.within(0.0, "proceed"))
    )
    screen.link.sendall(first + b"\n" + second + b"\n")
    entered.wait()
    release.set()
    answers = [msgspec.json.decode(screen.lines.readline()) for _ in range(2)]
    assert [answer["ok"] for answer in answers] == [True, False]
    assert desk.told == []


def test_a_refused_order_is_told(
    tmp_path: Path, desk: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.refusal = "nothing is asked now"
    with pytest.raises(HilcellError, match="nothing is asked now"):
        order(tmp_path, "answer")
    assert order(tmp_path, "pause").state == "running"
    monkeypatch.setattr(Request, "within", lambda *_, **subject: Request("proceed", before="0.0"))
    with pytest.raises(HilcellError, match=tmp_path.name):
        order(tmp_path, "proceed")
    assert desk.told == ["answer", "pause"]


ENGINE = """
import sys
from pathlib import Path
from hilcell.run.control import Control
from tests.hilcell.run.bed import until
from tests.hilcell.run.test_control import Recorder
desk = Recorder()
control = Control(Path(sys.argv[1]), desk)
print("listens", flush=True)
sys.stdin.read()
until(lambda: "stop" in desk.told)  # each connection is served by a thread of its own
control.close()
print(desk.told)
"""


@pytest.mark.process
def test_what_was_told_as_failed_is_not_done_later(
    tmp_path: Path, control: Control, monkeypatch: pytest.MonkeyPatch
) -> None:
    control.close()
    monkeypatch.setattr(client_module, "ORDER_S", 0.2)
    engine = subprocess.Popen(
        [sys.executable, "-c", ENGINE, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert engine.stdout is not None
    assert engine.stdout.readline() == "listens\n"
    engine.send_signal(signal.SIGSTOP)
    command: Command
    for command in ("proceed", "answer", "stop"):
        with pytest.raises(HilcellError, match=tmp_path.name):
            order(tmp_path, command)
    engine.send_signal(signal.SIGCONT)
    monkeypatch.undo()
    order(tmp_path, "pause")
    try:
        told, _ = engine.communicate(timeout=60)
    finally:
        engine.kill()  # one that waits for a lost stop would not end
    assert sorted(msgspec.json.decode(told.replace("'", '"'))) == ["pause", "stop"]


HOLD = """
import sys
from pathlib import Path
from hilcell.journal.journal import StorageError
from hilcell.run.cell_lock import locked
with locked(Path(sys.argv[1]), "cell paper", "other"):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.process
def test_another_process_holds_the_cell_until_it_dies(tmp_path: Path) -> None:
    path = lock_of_name(tmp_path, "paper")
    words = [sys.executable, "-c", HOLD, str(path)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with (
            pytest.raises(CellLocked, match=f"other .*{other.pid}"),
            locked(path, "cell paper", "mine"),
        ):
            pass
        other.kill()
    with locked(path, "cell paper", "mine"):
        pass


@pytest.mark.parametrize("folder", ["/etc/passwd", "x" * 300])
def test_a_folder_that_cannot_be_used_is_named(folder: str) -> None:
    with (
        pytest.raises(StorageError, match=folder),
        locked(lock_of_name(Path(folder), "paper"), "cell paper", "mine"),
    ):
        pass


def test_the_engine_s_file_is_never_seen_half_written(
    tmp_path: Path, desk: Recorder, monkeypatch: pytest.MonkeyPatch
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


NO_ROOM = """
import resource, sys, tempfile, threading
from pathlib import Path
from hilcell.run.control import Control
from hilcell.journal.journal import StorageError
from hilcell.run.cell_lock import locked
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


@pytest.mark.process
def test_a_full_disk_is_a_storage_fault_and_leaves_nothing(tmp_path: Path, temporary: Path) -> None:
    folder = tmp_path / "r"
    folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", NO_ROOM, folder, temporary],
        capture_output=True,
        text=True,
        check=True,
    )
    engine, lock, threads = done.stdout.splitlines()
    assert f"{folder}/engine.json" in engine
    assert f"{tmp_path}" in lock
    assert threads == "1"
    assert list(folder.iterdir()) == []
    assert list(temporary.iterdir()) == []


# -- A run's folder that was copied while its engine lives: the engine is the original's alone -----


def test_a_copied_folder_has_no_engine(tmp_path: Path) -> None:
    """To resume it, or to stop it, would move the original's machine."""
    run, copy, moved = tmp_path / "run", tmp_path / "copy", tmp_path / "moved"
    run.mkdir()
    with closing(Control(run, Recorder())):
        shutil.copytree(run, copy)
        assert live_engine(run) is not None
        assert live_engine(copy) is None
        assert EngineClient.of_run(copy) is None
        run.rename(moved)
        assert live_engine(moved) is not None
