"""Are the cell's drivers true to their ports? Every promise is judged on a device, one line each.

A simulated cell has a simulated device of its own for each driver on trial, behind wires that fail
on demand; the run's devices rest meanwhile. On a real one only promises that need no fault are
judged, by the run's own guarded motions, each of which waits for the operator.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hilcell.cell.file import Cell
from hilcell.conformance.bench import SIMULATED_ONLY, Bench
from hilcell.conformance.kit import promises_of
from hilcell.conformance.promise import Outcome, Promise, judge
from hilcell.conformance.trial import Trial
from hilcell.conformance.verdicts import PORTS, Port
from hilcell.journal.log import Log
from hilcell.ports import HilcellError
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Step, Table
from procedures.guarded import GuardedBench, GuardedHome

NAME = "conformance"
SLOW_PERCENT, SLOW_MM_S = 10.0, 25.0
TRIAL_S = 120.0  # of one driver, in real time

Judged = Callable[[Promise], Outcome]


class Conformance:
    """Judges every promise of every port, once in a run's life."""

    name = NAME
    needs = "devices connected"
    moves = (
        "simulated devices of its own; real ones slowly: the slide to the first station and 60 mm "
        "beyond, the robot 5 deg about its safe pose"
    )
    measures = "three floor nests"
    yields = "a verdict on each promise of each driver"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse a real cell that would move fast."""
        if cell.simulation is None:
            _check_slow(cell)
        return Step(self.name, 0, len(_ports(cell)) * TRIAL_S)

    def perform(self, session: CellSession) -> None:
        """Journal what each promise has found, then a verdict on each driver."""
        for port in _ports(session.cell):
            if session.cell.simulation is None:
                self._try(session, port, _on_real(GuardedBench(session, port)))
            else:
                with Trial(session.cell, port, outer=session.clock.check) as trial:
                    trial.begin(_waiting(session.log, port))
                    self._try(session, port, trial.judge)

    def _try(self, session: CellSession, port: Port, judged: Judged) -> None:
        for promise in _waiting(session.log, port):
            session.checkpoint()
            session.event("promise", port=port, **judged(promise).facts())
        if (key := f"{NAME} {port}") not in session.log.verdicts:
            broken = [e["promise"] for e in _found(session.log, port) if e["verdict"] == "broken"]
            driver = getattr(session.cell, port).driver
            session.verdict(key, holds=not broken, driver=driver, broken=broken)

    def result(self, log: Log) -> dict[str, Any]:
        """Return what each promise has found, by port."""
        return {NAME: {port: _found(log, port) for port in _ports(log.cell)}}


def _on_real(bench: Bench) -> Judged:
    def judged(promise: Promise) -> Outcome:
        if promise.real:
            return judge(promise, bench)
        return Outcome(promise.name, "not applicable", SIMULATED_ONLY)

    return judged


def _ports(cell: Cell) -> list[Port]:
    return [port for port in PORTS if port != "rail" or cell.has_rail]


def _waiting(log: Log, port: Port) -> list[Promise]:
    """Return the promises of a port of which the journal holds no outcome."""
    known = {each["promise"] for each in _found(log, port)}
    return [promise for promise in promises_of(port) if promise.name not in known]


def _found(log: Log, port: str) -> list[dict[str, Any]]:
    """Return the outcomes of a port that the journal holds."""
    keys = ("promise", "verdict", "why", "took_s")
    events = [e.body for e in log.events if e.body["what"] == "promise"]
    return [{key: e[key] for key in keys} for e in events if e["port"] == port]


def _check_slow(cell: Cell) -> None:
    wanted = {
        f"robot.speed_percent={SLOW_PERCENT:g}": cell.robot.speed_percent <= SLOW_PERCENT,
        f"rail.speed_mm_s={SLOW_MM_S:g}": not cell.has_rail or cell.rail.speed_mm_s <= SLOW_MM_S,
    }
    if fast := [setting for setting, slow in wanted.items() if not slow]:
        raise HilcellError(
            "real devices are tried slowly: add " + " ".join(f"--set {each}" for each in fast),
            code="HC-C10",
        )


def conformance_table(result: dict[str, Any]) -> Table:
    """Return one line a promise."""
    rows = [
        [port, each["promise"], each["verdict"], each["why"]]
        for port, outcomes in result[NAME].items()
        for each in outcomes
    ]
    return ["port", "promise", "verdict", "why"], rows


CONFORMANCE = Procedure(
    NAME,
    "whether the drivers keep the promises of their ports",
    (GuardedHome(), Conformance()),
    conformance_table,
)
