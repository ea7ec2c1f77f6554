"""Keep-out volumes, and the arm's own shape.

A box is fixed in {W}, or on the slide in nominal {B}. The arm is a chain of capsules along the
lines of its joints. Its shape is approximate and its base nominal: the clearance covers the
difference. Lengths mm, angles rad.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta, field

from hilcell.cell.layout import Layout
from hilcell.cell.tables import Frozen, Name, Point, Pose, Size
from hilcell.geometry.clearance import Body, Boxes, Capsules, Proof, joint_lines
from hilcell.geometry.kinematics import Arm, Array

LINKS = 6
LEAST_MM = 5.0  # of a size or radius: less is probably in metres


class KeepOut(Frozen, frozen=True, kw_only=True):
    """A box that the arm keeps out of: fixed in {W}, or on the slide in nominal {B}."""

    name: Name
    centre: Pose
    size_mm: tuple[Size, Size, Size]
    frame: Literal["world", "slide"] = "world"

    def __post_init__(self) -> None:
        _refuse_metres("size_mm", self.size_mm)


class CapsuleTable(Frozen, frozen=True, kw_only=True):
    """A protruding part, in the DH frame of its link."""

    link: Annotated[int, Meta(ge=1, le=LINKS)]
    from_mm: Point
    to_mm: Point
    radius_mm: Size

    def __post_init__(self) -> None:
        _refuse_metres("radius_mm", [self.radius_mm])


class EnvelopeTable(Frozen, frozen=True, kw_only=True):
    """The arm's shape: a radius around the line of each link's joints, and protruding parts."""

    radius_mm: tuple[Size, Size, Size, Size, Size, Size]
    clearance_mm: Size = 50.0
    capsule: list[CapsuleTable] = field(default_factory=list)

    def __post_init__(self) -> None:
        _refuse_metres("radius_mm", self.radius_mm)


@dataclass(frozen=True, slots=True)
class Nearest:
    """The smallest clearance of a motion: the link, the volume, the share of the motion."""

    clearance_mm: float
    link: int
    volume: str
    share: float


class Surroundings:
    """The keep-out volumes of a cell, checked against its arm up to a link."""

    def __init__(
        self,
        arm: Arm,
        envelope: EnvelopeTable,
        layout: Layout,
        keep_out: Sequence[KeepOut],
        to_link: int = LINKS,
    ) -> None:
        fixed = [volume for volume in keep_out if volume.frame == "world"]
        on_slide = [volume for volume in keep_out if volume.frame == "slide"]
        self.wanted_mm = envelope.clearance_mm
        self._names = [volume.name for volume in (*fixed, *on_slide)]
        lines = [
            (link, segment, radius_mm)
            for link, radius_mm in enumerate(envelope.radius_mm[:to_link], start=1)
            for segment in joint_lines(arm, link)
        ]
        parts = [
            (part.link, np.array([part.from_mm, part.to_mm]), part.radius_mm)
            for part in envelope.capsule
            if part.link <= to_link
        ]
        links, ends_mm, radii_mm = zip(*lines, *parts, strict=True)
        self._body = Body(
            arm,
            Capsules(np.array(links), np.array(ends_mm), np.array(radii_mm)),
            layout.nominal_base(0.0),
            np.array(layout.rail_direction),
            _boxes(fixed),
            _boxes(on_slide),
        )

    def prove(self, start: Array, end: Array, more_mm: float = 0.0) -> Proof:
        """Judge motions between postures (N, 7), `posture`; ``more_mm`` beyond the clearance."""
        return self._body.prove(start, end, self.wanted_mm + more_mm)

    def least_mm(self, postures: Array) -> dict[str, float]:
        """Return each volume's least clearance from postures (N, 7)."""
        found_mm = self._body.clearances_mm(postures, np.full((len(postures), 1), np.inf))
        return dict(zip(self._names, found_mm.min(axis=(0, 1)).tolist(), strict=True))

    def apart_mm(self, one: Array, other: Array) -> float:
        """Return the largest displacement of the arm's points between two postures (7,)."""
        return float(self._body.travel_mm(one[None], other[None]).max())

    def nearest(self, start: Array, end: Array, also: float) -> Nearest:
        """Return the closest approach between postures (7,); also checks share ``also``."""
        found = self._body.tightest(start, end, also)
        link = int(self._body.capsules.link[found.capsule])
        return Nearest(found.clearance_mm, link, self._names[found.box], found.share)


def keep_out_problems(
    keep_out: Sequence[KeepOut], envelope: EnvelopeTable | None, *, coming: bool = False
) -> Iterator[str]:
    """Yield problems of keep-out volumes; they need the arm's shape, and it needs them, also where
    they are ``coming`` later.
    """
    names = [volume.name for volume in keep_out]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"keep_out: names must differ, got {name} twice"
    most_volumes = 100
    if not len(names) <= most_volumes:
        yield f"keep_out: {len(names)} volumes, expected at most {most_volumes}"
    if names and envelope is None:
        yield "keep_out: the arm's shape is unknown; state robot.envelope.radius_mm"
    if envelope is not None and not names and not coming:
        yield "robot: envelope: no keep_out; state at least the floor"


def _refuse_metres(key: str, lengths_mm: Sequence[float]) -> None:
    """Raise `ValueError` for sizes that are probably in metres: nothing would collide."""
    least_mm = min(lengths_mm)
    if not least_mm >= LEAST_MM:
        raise ValueError(
            f"{key}: expected >= {LEAST_MM:g} mm, got {least_mm:g} mm; are these metres?"
        )


def posture(rail_mm: float, joints_rad: Array) -> Array:
    """Return postures (..., 7): the slide's position and joints (..., 6)."""
    postures = np.empty((*joints_rad.shape[:-1], 7))
    postures[..., 0], postures[..., 1:] = rail_mm, joints_rad
    return postures


def _boxes(volumes: list[KeepOut]) -> Boxes:
    frames = [volume.centre.matrix() for volume in volumes]
    sizes_mm = [volume.size_mm for volume in volumes]
    return Boxes(np.reshape(frames, (-1, 4, 4)), np.reshape(sizes_mm, (-1, 3)) / 2)
