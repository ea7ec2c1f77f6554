"""The end of a session: our script has ended and the arm is at rest, and both are confirmed.

A stop that was sent proves nothing: the dashboard may refuse it, be busy, or have closed an idle
connection long ago, and a register may not be read. So fresh packages are judged, and the stop is
sent again over all wires until they show rest. It gives no sign of life: a script that does not
read the stop either still brakes a motion by itself.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from drivers.robot_errors import DEVICE
from drivers.supervision import Patience
from drivers.universal_robots.dashboard import Dashboard
from drivers.universal_robots.health import Runtime, joints_text, runtime_text
from drivers.universal_robots.rtde import UrLink, UrState
from hilcell.ports import DeviceError

RELEASE_S = 5.0  # wire deadline: a brake from full speed (stopj, 2 rad/s2), then 3 s to standstill
LOOK_S = 0.5  # one look counts for this long, at most
AGAIN_S = 0.5  # between two stops
ANSWER_S = 0.5  # for the dashboard's answer, where the packages prove nothing
DWELL_S = 0.05  # of the packages that tell standstill


def stop_by_all_wires(link: UrLink | None, panel: Dashboard | None, session: int) -> None:
    """Send the stop over each wire that there is; raises `DeviceError` where none takes it."""
    taken, failure = False, None
    if panel is not None:
        try:
            panel.send("stop")
            taken = True
        except DeviceError as error:
            failure = error
    if link is not None:
        try:
            link.end_script(session)
            taken = True
        except DeviceError as error:
            failure = failure or error
    if failure is not None and not taken:
        raise failure


class Release:
    """Looks without the run's clock, which no longer waits after a stop."""

    def __init__(self, link: UrLink | None, panel: Dashboard | None, session: int) -> None:
        self._link, self._panel, self._session = link, panel, session
        self._answer = "none"  # of the dashboard to the last stop
        self._again_s = time.monotonic()

    def leave_at_rest(self) -> None:
        """Return when no program plays and the joints stand; raises `DeviceError`."""
        link, patience, over = self._link, Patience(RELEASE_S, LOOK_S), False
        if link is None:
            self._stop()
            raise self._unconfirmed("no connection by RTDE")
        while True:
            self._stop()
            try:
                states = _dwell(link)
            except DeviceError as error:
                raise self._unconfirmed(error.found) from error
            if _at_rest(states):
                return
            if over:
                raise self._unconfirmed(_words(states))
            over = patience.over()
            self._hear(Patience(0.0))

    def _stop(self) -> None:
        now_s = time.monotonic()
        if now_s < self._again_s:
            return
        self._again_s = now_s + AGAIN_S
        try:
            stop_by_all_wires(self._link, self._panel, self._session)
        except DeviceError as error:
            raise self._unconfirmed(error.found) from error

    def _hear(self, patience: Patience) -> None:
        """Take note of what the dashboard has answered to the stops."""
        if self._panel is None:
            return
        try:
            self._answer = self._panel.last_answer(patience) or self._answer
        except DeviceError as error:
            self._answer = error.found

    def _unconfirmed(self, found: str) -> DeviceError:
        self._hear(Patience(ANSWER_S))
        return DeviceError(
            "HC-B71",
            DEVICE,
            "close",
            f"the arm is not confirmed at rest: {found}; answer of the dashboard to stop: "
            f"{self._answer}",
            wanted=f"program stopped and joints at rest within {RELEASE_S:g} s",
            act="keep away from the arm, it may move: press the E-stop; then see the panel",
            fields={"answer": self._answer},
        )


def _dwell(link: UrLink) -> list[UrState]:
    """Return the states of a dwell that began after this call."""
    first = link.fresh(patiently=True)
    time.sleep(DWELL_S)
    last = link.fresh(patiently=True)
    between = link.following(first.by_s, patiently=True)
    return [first, *(state for state in between if state.by_s <= last.by_s)]


def stands(states: Sequence[UrState]) -> bool:
    """Whether no joint moves, by speed and by spread."""
    joints_rad = np.array([state.joints_rad for state in states])
    speeds = np.abs([state.speeds_rad_s for state in states])
    still = np.all(np.ptp(joints_rad, axis=0) <= 2e-5)  # rad; a joint that holds dithers
    return bool(still and np.all(speeds <= 2e-3))  # rad/s


def _at_rest(states: Sequence[UrState]) -> bool:
    """Whether no program plays and no joint moves, while the controller's time goes on."""
    ended = all(state.runtime_state == Runtime.STOPPED for state in states)
    return ended and stands(states) and states[-1].timestamp_s > states[0].timestamp_s


def _words(states: Sequence[UrState]) -> str:
    """Return what a dwell's last state shows."""
    last = states[-1]
    fastest_deg_s = float(np.degrees(np.max(np.abs(last.speeds_rad_s))))
    where = joints_text(np.degrees(last.joints_rad))
    return (
        f"runtime_state is {runtime_text(last)}, {fastest_deg_s:.2f} deg/s at {where}, "
        f"{last.timestamp_s:.3f} s by the controller's clock"
    )
