"""Dask workers that simulate cases: processes on this PC, or a cluster by its scheduler."""

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
from hilcell.study.case import FAILED, CaseResult, calibrate_case, versions
from hilcell.study.design import Case

CONNECT_S = 5.0
ANSWER_S = 15.0  # first reply of a scheduler
VERSIONS_S = 15.0  # reply of all workers with their versions
SCHEDULER_S = 60.0  # any reply of a busy scheduler
WORKERS_S = 60.0  # longest time without a worker
POLL_S = 5.0  # period of checks that workers exist and answer
SILENT_S = 15.0  # two to thirty heartbeats, by the number of workers
RESTARTED_S = 60.0  # until a frozen worker on this PC is restarted
SETTINGS = {
    "distributed.comm.timeouts.connect": f"{CONNECT_S:g}s",
    "distributed.comm.retry.count": 0,
    "distributed.admin.log-length": 100,
    "distributed.scheduler.allowed-failures": 1,  # a second worker tries
    "distributed.scheduler.worker-ttl": f"{RESTARTED_S / 2:g}s",  # also Dask's polling period
    "distributed.worker.profile.enabled": False,  # its samples take memory and processor
    "distributed.scheduler.http.routes": [],  # pages that every user of the PC could read
    "distributed.worker.http.routes": [],
}
DROPPED = "after 5 to 10 minutes, or once to twice the scheduler's worker-ttl"
Say = Callable[[str], object]  # takes a message for the user
LOST = (asyncio.CancelledError, FutureCancelledError, CommClosedError, OSError, TimeoutError)


class ClusterError(HilcellError):
    """The scheduler or its workers cannot be used, or were lost."""

    code = "HC-D01"


@dataclass(slots=True)
class Heartbeat:
    """A worker's last heartbeat by the scheduler's clock, and since when it is the last."""

    scheduler_s: float
    since_s: float
    silent: bool = False  # reported


class Workers:
    """Workers with the versions of this PC.

    ``say`` receives a message about each silent worker, ``dropped`` tells when Dask drops it.
    """

    def __init__(self, client: Client, name: str, say: Say, dropped: str) -> None:
        self._client, self._name = client, name
        self._say, self._dropped = say, dropped
        self._token = secrets.token_hex(4)
        self._versions = versions()
        self._polled_s = self._alive_s = time.monotonic()  # since when there may be no worker
        self._heartbeats: dict[str, Heartbeat] = {}

    def measure(self, cases: Iterable[tuple[Case, bytes]]) -> Iterator[tuple[Case, CaseResult]]:
        """Yield the results of cases with their cells, submitted shortly before they are needed.

        A case whose worker was killed each time may not be the cause: it is repeated alone at the
        end. Raises `ClusterError` if the scheduler or all workers are lost, or versions differ.
        """
        killed: list[tuple[Case, bytes]] = []
        ahead = max(64, 4 * len(self._workers()))
        for case, cell, found in self._measured(cases, ahead, "case"):
            if isinstance(found, KilledWorker):
                killed.append((case, cell))
            else:
                yield case, found
        why = "its worker was killed each time, also alone; the last one was"
        for case, _, found in self._measured(killed, 1, "alone"):
            if isinstance(found, KilledWorker):
                yield case, CaseResult(FAILED, f"{why} {found.last_worker.address}")
            else:
                yield case, found

    def _measured(
        self, cases: Iterable[tuple[Case, bytes]], ahead: int, how: str
    ) -> Iterator[tuple[Case, bytes, CaseResult | KilledWorker]]:
        waiting, running = iter(cases), as_completed(loop=self._client.loop)
        submitted: dict[str, tuple[Case, bytes]] = {}
        with self._lost_is_an_error():
            while True:
                for case, cell in itertools.islice(waiting, ahead - len(submitted)):
                    future = self._client.submit(
                        calibrate_case,
                        cell,
                        case.machine,
                        case.seed,
                        self._versions,
                        key=f"{how}-{case.number}-{self._token}",
                        priority=-case.number,
                    )
                    submitted[future.key] = case, cell
                    running.add(future)
                if not submitted:
                    return
                self._poll()
                while not running.has_ready():
                    time.sleep(0.02)
                    self._poll()
                future = next(running)
                yield *submitted.pop(future.key), self._checked(future)
                future.release()

    def _poll(self) -> None:
        """Raise `ClusterError` without workers, and report silent ones; once in `POLL_S`."""
        now_s = time.monotonic()
        if not now_s - self._polled_s >= POLL_S:
            return
        self._polled_s = now_s
        workers = self._workers()
        if workers:
            self._alive_s = now_s
        if not now_s - self._alive_s < WORKERS_S:
            raise ClusterError(f"{self._name} has had no worker for {WORKERS_S:g} s")
        for address, scheduler_s in workers.items():
            last = self._heartbeats.get(address)
            if last is None or last.scheduler_s != scheduler_s:
                self._heartbeats[address] = Heartbeat(scheduler_s, now_s)
            elif not last.silent and now_s - last.since_s >= SILENT_S:
                last.silent = True
                self._say(
                    f"{self._name}: worker {address} has not answered for {SILENT_S:g} s; if it "
                    f"stays silent, another repeats its cases, {self._dropped}"
                )

    def _workers(self) -> Mapping[str, float]:
        """Return the last heartbeat of each worker, by address, by the scheduler's clock."""
        with self._lost_is_an_error():
            return self._last_heartbeats()

    def _checked(self, future: Future[CaseResult]) -> CaseResult | KilledWorker:
        try:
            result = self._result(future)
        except KilledWorker as error:
            return error
        except LOST:
            raise
        except Exception as error:  # a new worker without hilcell, or with an older one
            raise ClusterError(
                f"{self._name}: a worker failed: {type(error).__name__}: {error}"
            ) from error
        if result.versions:
            self.check_versions()
            raise ClusterError(f"{self._name}: a worker had {self._differences(result.versions)}")
        return result

    def _result(self, future: Future[CaseResult]) -> CaseResult:
        """Return a worker's result; the worker may freeze before it is transferred."""
        while True:
            with suppress(TimeoutError):
                result: CaseResult = future.result(timeout=POLL_S)
                return result
            self._poll()

    def _last_heartbeats(self) -> Mapping[str, float]:
        # `Client.nthreads` would wait forever.
        status = self._client.sync(self._client.scheduler.identity, callback_timeout=SCHEDULER_S)
        return {each: typed(last["last_seen"], float) for each, last in status["workers"].items()}

    def check_versions(self) -> None:
        """Raise `ClusterError` if a worker has other versions, several threads, or is silent."""
        client, name = self._client, self._name
        before = self._last_heartbeats()
        try:
            replies: dict[str, dict[str, str] | Exception] = client.run(
                versions, on_error="return", callback_timeout=VERSIONS_S
            )
        except TimeoutError as error:
            after = self._last_heartbeats()
            silent = [address for address, seen_s in before.items() if after.get(address) == seen_s]
            raise ClusterError(
                f"{name}: worker {', '.join(silent) or 'unknown'} does not answer; end it, or wait "
                f"until Dask drops it, {DROPPED}"
            ) from error
        except LOST as error:
            raise ClusterError(f"{name} was lost: {error}") from error
        problems = []
        for address, reply in sorted(replies.items()):
            if isinstance(reply, Exception):
                problems.append(f"{address}: hilcell cannot be used there: {reply}")
            elif reply != self._versions:
                problems.append(f"{address}: {self._differences(reply)}")
        many = {address: n for address, n in client.nthreads().items() if n > 1}
        problems += [
            f"{address}: {n} threads, expected --nthreads 1" for address, n in many.items()
        ]
        if problems:
            raise ClusterError(f"{name}: workers differ: {'; '.join(problems)}")

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
            raise ClusterError(f"{self._name} was lost") from error


@contextmanager
def local_workers(count: int, say: Say) -> Iterator[Workers]:
    """Start worker processes on this PC, one thread each; end them.

    They, their scheduler and this process talk by TLS with certificates that only they have: every
    other user of the PC could run code as this one by a loopback port without them.
    """
    environment = {"OMP_NUM_THREADS": "1", "DASK_LOGGING__DISTRIBUTED": "critical"}
    with _quiet(), _environment(environment), ExitStack() as stack:
        try:
            get_context("spawn").Lock()  # fails without /dev/shm, as the workers would
            # Ctrl-C reaches all processes of a terminal, and would leave a half-started cluster.
            with postponed(signal.SIGTERM, signal.SIGHUP), ExitStack() as undo:
                # Child processes inherit the ignored signal.
                before = signal.signal(signal.SIGINT, signal.SIG_IGN)
                undo.callback(signal.signal, signal.SIGINT, before)
                cluster = stack.enter_context(
                    LocalCluster(
                        n_workers=count,
                        threads_per_worker=1,
                        processes=True,
                        protocol="tls://",
                        security=Security.temporary(),
                        host="127.0.0.1",
                        dashboard_address=None,
                        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # not 8787
                    )
                )
        except (OSError, RuntimeError) as error:
            raise ClusterError(
                f"cannot start workers: {getattr(error, 'strerror', None) or error}; check shared "
                "memory (/dev/shm) and free memory"
            ) from error
        client = stack.enter_context(Client(cluster))
        yield Workers(client, "the local cluster", say, f"within {RESTARTED_S:g} s")


@contextmanager
def scheduler_workers(scheduler: str, say: Say) -> Iterator[Workers]:
    """Use the workers of a scheduler; raises `ClusterError`."""
    name = f"scheduler {scheduler}"
    with _quiet(), ExitStack() as stack:
        try:
            asyncio.run(asyncio.wait_for(_read_identity(scheduler), ANSWER_S))
            client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:  # another server may listen there
            reason = str(error).partition("\n")[0] or f"no reply in {ANSWER_S:g} s"
            raise ClusterError(
                f"{name} does not answer: {reason}; start it with `dask scheduler`, or omit "
                "--scheduler"
            ) from error
        stack.callback(_close, client)
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            raise ClusterError(
                f"{name} has no worker after {WORKERS_S:g} s; start one with "
                f"`dask worker {scheduler} --nthreads 1`"
            ) from None
        workers = Workers(client, name, say, DROPPED)
        workers.check_versions()
        yield workers


async def _read_identity(scheduler: str) -> None:
    """Read a scheduler's identity: unlike this, a refused `Client` retries while it is closed."""
    comm = await connect(scheduler, timeout=CONNECT_S, **Security().get_connection_args("client"))
    try:
        await comm.write({"op": "identity", "reply": True})
        await comm.read()
    finally:
        comm.abort()


@contextmanager
def _quiet() -> Iterator[None]:
    """Disable Dask's log: hilcell reports problems once."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with dask.config.set(SETTINGS):
            yield
    finally:
        logging.disable(before)


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
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
    client.status = "closed"  # else Dask retries when the object is deleted
