"""What a test leaves behind is seen and named, and only that."""

from __future__ import annotations

import socket
import subprocess
import tempfile
import threading
from pathlib import Path

import pytest

from tests.leaks import no_leaks


def test_a_thread_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.leaks.END_S", 0.01)
    end = threading.Event()
    thread = threading.Thread(target=end.wait, name="leaked")
    with pytest.raises(AssertionError, match="thread leaked"), no_leaks():
        thread.start()
    end.set()
    thread.join()


def test_an_open_file_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.leaks.END_S", 0.01)
    with tempfile.NamedTemporaryFile() as before, no_leaks():
        before.write(b"opened before")
    with pytest.raises(AssertionError, match=r"file .*hc-leaked"), no_leaks():
        left = tempfile.NamedTemporaryFile(prefix="hc-leaked")  # noqa: SIM115 - it leaks
    left.close()


def test_a_socket_is_named_with_its_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.leaks.END_S", 0.01)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with pytest.raises(AssertionError, match=rf"socket:.* {port}\)"), no_leaks():
            left = socket.create_connection(("127.0.0.1", port))
        left.close()


@pytest.mark.process
def test_a_process_is_named_and_known_by_its_number() -> None:
    """Between fork and exec it has its starter's command, as `sh` here has before `sleep`."""
    words = ["sh", "-c", "read go; exec sleep 300"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, text=True) as before:
        assert before.stdin is not None
        with no_leaks():
            before.stdin.write("go\n")
            before.stdin.flush()
            while b"sleep\0" not in Path(f"/proc/{before.pid}/cmdline").read_bytes():
                pass  # the test's time limit bounds the wait
        before.kill()
    with pytest.raises(AssertionError, match="process") as error, no_leaks():
        left = subprocess.Popen(["sleep", "300"])
    assert f"process {left.pid}:" in str(error.value)
    left.kill()
    left.wait()


def test_a_process_is_started_by_marked_tests_alone() -> None:
    with pytest.raises(AssertionError, match="marked `process`"):
        subprocess.Popen(["true"])
