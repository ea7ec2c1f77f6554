"""Whether a calibration may be used here and now: cell, age, temperature, proof of its sign.

Volume and orientation are judged target by target in `hilcell.calibration.file`. A calibration
with the wrong sign looks sound and doubles every error, so one that was not proven on the cell is
refused.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from hilcell.calibration.form import Calibration
from hilcell.ports import HilcellError

TEMPERATURE_MARGIN_K = 2.0
MAX_AGE_DAYS = 180.0
CLOCK_ERROR = timedelta(hours=1)


class Unfit(HilcellError):
    """A calibration that must not be used for this."""


def check_fitness(
    calibration: Calibration,
    now: datetime,
    *,
    max_age_days: float = MAX_AGE_DAYS,
    digest: str | None = None,
    temperature_c: float | None = None,
) -> None:
    """Raise `Unfit` with every reason why the calibration must not be used.

    ``digest`` is the cell's of today, ``temperature_c`` the room's; None leaves each unchecked.
    """
    reasons = [_unproven(calibration), _age(calibration, now, max_age_days)]
    if digest is not None:
        reasons.append(_other_cell(calibration, digest))
    if temperature_c is not None:
        reasons.append(_temperature(calibration, temperature_c))
    found = [reason for reason in reasons if reason]
    if found:
        run = calibration.provenance.run
        raise Unfit(f"calibration of run {run} refused\n" + "\n".join(f"  {r}" for r in found))


def _unproven(calibration: Calibration) -> str:
    if calibration.provenance.sign_checked:
        return ""
    return (
        "its sign check did not hold, or was not made: corrected targets could be off by twice "
        "the error; see `hilcell show`, then calibrate again"
    )


def _age(calibration: Calibration, now: datetime, max_age_days: float) -> str:
    written = calibration.provenance.written
    try:
        age = now - datetime.strptime(written, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
    except ValueError:
        return f"it says {written!r} for when it was written, which is no UTC time"
    days = age / timedelta(days=1)
    if age < -CLOCK_ERROR:
        return f"it was written {written}, {-days:.1f} days from now; check the computer's clock"
    if not days <= max_age_days:
        return (
            f"it was written {written}, {days:.1f} days ago, wanted <= {max_age_days:g} days; "
            "calibrate again, or say --max-age DAYS"
        )
    return ""


def _other_cell(calibration: Calibration, digest: str) -> str:
    found = calibration.provenance.digest
    if found == digest:
        return ""
    return (
        f"it is of cell {calibration.provenance.cell} with digest {found[:12]}, the cell given has "
        f"{digest[:12]}: another cell, or one whose file was changed since"
    )


def _temperature(calibration: Calibration, temperature_c: float) -> str:
    if calibration.validity.temperature_c is None:
        return (
            f"{temperature_c:.1f} C cannot be compared: the calibration's tracker had no weather "
            "station; leave --temperature out"
        )
    low_c, high_c = calibration.validity.temperature_c
    if low_c - TEMPERATURE_MARGIN_K <= temperature_c <= high_c + TEMPERATURE_MARGIN_K:
        return ""
    return (
        f"{temperature_c:.1f} C is not within {TEMPERATURE_MARGIN_K:g} K of the calibrated "
        f"{low_c:.1f} .. {high_c:.1f} C; bring the cell to temperature, or calibrate again"
    )
