"""A strip that does not read suspends a run, and lets it go on when it reads well again.

The slide is held meanwhile. Somebody may have had his hands at it, so no station counts as held
afterwards: the next act that needs one approaches it and proves it by a nest.
"""

from __future__ import annotations

from hilcell.ports import DeviceError, NoReading, StripLost
from hilcell.run.measuring import Ask
from hilcell.run.motion import Motion
from hilcell.run.prompts import Look, Prompt
from hilcell.run.run_context import RunContext

STRIP_BACK = "strip back"  # event
FROZEN = "HC-S02"


class StripGuard:
    """Used where an act has failed for its strip; ``ask`` suspends the run until a look is good."""

    def __init__(self, run: RunContext, motion: Motion, ask: Ask) -> None:
        self._run, self._motion, self._ask = run, motion, ask

    def wait(self, lost: StripLost) -> None:
        """Hold the slide where it is, and suspend the run until the strip reads well."""
        self._motion.hold_here()
        prompt = Prompt(
            title="The strip cannot be read",
            text=f"{lost.summary}. The slide is held. Clean the strip at the head, see that the "
            "head is fixed and near enough to it, and look at its cable.",
            place="the strip",
            expected_mm=None,
            limit_mm=self._run.cell.rail.slip_limit_mm,
            reason=lost.summary,
        )
        self._ask(prompt, lambda: self._look(lost), lost)
        self._run.event(STRIP_BACK)

    def _look(self, lost: StripLost) -> Look:
        """Read the strip; one that was frozen must be where the drive is, as far as may slip.

        One that was in alarm may be read before the drive has its reference.
        """
        try:
            reading = self._run.devices.rail.read()
        except DeviceError as error:
            at_s, silent = self._run.clock.pc_s(), not isinstance(error, NoReading)
            return Look(None, error.summary, at_s, lost=silent)
        if not reading.still:
            return Look(
                None, f"the slide moves at {reading.velocity_mm_s:.3f} mm/s", reading.taken_s
            )
        off_mm = abs(reading.strip_mm - reading.position_mm) if lost.code == FROZEN else 0.0
        why = f"strip {reading.strip_mm:.2f} mm, drive {reading.position_mm:.2f} mm"
        return Look(off_mm, why, reading.taken_s)
