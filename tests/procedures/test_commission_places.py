"""Commissioning of places: what is not where it is predicted is sought, and then named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.file import Cell, Nest
from hilcell.cell.tables import UNPLACED_MM, Pose
from hilcell.geometry.frames import apply, from_zyx, inverse, matrix, unit
from hilcell.model.events import PlaceSeen
from hilcell.model.verdicts import Proved
from hilcell.ports import Array, DeviceError, TrackerReading
from procedures.commission_places import COMMISSION_SLIDE, COMMISSION_TRACKER, world_of
from tests.hilcell.run.bed import CELL, Bed
from tests.hilcell.run.test_places_taken import NOMINAL_MM, HallTracker

T_L_W = inverse(CELL.tracker.pose.matrix())


class Person(HallTracker):
    """A tracker, and a person who puts its beam on one nest after the other."""

    def measure_aimed(self, reflector: str, samples: int) -> TrackerReading:
        if self.asked[-1] == "release":
            self.beam_on = 0 if self.beam_on is None else (self.beam_on + 1) % len(self.nests_mm)
        return super().measure_aimed(reflector, samples)


def hall(folder: Path, nests_mm: Array, cell: Cell = CELL) -> tuple[Bed, Person]:
    """Return a bed of a hall with nests (N, 3) in {L}."""
    bed = Bed(folder, unattended=False, cell=cell)
    tracker = Person(bed.tracker, nests_mm)
    bed.devices = replace(bed.devices, tracker=tracker)
    return bed, tracker


def proved(bed: Bed) -> dict[str, Proved]:
    return {
        key.partition(".")[2]: verdict
        for key, verdict in bed.log().verdicts.items()
        if isinstance(verdict, Proved)
    }


@pytest.mark.parametrize(
    ("mounted_mm", "found"), [(19.05, ""), (6.35, "0.5 in"), (11.1125, "0.875 in")]
)
def test_another_reflector_is_named_and_no_pose_is_written(
    mounted_mm: float, found: str, tmp_path: Path
) -> None:
    nests_mm = apply(T_L_W, NOMINAL_MM)
    bed, _ = hall(tmp_path, nests_mm + (mounted_mm - 19.05) * unit(nests_mm))
    assert bed.run(COMMISSION_TRACKER) == (1 if found else 0)
    by_name = proved(bed)
    assert by_name["floor nests"].holds
    assert ("tracker" in by_name) == (not found)
    if found:
        assert not by_name["reflector"].holds
        assert f"reflectors of {found} where the tracker is set to 1.5 in" in (
            by_name["reflector"].found
        )


UNPLACED = msgspec.structs.replace(
    CELL,
    layout=msgspec.structs.replace(
        CELL.layout,
        floor=[
            Nest(name=f"N{n}", x_mm=x_mm, y_mm=y_mm, z_mm=UNPLACED_MM)
            for n, (x_mm, y_mm) in enumerate([(400.0, 0.0), (-200.0, 346.4), (-200.0, -346.4)], 1)
        ],
        bar=[],
        length=[],
    ),
)


def test_nests_without_a_drawing_define_the_frame_where_they_stand(tmp_path: Path) -> None:
    at_mm = np.array([[0.0, 0.0, 0.0], [1600.0, 0.0, 0.0], [700.0, -1200.0, 0.0]])
    bed, _ = hall(tmp_path, apply(T_L_W, at_mm), UNPLACED)
    assert bed.run(COMMISSION_TRACKER) == 0, bed.log().fault
    values = proved(bed)["floor nests"].values
    found = [Nest(**each) for each in values["layout.floor"]]
    assert [nest.name for nest in found] == ["N1", "N2", "N3"]
    assert np.allclose([nest.xyz_mm for nest in found], at_mm, atol=2e-3)
    pose = Pose(**values["tracker.pose"])
    assert np.allclose(pose.matrix(), CELL.tracker.pose.matrix(), atol=2e-3)


def test_nests_along_a_line_define_no_frame(tmp_path: Path) -> None:
    at_mm = np.array([[0.0, 0.0, 0.0], [1600.0, 0.0, 0.0], [700.0, -299.0, 0.0]])
    bed, _ = hall(tmp_path, apply(T_L_W, at_mm), UNPLACED)
    assert bed.run(COMMISSION_TRACKER) == 1
    verdict = proved(bed)["floor nests"]
    assert (verdict.holds, verdict.values) == (False, {})
    assert "of which no frame follows" in verdict.found


def test_nests_in_an_upright_plane_define_no_frame() -> None:
    """The side on which the tracker stands upright is that of a rounding error there."""
    assert world_of(np.array([[0.0, 0.0, 303.0], [0.0, 0.0, 1373.0], [0.0, 800.0, 303.0]])) is None
    ramp_mm = np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0], [0.0, 300.0, 1000.0]])
    assert world_of(ramp_mm) is not None


@given(
    st.tuples(*[st.floats(-3000.0, 3000.0)] * 9),
    st.floats(-180.0, 180.0),
)
def test_the_frame_of_nests_does_not_depend_on_the_tracker_s_place(
    corners: tuple[float, ...], turned_deg: float
) -> None:
    """Its z is the side on which the tracker stands upright."""
    floor_mm = np.reshape(corners, (3, 3))
    T_W_L = world_of(floor_mm)
    if T_W_L is None:
        return
    seen_mm = apply(T_W_L, floor_mm)
    assert np.allclose(seen_mm[0], 0.0, atol=1e-6)
    assert np.allclose([*seen_mm[1, 1:], seen_mm[2, 2]], 0.0, atol=1e-6)
    assert seen_mm[1, 0] > 0.0
    assert T_W_L[2, 2] > 0.0
    elsewhere = matrix(from_zyx([turned_deg, 0.0, 0.0]), np.array([500.0, -800.0, 300.0]))
    again = world_of(apply(elsewhere, floor_mm))
    assert again is not None
    assert np.allclose(again @ elsewhere, T_W_L, atol=1e-6)


def test_a_tracker_that_is_gone_is_not_waited_for(tmp_path: Path) -> None:
    class Gone(Person):
        def measure_aimed(self, reflector: str, samples: int) -> TrackerReading:
            raise DeviceError("HC-T02", "Tracker", "measure", "the device closed the connection")

    bed = Bed(tmp_path, unattended=False)
    bed.devices = replace(bed.devices, tracker=Gone(bed.tracker, apply(T_L_W, NOMINAL_MM)))
    assert bed.run(COMMISSION_TRACKER) == 3
    end = bed.log().life[-1].change
    assert end.error["code"] == "HC-T02"


@pytest.mark.parametrize(
    ("off_mm", "how"), [(0.0, "20 mm around"), (150.0, "300 mm around"), (700.0, "by hand")]
)
def test_a_slide_nest_that_does_not_ride_is_sought(off_mm: float, how: str, tmp_path: Path) -> None:
    """Where the slide has moved, its nests are higher than predicted."""
    bed, tracker = hall(tmp_path, np.empty((0, 3)))
    rail, began_mm = bed.rail, bed.rail.position_mm
    at_mm = np.array([nest.xyz_mm for nest in CELL.layout.slide])

    def place(position_mm: float) -> None:
        T_L_B = T_L_W @ CELL.layout.nominal_base(position_mm)
        moved_mm = at_mm + (off_mm if position_mm != began_mm else 0.0) * np.array([0, 0, 1.0])
        tracker.nests_mm = apply(T_L_B, moved_mm)
        rail.position_mm = position_mm
        rail.powered, rail.ended_s = True, rail.clock.pc_s()

    place(began_mm)
    rail.hold()
    bed.rail.move_to = place  # type: ignore[method-assign]
    assert bed.run(COMMISSION_SLIDE) == (1 if off_mm else 0), bed.log().fault
    ridden = proved(bed)["slide nest rides"]
    assert ridden.holds == (off_mm == 0.0)
    assert f"{off_mm:.3f} mm" in ridden.found
    assert [seen.key for seen in bed.log().happened(PlaceSeen)][-1] == f"slide nest rides, {how}"
