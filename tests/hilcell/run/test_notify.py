"""Notifications: a command gets each event as JSON, and can neither delay nor disturb the run."""

from __future__ import annotations

import json
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import pytest

from hilcell.cell.file import NotifyEvent, NotifyTable, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.commands.cli import main
from hilcell.errors import DeviceError
from hilcell.journal.journal import Record
from hilcell.journal.log import RunJournal
from hilcell.journal.runs import JOURNAL, read_log
from hilcell.model.events import NotificationFailed
from hilcell.run import notify
from hilcell.run.notify import Notifier, cleaned
from tests.fakes.rail_bench import until
from tests.hilcell.report.journals import Writer, plan_record
from tests.leaks import children

pytestmark = pytest.mark.process

PAPER = Path(__file__).parents[3] / "hilcell/cells/paper.toml"
KEEP = "import sys; open(sys.argv[1], 'a').write(sys.stdin.read() + '\\n')"


def keeping(file: Path) -> list[str]:
    """Return a command that adds each event to a file."""
    return [sys.executable, "-c", KEEP, str(file)]


def events_in(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


class Session:
    """One session of a run with notifications; records are written as its runner does."""

    def __init__(self, folder: Path, command: list[str], *events: NotifyEvent) -> None:
        Writer(folder, job="J\x1b[2J-17").left()
        self.journal, self.said = RunJournal(folder / JOURNAL, "r1", create=False), list[str]()
        chosen = {"events": [*events]} if events else {}
        table = NotifyTable(command=command, **chosen)
        self.notifier = Notifier(table, self.journal, folder, self.said.append)

    def __enter__(self) -> Session:
        self.notifier.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self.notifier.__exit__(None, None, None)
        self.journal.close()

    def state(self, to: str, **more: Any) -> Record:
        return self.journal.append("state", "", {"machine": "run", "to": to} | more)

    def ended(self, state: str = "finished", code: int = 0) -> None:
        self.state(state)
        self.journal.append("end", "", {"state": state, "exit": code, "result": {}})
        self.notifier.ended(code, None)


PROMPT = {"title": "Seat the reflector in P1", "text": "Take it\nand seat it.", "by_itself": False}
LOST = DeviceError("HC-T02", "Tracker", "measure", "no\x07 answer").facts()


def run_through(session: Session) -> None:
    session.state("checking")
    session.state("running")
    session.state("suspended", reason="P1", prompt=PROMPT)
    session.state("running")
    session.state("suspended", reason="the room", prompt=PROMPT | {"by_itself": True})
    session.state("running")
    session.state("paused", reason="the screen was lost")
    session.state("faulted", reason="no answer", error=LOST)
    session.journal.append("end", "", {"state": "faulted", "exit": 3, "result": {}, "error": LOST})
    session.notifier.ended(3, None)


def test_the_command_gets_each_event_as_clean_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notify, "REST_S", 60.0)  # this PC may be busy
    monkeypatch.setattr(notify, "CLOSING_S", 120.0)
    file = tmp_path / "events"
    with Session(tmp_path / "r1", keeping(file)) as session:
        run_through(session)
    found = events_in(file)
    assert [each["event"] for each in found] == [
        "prompt", "suspension", "suspension", "alarm", "end",
    ]  # fmt: skip
    assert all(each["run"] == "r1" and each["simulated"] is True for each in found)
    assert found[0]["text"] == "Seat the reflector in P1: Take it and seat it."
    assert found[2]["text"] == "paused: the screen was lost"
    assert found[3]["code"] == "HC-T02"
    assert found[3]["do"]
    assert found[4]["exit"] == 3
    assert found[4]["text"].startswith("FAULT HC-T02 (simulated): ")
    assert found[4]["next"][-1].startswith("hilcell resume r1")
    texts = [text for each in found for text in each.values() if isinstance(text, str)]
    assert [text for text in texts if not text.isprintable()] == []


def test_only_chosen_events_run_the_command(tmp_path: Path) -> None:
    file = tmp_path / "events"
    with Session(tmp_path / "r1", keeping(file), "end") as session:
        run_through(session)
    assert [each["event"] for each in events_in(file)] == ["end"]


def failures(folder: Path) -> list[tuple[str, str]]:
    log = read_log(folder)
    return [(each.event, each.reason) for each in log.happened(NotificationFailed)]


MISSING, FAILS = ["/nowhere/notify"], [sys.executable, "-c", "raise SystemExit(3)"]
KILLED = [sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (MISSING, "cannot be started: No such file"),
        (["/"], "cannot be started: "),
        (FAILS, "exit code 3"),
        (KILLED, "signal 9"),
    ],
)
def test_a_command_that_fails_is_journalled_with_its_reason(
    tmp_path: Path, command: list[str], why: str
) -> None:
    with Session(tmp_path / "r1", command, "end") as session:
        session.ended()
    ((event, reason),) = failures(tmp_path / "r1")
    assert event == "end"
    assert why in reason
    assert session.said == []


HANGS = [sys.executable, "-c", "import time; time.sleep(1000)"]
FLOODS = [sys.executable, "-c", "while True: print('x' * 65536)"]


@pytest.mark.parametrize("command", [HANGS, FLOODS])
def test_a_command_that_hangs_delays_neither_the_run_nor_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    """It does not read its input either, of which a pipe would hold a part only."""
    monkeypatch.setattr(notify, "REST_S", 0.3)
    monkeypatch.setattr(notify, "END_S", 0.3)
    monkeypatch.setattr(notify, "CLOSING_S", 120.0)  # a loaded PC writes 21 failures slowly
    monkeypatch.setattr(notify, "LIMIT_S", 1e6)  # a record that waits for a command never returns
    before = children()
    with Session(tmp_path / "r1", command) as session:
        for _ in range(20):
            session.state("paused", reason="x" * 100_000)
            session.state("running")
        until(lambda: not children().keys() <= before.keys())  # the first command hangs
        session.ended()
    found = failures(tmp_path / "r1")
    assert [event for event, _ in found] == [*["suspension"] * 20, "end"]
    assert "hangs" in found[0][1]
    assert "hangs" in found[-1][1]
    assert "not sent" in found[-2][1]


def test_a_journal_that_cannot_take_a_failure_is_said(tmp_path: Path) -> None:
    with Session(tmp_path / "r1", MISSING, "end") as session:
        session.state("finished")
        (tmp_path / "r1" / JOURNAL).unlink()
        session.notifier.ended(7, OSError("full"))
    assert "No such file" in session.said[-1]


def test_all_texts_are_one_clean_line() -> None:
    assert cleaned({"a": ["x\ny\x1b", 1, None, ("\u202e",)]}) == {
        "a": ["x y\N{REPLACEMENT CHARACTER}", 1, None, ["\N{REPLACEMENT CHARACTER}"]]
    }


# -- the cell file ---------------------------------------------------------------------------------


def test_a_command_is_a_list_or_one_text_that_no_shell_reads() -> None:
    text = "/bin/notify --to 'the office' $HOME; rm"
    assert NotifyTable(command=text).words == ["/bin/notify", "--to", "the office", "$HOME;", "rm"]
    assert load_cell("paper").notify is None


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("command", "", "notify.command: expected a program"),
        ("command", "[]", "notify.command: expected a program"),
        ("command", "mail 'office", "notify.command: no closing quotation"),
        ("command", "a\0b", "notify.command: expected no NUL"),
        ("shell", "true", "notify.shell: unknown key"),
        ("events", '["ends"]', "notify.events"),
    ],
)
def test_a_table_that_is_wrong_is_refused_with_its_place(key: str, value: str, why: str) -> None:
    with pytest.raises(SettingsError) as refused:
        load_cell("paper", {"notify.command": "true", f"notify.{key}": value})
    assert why in str(refused.value)


# -- whole runs ------------------------------------------------------------------------------------


def runs_of(tmp_path: Path, command: str) -> Path:
    """Return a cell file with the command."""
    cell = tmp_path / "cell.toml"
    cell.write_text(f"{PAPER.read_text()}\n[notify]\ncommand = {command}\n")
    return cell


def test_a_run_notifies_once_of_its_end_and_a_dry_run_of_nothing(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    file = tmp_path / "events"
    cell = runs_of(tmp_path, json.dumps(keeping(file)))
    words = ["run", "home", "--cell", str(cell), "--runs", str(tmp_path / "runs"), "--json"]
    assert main([*words, "--dry-run"]) == 0
    assert not file.exists()
    assert main([*words, "--unattended", "--name", "r"]) == 0
    (end,) = events_in(file)
    assert (end["event"], end["exit"], end["cell"]) == ("end", 0, "paper")
    assert end["text"].startswith("DONE (simulated)")
    assert json.loads(capfdbinary.readouterr().out.splitlines()[-1])["kind"] == "end"


def test_the_end_is_the_last_line_though_its_notification_fails(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    cell, runs = runs_of(tmp_path, '"/nowhere/notify"'), ["--runs", str(tmp_path / "runs")]
    words = ["run", "home", "--cell", str(cell), *runs, "--json", "--unattended", "--name", "r"]
    assert main(words) == 0
    assert json.loads(capfdbinary.readouterr().out.splitlines()[-1])["kind"] == "end"
    assert [event for event, _ in failures(tmp_path / "runs" / "r")] == ["end"]
    assert main(["show", "r", "--check", *runs]) == 0


@pytest.mark.parametrize("in_file", [True, False])
def test_a_resumed_run_takes_the_command_of_its_cell_file_never_of_the_journal(
    tmp_path: Path, in_file: bool
) -> None:
    """A journal may come from anywhere."""
    file, bad = tmp_path / "events", tmp_path / "bad"
    cell = runs_of(tmp_path, json.dumps(keeping(file)))
    if not in_file:
        cell.write_text(PAPER.read_text())
    plan = plan_record()
    plan["cell"]["notify"] = {"command": keeping(bad)}
    folder = tmp_path / "runs" / "r"
    writer = Writer(folder, cell_file=str(cell), cell=plan["cell"])
    writer.state("run", "checking")
    writer.left()
    runs = ["--runs", str(tmp_path / "runs")]
    assert main(["resume", "r", *runs, "--unattended", "--accept-changes"]) == 0
    assert len(events_in(file)) == in_file
    assert not bad.exists()


# -- the recipes of the manual ---------------------------------------------------------------------


class Office(BaseHTTPRequestHandler):
    """Takes what a webhook posts."""

    posted: ClassVar[list[Any]] = []

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.posted.append(json.loads(body))
        self.send_response(200)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the name of its parent
        """Print nothing."""


def test_the_webhook_of_the_manual_posts_the_last_word(tmp_path: Path) -> None:
    Office.posted.clear()
    address = tmp_path / "address"
    script = Path(__file__).parents[3] / "docs/examples/notify_webhook.py"
    with ThreadingHTTPServer(("127.0.0.1", 0), Office) as office:
        serving = threading.Thread(target=office.serve_forever)
        serving.start()
        try:
            address.write_text(f"http://127.0.0.1:{office.server_port}/hook\n")
            command = [sys.executable, str(script), str(address)]
            with Session(tmp_path / "r1", command, "end") as session:
                session.ended()
        finally:
            office.shutdown()
            serving.join()
    assert failures(tmp_path / "r1") == []
    (posted,) = Office.posted
    assert posted["text"].startswith("paper, run r1: DONE (simulated)")
