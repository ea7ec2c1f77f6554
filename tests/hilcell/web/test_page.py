"""The page of a run over real HTTP: what viewers see, and what nobody may do."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from datetime import UTC, datetime, timedelta
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any

import pytest

from hilcell.commands.cli import main
from hilcell.errors import HilcellError
from hilcell.journal.runs import JOURNAL
from hilcell.web.server import LOOPBACK, PageServer, _Viewer
from hilcell.web.snapshot import FollowedRun
from tests.hilcell import verdicts
from tests.hilcell.report.journals import Writer, validated_run

NOW = datetime(2100, 1, 1, tzinfo=UTC)


@pytest.fixture
def server() -> Iterator[PageServer]:
    with PageServer(LOOPBACK, 0) as made:
        yield made


class Viewer:
    """A browser that reads the stream of events."""

    def __init__(self, server: PageServer, seen: str = "") -> None:
        self._connection = HTTPConnection(*server.place, timeout=60)
        headers = {"Last-Event-ID": seen} if seen else {}
        self._connection.request("GET", f"/{server.token}/events", headers=headers)
        self.response: HTTPResponse = self._connection.getresponse()
        self.seen = seen

    def next(self) -> Any:
        """Return the next snapshot; beats have no number."""
        number = ""
        while True:
            name, _, value = self.response.readline().decode().rstrip("\n").partition(": ")
            if name == "id":
                number = value
            elif name == "data" and number:
                self.seen = number
                return json.loads(value)

    def close(self) -> None:
        self.response.close()
        self._connection.close()


def get(server: PageServer, path: str, method: str = "GET") -> tuple[int, bytes, dict[str, str]]:
    with closing(HTTPConnection(*server.place, timeout=60)) as connection:
        connection.request(method, path)
        answer = connection.getresponse()
        return answer.status, answer.read(), dict(answer.headers)


def test_the_page_asks_nobody_else_and_leaks_no_address(server: PageServer) -> None:
    status, page, headers = get(server, f"/{server.token}")
    assert status == 200
    assert b"EventSource" in page
    assert b"//" not in page.replace(b"<!doctype html>", b"").replace(b"/\\/$/", b"")
    assert headers["Referrer-Policy"] == "no-referrer"
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/", 403),
        ("GET", "/events", 403),
        ("GET", "/{wrong}/events", 403),
        ("GET", "/{token}x/events", 403),
        ("GET", "/\xe9/events", 403),
        ("GET", "/../../etc/passwd", 403),
        ("GET", "/{token}/../../../etc/passwd", 404),
        ("GET", "/{token}/%2e%2e/page.html", 404),
        ("GET", "/{token}/events?stop", 404),
        ("POST", "/{token}/events", 501),
        ("DELETE", "/{token}", 501),
    ],
)
def test_nothing_else_is_served(server: PageServer, method: str, path: str, status: int) -> None:
    names = {"token": server.token, "wrong": server.token[::-1]}
    path = path.format(**names)
    request = f"{method} {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode("latin-1")
    with socket.create_connection(server.place, 60) as raw, raw.makefile("rb") as file:
        raw.sendall(request)
        found = file.read()
    head, _, body = found.partition(b"\r\n\r\n")
    assert int(head.split()[1]) == status
    assert b"no-referrer" in head
    assert server.token.encode() not in found
    assert b"root:" not in body


def test_viewers_see_a_run_to_its_end_and_after(server: PageServer, tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r1", job="<b>J\x1b[2J</b>")
    run = FollowedRun(writer.folder)
    server.publish(run.snapshot(NOW))
    with ExitStack() as left:
        first, second = (left.enter_context(closing(Viewer(server))) for _ in range(2))
        seen = first.next()
        assert second.next() == seen
        assert seen["simulated"] is True
        assert seen["job"] == "<b>J\N{REPLACEMENT CHARACTER}[2J</b>"
        assert seen["points"] == 16
        assert [row["norm_mm"] for row in seen["rows"][:4]] == pytest.approx([0.2, 0.3, 0.2, 0.1])
        assert seen["last_word"].startswith("INTERRUPTED")  # no engine lives
        writer.journal.append("verdict", "validation.S1100", verdicts.JUDGED)
        writer.state("run", "finished")
        writer.journal.append("end", "", {"state": "finished", "exit": 0, "result": {}})
        writer.journal.close()
        server.publish(run.snapshot(NOW))
        ended = first.next()
    assert ended["last_word"].startswith("IN TOLERANCE (simulated): mean")
    assert (ended["state"], ended["live"], ended["stale"]) == ("DONE", False, True)
    assert ended["verdicts"][0]["holds"] is True
    before = first.seen
    server.publish(run.snapshot(NOW + timedelta(hours=1)))  # unchanged, so not sent again
    server.publish({"newer": 1})
    for number, expected in ((before, {"newer": 1}), ("", {"newer": 1})):
        with closing(Viewer(server, number)) as again:
            assert again.next() == expected
            assert int(again.seen) == int(before) + 1


def test_values_of_a_live_run_have_an_age(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = validated_run(tmp_path / "r1")
    writer.state("run", "suspended", prompt={"title": "Nest F2", "text": "Seat the\x07 reflector."})  # type: ignore[arg-type]
    writer.journal.close()
    monkeypatch.setattr("hilcell.web.snapshot.live_engine", lambda _: object())
    seen = FollowedRun(writer.folder).snapshot(NOW)
    assert (seen["state"], seen["live"], seen["stale"]) == ("NEEDS OPERATOR", True, False)
    assert isinstance(seen["age_s"], float)
    assert seen["age_s"] > 30.0 == seen["stale_after_s"]
    assert seen["prompt"] == "Nest F2: Seat the\N{REPLACEMENT CHARACTER} reflector."
    assert seen["last_word"] == ""


def test_a_run_without_a_readable_journal_says_so(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r1")
    writer.journal.close()
    (tmp_path / "r1" / JOURNAL).write_bytes(b"\xff\n\xff\n")
    seen = FollowedRun(tmp_path / "r1").snapshot(NOW)
    assert seen["trouble"]
    assert "rows" not in seen


def test_idle_connections_keep_nobody_out_and_are_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(PageServer, "REQUEST_S", 0.0)  # checked when the server is idle
    with PageServer(LOOPBACK, 0) as server, ExitStack() as idle:
        place = server.place
        opened = [idle.enter_context(socket.create_connection(place, 60)) for _ in range(50)]
        for each in opened:
            each.sendall(b"GET / HT")
        assert [each.recv(100) for each in opened] == [b""] * 50
    with PageServer(LOOPBACK, 0) as server, ExitStack() as idle:
        monkeypatch.setattr(PageServer, "REQUEST_S", 1e9)
        place = server.place
        opened = [idle.enter_context(socket.create_connection(place, 60)) for _ in range(50)]
        assert get(server, f"/{server.token}")[0] == 200
        monkeypatch.setattr(PageServer, "MOST_CONNECTIONS", 50)
        refused = idle.enter_context(socket.create_connection(place, 60))
        assert refused.recv(100) == b""


def test_a_viewer_that_reads_nothing_holds_no_other(
    server: PageServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_Viewer, "timeout", 0.5)
    large = {"text": "x" * (1 << 25)}  # beyond all buffers of a loopback
    before = {*threading.enumerate()}
    with socket.create_connection(server.place, 60) as slow:
        slow.sendall(f"GET /{server.token}/events HTTP/1.1\r\n\r\n".encode())
        assert slow.recv(1) == b"H"
        (thread,) = {*threading.enumerate()} - before
        monkeypatch.setattr(_Viewer, "timeout", 60.0)
        with closing(Viewer(server)) as quick:
            server.publish(large)
            assert quick.next() == large
            server.publish({"newer": 1})
            assert quick.next() == {"newer": 1}
        thread.join(60)  # without a read, it ends only by its timeout
        assert not thread.is_alive()


@pytest.mark.parametrize("words", [("--port", "8080"), ("--bind", "127.0.0.1")])
def test_options_of_the_page_require_it(tmp_path: Path, words: tuple[str, str]) -> None:
    Writer(tmp_path / "r1").journal.close()
    assert main(["watch", "r1", "--runs", str(tmp_path), *words]) == 2


def test_a_port_that_is_taken_is_refused(server: PageServer) -> None:
    with pytest.raises(HilcellError, match="--port"):
        PageServer(LOOPBACK, server.place[1])


def test_the_command_serves_until_it_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    validated_run(tmp_path / "r1").journal.close()
    found: list[int] = []

    def interrupt(_: float) -> None:
        found.append(get_url(json.loads(capsys.readouterr().out)["url"]))
        raise KeyboardInterrupt

    def get_url(url: str) -> int:
        host, _, token = url.removeprefix("http://").partition("/")
        with closing(HTTPConnection(host, timeout=60)) as connection:
            connection.request("GET", f"/{token}")
            return connection.getresponse().status

    monkeypatch.setattr("hilcell.commands.control.time.sleep", interrupt)
    assert main(["watch", "r1", "--runs", str(tmp_path), "--web", "--json"]) == 4
    assert found == [200]
