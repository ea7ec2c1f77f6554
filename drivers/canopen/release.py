"""The end of a session: the drive without power, the slide at rest, and both confirmed.

No PDO is confirmed, so a drive that goes on after a quick stop is asked again at each look, then by
SDO and by the end of the PC's heartbeat, then to take its power away. One without power may still
roll: it counts as held only when its positions stand for a dwell, or where they stood before.

A drive that has missed the PC's heartbeat brakes by itself and leaves OPERATIONAL (CiA 301, 1029h).
It then sends and obeys no PDO, but it answers SDO: the same values are read and the same control
words are written that way.
"""

from __future__ import annotations

import time

from drivers.canopen import cia402
from drivers.canopen.can_link import CanLink
from drivers.canopen.cia301 import NMT, NodeCommand, NodeState
from drivers.canopen.cia402 import Control, Object, State
from drivers.canopen.node_watch import NodeWatch
from drivers.canopen.process_image import ProcessImage, Snapshot
from drivers.canopen.sdo import SdoChannel
from drivers.standstill import DEVICE, READINGS, Rest, Standstill, Windows
from drivers.supervision import Patience, go_on
from hilcell.ports import DeviceError

RELEASE_S = 5.0  # wire deadline, beside two dwells
SILENT_S = 1.0  # more than a poll takes that nothing answers
POLL_S = 0.02
HEARD = 5  # looks within which a drive shows that it obeys
NO_STRIP = -1  # alarms: SDO asks the drive alone


class Release:
    """Takes the power away without the run's clock, which no longer waits after a stop."""

    def __init__(
        self,
        link: CanLink,
        image: ProcessImage,
        sdo: SdoChannel,
        windows: Windows,
        *,
        watch: NodeWatch,
        rest: Rest | None,
    ) -> None:
        """``watch`` is that of the drive; ``rest`` is where its slide is known to stand."""
        self._link, self._image, self._sdo = link, image, sdo
        self._windows, self._watch, self._rest = windows, watch, rest
        self._standstill = Standstill(windows)
        self._unheard = 0  # looks at a drive that goes on, though it was asked to stop
        self.by_sdo = watch.state != NodeState.OPERATIONAL  # no PDO comes, SDO is asked
        self._began_s, self._looks = time.monotonic(), 0  # of asking this way

    def leave_held(self) -> None:
        """Return when the drive has no power and the slide stands; raises `DeviceError`."""
        limit_s = RELEASE_S + 2 * self._windows.dwell_s
        patience, had_power = Patience(limit_s, SILENT_S), True
        while True:
            now = self._answer(patience)
            powered = now.powered or now.state is State.UNKNOWN
            if had_power and not powered:
                patience, had_power = Patience(limit_s, SILENT_S), False  # as long to come to rest
            if powered:
                self._take_power(now)
            elif self._standstill.rest is not None or self._stands_as_before(now):
                return
            if patience.over():
                found = "the drive keeps its power" if powered else "the slide does not rest"
                raise DeviceError(
                    "HC-R37",
                    DEVICE,
                    "close",
                    f"{found}: {now.state.value}, speed {now.velocity} counts/s",
                    wanted=f"held within {limit_s:.0f} s",
                    act="keep away from the slide; press the E-stop, or switch the drive off",
                    fields={"state": now.state.value, "waited_s": RELEASE_S},
                )
            time.sleep(POLL_S)

    def _stands_as_before(self, now: Snapshot) -> bool:
        """Whether a slide that was known to stand has not moved since."""
        windows, rest = self._windows, self._rest
        return (
            rest is not None
            and abs(now.velocity) <= windows.speed
            and abs(now.position - rest.position) <= windows.spread
        )

    def _take_power(self, now: Snapshot) -> None:
        windows, passed_s = self._windows, time.monotonic() - self._began_s
        # A busy PC looks seldom: until it has looked as often as rest needs, time tells nothing.
        # These looks fit into the deadline, however slow: a slide that creeps is always braked.
        restless = passed_s > 2 * windows.dwell_s and self._looks >= READINGS
        if self._standstill.rest is not None:
            self._control(Control.DISABLE_VOLTAGE)
        elif now.state in cia402.BRAKING:
            self._unheard = 0
        elif not abs(now.velocity) <= windows.speed or restless:
            self._unheard += 1
            last = self._unheard > 2 * HEARD
            self._control(Control.DISABLE_VOLTAGE if last else Control.QUICK_STOP)
            if self._unheard > HEARD:
                self._stop_by_all_ways()

    def _control(self, controlword: int) -> None:
        if self.by_sdo:
            try:
                self._sdo.command(Object.CONTROLWORD, 0, controlword)
            except DeviceError:
                self._link.check()
                return  # the next poll shows that the drive has kept its power
        elif controlword == Control.QUICK_STOP:
            self._image.quick_stop()
        else:
            self._image.control(controlword)

    def _stop_by_all_ways(self) -> None:
        """Stop a drive that does not answer, or does not obey."""
        self._link.end_heartbeat()
        if self._watch.state == NodeState.STOPPED:  # it serves no SDO there
            self._link.send(NMT, bytes((NodeCommand.ENTER_PRE_OPERATIONAL, self._watch.node)))
        self._sdo.post(Object.CONTROLWORD, 0, Control.QUICK_STOP)

    def _answer(self, patience: Patience) -> Snapshot:
        """Return the next poll that is answered; one that is not proves nothing before the end."""
        silent: DeviceError | None = None
        while True:
            over = patience.over()
            try:
                now = self._read_by_sdo() if self.by_sdo else self._image.refresh(go_on)
            except DeviceError as error:
                self._link.check()  # a link that is lost brings no answer
                silent = silent or error
                if self.by_sdo:
                    self._stop_by_all_ways()
                    if over:
                        raise DeviceError(
                            silent.code,
                            DEVICE,
                            "close",
                            silent.found,
                            wanted="a drive that is confirmed held",
                            act="keep away from the slide, it may move: press the E-stop; then "
                            "check the drive's power and the bus",
                            fields=silent.fields,
                        ) from error
                self._ask(by_sdo=not self.by_sdo)
            else:
                self._standstill.take(now, time.monotonic() - self._began_s)
                self._looks += 1
                return now

    def _ask(self, *, by_sdo: bool) -> None:
        """Change the way of asking: earlier looks prove nothing now."""
        self.by_sdo = by_sdo
        self._standstill.forget()
        self._began_s, self._looks = time.monotonic(), 0

    def _read_by_sdo(self) -> Snapshot:
        statusword, velocity, position = (
            self._sdo.read(index, tries=1)
            for index in (Object.STATUSWORD, Object.VELOCITY_ACTUAL, Object.POSITION_ACTUAL)
        )
        return Snapshot(statusword, position, velocity, 0, 0, NO_STRIP, self._link.clock.pc_s())
