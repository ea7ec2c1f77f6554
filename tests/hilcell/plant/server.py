"""PostgreSQL servers of the tests: each in a folder of its own, on a socket there.

One is shared by all workers: the first makes and starts it, the last to leave ends it. Tests that
kill a server have one of their own, a copy of the shared one as it was when it was made.
"""

from __future__ import annotations

import fcntl
import os
import pwd
import secrets
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import IO

import psycopg

from hilcell.plant.database import Database

BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
PLACES = os.pathsep.join([os.environ.get("PATH", ""), *map(str, BINARIES)])
# Processes are killed, not the machine: the system keeps what was written to its files.
FAST = ("fsync=off", "full_page_writes=off", "shared_buffers=32MB")
READY_S = 60.0
BLANK = "blank"  # a database with the plant's tables, of which others are copies
MADE = "made"  # the folder of a server's data as it was when it was made


def program(name: str) -> str | None:
    """Return where a program of PostgreSQL is."""
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
        """Make its data."""
        self._do("initdb", "-D", self._data, "-U", "owner", "-A", "trust", "-N", "-E", "UTF8")

    def copy(self, to: Path) -> None:
        """Copy its data, with their owner, to another folder."""
        subprocess.run(["cp", "-a", self._data, to], check=True)

    def start(self) -> None:
        """Start it, and wait until it takes connections."""
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
            _signal(_children(pid), signal.SIGSTOP)
            yield
        finally:
            _signal([pid, *_children(pid)], signal.SIGCONT)

    def kill(self) -> None:
        """Kill it as a power loss would: every process at once."""
        family = [self._pid(), *_children(self._pid())]
        _signal(family, signal.SIGKILL)
        for each in family:
            _wait_gone(each)
        # Where nobody reaps it, a dead server's number looks alive to the next one.
        for left in (self._data / "postmaster.pid", *self._folder.glob(".s.PGSQL.*")):
            left.unlink(missing_ok=True)

    def stop(self) -> None:
        """End it, if it runs."""
        if (self._data / "postmaster.pid").exists():
            self._do("pg_ctl", "stop", "-m", "immediate", "-D", self._data)

    def ask_password(self, user: str) -> None:
        """Let a user in by a password alone, from the next connection on."""
        rules = self._data / "pg_hba.conf"
        rules.write_text(f"local all {user} scram-sha-256\n{rules.read_text()}")
        with psycopg.connect(self.url(), autocommit=True) as connection:
            connection.execute("SELECT pg_reload_conf()")

    def url(self, database: str = "postgres", user: str = "owner") -> str:
        """Return the URL of one of its databases."""
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
        """Return what it has logged."""
        log = self._folder / "log"
        return log.read_text() if log.exists() else ""


@contextmanager
def server(settings: tuple[str, ...] = FAST, made: Path | None = None) -> Iterator[Server]:
    """Run a server in a folder of its own; ``made`` are data that it begins with a copy of."""
    with tempfile.TemporaryDirectory(prefix="hilcell-plant-") as folder:
        found = Server(Path(folder), settings)
        if made is None:
            found.init()
        else:
            subprocess.run(["cp", "-a", made, Path(folder, "data")], check=True)
        found.start()
        try:
            yield found
        finally:
            found.stop()


@contextmanager
def shared_server(notes: Path) -> Iterator[tuple[Server, Path]]:
    """Run one server for all workers; yield it, and its data as they were when it was made.

    ``notes`` is a folder that all workers share; the server's own user may not enter it.
    """
    notes.mkdir(exist_ok=True)
    with (notes / "lock").open("w") as lock, (notes / "users").open("w") as users:
        with _held(lock):
            if not (notes / "place").exists():
                place = Path(tempfile.mkdtemp(prefix="hilcell-plant-"))
                _begin(Server(place), place / MADE)
                (notes / "place").write_text(str(place))
            fcntl.flock(users, fcntl.LOCK_SH)
        place = Path((notes / "place").read_text())
        try:
            yield Server(place), place / MADE
        finally:
            with _held(lock), suppress(BlockingIOError):
                fcntl.flock(users, fcntl.LOCK_EX | fcntl.LOCK_NB)
                Server(place).stop()
                (notes / "place").unlink()
                shutil.rmtree(place)


def _begin(server: Server, made: Path) -> None:
    server.init()
    server.copy(made)
    server.start()
    with closing(Database(server.make(BLANK))) as database:
        database.make()


@contextmanager
def _held(lock: IO[str]) -> Iterator[None]:
    fcntl.flock(lock, fcntl.LOCK_EX)
    try:
        yield
    finally:
        fcntl.flock(lock, fcntl.LOCK_UN)


def _user() -> str:
    """Return the user of the server; initdb refuses root."""
    if os.geteuid() != 0:
        return ""
    known = {each.pw_name for each in pwd.getpwall()}
    return "postgres" if "postgres" in known else "nobody"


def _children(pid: int) -> list[int]:
    found = []
    for path in Path("/proc").iterdir():
        if path.name.isdigit():
            with suppress(OSError):
                stat = (path / "stat").read_text().rsplit(")", 1)[1].split()
                found += [int(path.name)] if int(stat[1]) == pid else []
    return found


def _signal(pids: list[int], number: signal.Signals) -> None:
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def _wait_gone(pid: int) -> None:
    from tests.whole.bench import wait_gone

    wait_gone(pid)
