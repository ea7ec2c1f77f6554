"""The stations and the provenance of a calibration, as its file has them."""

from __future__ import annotations

from typing import Literal

import msgspec

from hilcell.model.frame import Matrix


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
    """A change by a later run, from so many points.

    ``motion`` (6,) is that of the base: shift of {B}'s origin (mm) and rotation vector (rad), axes
    of the {B} before, ``covariance`` (6, 6) its own.
    """

    run: str
    what: Literal["base", "targets", "touch"]
    written: str
    points: int
    motion: list[float] = []
    covariance: Matrix = []


class Provenance(msgspec.Struct, frozen=True):
    """Where the calibration comes from, and whether its sign was proven on the cell.

    ``points`` are the journal's keys of the grid, ``scores`` mean, p95 and max (mm) by which each
    candidate's cross-validation was judged. ``run`` is the one that measured the model, ``updates``
    are later ones, and ``written`` is when the last of them changed it. ``links`` are those with
    which the controller solves Cartesian points: the cell file's, or of its own factory.
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
    links: Literal["cell file", "factory"] = "cell file"

    @property
    def latest(self) -> str:
        """Return the run that wrote the file."""
        return self.updates[-1].run if self.updates else self.run

    @property
    def named(self) -> str:
        """Return the run that wrote the file, and the one that measured the model."""
        based = f" (based on run {self.run})" if self.updates else ""
        return f"run {self.latest}{based}"

    @property
    def is_of_visit(self) -> bool:
        """Whether its last change is a base that was touched on one visit of a station."""
        return bool(self.updates) and self.updates[-1].what == "touch"
