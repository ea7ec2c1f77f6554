"""Commissioning of places: what is not where it is predicted is sought, and then named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilcell.geometry.frames import apply, inverse, unit
from hilcell.model.events import PlaceSeen
from hilcell.model.verdicts import Proved
from hilcell.ports import Array, DeviceError, TrackerReading
from procedures.commission_places import COMMISSION_SLIDE, COMMISSION_TRACKER
from tests.hilcell.run.bed import CELL, Bed
from tests.hilcell.run.test_places_taken import NOMINAL_MM, HallTracker

T_L_W = inverse(CELL.tracker.pose.matrix())


class Person(HallTracker):
    """A tracker, and a person who puts its beam on one nest after the other."""

    def measure_aimed(self, reflector: str, samples: int) -> TrackerReading:
        if self.asked[-1] == "release":
            self.beam_on = 0 if self.beam_on is None else (self.beam_on + 1) % len(self.nests_mm)
        return super().measure_aimed(reflector, samples)


def hall(folder: Path, nests_mm: Array) -> tuple[Bed, Person]:
    """Return a bed of a hall with nests (N, 3) in {L}."""
    bed = Bed(folder, unattended=False)
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
