"""Distances of reflectors from fixed points: a ball bar, a wire, an instrument of range alone.

The points, anchors, are unknown, and estimated with reflectors and links in the robot's root frame.
Then each distance is a position that is known along the line from its anchor, and not across it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hilcell.fit.measurements import Measurements
from hilcell.fit.placement import ABSURD_MM, FitError, refuse_unknown_targets
from hilcell.geometry.frames import apply_each, unit
from hilcell.geometry.kinematics import Arm, Array, Ints, forward
from hilcell.identification.kinematics import BASE, Kinematics, State

ACROSS_MM = 1000.0  # standard uncertainty of a position across its distance


@dataclass(frozen=True, eq=False)
class Anchors:
    """The parameters ``x``: anchors by name, reflectors by target, and links."""

    kinematics: Kinematics
    targets: list[str]
    names: list[str]
    x: Array

    @classmethod
    def of(cls, arm: Arm, rows: Measurements) -> Anchors:
        """The most probable parameters of distances; raises `FitError`."""
        nominal = [each.placed(rows) for each in cls._starts(arm, rows)]
        found = min(nominal, key=lambda each: each.half_mm(rows))
        half_mm = found.half_mm(rows)
        if not half_mm <= ABSURD_MM:
            raise FitError(
                f"{rows.source}: nominal kinematics miss half of the distances by {half_mm:.4g} mm "
                f"or more, expected <= {ABSURD_MM:g} mm"
            )
        found = found.improved(rows)
        gross = 12.0  # half misses, 8 standard deviations: such rows bend the anchors
        agreeing = found.misses(rows) <= gross * found.half_mm(rows)
        return found.improved(rows.at(np.flatnonzero(agreeing)))

    @classmethod
    def roughly(cls, arm: Arm, rows: Measurements) -> Anchors:
        """The same from one start, by which a supposition is judged."""
        first = min(cls._starts(arm, rows), key=lambda each: each.half_mm(rows))
        found = first.placed(rows)
        return found.improved(rows) if found.half_mm(rows) <= ABSURD_MM else found

    @classmethod
    def _starts(cls, arm: Arm, rows: Measurements) -> list[Anchors]:
        targets, names = sorted(set(rows.target)), sorted(set(rows.anchor))
        kinematics = Kinematics(arm, len(targets), gravity=False, waves=False)
        return [cls(kinematics, targets, names, x) for x in _starts(arm, rows, names, targets)]

    def placed(self, rows: Measurements) -> Anchors:
        """After a fit of anchors and reflectors alone."""
        return self.improved(rows, 3 * (len(self.names) + len(self.targets)))

    def located(self, rows: Measurements) -> Measurements:
        """The rows with positions; raises `FitError` for anchors that are not known."""
        refuse_unknown_targets(rows, self.targets)
        if unknown := sorted({*rows.anchor} - {*self.names}):
            raise FitError(
                f"{rows.source}: no training row measures from anchor {unknown[0]}; correct its "
                f"name, or measure from it in training rows; known: {', '.join(self.names)}"
            )
        along, distance_mm = unit(self.lines(rows)), _distances_mm(rows)[:, None]
        outer = along[:, :, None] * along[:, None, :]
        own_mm2 = np.zeros(outer.shape) if rows.covariance_mm2 is None else rows.covariance_mm2
        return replace(
            rows,
            xyz_mm=self.anchors_mm[_numbers(rows.anchor, self.names)] + distance_mm * along,
            covariance_mm2=outer @ own_mm2 @ outer + ACROSS_MM**2 * (np.eye(3) - outer),
            along=along,
        )

    def lines(self, rows: Measurements) -> Array:
        """Vectors from the anchors (N, 3)."""
        at_mm = self.kinematics.positions_mm(self._state, rows.joints_rad)
        which, anchor = _numbers(rows.target, self.targets), _numbers(rows.anchor, self.names)
        return at_mm[np.arange(len(rows)), which] - self.anchors_mm[anchor]

    def slopes(self, rows: Measurements) -> Array:
        """The derivatives of distances (N, P)."""
        each, free = np.arange(len(rows)), self.anchors_mm.size
        which, anchor = _numbers(rows.target, self.targets), _numbers(rows.anchor, self.names)
        found = self.kinematics.linearised(self._state, rows.joints_rad)
        along, J = unit(self.lines(rows)), np.zeros((len(rows), len(self.x)))
        for axis in range(3):
            J[each, 3 * anchor + axis] = -along[:, axis]
        J[:, free:] = np.einsum("ni,nip->np", along, found.by_parameter[each, which][..., BASE:])
        return J

    @property
    def anchors_mm(self) -> Array:
        """The anchors (A, 3) in the root frame."""
        return self.x[: 3 * len(self.names)].reshape(-1, 3)

    @property
    def _state(self) -> State:
        start = self.kinematics.start(np.eye(4), np.zeros((len(self.targets), 3)))
        others = self.x[self.anchors_mm.size :]
        return self.kinematics.moved(start, np.concatenate([np.zeros(BASE), others]))

    def missed_mm(self, rows: Measurements) -> Array:
        """Measured minus predicted distances (N,)."""
        return np.asarray(_distances_mm(rows) - np.linalg.norm(self.lines(rows), axis=1))

    def misses(self, rows: Measurements) -> Array:
        """Distances (N,) of rows from this robot."""
        return np.abs(self.missed_mm(rows))

    def half_mm(self, rows: Measurements) -> float:
        return float(np.median(self.misses(rows)))

    def improved(self, rows: Measurements, count: int | None = None) -> Anchors:
        """After a robust fit of the first ``count`` parameters, or of all."""
        from scipy.optimize import least_squares

        scatter_mm, free = 0.05, 3 * len(self.names)  # beside the rows' own
        size = len(self.x) if count is None else count
        sigma = np.full(len(rows), scatter_mm)
        if rows.covariance_mm2 is not None:
            sigma = np.hypot(scatter_mm, np.sqrt(np.einsum("nii->n", rows.covariance_mm2) / 3.0))
        prior = 1.0 / np.sqrt(np.diag(self.kinematics.prior[1]))[BASE:]
        prior_root = np.hstack([np.zeros((len(prior), free)), np.diag(prior)])[:, :size]

        def at(x: Array) -> Anchors:
            return replace(self, x=np.concatenate([x, self.x[size:]]))

        def missed(x: Array) -> Array:
            return np.concatenate([at(x).missed_mm(rows) / sigma, prior_root @ x])

        def slope(x: Array) -> Array:
            J = at(x).slopes(rows)[:, :size]
            return np.concatenate([-J / sigma[:, None], prior_root])

        def scale(x: Array) -> float:  # at least 3; far from the distances, L1 would creep
            return max(3.0, float(np.median(np.abs(missed(x)[: len(rows)]))))

        x, rounds, steps, falling = self.x[:size], 8, 6, 0.9
        far = scale(x)
        for _ in range(rounds):
            found = least_squares(
                missed, x, jac=slope, x_scale="jac", loss="soft_l1", f_scale=far, max_nfev=steps
            )
            before, x = far, found.x
            far = scale(x)
            if found.success and far > falling * before:
                break
        return at(x)


def _starts(
    arm: Arm, rows: Measurements, names: Sequence[str], targets: Sequence[str]
) -> Iterator[Array]:
    """Parameters to begin with: anchors by trilateration, of reflectors at some places."""
    flange, distance_mm = forward(arm, rows.joints_rad), _distances_mm(rows)
    anchor, links = _numbers(rows.anchor, names), Kinematics(arm, gravity=False, waves=False).links
    away_mm = 150.0
    for place_mm in away_mm * np.vstack([np.zeros(3), np.eye(3), -np.eye(3)]):
        at_mm = apply_each(flange, np.broadcast_to(place_mm, (len(rows), 3)))
        anchors = [
            _trilaterated(at_mm[anchor == n], distance_mm[anchor == n]) for n in range(len(names))
        ]
        yield np.concatenate([*anchors, np.tile(place_mm, len(targets)), np.zeros(links)])


def _trilaterated(places_mm: Array, distances_mm: Array) -> Array:
    """The point (3,) at distances (N,) from places (N, 3): |p|^2 - 2 p a + |a|^2 = d^2."""
    design = np.column_stack([-2.0 * places_mm, np.ones(len(places_mm))])
    squares = distances_mm**2 - np.sum(places_mm**2, axis=1)
    return np.asarray(np.linalg.lstsq(design, squares, rcond=None)[0][:3])


def _distances_mm(rows: Measurements) -> Array:
    return np.full(len(rows), np.nan) if rows.distance_mm is None else rows.distance_mm


def _numbers(labels: Sequence[str], names: Sequence[str]) -> Ints:
    return np.array([names.index(each) for each in labels])
