"""Rules of the tracker's set-ups: I10, I15, I16."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations

import msgspec
import numpy as np

from hilcell.geometry.beam_noise import beam_noise
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import coverage_factor
from hilcell.invariants.bodies import Framed, Life, Measured
from hilcell.invariants.scene import Scene, is_proof, is_world, nest_of, set_up_of
from hilcell.invariants.tally import Tally
from hilcell.journal.journal import Record
from hilcell.journal.set_ups import PROVEN, TRACKER_MOVED

SIGMAS = 4.0
FRAMING = "world"  # kind of the points of which {W} is framed


class TrackerSetUps:
    """Judges what was measured at which set-up, and when the tracker was proven."""

    def __init__(self, tally: Tally, scene: Scene) -> None:
        self._check, self._scene = tally.check, scene

    def take(self, record: Record) -> None:
        """Judge a record."""
        match record.kind:
            case "point":
                self._point(record, msgspec.convert(record.body, Measured))
            case "frame":
                self._frame(record, msgspec.convert(record.body, Framed))
            case "state" if record.body.get("machine") == "run":
                if msgspec.convert(record.body, Life).to == "finished":
                    self._closed(record, "the run's end", list(self._scene.unproven))
            case "event":
                self._event(record)

    def _event(self, record: Record) -> None:
        body, scene = record.body, self._scene
        match body.get("what"):
            case "step":
                here = [key for key, session in scene.unproven.items() if session == scene.session]
                self._closed(record, f"step {body['name']}", here)
            case "stream":
                self._followed(record, body["key"])
            case found if found == PROVEN:
                self._proof(record)
            case found if found == TRACKER_MOVED:
                kept = sorted(scene.unproven.keys() - set(body["invalid"]))
                what = f"kept {', '.join(kept)} of a tracker that had moved"
                self._check("I10", record, not kept, what)

    def _point(self, record: Record, point: Measured) -> None:
        scene = self._scene
        what = f"{record.key} is of set-up {point.set_up}, the tracker at {scene.set_up}"
        self._check("I15", record, point.set_up == scene.set_up, what)
        if not is_proof(record.key):
            self._followed(record, record.key)

    def _followed(self, record: Record, key: str) -> None:
        """Judge what is added: after a pause the tracker comes first."""
        scene = self._scene
        if self._mounted and scene.framed and scene.state != "checking":
            what = f"{key} added before the tracker was proven after a pause"
            self._check("I16", record, not scene.interrupted, what)

    def _closed(self, record: Record, before: str, unproven: list[str]) -> None:
        """Judge the end of what was measured before a step, or before the end.

        A step that an earlier session has begun goes on, and is proven first.
        """
        if self._mounted and self._scene.framed:
            what = f"{len(unproven)} points unproven before {before}: {', '.join(unproven[:3])}"
            self._check("I16", record, not unproven, what)

    @property
    def _mounted(self) -> bool:
        """Whether all nests have reflectors; one that is carried proves the tracker less often."""
        return self._scene.cell.layout.reflectors == "mounted"

    def _frame(self, record: Record, frame: Framed) -> None:
        scene = self._scene
        if is_world(record.key):
            self._world(record)
        if frame.points is None:
            return
        lost = [key for key in frame.points if key not in scene.points]
        what = f"{record.key} is built of {', '.join(lost[:3])}, not valid"
        self._check("I10", record, not lost, what)
        of = {scene.points[key].set_up for key in frame.points if key in scene.points}
        what = f"{record.key} is built of points of set-ups {sorted(of)}, {{W}} known of "
        what += f"{sorted(scene.framed)}"
        known = of == {set_up_of(record.key)} if is_world(record.key) else of <= scene.framed
        self._check("I15" if is_world(record.key) else "I10", record, known, what)

    def _world(self, record: Record) -> None:
        """Judge a {W}: of nests at its own set-up, which stand as they did at the first."""
        number = set_up_of(record.key)
        nests = self._nests(number)
        what = f"{record.key} framed at set-up {self._scene.set_up} by {len(nests)} nests"
        self._check("I15", record, number == self._scene.set_up and len(nests) >= 3, what)
        if number:
            for what, off_mm, limit_mm in self._changes(self._nests(0), nests):
                text = f"{record.key}: {what} changed by {off_mm:.3f} mm, at most {limit_mm:.3f}"
                self._check("I15", record, off_mm <= limit_mm, text)

    def _proof(self, record: Record) -> None:
        """Judge the proof by its points: each nest is where it was when {W} was framed."""
        before, now = self._nests(self._scene.set_up), self._scene.control
        self._check("I15", record, bool(before) and before.keys() == now.keys(), "nests missing")
        for nest in before.keys() & now.keys():
            off_mm = _apart_mm(before[nest], now[nest])
            limit_mm = self._limit_mm(before[nest], now[nest])
            what = f"proven with {nest} {off_mm:.3f} mm off, at most {limit_mm:.3f} mm"
            self._check("I15", record, off_mm <= limit_mm, what)

    def _nests(self, set_up: int) -> dict[str, Measured]:
        """Return the points of which {W} was framed at a set-up, by nest."""
        points = self._scene.points.items()
        return {
            nest_of(key): point
            for key, point in points
            if key.startswith(f"{FRAMING}/") and point.set_up == set_up
        }

    def _changes(
        self, before: dict[str, Measured], now: dict[str, Measured]
    ) -> Iterator[tuple[str, float, float]]:
        """Yield each two nests, by how much their distance has changed, and its limit."""
        for one, other in combinations(sorted(before.keys() & now.keys()), 2):
            then_mm = _apart_mm(before[one], before[other])
            off_mm = abs(_apart_mm(now[one], now[other]) - then_mm)
            four = (before[one], before[other], now[one], now[other])
            yield f"{one} to {other}", off_mm, self._limit_mm(*four)

    def _limit_mm(self, *points: Measured) -> float:
        """Return by how much points may differ: stated drift, and the readings' noise.

        The noise is what all points so far have shown, at the places of these.
        """
        found = [point for point in self._scene.points.values() if _stated(point)]
        if not all(_stated(point) for point in points):
            return math.nan
        noise = beam_noise(*_columns(found or points))
        at_mm, _, samples = _columns(points)
        noise_mm2 = float(np.trace(noise.at(at_mm, samples), axis1=-2, axis2=-1).sum())
        drift_mm = math.sqrt(3.0) * self._scene.cell.uncertainty.drift_limit_mm
        return drift_mm + coverage_factor(SIGMAS, noise.freedom) * math.sqrt(noise_mm2)


def _stated(point: Measured) -> bool:
    """Whether a point's place and scatter are numbers."""
    return all(map(math.isfinite, (*point.xyz_mm, *point.std_mm))) and point.samples >= 1


def _columns(points: Sequence[Measured]) -> tuple[Array, Array, Array]:
    """Return positions (N, 3), standard deviations (N, 3) and numbers of samples (N,)."""
    rows = [(point.xyz_mm, point.std_mm, point.samples) for point in points]
    at_mm, std_mm, samples = zip(*rows, strict=True)
    return np.array(at_mm), np.array(std_mm), np.array(samples, dtype=float)


def _apart_mm(one: Measured, other: Measured) -> float:
    return math.dist(one.xyz_mm, other.xyz_mm)
