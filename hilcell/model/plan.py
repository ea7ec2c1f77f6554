"""The frozen inputs of a run: its first record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import msgspec

from hilcell.decoding import Json
from hilcell.model.events import Three
from hilcell.model.frame import Frame


@dataclass(frozen=True, slots=True)
class Span:
    """Consecutive measurements of one kind: how many, total time; none: the motion to the next."""

    kind: str
    measured: int  # with those of control points, which no plan counts as points
    duration_s: float

    @property
    def each_s(self) -> float:
        return self.duration_s / max(1, self.measured)


@dataclass(frozen=True, slots=True)
class PlannedStep:
    """A step as planned: how many points it yields, how long it takes."""

    name: str
    points: int
    duration_s: float
    spans: tuple[Span, ...] = ()  # in their order; for the forecast
    note: str = ""  # why a step does nothing
    warning: str = ""  # why hardly any result could be accepted

    @classmethod
    def of_spans(cls, name: str, points: int, spans: Sequence[Span]) -> Self:
        return cls(name, points, sum(span.duration_s for span in spans), tuple(spans))


class PreviousReference(msgspec.Struct, frozen=True):
    """Floor nests of an earlier run: positions in its tracker frame (mm), its base and slide
    frames.

    The base is at the grid's station, None where that has changed. ``alike``: same robot, same
    circles. ``frames_c``: air temperature of base and slide where another run measured these.
    ``visits_mm``: positions of the same grid that this robot visited repeatedly.
    """

    run: str
    nests_mm: dict[str, Three]
    temperature_c: float | None
    base: Frame | None = None
    alike: bool = False
    stations: dict[str, Frame] = {}
    frames_c: float | None = None
    visits_mm: list[list[Three]] = []


class FolderOrder(msgspec.Struct, frozen=True):
    """A session's place in its folder of runs: ``number`` 1, 2, .. and the run before, "" for none.
    ``folder`` is drawn with the first number, "" where none was taken.
    """

    folder: str = ""
    number: int = 0
    after: str = ""


class PlanRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The frozen inputs of a run."""

    procedure: str
    cell: Json
    digest: str
    seed: int
    speed: float | None
    unattended: bool
    operator: str
    job: str
    simulated: bool
    versions: dict[str, str]
    settings: dict[str, str]
    steps: list[PlannedStep]
    points: int
    duration_s: float
    machine_seed: int | None  # of the simulated machine; None where this run did not start it
    cell_file: str  # where the cell came from
    driven_by: list[str] = []  # runs finished before, newest first: the poses they drove are known
    accepted: list[str] = []  # why the calibration that it uses should not be used
    order: FolderOrder = FolderOrder()
    floor_before: PreviousReference | None = None  # by the cell's current calibration
    replayed: bool = False  # it only repeats a recorded run, and measures nothing
    utc_offset_min: int = 0  # by which the clock on the wall was ahead of UTC when it began

    @property
    def serial(self) -> str:
        return str(self.cell["serial"])
