"""Cases measured by workers of Dask: processes of this PC, or a cluster by its scheduler."""

from __future__ import annotations

import asyncio
import itertools
import logging
import os
import secrets
import signal
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import dask
from distributed import Client, Future, KilledWorker, LocalCluster, as_completed
from distributed.client import FutureCancelledError
from distributed.comm.core import CommClosedError

from hilcell.cell.file import Cell
from hilcell.study.case import FAILED, Row, measured, packed, versions
from hilcell.study.design import Case
from hilcell.study.errors import Cluster

CONNECT_S = 5.0
WORKERS_S = 60.0
AHEAD = 4  # cases a worker that are handed over before they are needed
LEAST_AHEAD = 64
SETTINGS = {
    "distributed.comm.timeouts.connect": f"{CONNECT_S:g}s",
    "distributed.comm.retry.count": 0,
    "distributed.admin.log-length": 100,
}
LOST = (asyncio.CancelledError, FutureCancelledError, CommClosedError, OSError, TimeoutError)


class Workers:
    """Workers that all have this hilcell's versions."""

    def __init__(self, client: Client, name: str) -> None:
        self._client, self._name = client, name
        self._token = secrets.token_hex(4)

    def measure(self, cases: Iterable[tuple[Case, Cell]]) -> Iterator[tuple[Case, Row]]:
        """Yield cases as they are measured; ``cases`` are read a little ahead of the workers.

        Raises `Cluster` where the scheduler is gone, or a worker has other versions.
        """
        waiting = iter(cases)
        running = as_completed(loop=self._client.loop)
        asked: dict[Any, Case] = {}
        ahead = max(LEAST_AHEAD, AHEAD * len(self._client.nthreads()))
        with self._lost_is_an_error():
            while True:
                for case, cell in itertools.islice(waiting, ahead - len(asked)):
                    future = self._submit(case, cell)
                    asked[future.key] = case
                    running.add(future)
                if not asked:
                    return
                future = next(running)
                yield asked.pop(future.key), self._found(future)
                future.release()

    def _submit(self, case: Case, cell: Cell) -> Future[Row]:
        return self._client.submit(
            measured,
            packed(cell),
            case.machine,
            case.seed,
            versions(),
            key=f"case-{case.number}-{self._token}",
            priority=-case.number,
        )

    def _found(self, future: Future[Row]) -> Row:
        try:
            row: Row = future.result()
        except KilledWorker as error:
            last = error.last_worker.address
            return {
                "state": FAILED,
                "reason": f"its worker was killed each time, the last one {last}",
                "minutes": None,
            }
        if other := row.get("other versions"):
            raise Cluster(f"{self._name}: a worker has {_differences(other)}")
        return row

    @contextmanager
    def _lost_is_an_error(self) -> Iterator[None]:
        try:
            yield
        except LOST as error:
            raise Cluster(
                f"{self._name} is gone; finished cases are kept, the same command goes on"
            ) from error


@contextmanager
def local_workers(count: int) -> Iterator[Workers]:
    """Start worker processes on this PC, one thread each; end them."""
    with _quiet(), ExitStack() as stack:
        os.environ["OMP_NUM_THREADS"] = "1"
        with _interrupts_ignored():  # ctrl-C reaches all processes of a terminal
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=None,
                )
            )
        client = stack.enter_context(Client(cluster))
        yield Workers(client, "the local cluster")


@contextmanager
def workers_of(scheduler: str) -> Iterator[Workers]:
    """Use the workers of a scheduler; raises `Cluster` where they cannot be used."""
    name = f"scheduler {scheduler}"
    with _quiet(), ExitStack() as stack:
        try:
            client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise Cluster(
                f"{name} does not answer: {str(error).splitlines()[0]}; start it with `dask "
                "scheduler`, or leave --scheduler out"
            ) from error
        stack.callback(_close, client)
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            raise Cluster(
                f"{name} has no worker after {WORKERS_S:g} s; start one with "
                f"`dask worker {scheduler} --nthreads 1`"
            ) from None
        _check_versions(client, name)
        yield Workers(client, name)


def _check_versions(client: Client, name: str) -> None:
    try:
        found: dict[str, Any] = client.run(versions, on_error="return")
    except LOST as error:
        raise Cluster(f"{name} is gone: {error}") from error
    problems = []
    for address, there in sorted(found.items()):
        if isinstance(there, Exception):
            problems.append(f"{address}: hilcell cannot be used there: {there}")
        elif there != versions():
            problems.append(f"{address}: {_differences(there)}")
    many = {address: n for address, n in client.nthreads().items() if n > 1}
    problems += [f"{address}: {n} threads, wanted --nthreads 1" for address, n in many.items()]
    if problems:
        raise Cluster(f"{name}: workers differ: {'; '.join(problems)}")


def _differences(there: Mapping[str, str]) -> str:
    here = versions()
    return ", ".join(
        f"{name} {there.get(name, 'none')} (here {here[name]})"
        for name in here
        if there.get(name) != here[name]
    )


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
def _interrupts_ignored() -> Iterator[None]:
    """Ignore ctrl-C, as processes that are started meanwhile do for good."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _close(client: Client) -> None:
    with suppress(*LOST):
        client.close(timeout=2.0)
