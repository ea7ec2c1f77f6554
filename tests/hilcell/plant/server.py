"""A PostgreSQL server in a folder of its own, on a socket there."""

from __future__ import annotations

import os
import pwd
import secrets
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import psycopg

from tests.whole.bench import children, wait_gone

BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
PLACES = os.pathsep.join([os.environ.get("PATH", ""), *map(str, BINARIES)])
# Processes are killed, not the machine: the system keeps what was written to its files.
FAST = ("fsync=off", "full_page_writes=off", "shared_buffers=32MB")
READY_S = 60.0
BLANK = "blank"  # a database with the plant's tables, of which others are copies


def program(name: str) -> str | None:
    return shutil.which(name, path=PLACES)


MISSING = "" if program("initdb") and program("pg_ctl") else (
    "POSTGRESQL IS NOT INSTALLED: nothing of the plant's server is tested "
    "(apt-get install postgresql)"
)  # fmt: skip


class Server:
    """A server that tests kill and start again."""

    def __init__(self, folder: Path, settings: tuple[str, ...] = FAST) -> None:
        self._folder, self._settings = folder, settings
        self._user = _user()
        if self._user:
            shutil.chown(folder, self._user)
        self._data = folder / "data"

    def init(self) -> None:
        self._do("initdb", "-D", self._data, "-U", "owner", "-A", "trust", "-N", "-E", "UTF8")

    def start(self) -> None:
        options = f"-k {self._folder} -c listen_addresses= "
        options += " ".join(f"-c {setting}" for setting in self._settings)
        log = self._folder / "log"
        self._do("pg_ctl", "start", "-w", "-t", READY_S, "-D", self._data, "-l", log, "-o", options)

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Let it stand still, as on a disk that hangs: its system still takes connections."""
        pid = self._pid()
        try:
            os.kill(pid, signal.SIGSTOP)  # first: then it has no further children
            _signal(children(pid), signal.SIGSTOP)
            yield
        finally:
            _signal([pid, *children(pid)], signal.SIGCONT)

    def kill(self) -> None:
        """Kill it as a power loss would: every process at once."""
        family = [self._pid(), *children(self._pid())]
        _signal(family, signal.SIGKILL)
        for each in family:
            wait_gone(each)
        # Where nobody reaps it, a dead server's number looks alive to the next one.
        for left in (self._data / "postmaster.pid", *self._folder.glob(".s.PGSQL.*")):
            left.unlink(missing_ok=True)

    @property
    def runs(self) -> bool:
        """Whether it was started and not killed since."""
        return (self._data / "postmaster.pid").exists()

    def stop(self) -> None:
        if self.runs:
            self._do("pg_ctl", "stop", "-m", "immediate", "-D", self._data)

    def ask_password(self, user: str) -> None:
        """Let a user in by a password alone, from the next connection on."""
        rules = self._data / "pg_hba.conf"
        asks = f"local all {user} scram-sha-256\nhost all {user} all scram-sha-256\n"
        rules.write_text(f"{asks}{rules.read_text()}")
        self._do("pg_ctl", "reload", "-D", self._data)

    def write(self, name: str, content: bytes) -> None:
        """Write a file of its own, which it alone may read."""
        path = self._data / name
        path.write_bytes(content)
        path.chmod(0o600)
        if self._user:
            shutil.chown(path, self._user)

    def url(self, database: str = "postgres", user: str = "owner") -> str:
        return f"postgresql://{user}@/{database}?host={self._folder}"

    def make(self, database: str = "", like: str = "template1") -> str:
        """Make a database like another, with a name of its own if it has none; return its URL."""
        database = database or f"plant_{secrets.token_hex(6)}"
        with psycopg.connect(self.url(), autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {database} TEMPLATE {like}".encode())
        return self.url(database)

    def _pid(self) -> int:
        return int((self._data / "postmaster.pid").read_text().split()[0])

    def _do(self, name: str, *words: object) -> None:
        place = program(name)
        assert place, f"{name} is not installed"
        environment: Mapping[str, str] = {"PATH": PLACES, "LC_ALL": "C"}
        log = self._folder / f"{name}.txt"  # a pipe would stay open as long as the server lives
        with log.open("w") as said:
            done = subprocess.run(
                [place, *map(str, words)],
                stdout=said, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                cwd=self._folder, env=environment, user=self._user or None, check=False,
            )  # fmt: skip
        assert done.returncode == 0, f"{log.read_text()}\n{self.log()}"

    def log(self) -> str:
        log = self._folder / "log"
        return log.read_text() if log.exists() else ""


@contextmanager
def server(settings: tuple[str, ...] = FAST) -> Iterator[Server]:
    with tempfile.TemporaryDirectory(prefix="hilcell-plant-") as folder:
        found = Server(Path(folder), settings)
        found.init()
        found.start()
        try:
            yield found
        finally:
            found.stop()


def _user() -> str:
    """Return the user of the server; initdb refuses root."""
    if os.geteuid() != 0:
        return ""
    known = {each.pw_name for each in pwd.getpwall()}
    return "postgres" if "postgres" in known else "nobody"


def _signal(pids: list[int], number: signal.Signals) -> None:
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)
