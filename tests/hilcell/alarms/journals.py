"""Journals in memory, record by record, for tests of what alarms make of them."""

from __future__ import annotations

from typing import Any

from hilcell.alarms import Alarm, alarms_of
from hilcell.errors import HilcellError, facts_of
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.records import Kind
from hilcell.model.verdicts import Verdict
from hilcell.ports import NoReading
from tests.hilcell.report.journals import plan_record
from tests.hilcell.verdicts import plain

Row = tuple[Kind, str, dict[str, Any]]
RUN = "20261121-120000-home-abcd"
END = {"state": "faulted", "exit": 3, "result": {}}
CONNECTED: Row = ("event", "", {"what": "connected", "devices": []})
CLOSED: Row = ("event", "", {"what": "closed", "problems": {}})


def state(to: str, **more: Any) -> Row:
    return ("state", "", {"machine": "run", "from": "?", "to": to, "trigger": "?"} | more)


def event(what: str, **facts: Any) -> Row:
    return ("event", "", {"what": what} | facts)


def verdict(key: str, judged: Verdict) -> Row:
    return ("verdict", key, plain(judged))


def faulted(error: Exception) -> Row:
    return state("faulted", reason=str(error), error=facts_of(error))


def no_reading(key: str, error: NoReading) -> Row:
    """Return the record of a measurement that failed and is tried again."""
    facts = error.of_point(key).facts()
    return event("no reading", key=key, tries=1, reason=str(error), error=facts)


def asks(key: str, error: NoReading) -> Row:
    """Return the record of a run that asks what to do about it."""
    return state("suspended", reason=f"{key}: {error.summary}", error=error.of_point(key).facts())


def problem(what: str, device: str, error: HilcellError) -> Row:
    return event(what, problems={device: str(error)}, errors={device: error.facts()})


def ended(error: HilcellError | None, code: int = 3, to: str = "faulted") -> Row:
    said = {} if error is None else {"reason": str(error), "error": error.facts()}
    return ("end", "", END | said | {"exit": code, "state": to})


def point(key: str, temperature_c: float | None = 20.0) -> Row:
    kind, _, target = key.partition("/")
    return ("point", key, {
        "id": {"kind": kind, "target": target},
        "group": "grid", "station": "S1100", "frame": "tracker", "reflector": "SMR", "samples": 1,
        "xyz_mm": (1.0, 2.0, 3.0), "std_mm": (0.0, 0.0, 0.0), "temperature_c": temperature_c,
        "pressure_mbar": 1013.0, "humidity_percent": 50.0, "session": 1,
    })  # fmt: skip


BEGUN = (state("checking"), CONNECTED, state("running"))
BEAM = NoReading("HC-T10", "Tracker", "measure", "the beam broke", act="clear the line of sight")


def log_of(*rows: Row) -> Log:
    """Return the log of a journal with a plan and these records, dated by their numbers."""
    plan: Row = ("plan", "", plan_record())
    return Log(
        Record(seq, f"2026-11-21T12:00:{seq:02d}Z", kind, key, body)
        for seq, (kind, key, body) in enumerate((plan, *rows), start=1)
    )


def alarms(*rows: Row, live: bool = False, lost: bool = False) -> list[Alarm]:
    return alarms_of(log_of(*rows), RUN, live=live, lost=lost)
