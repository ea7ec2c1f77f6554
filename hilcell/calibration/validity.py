"""Whether a calibration may be used: sign, validation, cell, age, temperature.

Volume and orientation are judged target by target in `hilcell.calibration.file`. A wrong sign
doubles every error and shows nowhere, so a calibration whose sign was not verified on the cell is
refused; so is one without a passed validation, unless accepted.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import msgspec

from hilcell.calibration.decision_rule import tolerance_limits
from hilcell.calibration.file import Calibration
from hilcell.cell.differences import differences
from hilcell.cell.file import Cell
from hilcell.journal.calibration_status import CalibrationStatus
from hilcell.model.calibration import CLOCK_ERROR, MAX_AGE_DAYS
from hilcell.model.verdicts import ChangedSince, Limits
from hilcell.ports import HilcellError

TEMPERATURE_MARGIN_K = 2.0


class CalibrationRefused(HilcellError):
    """A calibration that must not be used for this, with every reason."""

    def __init__(self, calibration: Calibration, reasons: Sequence[str]) -> None:
        lines = "\n".join(f"  {reason}" for reason in reasons)
        super().__init__(f"calibration of {calibration.provenance.named} refused\n{lines}")


def check_usable(
    calibration: Calibration,
    now: datetime,
    *,
    max_age_days: float = MAX_AGE_DAYS,
    cell: Cell | None = None,
    calibrated: Cell | None = None,
    limits: Limits | None = None,
    temperature_c: float | None = None,
    accept_out_of_tolerance: bool = False,
    status: CalibrationStatus | None = None,
    accept_not_current: bool = False,
) -> list[str]:
    """Why a calibration is out of tolerance; raises `CalibrationRefused`.

    ``cell``: today's; ``calibrated``: as it was when its run began; ``limits``: of a cell that is
    not given; None leaves each unchecked.
    """
    use = _Use(calibration, now, max_age_days, cell, calibrated, temperature_c)
    settled = ChangedSince.keys if status is not None and status.state == "current" else ()
    limits = tolerance_limits(cell) if cell is not None else limits
    intolerant = out_of_tolerance(calibration, limits, settled)
    acceptable = {
        "--accept-not-current": [] if accept_not_current else [*_not_current(status)],
        "--accept-out-of-tolerance": [] if accept_out_of_tolerance else intolerant,
    }
    reasons = [each for each in (use.unproven, use.age, use.other_cell, use.temperature) if each]
    flags = [flag for flag, against in acceptable.items() if against and not reasons]
    reasons += itertools.chain.from_iterable(acceptable.values())
    if flags:
        reasons.append(f"to use it all the same, add {' '.join(flags)}; the output says so")
    if reasons:
        raise CalibrationRefused(calibration, reasons)
    return intolerant


def out_of_tolerance(
    calibration: Calibration, limits: Limits | None = None, settled: Collection[str] = ()
) -> list[str]:
    """Why a calibration is not known to be in tolerance, with the figures.

    ``limits``: of the cell; None: those that it was judged by. ``settled``: keys of verdicts that
    an operator has decided on since.
    """
    if not calibration.verdicts:
        return ["its correction was never validated: its run ended before, or measures none"]
    reasons = [
        f"validation at {place}: {each.decision}: {each.figures_text}"
        for place, each in calibration.verdicts.items()
        if not each.holds
    ]
    if limits is not None:
        turn = "" if limits.max_deg is None else f", orientation {limits.max_deg:g} deg"
        reasons += [
            f"validation at {place} had another tolerance than the cell given, which has mean "
            f"{limits.mean_mm:g} and largest {limits.max_mm:g} mm{turn}: "
            f"{each.figures_text}"
            for place, each in calibration.verdicts.items()
            if limits != each.limits
        ]
    failed = {key: words for key, words in calibration.failed.items() if key not in settled}
    if ChangedSince.keys[0] in failed:
        reasons.append(
            "it differs from the calibration before it: `hilcell revoke RUN` the wrong one of both"
        )
    return reasons + [f"{key} did not hold: {words}" for key, words in failed.items()]


def _not_current(status: CalibrationStatus | None) -> Iterator[str]:
    if status is None or status.usable:
        return
    yield f"it is {status.text}"
    if status.current:
        yield f"the current one of the cell is that of run {status.current}"
    elif status.state != "in doubt":
        yield "no calibration of the cell is current: calibrate again"


@dataclass(frozen=True, eq=False)
class _Use:
    """A calibration that is to be used, and why it must not be: "" where it may."""

    calibration: Calibration
    now: datetime
    max_age_days: float
    cell: Cell | None
    calibrated: Cell | None
    temperature_c: float | None

    @property
    def unproven(self) -> str:
        if self.calibration.provenance.sign_checked:
            return ""
        return (
            "its sign check did not hold, or was not made: corrected targets could be off by twice "
            "the error; see `hilcell show`, then calibrate again"
        )

    @property
    def age(self) -> str:
        written = self.calibration.provenance.written
        try:
            age = self.now - datetime.strptime(written, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
        except ValueError:
            return f"its date {written!r} is not a UTC time"
        days = age / timedelta(days=1)
        if age < -CLOCK_ERROR:
            return (
                f"it was written {written}, {-days:.1f} days from now; check the computer's clock"
            )
        if not days <= self.max_age_days:
            return (
                f"it was written {written}, {days:.1f} days ago, expected <= "
                f"{self.max_age_days:g} days; calibrate again, or say --max-age DAYS"
            )
        return ""

    @property
    def other_cell(self) -> str:
        cell, digest = self.cell, self.calibration.provenance.digest
        if cell is None:
            return ""
        limits = {each.limits for each in self.calibration.verdicts.values()}
        tables = (
            msgspec.structs.replace(
                cell.validation,
                mean_tolerance_mm=each.mean_mm,
                max_tolerance_mm=each.max_mm,
                max_tolerance_deg=each.max_deg,
            )
            for each in limits
            if each.max_deg is None or cell.orients
        )
        cells = (cell, *(msgspec.structs.replace(cell, validation=each) for each in tables))
        if digest in {each.digest for each in cells}:
            return ""
        name = self.calibration.provenance.cell
        if name != cell.name:
            return f"it is of cell {name}, not {cell.name}"
        changed = differences(self.calibrated, cell) if self.calibrated is not None else ""
        return (
            f"it is of cell {name} with digest {digest[:12]}, the cell given has "
            f"{cell.digest[:12]}: another cell, one whose file was changed since, or other "
            "--set than its run's"
            + (f"; its run's and the one given: {changed}" if changed else "")
        )

    @property
    def temperature(self) -> str:
        temperature_c = self.temperature_c
        if temperature_c is None:
            return ""
        if self.calibration.validity.temperature_c is None:
            return (
                f"{temperature_c:.1f} C cannot be compared: the calibration's tracker had no "
                "weather station; leave --temperature out"
            )
        low_c, high_c = self.calibration.validity.temperature_c
        if low_c - TEMPERATURE_MARGIN_K <= temperature_c <= high_c + TEMPERATURE_MARGIN_K:
            return ""
        return (
            f"{temperature_c:.1f} C is not within {TEMPERATURE_MARGIN_K:g} K of the calibrated "
            f"{low_c:.1f} .. {high_c:.1f} C; bring the cell to temperature, or calibrate again"
        )
