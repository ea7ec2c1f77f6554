"""Readings of a tracker, and the errors that all trackers share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Literal, TypeAlias, TypeVar

import numpy as np
from msgspec import Meta

from drivers.device_errors import TRACKER
from drivers.supervision import Deadline
from hilcell.ports import (
    Ability,
    Array,
    Clock,
    DeviceError,
    DeviceRefused,
    Identity,
    NoReading,
    is_simulated_name,
)

OUTLIER_FACTOR = (
    6.0  # times the scatter of the others from their mean: a repeat beyond is an outlier
)
BUSY_PAUSE_S = 0.1  # before a busy tracker is asked again
Needed: TypeAlias = Literal["mandatory", "optional"]
Positive = Annotated[float, Meta(gt=0)]


class TrackerAbilities:
    """Collects the abilities of a tracker."""

    def __init__(self) -> None:
        self.listed: list[Ability] = []

    def need(self, feature: str, has: bool, note: str) -> None:
        """Add one without which no run begins."""
        self._add(feature, has, "mandatory", note)

    def may(self, feature: str, has: bool, note: str) -> None:
        """Add one that a run does without; ``note`` says what replaces it."""
        self._add(feature, has, "optional", note)

    def _add(self, feature: str, has: bool, needed: Needed, note: str) -> None:
        state: Literal["has", "has not"] = "has" if has else "has not"
        self.listed.append(Ability(TRACKER.name, feature, state, needed, note))


def check_serial(serial: str, expected: str) -> None:
    """Refuse a tracker whose serial number is not that of the cell file; "" there is any."""
    if expected not in ("", serial):
        raise TRACKER.refused(
            "HC-T03", "connect", f"serial {serial}", expected=expected, serial=serial
        )


def leica_identity(name: str, besides: str, serial: str, address: str, firmware: str) -> Identity:
    maker, simulated = "Leica", is_simulated_name(name)
    model = name if name.casefold().startswith("leica") else f"{maker} {name}".strip()
    model += besides
    return Identity(TRACKER.name, model, serial, address, simulated, "tracker", maker, firmware)


def checked_request(near_mm: Array, samples: int = 1, operation: str = "measure") -> Array:
    """Return the place (3,) that is to be measured; raises `DeviceError` for an impossible one."""
    near_mm = np.asarray(near_mm, dtype=float)
    if near_mm.shape != (3,) or not bool(np.all(np.isfinite(near_mm))) or samples < 1:
        found = f"{samples} samples at {near_mm} mm"
        expected = ">= 1 sample at three finite coordinates"
        raise TRACKER.failed("HC-T35", operation, found, expected=expected)
    return near_mm


def check_samples(samples: int) -> None:
    """Refuse a measurement at the present aim without samples; raises `DeviceError`."""
    if samples < 1:
        found, expected = f"{samples} samples", ">= 1 sample"
        raise TRACKER.failed("HC-T35", "measure", found, expected=expected)


def checked_search(near_mm: Array, samples: int, radius_mm: float) -> Array:
    """Return as `checked_request`; raises `DeviceError` for an impossible radius, too."""
    if not 0.0 < radius_mm < np.inf:
        found, expected = f"a radius of {radius_mm} mm", "> 0 mm"
        raise TRACKER.failed("HC-T35", "search", found, expected=expected, radius_mm=radius_mm)
    return checked_request(near_mm, samples, "search")


def check_reflector(reflector: str, known: list[str], found: str) -> None:
    """Refuse a reflector without a constant in the tracker; ``found`` names those it has."""
    if reflector not in known:
        operation, expected = "choose reflector", repr(reflector)
        raise TRACKER.refused(
            "HC-T07", operation, found, expected=expected, reflector=reflector, known=known
        )


def readback_error(
    setting: str, read: object, written: object, why: str = "", act: str = ""
) -> DeviceRefused:
    """Return the error of a setting that does not read as it was written."""
    return TRACKER.refused(
        "HC-T06",
        f"set {setting}",
        f"reads back as {read}{why}",
        expected=f"{written}",
        act=act,
        setting=setting,
        read=read,
        written=written,
    )


def changed(setting: str, found: str, kept: str, act: str = "") -> DeviceError:
    operation = f"read {setting} again"
    return TRACKER.failed("HC-T06", operation, found, expected=kept, act=act, setting=setting)


def matching_form(near_mm: Array, limit_mm: float, forms: Mapping[str, Array]) -> str:
    """Return the form in which a result (3,) is at its place, "" where it is so in none."""
    for form, xyz_mm in forms.items():
        if float(np.linalg.norm(xyz_mm - near_mm)) <= limit_mm:
            return form
    return ""


def off_target(off_mm: float, radius_mm: float, operation: str = "measure") -> NoReading:
    return TRACKER.no_reading(
        "HC-T16",
        operation,
        f"the reflector is {off_mm:.2f} mm from its expected place",
        expected=f"<= {radius_mm:.2f} mm",
        off_mm=off_mm,
        limit_mm=radius_mm,
        searched_mm=radius_mm,
    )


def scatter_error(found: str, limit_mm: float, **figures: float) -> NoReading:
    """Return the error of a result that scatters; ``figures`` are its values."""
    expected, fields = f"<= {limit_mm:.4f} mm", {**figures, "limit_mm": limit_mm}
    return NoReading("HC-T15", TRACKER.name, "measure", found, expected=expected, fields=fields)


def repeats_std(points_mm: Array, limit_mm: float) -> Array:
    """Return the standard deviation (3,) of one of the repeats (N, 3), N > 1.

    Raises `NoReading` where they spread by more than ``limit_mm``, or one is far from the others.
    """
    std_mm: Array = points_mm.std(axis=0, ddof=1)
    spread_mm, repeats = float(np.linalg.norm(std_mm)), len(points_mm)
    if not spread_mm <= limit_mm:
        found = f"{repeats} repeats spread by {spread_mm:.4f} mm (1 sigma)"
        raise scatter_error(found, limit_mm, std_mm=spread_mm, repeats=repeats)
    # One of many hardly widens the spread of all, yet shifts their mean.
    for number, point_mm in enumerate(points_mm if repeats > 2 else ()):
        others_mm = np.delete(points_mm, number, axis=0)
        off_mm = float(np.linalg.norm(point_mm - others_mm.mean(axis=0)))
        scatter_mm = float(np.linalg.norm(others_mm.std(axis=0, ddof=1)))
        if not off_mm <= max(limit_mm, OUTLIER_FACTOR * scatter_mm):
            raise scatter_error(
                f"repeat {number + 1} of {repeats} is {off_mm:.4f} mm from the others,"
                f" which spread by {scatter_mm:.4f} mm (1 sigma)",
                limit_mm,
                off_mm=off_mm,
                scatter_mm=scatter_mm,
                repeats=repeats,
            )
    return std_mm


Answer = TypeVar("Answer")


def retry_while_busy(
    ask: Callable[[], Answer],
    busy: Callable[[Answer], bool],
    limit_s: float,
    clock: Clock,
    pause_s: float = BUSY_PAUSE_S,
) -> Answer:
    """Return the answer of a device that is asked again while it is busy; the last one, then."""
    deadline = Deadline(limit_s, limit_s)
    while busy(answer := ask()) and not deadline.expired():
        clock.wait(pause_s)
    return answer
