"""A client of an engine: answers, refusals, silence, garbage, ends; and nothing is leaked."""

from __future__ import annotations

import socket
import threading
from contextlib import ExitStack, suppress
from pathlib import Path

import msgspec
import pytest

from hilcell.errors import HilcellError
from hilcell.journal.runs import EngineFile, live_engine
from hilcell.run import control
from hilcell.run.control import EngineClient, EngineLost, EngineSilent, Status, order, stop_engine
from tests.hilcell.tui.engine_peer import SILENCE, STATUS, Peer, says, usual

MANY_STOPS = 2000  # their answers fill any buffer


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait a tenth of a second for an engine that will not answer."""
    monkeypatch.setattr(control, "ANSWER_S", 0.1)


def connected(folder: Path) -> EngineClient:
    client = EngineClient.of_run(folder)
    assert client is not None
    return client


def test_esc_held_down_is_heard_to_the_end(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        client = connected(tmp_path)
        for heard in range(10, MANY_STOPS + 1, 10):
            assert all(client.stop() for _ in range(10))
            peer.until_stops(heard)
        client.close()


def test_it_asks_and_is_answered(tmp_path: Path) -> None:
    with Peer(tmp_path) as peer:
        client = connected(tmp_path)
        assert client.ask("status") == msgspec.convert(STATUS, Status)
        client.ask("retake", key="grid/0-0-0")
        assert client.stop()
        peer.until(lambda: "stop" in peer.commands)
        client.close()
        peer.until(lambda: peer.open == 0)
        numbers = {command: number for number, command in peer.heard}
    assert numbers["status"] == numbers["retake"] != numbers["stop"]


def test_a_refusal_keeps_its_reason_and_the_line(tmp_path: Path) -> None:
    def refuse(words: dict[str, str]) -> bytes:
        refused = words["command"] == "answer"
        return says({"ok": False, "error": "not seen"}) if refused else usual(words)

    with Peer(tmp_path, refuse):
        client = connected(tmp_path)
        with pytest.raises(HilcellError, match="not seen") as caught:
            client.ask("answer")
        assert not isinstance(caught.value, EngineLost)
        assert client.ask("status") == msgspec.convert(STATUS, Status)
        client.close()


@pytest.mark.parametrize(
    "answer",
    [
        b"garbage\n",
        b"\n",
        b"[1, 2]\n",
        b'"ok"\n',
        b"\xff\xfe\n",
        b'{"ok": "\xd6"}\n',
        b"x" * 200_000 + b"\n",
        None,
    ],
    ids=["garbage", "empty", "list", "text", "bytes", "no text", "endless", "closed"],
)
def test_what_is_no_answer_loses_the_line(tmp_path: Path, answer: bytes | None) -> None:
    with Peer(tmp_path, lambda _: answer) as peer:
        client = connected(tmp_path)
        with pytest.raises(EngineLost, match="status"):
            client.ask("status")
        with pytest.raises(EngineLost):
            client.ask("status")
        assert not client.stop()
        peer.until(lambda: peer.open == 0)


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("beginning", [SILENCE, b'{"ok": tr'], ids=["silence", "torn"])
def test_a_late_answer_is_never_taken_for_the_next_one_s(tmp_path: Path, beginning: bytes) -> None:
    waits = threading.Event()
    answers = iter([beginning, says(STATUS | {"points": 2})])
    rest = says(STATUS | {"points": 1}).removeprefix(beginning)

    def slowly(words: dict[str, str]) -> bytes:
        if words["command"] == "late":
            waits.wait()
            return rest
        return usual(words) if words["command"] == "stop" else next(answers)

    with Peer(tmp_path, slowly) as peer:
        client = connected(tmp_path)
        with pytest.raises(EngineSilent, match="status"):
            client.ask("status")
        with pytest.raises(EngineSilent):  # nothing else is asked while one is owed
            client.ask("pause")
        client._asking.sendall(b'{"command": "late"}\n')  # stands for the engine's own time
        assert client.stop()
        peer.until_stops(1)
        waits.set()
        client._asking.settimeout(None)  # however late
        assert client.ask("answer").points == 2
        assert "pause" not in peer.commands
        client.close()


@pytest.mark.usefixtures("short")
def test_a_stop_waits_for_no_answer(tmp_path: Path) -> None:
    asked, lost = threading.Event(), threading.Event()

    def hang(words: dict[str, str]) -> bytes:
        asked.set()
        return SILENCE

    with Peer(tmp_path, hang) as peer:
        client = connected(tmp_path)

        def ask() -> None:
            with pytest.raises(EngineSilent):
                client.ask("status")
            lost.set()

        asking = threading.Thread(target=ask)
        asking.start()
        asked.wait()
        assert client.stop()
        peer.until(lambda: "stop" in peer.commands)
        asking.join()
        assert lost.is_set()
        client.close()


@pytest.mark.parametrize(
    "text",
    [
        None,
        b"",
        b"garbage",
        b"{}",
        b'{"pid": 1, "socket": "/nowhere/control"}',
        b'{"pid": 1, "socket": "' + b"x" * 500 + b'"}',
    ],
    ids=["none", "empty", "garbage", "fields", "nobody", "long"],
)
def test_no_engine_no_link(tmp_path: Path, text: bytes | None) -> None:
    if text is not None:
        (tmp_path / "engine.json").write_bytes(text)
    assert EngineClient.of_run(tmp_path) is None


@pytest.mark.usefixtures("short")
def test_an_engine_whose_queue_is_full_lives_and_is_silent(tmp_path: Path) -> None:
    path = tmp_path / "control"
    with socket.socket(socket.AF_UNIX) as server, ExitStack() as waiting:
        server.bind(str(path))
        server.listen(0)
        (tmp_path / "engine.json").write_bytes(msgspec.json.encode(EngineFile(1, str(path))))
        with suppress(BlockingIOError):
            while True:
                client = waiting.enter_context(socket.socket(socket.AF_UNIX))
                client.setblocking(False)
                client.connect(str(path))
        assert live_engine(tmp_path) is not None
        with pytest.raises(EngineSilent, match="connect"):
            EngineClient.of_run(tmp_path)
        assert not stop_engine(tmp_path)
        with pytest.raises(HilcellError, match="process 1"):
            order(tmp_path, "stop")
