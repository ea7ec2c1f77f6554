"""Verification that tracker, slide and ambient temperature are unchanged since the run began.

A bumped tracker measures everything with an offset, and every reading looks good. So the floor
nests are re-measured at the end of every measuring step, after every pause and every
`plan.prove_every` points. If all have moved alike, the tracker has moved: the points since its last
verification are invalid, {W} is framed at the new set-up, and the step is repeated. If they have
moved against each other, they are measured once more, since the tracker may have been bumped
between two of them. If they still differ, a nest has moved, and the run ends with a fault.

A strip that has jumped a pole reads the station's value at another slide position; neither drive
nor strip shows that. So after each hold one slide nest is compared with its first hold at the
station in this run, on which base and station frame are built.

An ambient temperature out of range suspends a run until it is back. Level, not edge: each point's
own temperature is checked before the next is measured, on resume too. While the run is suspended
the tracker measures a floor nest to read its weather station.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Container, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import NamedTuple, NoReturn

import numpy as np

from hilcell.calibration.diagnosis import NOTICED_BY, reference_c
from hilcell.calibration.frames import world_from_tracker
from hilcell.calibration.misplaced_nests import misplaced_nest, other_reflector
from hilcell.cell.file import Cell, Nest, Station
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.statistics import BeamNoise, coverage_factor, lengths_mm
from hilcell.identification.places import proven_shift
from hilcell.identification.reflector_radius import reflectors_of
from hilcell.journal.log import VERIFICATION_KINDS, noise_at, positions_mm, run_noise, world_key
from hilcell.model.events import (
    AmbientInLimits,
    RemeasureRequested,
    SlideVerified,
    TrackerMoved,
    TrackerVerified,
    WorldRemeasured,
)
from hilcell.model.frame import Frame
from hilcell.model.point import HELD, LENGTH, Point, PointId
from hilcell.model.verdicts import Cause, Suspicion
from hilcell.ports import Array, DeviceError, NoReading, TrackerReading
from hilcell.run.meter import Meter
from hilcell.run.prompts import Prompt, Verification
from hilcell.run.states import retake_refusal

SIGMAS = 4.0  # of the readings' noise beyond the stated drift
ALIKE = 0.5  # share of the largest motion; a bumped tracker moves every nest by more


class RemeasureStep(Exception):
    """The points since the tracker's last verification are invalid; their step is repeated."""


class SlideOffset(NamedTuple):
    """The slide's offset along the rail from its earlier position, and the limit."""

    off_mm: float
    limit_mm: float

    @property
    def holds(self) -> bool:
        return abs(self.off_mm) <= self.limit_mm


class WrongDistance(NamedTuple):
    """Two nests whose distance is not the expected one."""

    nests: list[str]
    distance_mm: float
    wanted_mm: float
    limit_mm: float

    @property
    def names(self) -> str:
        return " to ".join(self.nests)


class Watch(Meter):
    """Verifies between measurements what they rest on: the tracker by the floor nests, the slide's
    hold by a slide nest, the ambient temperature by the newest point. After a prompt it measures
    again only once the tracker is verified.
    """

    MOST_SET_UPS = 5  # of one run

    _hold_verified: tuple[str, int] | None = None  # station and visit
    _temperature_judged: Point | None = None
    _temperature_good_since_s: float | None = None  # since which, cell time

    def measured(self, key: str, place: str, near_mm: Array, samples: int) -> TrackerReading:
        """Measure the reflector at ``place``, expected at (3,), tracker's frame.

        After a prompt the tracker is verified first: it may have moved meanwhile.
        """
        while (reading := self.measure(key, place, near_mm, samples)) is None:
            self.verify_tracker_if_due()
        return reading

    def measured_in_world(
        self, key: str, place: str, expected_mm: Array, samples: int, limit_mm: float | None = None
    ) -> TrackerReading:
        """Measure the reflector at ``place``, expected at (3,) in {W}; see `measured`.

        Raises `DeviceError` where it is further away than ``limit_mm``, once {B} was measured.
        """
        near_mm = self.frames.tracker_from_world(expected_mm)[0]
        reading = self.measured(key, place, near_mm, samples)
        if limit_mm is None or not self.frames.based():
            return reading
        off_mm = math.dist(self.frames.world_from_tracker(reading.xyz_mm)[0], expected_mm)
        if not off_mm <= limit_mm:
            raise DeviceError(
                "HC-T17",
                "Tracker",
                f"measure {key}",
                f"reflector {off_mm:.2f} mm from its expected place",
                expected=f"<= {limit_mm:.1f} mm",
                fields={"point": key, "off_mm": off_mm, "limit_mm": limit_mm},
            )
        return reading

    # -- the tracker's set-up ---------------------------------------------------------------------

    def frame_world(self) -> None:
        """Frame {W} at the tracker's present set-up, or verify the tracker there."""
        cell, number = self.cell, self.log.set_ups.number
        if self._framed:
            self.verify_tracker()
            return
        ids = self._nest_ids(number)
        # Since an engine before this one measured them, the tracker may have moved.
        if begun := [id.key for id in ids if self.log.find(id)]:
            self.add(WorldRemeasured(invalid=begun))
        nests = self._measured(ids)
        measured_mm = positions_mm(nests)
        if not number:
            check_places(cell, measured_mm, taken=self.log.taken)
            check_distances(cell, measured_mm)
            self._check_before(nests)
        elif any(self._changes(nests)):
            self._renew(nests, self._controls())
        T = world_from_tracker(cell, measured_mm)
        keys = [nest.key for nest in nests]
        self.frame(world_key(number), Frame(matrix=T.tolist(), points=keys))

    def verify_tracker(self) -> None:
        """Verify that the tracker has not moved since {W} was framed.

        Raises `RemeasureStep` where it has, after {W} was framed again, and `DeviceError` where a
        nest has moved or frames were built since the last verification.
        """
        before = [self.log.point(id) for id in self._nest_ids(self.log.set_ups.number)]
        now = self._controls()
        unmoved = self._unmoved(before, now)
        if not unmoved and (some_unmoved(before, now) or any(self._changes(now))):
            now = self._controls()
            unmoved = self._unmoved(before, now)
        if not unmoved:
            if some_unmoved(before, now):
                self._refuse_moved_nests(motions_mm(before, now))
            self._renew(before, now)
        self.add(TrackerVerified(off_mm=motions_mm(before, now).tolist()))

    def close_step(self, *, carried: bool = False) -> None:
        """Verify the tracker at the end of a measuring step.

        With a reflector that is carried by hand only if ``carried``.
        """
        by_hand = self.cell.layout.by_hand
        if self.log.set_ups.needs_verification and self._framed and (carried or not by_hand):
            self.verify_tracker()

    def verify_tracker_if_due(self) -> None:
        """Verify the tracker after a pause and every `plan.prove_every` points.

        Not with a reflector that is carried by hand: each of its moves is a pause.
        """
        cell, set_ups = self.cell, self.log.set_ups
        due = set_ups.interrupted or len(set_ups.unverified) >= cell.plan.prove_every
        if due and not cell.layout.by_hand and self._framed:
            self.verify_tracker()

    @property
    def _framed(self) -> bool:
        return world_key(self.log.set_ups.number) in self.log.frames

    def _measured(self, ids: list[PointId]) -> list[Point]:
        nests = self.cell.layout.floor
        return [self.floor_nest_point(id, nest) for id, nest in zip(ids, nests, strict=True)]

    def _controls(self) -> list[Point]:
        log, names = self.log, [nest.name for nest in self.cell.layout.floor]
        kinds = (*VERIFICATION_KINDS, LENGTH)
        before = Counter(point.id.nest for kind in kinds for point in log.measured(kind))
        return self._measured(
            [PointId("control", session=log.session, pass_number=before[n], nest=n) for n in names]
        )

    def _renew(self, before: list[Point], now: list[Point]) -> NoReturn:
        """Frame {W} at a new set-up of a tracker that has moved since ``before``."""
        for wrong in self._changes(now):
            raise self._moved(
                f"{wrong.names} was {wrong.wanted_mm:.3f} mm, is {wrong.distance_mm:.3f} mm",
                f"{wrong.wanted_mm:.3f} +-{wrong.limit_mm:.3f} mm",
                "a floor nest or its reflector has moved; fix it, then start a new run",
                wrong._asdict(),
            )
        set_ups = self.log.set_ups
        moved_mm = float(motions_mm(before, now).max())
        limit_mm = float(self._limits_mm(before, now).min())
        self._check_renewable(moved_mm, limit_mm)
        number, invalid = set_ups.number + 1, list(set_ups.unverified)
        moved = TrackerMoved(set_up=number, invalid=invalid, moved_mm=moved_mm, limit_mm=limit_mm)
        self.add(moved)
        self.frame_world()
        raise RemeasureStep

    def _unmoved(self, before: Sequence[Point], now: Sequence[Point]) -> bool:
        return bool(np.all(motions_mm(before, now) <= self._limits_mm(before, now)))

    def _changes(self, now: list[Point]) -> Iterator[WrongDistance]:
        """Yield the pairs of nests whose distance has changed since {W} was first framed."""
        first = [self.log.point(id) for id in self._nest_ids(0)]
        limits_mm = self._distance_limits_mm(first, now)
        return wrong_distances(self.cell, positions_mm(first), positions_mm(now), limits_mm)

    def _limits_mm(self, before: Sequence[Point], now: Sequence[Point]) -> Array:
        return motion_limits_mm(self.cell, run_noise(self.log), before, now)

    def _distance_limits_mm(self, before: Sequence[Point], now: Sequence[Point]) -> Array:
        """Return the limits (N, N) of changes of distances between nests; see `motion_limits_mm`.

        Of the readings' noise only the component along the line between two nests counts.
        """
        noise, at_mm = run_noise(self.log), positions_mm(before)
        mm2 = noise_at(noise, before) + noise_at(noise, now)
        lines_mm = at_mm[:, None] - at_mm[None]
        along = lines_mm / np.maximum(np.linalg.norm(lines_mm, axis=-1), 1.0)[..., None]
        both_mm2 = np.einsum("ijk,ijkl,ijl->ij", along, mm2[:, None] + mm2[None], along)
        return _length_limits_mm(self.cell, noise, both_mm2)

    def _limit_since_mm(self, nests: Sequence[Point], then_c: float | None) -> float:
        """Return the limit of changes of the floor nests' distances since an earlier run.

        Noise, stated drift, the tracker's limits in both runs and the floor's thermal growth.
        """
        now_c = [point.temperature_c for point in nests if point.temperature_c is not None]
        warmer_k = 10.0  # without measured air
        if now_c and then_c is not None:
            warmer_k = abs(float(np.mean(now_c)) - then_c)
        at_mm, stated = positions_mm(nests), self.cell.uncertainty
        longest_mm = float(np.linalg.norm(at_mm[:, None] - at_mm[None], axis=-1).max())
        far_mm = float(np.linalg.norm(at_mm, axis=1).max())
        tracker_mm = 2.0 * (stated.tracker_limit_mm + 1e-6 * stated.tracker_limit_um_m * far_mm)
        floor_um_m_k = 12.0  # growth of concrete and steel
        grown_mm = 1e-6 * floor_um_m_k * warmer_k * longest_mm
        return float(self._limits_mm(nests, nests).max()) + tracker_mm + grown_mm

    def _check_before(self, nests: list[Point]) -> None:
        """Refuse nests that have moved since the cell's current calibration was measured."""
        cell, before = self.cell, self.log.inputs.floor_before
        if before is None:
            return
        then_mm = np.array([before.nests_mm[nest.name] for nest in cell.layout.floor])
        limit_mm = self._limit_since_mm(nests, before.temperature_c)
        for wrong in wrong_distances(cell, then_mm, positions_mm(nests), limit_mm):
            raise DeviceError(
                "HC-T32",
                "Tracker",
                "world frame",
                f"{wrong.names} is {wrong.distance_mm:.3f} mm",
                expected=f"{wrong.wanted_mm:.3f} +-{limit_mm:.3f} mm, as in run {before.run}",
                act="a floor nest has moved since that run, or a reflector is not seated; put it "
                "right and resume, or revoke that run's calibration and start a new run",
                fields=wrong._asdict() | {"run": before.run},
            )

    def _refuse_moved_nests(self, off_mm: Array) -> NoReturn:
        """Refuse motions of only some nests: one lifted out of the plane of three changes no
        distance by as much as would show.
        """
        still = off_mm <= ALIKE * off_mm.max()
        names = np.array([nest.name for nest in self.cell.layout.floor])
        moving, standing = names[~still].tolist(), names[still].tolist()
        raise self._moved(
            f"{', '.join(moving)} moved by {off_mm.max():.3f} mm, {', '.join(standing)} by "
            f"{off_mm[still].max():.3f} mm at most",
            "all alike, as of a tracker that was moved",
            "a floor nest or its reflector has moved, or the tracker has tilted; check them, then "
            "start a new run",
            {"nests": moving, "moved_mm": float(off_mm.max()), "standing": standing},
        )

    def _check_renewable(self, moved_mm: float, limit_mm: float) -> None:
        """Refuse to continue where frames use invalid points, or after too many set-ups."""
        log = self.log
        invalid = [log.points[key] for key in log.set_ups.unverified if key in log.points]
        built = next((key for point in invalid if (key := self._rests_on(point))), "")
        if not built and log.set_ups.number < self.MOST_SET_UPS:
            return
        act = "fix its stand, then start a new run"
        if built:
            act = f"{built} uses points measured since its last verification; start a new run"
        suspicion = Suspicion(Cause.TRACKER_MOVED, moved_mm, "mm", "control points")
        raise self._moved(
            f"moved by {moved_mm:.3f} mm",
            f"<= {limit_mm:.3f} mm",
            f"the tracker was bumped: {act}",
            {"moved_mm": moved_mm, "limit_mm": limit_mm} | suspicion.facts,
        )

    def _rests_on(self, point: Point) -> str:
        """Return the frame or verdict that uses a point, "" for none."""
        built = {
            "base": "base",
            "slide": f"station.{point.station}",
            "three": f"three_points.{point.station}",
            "grid": "fit",
            "oriented": "fit",
            "pose": "fit",
            "repeatability": "fit",
        }.get(point.id.kind, "")
        return built if built in self.log.frames or built in self.log.verdicts else ""

    # -- the slide's hold -------------------------------------------------------------------------

    def hold_station(self, station: Station, *, again: bool = False) -> None:
        """Hold a station and verify it, unless that was done since the slide last moved.

        ``again`` approaches a held station and leaves the verification to the caller. Nothing can
        be verified without {W}, without a rail or with a reflector carried by hand. Raises
        `RemeasureStep` where the tracker has moved. A strip that has jumped pauses an attended run;
        `DeviceError` where the slide is out of place after another approach.
        """
        super().hold_station(station, again=again)
        if again or not (self._framed and self.cell.has_rail) or self.cell.layout.by_hand:
            return
        if self._hold_verified == (station.name, self.log.visit):
            return
        self.parked()  # the arm may block the beam to the slide
        off = self._verify_hold(station)
        if not off.holds:
            self.verify_tracker()
            self.pause(
                f"the slide is {off.off_mm:+.3f} mm along the rail from its first hold of "
                f"{station.name}, expected within {off.limit_mm:.3f} mm: the strip has jumped, or "
                "a slide nest has moved"
            )
            super().hold_station(station, again=True)
            off = self._verify_hold(station)
        if not off.holds:
            jump = Suspicion(Cause.STRIP, off.off_mm, "mm", f"slide nest at {station.name}").facts
            raise DeviceError(
                "HC-S10",
                "Rail",
                f"hold {station.name}",
                f"the strip reads the station, the slide is {off.off_mm:+.3f} mm from it",
                expected=f"within {off.limit_mm:.3f} mm along the rail of its first hold in this "
                "run",
                fields=jump
                | {"station": station.name, "off_mm": off.off_mm, "limit_mm": off.limit_mm},
            )
        self._hold_verified = (station.name, self.log.visit)

    def _verify_hold(self, station: Station) -> SlideOffset:
        """Measure the nest; journal the hold as verified if it is within the limit."""
        self.verify_tracker_if_due()
        nest = self.cell.layout.slide[0]
        turn = len(self.log.select(HELD, station.name))
        id = PointId(
            HELD, station=station.name, session=self.log.session, pass_number=turn, nest=nest.name
        )
        expected_mm = (self.frames.base_in_world(station) @ np.append(nest.xyz_mm, 1.0))[:3]
        samples = self.cell.tracker.samples  # as quickly as a target
        measure = partial(self.measured_in_world, id.key, nest.name, expected_mm, samples)
        reading = self.settled(measure, self.rests.rail_s, self.cell.settle.rail_s)
        point = self.record_point(id, station.name, reading)
        off = self._off(station, point)
        if off.holds:
            self.add(SlideVerified(key=point.key, off_mm=off.off_mm, limit_mm=off.limit_mm))
        return off

    def _off(self, station: Station, now: Point) -> SlideOffset:
        """Return the offset of a hold from the first hold: of the same station, or else of any.

        The very first hold has none. Between stations the strip's own error allows more.
        """
        keys = (each.key for each in self.log.happened(SlideVerified))
        before = [self.log.points[key] for key in keys if key in self.log.points]
        here = [point for point in before if point.station == station.name]
        if not before:
            return SlideOffset(0.0, 0.0)
        first = (here or before)[0]
        straight_mm = 0.5  # between stations by the strip: its error, the rail's tilt and lean
        held_mm = 2.0 * self.cell.rail.hold_limit_mm if here else straight_mm
        limit_mm = held_mm + float(self._limits_mm([first], [now])[0])
        at_mm = apply(self.log.matrix("world"), positions_mm([first, now]))
        travel_mm = station.strip_mm - self.cell.station_named(first.station).strip_mm
        along_mm = float((at_mm[1] - at_mm[0]) @ np.array(self.cell.layout.rail_direction))
        return SlideOffset(along_mm - travel_mm, limit_mm)

    # -- the ambient temperature ------------------------------------------------------------------

    def check_ambient_temperature(self) -> None:
        """Suspend the run if its newest point was measured out of the temperature range.

        That point is re-measured, if it may be. With a reflector carried by hand the operator
        watches the temperature.
        """
        point, table = self.last, self.cell.room
        if point is None or point is self._temperature_judged or self.cell.layout.by_hand:
            return
        then_c, self._temperature_judged = reference_c(self.log), point
        if then_c is None or point.temperature_c is None:
            return
        if abs(point.temperature_c - then_c) <= table.range_k:
            return
        self._await_ambient_temperature(point, then_c)

    def _await_ambient_temperature(self, point: Point, then_c: float) -> None:
        cause, nest = self._temperature_error(point, then_c), self.cell.layout.floor[0]
        x, y, z = self.frames.tracker_from_world(nest.xyz_mm)[0].tolist()
        prompt = Prompt(
            title="Wait for the ambient temperature",
            text=f"{cause.found}. The run continues when the air is {cause.expected}; "
            "close doors and gates, look at the heating.",
            place="the ambient temperature",
            expected_mm=(x, y, z),
            limit_mm=self.cell.tracker.find_radius_mm,
            reason=f"ambient temperature: {cause.found}, expected {cause.expected}",
            by_itself=True,
        )
        self._temperature_good_since_s = None
        if not retake_refusal(self.log, point.key):
            self.add(RemeasureRequested(key=point.key))  # also after a resume
        self.ask(
            prompt,
            lambda: self._verify_ambient_temperature(np.array(prompt.expected_mm), then_c),
            cause,
        )
        self.add(AmbientInLimits())

    def _temperature_error(self, point: Point, then_c: float) -> NoReading:
        table, now_c = self.cell.room, point.temperature_c or 0.0
        return NoReading(
            "HC-V14",
            "Tracker",
            f"weather station at {point.key}",
            f"air {now_c:.1f} C, {now_c - then_c:+.1f} K from the grid's first point",
            expected=f"within {table.back_k:g} K of {then_c:.1f} C for {table.steady_s:g} s",
            act="wait until the temperature is back, then resume",
            fields=Suspicion(Cause.TEMPERATURE, now_c - then_c, "K", NOTICED_BY).facts
            | {"air_c": now_c, "then_c": then_c, "limit_k": table.range_k},
        )

    def _verify_ambient_temperature(self, near_mm: Array, then_c: float) -> Verification:
        """Read the weather station; passes once the air has been within the band long enough."""
        table, reflector = self.cell.room, self.cell.tracker.reflector
        try:
            reading = self.devices.tracker.measure(near_mm, reflector, 1)
        except DeviceError as error:
            return Verification.failed(error, self.clock.pc_s())
        now_s = self.clock.now_s()
        off_k = np.nan if reading.air is None else reading.air.temperature_c - then_c
        if not abs(off_k) <= table.back_k:
            self._temperature_good_since_s = None
            return Verification(
                None, f"the air is {off_k:+.1f} K from {then_c:.1f} C", reading.taken_s
            )
        self._temperature_good_since_s = (
            now_s if self._temperature_good_since_s is None else self._temperature_good_since_s
        )
        steady_s = now_s - self._temperature_good_since_s
        if not steady_s >= table.steady_s:
            why = f"the air has been within {table.back_k:g} K for {steady_s:.0f} s"
            return Verification(None, f"{why}, expected {table.steady_s:g} s", reading.taken_s)
        return Verification(float(np.linalg.norm(reading.xyz_mm - near_mm)), "", reading.taken_s)

    @staticmethod
    def _moved(found: str, expected: str, act: str, fields: Mapping[str, object]) -> DeviceError:
        return DeviceError(
            "HC-T33", "Tracker", "control points", found, expected=expected, act=act, fields=fields
        )

    def _nest_ids(self, set_up: int) -> list[PointId]:
        """Return the identities of the points that frame {W} at a set-up."""
        return [
            PointId("world", number=set_up or None, nest=nest.name)
            for nest in self.cell.layout.floor
        ]


# -- floor nests as measured ----------------------------------------------------------


def motion_limits_mm(
    cell: Cell, noise: BeamNoise, before: Sequence[Point], now: Sequence[Point]
) -> Array:
    """Return the limits (N,) of apparent motions of nests: stated drift and the noise of all
    readings of the run so far.
    """
    mm2 = noise_at(noise, before) + noise_at(noise, now)
    return _length_limits_mm(cell, noise, np.trace(mm2, axis1=-2, axis2=-1))


def _length_limits_mm(cell: Cell, noise: BeamNoise, variances_mm2: Array) -> Array:
    sigmas = coverage_factor(SIGMAS, noise.freedom)
    limits: Array = np.sqrt(3.0) * cell.uncertainty.drift_limit_mm + sigmas * np.sqrt(variances_mm2)
    return limits


def motions_mm(before: Sequence[Point], now: Sequence[Point]) -> Array:
    return lengths_mm(positions_mm(now) - positions_mm(before))


def some_unmoved(before: Sequence[Point], now: Sequence[Point]) -> bool:
    """Whether some nests moved much less than others, which no tracker motion can cause."""
    off_mm = motions_mm(before, now)
    return bool(np.any(off_mm <= ALIKE * off_mm.max()))


def check_places(cell: Cell, measured_mm: Array, *, taken: Container[str] = ()) -> None:
    """Refuse nests measured outside their search radius, besides those whose place was ``taken``.

    Positions show two swapped nests of a symmetric triangle; distances do not.
    """
    nests, limit_mm = cell.layout.floor, cell.tracker.find_radius_mm
    nominal_mm = np.array([nest.xyz_mm for nest in nests])
    expected_mm = apply(inverse(cell.tracker.pose.matrix()), nominal_mm)
    off_mm = np.linalg.norm(measured_mm[:, None] - expected_mm[None], axis=-1)
    for nest, row_mm, found_mm in zip(nests, off_mm, np.diag(off_mm), strict=True):
        if found_mm <= limit_mm or nest.name in taken:
            continue
        near = zip(nests, row_mm, strict=True)
        at = [other.name for other, each_mm in near if each_mm <= limit_mm]
        where = f", where {at[0]} is expected" if at else ""
        raise DeviceError(
            "HC-T32",
            "Tracker",
            "world frame",
            f"{nest.name} is {found_mm:.1f} mm from its expected place{where}",
            expected=f"<= {limit_mm:.1f} mm (tracker.find_radius_mm)",
            act="nests swapped, or tracker.pose is wrong; check, then resume",
            fields={
                "nest": nest.name,
                "off_mm": float(found_mm),
                "limit_mm": limit_mm,
                "seen_at": at[:1],
            },
        )


def check_distances(cell: Cell, measured_mm: Array) -> None:
    """Refuse nests whose distances are not those of the cell file: swapped, lifted, wrong unit."""
    nominal_mm = np.array([nest.xyz_mm for nest in cell.layout.floor])
    limit_mm = 2 * cell.layout.nest_tolerance_mm
    for wrong in wrong_distances(cell, nominal_mm, measured_mm, limit_mm):
        act = "nests swapped, a reflector not seated, or wrong units; check, then resume"
        fields, one = wrong._asdict(), misplaced_nest(cell, measured_mm, limit_mm)
        if reflector := other_reflector(cell, measured_mm, limit_mm):
            act = reflector
        elif one is not None:
            act = one.text
            fields |= {"nest": one.name, "off_mm": one.off_mm, "world_mm": one.world_mm.tolist()}
        raise DeviceError(
            "HC-T32",
            "Tracker",
            "world frame",
            f"{wrong.names} is {wrong.distance_mm:.2f} mm",
            expected=f"{wrong.wanted_mm:.2f} +-{limit_mm:.1f} mm",
            act=act,
            fields=fields,
        )
    check_reflector(cell, cell.layout.floor, measured_mm)


def check_reflector(cell: Cell, nests: Sequence[Nest], measured_mm: Array) -> None:
    """Refuse readings of nests (N, 3) that prove a reflector of another radius, or setting."""
    nominal_mm = np.array([nest.xyz_mm for nest in nests])
    shift_mm = proven_shift(nominal_mm, measured_mm, cell.layout.nest_tolerance_mm)
    if shift_mm:
        raise DeviceError(
            "HC-T32",
            "Tracker",
            "world frame",
            f"the nests' distances need {shift_mm:+.2f} mm in every reading along its beam: "
            f"reflectors of {reflectors_of(shift_mm)}",
            expected=f"those of {cell.tracker.reflector!r}",
            act="seat these in all nests and on the flange, or correct tracker.reflector; then "
            "start a new run",
            fields={"shift_mm": shift_mm, "reflector": cell.tracker.reflector},
        )


def wrong_distances(
    cell: Cell, expected_mm: Array, measured_mm: Array, limits_mm: Array | float
) -> Iterator[WrongDistance]:
    """Yield the pairs of floor nests whose distance differs from ``expected_mm`` (N, 3).

    ``limits_mm`` is one for all, or (N, N).
    """
    names = [nest.name for nest in cell.layout.floor]
    each_mm = np.broadcast_to(limits_mm, (len(names), len(names)))
    for pair in combinations(range(len(names)), 2):
        then, now = (
            float(np.linalg.norm(at_mm[pair[0]] - at_mm[pair[1]]))
            for at_mm in (expected_mm, measured_mm)
        )
        limit_mm = float(each_mm[pair])
        if not abs(now - then) <= limit_mm:
            yield WrongDistance([names[n] for n in pair], now, then, limit_mm)
