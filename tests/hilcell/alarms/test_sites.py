"""Whoever adds a fault adds its text: every error that the source builds has an alarm of its own.

The samples stand for what the syntax does not tell: names of devices that a class is given, and
words that come from tables.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from drivers import cia406, emcy, emscon
from drivers.robot_kuka_c3 import HEALTH
from hilcell.alarms.catalogue import catalogue, entry_of
from hilcell.alarms.finding import Finding
from tests.hilcell.alarms.sites import HOLE, ROOT, Module, Site, loaded, modules, sites
from tests.hilcell.alarms.test_alarms import BY_EVENTS, NO_FILE

CODES = [*emcy.CODES, *(family << 8 for family in emcy.FAMILIES if family >= 0x10), 0x1234, 0x0000]
SAMPLES = {
    "drivers/tcp.py": {"device": ["Robot", "Tracker"], "self.device": ["Robot", "Tracker"]},
    "drivers/supervision.py": {"self._device": ["Rail", "Robot"]},
    "drivers/c3.py": {"self._device": ["Robot"]},
    "drivers/can_link.py": {"device": ["Rail"], "self.device": ["Rail"]},
    "drivers/pdo.py": {"self._device": ["Rail"]},
    "drivers/sdo.py": {
        "self._device": ["Rail"],
        "device": ["Rail"],
        "operation": ["read 6041h:00"],
    },
    "drivers/node_watch.py": {
        "self._device": ["Rail"],
        "emcy.text(code)": [emcy.text(code) for code in CODES],
    },
    "drivers/drive.py": {
        "emcy.text(code)": [emcy.text(code) for code in CODES],
        "cia406.alarm_text(now.alarms)": [cia406.alarm_text(1 << bit) for bit in range(16)],
    },
    "drivers/robot_kuka_c3.py": {
        "name": [*HEALTH, "HC_VER", "$OV_PRO", "$ACT_TOOL", "$ACT_BASE", "$TOOL", "$BASE"],
        "error": ["1", "2", "9", "77"],
    },
    "drivers/tracker_leica_emscon.py": {
        "emscon.status_text(status)": [emscon.status_text(code) for code in [*emscon.STATUS, 777]],
    },
    "procedures/plan.py": {"error": ["1 of 8 poses are out of reach: 3"]},
}
# Where a run begins: what these import may end it, or keep it from beginning.
ENGINE = ("hilcell/commands/run.py", "hilcell/run/", "procedures/", "drivers/")
# These hand on what another error says, or are met by commands on files alone.
ELSEWHERE = {
    ("hilcell/run/runner.py", "_ask"),
    ("hilcell/run/control.py", "order"),
    ("hilcell/commands/run.py", "resume"),
    ("hilcell/calibration_file.py", "compensate_targets"),
    ("hilcell/calibration_file.py", "_refuse_turned"),
}

FOUND = sites(SAMPLES)
MET = loaded(modules(), ENGINE)
JUDGED = [
    site
    for site in FOUND
    if (site.kind == "device" or site.path in MET) and (site.path, site.function) not in ELSEWHERE
]


@pytest.mark.parametrize("site", JUDGED, ids=str)
def test_every_error_has_an_alarm_of_its_own(site: Site) -> None:
    assert site.findings
    for finding in site.findings:
        assert entry_of(finding).specific, finding


def test_the_walk_sees_the_errors() -> None:
    """It reads f-strings, tables, helpers and attributes; a count would only grow stale."""
    told = {(finding.device, finding.found) for site in FOUND for finding in site.findings}
    for finding in (
        ("Rail", "node 7: no heartbeat for 7 s"),
        ("Rail", "following error at 7 mm"),
        ("Rail", "the rail was stopped"),
        ("Robot", "$ALARM_STOP is 7"),
        ("Robot", "7:7: the device closed the connection"),
        ("Tracker", "7 7 7 is not between 7 and 7"),
        ("Tracker", "status 10012 (not warmed up)"),
        ("", "journal 7: record 7 could not be stored: 7"),
    ):
        assert finding in told
    assert {(site.path, site.function) for site in FOUND} >= ELSEWHERE


def test_a_fault_without_a_text_is_found_out() -> None:
    for device in ("Rail", "Robot", "Tracker", "Cell", ""):
        assert not entry_of(Finding(device, "dance", f"the {HOLE} fell over")).specific


REACHED = {entry_of(finding).code for site in FOUND for finding in site.findings}


@pytest.mark.parametrize(
    "code", sorted(entry.code for entry in catalogue() if entry.specific), ids=str
)
def test_every_entry_is_reached(code: str) -> None:
    assert code in REACHED | set(BY_EVENTS) | {NO_FILE}


# Events that are the run's ordinary course; every other one becomes an alarm.
ORDINARY = {"connected", "station found held", "step", "retake asked", "seated", "screen back"}
ALARMING = {
    "no reading", "safe stop", "closed", "command refused", "screen lost", "answer refused",
    "retake refused", "outlier measured again", "station held", "internal error", "link",
}  # fmt: skip


def events_of(module: Module) -> Iterator[str]:
    """Yield the names of all events that a module journals."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Dict):
            said = zip(node.keys, node.values, strict=True)
            named = [v for k, v in said if k is not None and ast.unparse(k) == "'what'"]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith((".event", "._note")):
            named = node.args[:1]
        else:
            continue
        yield from (str(name.value) for name in named if isinstance(name, ast.Constant))


def test_every_event_is_either_ordinary_or_an_alarm() -> None:
    rooms = ("hilcell/run/", "hilcell/commands/", "procedures/")
    found = {name for m in modules() if m.path.startswith(rooms) for name in events_of(m)}
    assert found == ORDINARY | ALARMING
    judged = (ROOT / "hilcell/alarms/alarm.py").read_text("utf-8")
    assert all(f'"{name}"' in judged for name in ALARMING)
