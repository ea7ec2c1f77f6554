"""What a procedure is: its words, its plan before anything moves, its acts and its result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from hilcell.cell import Cell
from hilcell.run.bench import Bench
from hilcell.run.log import Log


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a plan: what is done, how many points it yields, how long it takes."""

    name: str
    points: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class Plan:
    """What a run will do. Building it has checked reach, limits and sight of every target."""

    steps: list[Step]
    notes: list[str] = field(default_factory=list)

    @property
    def points(self) -> int:
        """Return how many points the run measures."""
        return sum(step.points for step in self.steps)

    @property
    def duration_s(self) -> float:
        """Return how long the run takes in the cell's time."""
        return sum(step.duration_s for step in self.steps)


class Procedure(Protocol):
    """A procedure, found through the entry points ``hilcell.procedures``."""

    name: str
    summary: str
    needs: str
    moves: str
    measures: str
    yields: str

    def plan(self, cell: Cell, seed: int) -> Plan:
        """Return the plan; raises `HilcellError` for what cannot be reached or seen."""

    def perform(self, bench: Bench) -> None:
        """Do it. Called again from its start on resume: the bench skips what the journal holds."""

    def result(self, log: Log) -> dict[str, Any]:
        """Compute the result from the log alone."""

    def table(self, result: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
        """Return headers and rows of the result for a person to read."""
