"""A calibration: its stations and provenance, as its file has them, and how long it is valid."""

from __future__ import annotations

from datetime import timedelta
from typing import Literal

import msgspec

from hilcell.model.frame import Matrix

MAX_AGE_DAYS = 180.0
CLOCK_ERROR = timedelta(hours=1)  # by which two PCs may differ


class StationEntry(msgspec.Struct, frozen=True):
    """A station's frames: {B} and {S} in {W}, covariance (6, 6) of {S}, tool-point uncertainty."""

    T_W_B: Matrix
    T_W_S: Matrix
    covariance: Matrix
    tool_uncertainty_mm: float
    strip_mm: float


class Device(msgspec.Struct, frozen=True):
    """An asset that measured."""

    device: str
    model: str
    serial: str
    kind: str
    maker: str
    firmware: str


class Update(msgspec.Struct, frozen=True):
    """A change by a later run, measured at this number of points.

    ``motion`` (6,), of the base: shift of {B}'s origin (mm) and rotation vector (rad), axes of the
    former {B}; ``covariance`` (6, 6) of it.
    """

    run: str
    what: Literal["base", "targets", "touch"]
    written: str
    points: int
    motion: list[float] = []
    covariance: Matrix = []


class Provenance(msgspec.Struct, frozen=True):
    """Origin of a calibration, and whether its sign was verified on the cell.

    ``points``: journal keys of the grid; ``scores``: mean, p95 and max (mm) of each candidate's
    cross-validation. ``run`` measured the model, ``updates`` are later runs, ``written`` is the
    last change. ``arm_from``: the run whose arm a re-calibration has. ``links``: those with which
    the controller solves Cartesian points, from the cell file or its own factory.
    """

    run: str
    cell: str
    digest: str
    simulated: bool
    operator: str
    job: str
    software: str
    written: str
    sign_checked: bool
    versions: dict[str, str]
    devices: list[Device]
    points: list[str]
    scores: dict[str, dict[str, float]]
    updates: list[Update] = []
    arm_from: str = ""
    links: Literal["cell file", "factory"] = "cell file"

    @property
    def latest(self) -> str:
        return self.updates[-1].run if self.updates else self.run

    @property
    def named(self) -> str:
        based = [f"based on run {self.run}"] if self.updates else []
        based += [f"re-calibrated from run {self.arm_from}"] if self.arm_from else []
        return f"run {self.latest}" + (f" ({', '.join(based)})" if based else "")

    @property
    def is_of_visit(self) -> bool:
        return bool(self.updates) and self.updates[-1].what == "touch"
