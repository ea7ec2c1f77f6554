"""One driver on trial: its benches, and its promises judged on them.

Promises that wait until the driver gives up (half a minute for a tracker that measures) are judged
beside the others, each on a device of its own; those about times of milliseconds one after another.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial

from hilcell.cell.file import Cell
from hilcell.conformance.acts import Driver
from hilcell.conformance.bench import Bench, SimulatedBench, goes_on
from hilcell.conformance.verdicts import PORTS, Broken, NeedsPerson, NotApplicable, Port, Verdict
from hilcell.errors import Stopped, with_place
from hilcell.typed import Json


@dataclass(frozen=True, slots=True)
class Promise:
    """``check`` raises `Broken`. ``paced``: on a device that moves in real time.

    ``real``: on real devices, too, where nothing else is done than in any run. ``waits``: until the
    driver gives up.
    """

    name: str
    sentence: str
    check: Callable[[Bench], None]
    ports: tuple[Port, ...] = PORTS
    paced: bool = False
    real: bool = False
    waits: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """The finding of one promise."""

    promise: str
    verdict: Verdict
    why: str = ""
    took_s: float = 0.0

    def facts(self) -> Json:
        """Return it for the journal."""
        return asdict(self)


def judge(promise: Promise, bench: Bench) -> Outcome:
    """Put a driver through one promise; raises `Stopped` where the run is stopped."""
    began_s = time.monotonic()
    verdict: Verdict = "held"
    why = ""
    try:
        promise.check(bench)
    except NotApplicable as error:
        verdict, why = "not applicable", str(error)
    except NeedsPerson as error:
        verdict, why = "needs a person", str(error)
    except Broken as error:
        verdict, why = "broken", str(error)
    except Stopped as error:
        bench.check_outer()
        verdict, why = "broken", f"Stopped: {error}"
    except Exception as error:  # noqa: BLE001 - a driver may raise anything, which is its answer
        verdict, why = "broken", with_place(error)
    finally:
        bench.tidy()
    return Outcome(promise.name, verdict, why, round(time.monotonic() - began_s, 2))


class Trial:
    """Two benches of one driver, one whose time passes as fast as it goes, one in real time."""

    def __init__(
        self,
        cell: Cell,
        port: Port,
        *,
        kind: type[Driver] | None = None,
        outer: Callable[[], None] = goes_on,
    ) -> None:
        self._bench = partial(SimulatedBench, cell, port, outer=outer)
        self._kind = kind
        self._in_turn = {paced: self._bench(kind=kind, paced=paced) for paced in (False, True)}
        self._beside: list[SimulatedBench] = []
        self._judged: dict[str, Future[Outcome]] = {}

    def __enter__(self) -> Trial:
        return self

    def __exit__(self, *exception: object) -> None:
        for each in self._beside:
            each.clock.stop.set()  # nobody asks for its finding any more
        for future in self._judged.values():
            future.exception()
        for each in (*self._beside, *self._in_turn.values()):
            each.close()

    def begin(self, promises: Iterable[Promise]) -> None:
        """Begin with those of ``promises`` that wait until the driver gives up."""
        waiting = [promise for promise in promises if promise.waits]
        if not waiting:
            return
        with_threads = ThreadPoolExecutor(len(waiting), "conformance")
        for promise in waiting:
            bench = self._bench(kind=self._kind, paced=promise.paced)
            self._beside.append(bench)
            self._judged[promise.name] = with_threads.submit(judge, promise, bench)
        with_threads.shutdown(wait=False)

    def judge(self, promise: Promise) -> Outcome:
        """Return the finding of one promise; raises `Stopped` where the run is stopped."""
        if promise.name in self._judged:
            return self._judged.pop(promise.name).result()
        return judge(promise, self._in_turn[promise.paced])

    def try_kind(self, kind: type[Driver] | None) -> None:
        """Try another class from now on."""
        self._kind = kind
        for each in self._in_turn.values():
            each.kind = kind
