"""Cases measured by workers of Dask: processes of this PC, or a cluster by its scheduler."""

from __future__ import annotations

import asyncio
import itertools
import logging
import os
import secrets
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context

import dask
from distributed import Client, Future, KilledWorker, LocalCluster, as_completed
from distributed.client import FutureCancelledError
from distributed.comm.core import CommClosedError, connect
from distributed.security import Security

from hilcell.decoding import typed
from hilcell.errors import HilcellError
from hilcell.run.signals import postponed
from hilcell.study.case import FAILED, Found, measured, versions
from hilcell.study.design import Case

CONNECT_S = 5.0
ANSWER_S = 15.0  # of a scheduler to its first question
VERSIONS_S = 15.0  # of all workers to the question for their versions
SCHEDULER_S = 60.0  # of a scheduler at work to any question
WORKERS_S = 60.0  # without any worker
LOOK_S = 5.0  # between two looks whether there are workers, and whether they answer
SILENT_S = 15.0  # two to thirty heartbeats, by the number of workers
RESTARTED_S = 60.0  # in which a worker of this PC that froze has been restarted
SETTINGS = {
    "distributed.comm.timeouts.connect": f"{CONNECT_S:g}s",
    "distributed.comm.retry.count": 0,
    "distributed.admin.log-length": 100,
    "distributed.scheduler.allowed-failures": 1,  # a second worker tries
    "distributed.scheduler.worker-ttl": f"{RESTARTED_S / 2:g}s",  # Dask looks as often
}
DROPPED = "after 5 to 10 minutes, or once to twice the scheduler's worker-ttl"
Say = Callable[[str], object]  # takes a message for the user
LOST = (asyncio.CancelledError, FutureCancelledError, CommClosedError, OSError, TimeoutError)


class Cluster(HilcellError):
    """The scheduler or its workers cannot be used, or are gone."""

    code = "HC-D01"


@dataclass(slots=True)
class Heartbeat:
    """The last of a worker: by the scheduler's clock, and since when it is known here."""

    scheduler_s: float
    since_s: float
    silent: bool = False  # the user knows


class Workers:
    """Workers that all have this hilcell's versions.

    ``say`` takes a message on each that does not answer; ``dropped`` says when Dask drops it.
    """

    def __init__(self, client: Client, name: str, say: Say, dropped: str) -> None:
        self._client, self._name = client, name
        self._say, self._dropped = say, dropped
        self._token = secrets.token_hex(4)
        self._versions = versions()
        self._looked_s = self._seen_s = time.monotonic()  # since when there may be no worker
        self._heartbeats: dict[str, Heartbeat] = {}

    def measure(self, cases: Iterable[tuple[Case, bytes]]) -> Iterator[tuple[Case, Found]]:
        """Yield cases as they are measured; they come with their cells, a little ahead of workers.

        A case whose worker died each time may have been beside the one that killed it: in the end
        it is measured again, alone. Raises `Cluster` where the scheduler or all workers are gone,
        or a worker has other versions.
        """
        killed: list[tuple[Case, bytes]] = []
        ahead = max(64, 4 * len(self._workers()))  # handed over before they are needed
        for case, cell, found in self._measured(cases, ahead, "case"):
            if isinstance(found, KilledWorker):
                killed.append((case, cell))
            else:
                yield case, found
        why = "its worker was killed each time, alone at last; the last one was"
        for case, _, found in self._measured(killed, 1, "alone"):
            if isinstance(found, KilledWorker):
                yield case, Found(FAILED, f"{why} {found.last_worker.address}")
            else:
                yield case, found

    def _measured(
        self, cases: Iterable[tuple[Case, bytes]], ahead: int, how: str
    ) -> Iterator[tuple[Case, bytes, Found | KilledWorker]]:
        waiting, running = iter(cases), as_completed(loop=self._client.loop)
        asked: dict[str, tuple[Case, bytes]] = {}
        with self._lost_is_an_error():
            while True:
                for case, cell in itertools.islice(waiting, ahead - len(asked)):
                    future = self._client.submit(
                        measured,
                        cell,
                        case.machine,
                        case.seed,
                        self._versions,
                        key=f"{how}-{case.number}-{self._token}",
                        priority=-case.number,
                    )
                    asked[future.key] = case, cell
                    running.add(future)
                if not asked:
                    return
                self._look()
                while not running.has_ready():
                    time.sleep(0.02)
                    self._look()
                future = next(running)
                yield *asked.pop(future.key), self._found(future)
                future.release()

    def _look(self) -> None:
        """Now and then raise `Cluster` where there are no workers, and name those that froze."""
        now_s = time.monotonic()
        if not now_s - self._looked_s >= LOOK_S:
            return
        self._looked_s = now_s
        found = self._workers()
        if found:
            self._seen_s = now_s
        if not now_s - self._seen_s < WORKERS_S:
            raise Cluster(f"{self._name} has had no worker for {WORKERS_S:g} s")
        for address, scheduler_s in found.items():
            last = self._heartbeats.get(address)
            if last is None or last.scheduler_s != scheduler_s:
                self._heartbeats[address] = Heartbeat(scheduler_s, now_s)
            elif not last.silent and now_s - last.since_s >= SILENT_S:
                last.silent = True
                self._say(
                    f"{self._name}: worker {address} has not answered for {SILENT_S:g} s; if it "
                    f"stays silent, its cases are measured by another, {self._dropped}"
                )

    def _workers(self) -> Mapping[str, float]:
        """Return by address when, by its clock, the scheduler heard of each worker."""
        with self._lost_is_an_error():
            return self._last_heartbeats()

    def _found(self, future: Future[Found]) -> Found | KilledWorker:
        try:
            found = self._result(future)
        except KilledWorker as error:
            return error
        except LOST:
            raise
        except Exception as error:  # a worker that joined without hilcell, or with an older one
            raise Cluster(
                f"{self._name}: a worker cannot measure: {type(error).__name__}: {error}"
            ) from error
        if found.versions:
            self.check_versions()
            raise Cluster(f"{self._name}: a worker had {self._differences(found.versions)}")
        return found

    def _result(self, future: Future[Found]) -> Found:
        """Return what a worker found; it may have frozen before it sent that."""
        while True:
            with suppress(TimeoutError):
                found: Found = future.result(timeout=LOOK_S)
                return found
            self._look()

    def _last_heartbeats(self) -> Mapping[str, float]:
        # `Client.nthreads` would wait for ever.
        found = self._client.sync(self._client.scheduler.identity, callback_timeout=SCHEDULER_S)
        return {each: typed(last["last_seen"], float) for each, last in found["workers"].items()}

    def check_versions(self) -> None:
        """Raise `Cluster` where a worker has other versions, several threads, or is silent."""
        client, name = self._client, self._name
        before = self._last_heartbeats()
        try:
            found: dict[str, dict[str, str] | Exception] = client.run(
                versions, on_error="return", callback_timeout=VERSIONS_S
            )
        except TimeoutError as error:
            after = self._last_heartbeats()
            silent = [address for address, seen_s in before.items() if after.get(address) == seen_s]
            raise Cluster(
                f"{name}: worker {', '.join(silent) or 'unknown'} does not answer; end it, or wait "
                f"until Dask drops it, {DROPPED}"
            ) from error
        except LOST as error:
            raise Cluster(f"{name} is gone: {error}") from error
        problems = []
        for address, there in sorted(found.items()):
            if isinstance(there, Exception):
                problems.append(f"{address}: hilcell cannot be used there: {there}")
            elif there != self._versions:
                problems.append(f"{address}: {self._differences(there)}")
        many = {address: n for address, n in client.nthreads().items() if n > 1}
        problems += [
            f"{address}: {n} threads, expected --nthreads 1" for address, n in many.items()
        ]
        if problems:
            raise Cluster(f"{name}: workers differ: {'; '.join(problems)}")

    @staticmethod
    def _differences(there: Mapping[str, str]) -> str:
        here = versions()
        return ", ".join(
            f"{name} {there.get(name, 'none')} (here {here[name]})"
            for name in here
            if there.get(name) != here[name]
        )

    @contextmanager
    def _lost_is_an_error(self) -> Iterator[None]:
        try:
            yield
        except LOST as error:
            raise Cluster(f"{self._name} is gone") from error


@contextmanager
def local_workers(count: int, say: Say) -> Iterator[Workers]:
    """Start worker processes on this PC, one thread each; end them."""
    environment = {"OMP_NUM_THREADS": "1", "DASK_LOGGING__DISTRIBUTED": "critical"}
    with _quiet(), _environment(environment), ExitStack() as stack:
        try:
            get_context("spawn").Lock()  # they share some: without /dev/shm there is none
            # Ctrl-C reaches all processes of a terminal; a cluster that is half started would stay.
            with postponed(signal.SIGTERM, signal.SIGHUP), ExitStack() as undo:
                # Processes that are started meanwhile ignore it for good.
                before = signal.signal(signal.SIGINT, signal.SIG_IGN)
                undo.callback(signal.signal, signal.SIGINT, before)
                cluster = stack.enter_context(
                    LocalCluster(
                        n_workers=count,
                        threads_per_worker=1,
                        processes=True,
                        host="127.0.0.1",
                        dashboard_address=None,
                        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # not 8787
                    )
                )
        except (OSError, RuntimeError) as error:
            raise Cluster(
                f"this PC starts no workers: {getattr(error, 'strerror', None) or error}; is there "
                "a /dev/shm, and memory?"
            ) from error
        client = stack.enter_context(Client(cluster))
        yield Workers(client, "the local cluster", say, f"within {RESTARTED_S:g} s")


@contextmanager
def workers_of(scheduler: str, say: Say) -> Iterator[Workers]:
    """Use the workers of a scheduler; raises `Cluster` where they cannot be used."""
    name = f"scheduler {scheduler}"
    with _quiet(), ExitStack() as stack:
        try:
            asyncio.run(asyncio.wait_for(_asked(scheduler), ANSWER_S))
            client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:  # whatever listens there may answer anything
            reason = str(error).partition("\n")[0] or f"nothing came for {ANSWER_S:g} s"
            raise Cluster(
                f"{name} does not answer: {reason}; start it with `dask scheduler`, or leave "
                "--scheduler out"
            ) from error
        stack.callback(_close, client)
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            raise Cluster(
                f"{name} has no worker after {WORKERS_S:g} s; start one with "
                f"`dask worker {scheduler} --nthreads 1`"
            ) from None
        workers = Workers(client, name, say, DROPPED)
        workers.check_versions()
        yield workers


async def _asked(scheduler: str) -> None:
    """Ask a scheduler who it is; a client that is refused would go on trying while it is closed."""
    found = await connect(scheduler, timeout=CONNECT_S, **Security().get_connection_args("client"))
    try:
        await found.write({"op": "identity", "reply": True})
        await found.read()
    finally:
        found.abort()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's own log off the terminal: hilcell says what matters once."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with dask.config.set(SETTINGS):
            yield
    finally:
        logging.disable(before)


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set variables that processes inherit which are started meanwhile."""
    before = {name: os.environ[name] for name in values if name in os.environ}
    os.environ.update(values)
    try:
        yield
    finally:
        for name in values:
            del os.environ[name]
        os.environ.update(before)


def _close(client: Client) -> None:
    with suppress(*LOST):
        client.close(timeout=2.0)
    client.status = "closed"  # else Dask tries again when the object is deleted
