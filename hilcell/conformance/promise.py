"""A promise of a port, and the judgement of one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from hilcell.conformance.bench import Bench
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
