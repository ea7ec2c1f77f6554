"""The states of a run and of its calibration: the only list of their names.

Engine, journal, index, reports, alarms and screen take the names from here; `hilcell.run.states`
has the transitions between them.
"""

from __future__ import annotations

from typing import Literal

RunState = Literal[
    "idle",
    "checking",  # identities and interlocks; nothing moves
    "running",
    "pausing",  # asked to pause: the point in flight is finished first
    "paused",
    "suspended",  # waits for the answer to a prompt
    "aborting",  # asked to abort: the point in flight is finished first
    "stopping",
    "finished",
    "aborted",
    "faulted",
]
CalibrationState = Literal[
    "unknown",
    "connected",
    "referenced",
    "world_framed",
    "station_held",
    "base_framed",
    "grid_measured",
    "stations_framed",
    "fitted",
    "validated",
]

OVER: tuple[RunState, ...] = ("finished", "aborted", "faulted")
WAITING: tuple[RunState, ...] = ("paused", "suspended")  # nothing moves, the operator is waited for
WORKING: tuple[RunState, ...] = ("checking", "running", "pausing", "aborting", "stopping")
PASSING: tuple[RunState, ...] = ("pausing", "aborting")  # `status` says so by its key ``pausing``
