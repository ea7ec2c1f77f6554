from __future__ import annotations

import numpy as np
import pytest

from fakes.truth.arm_truth import Deflection, Loads, Ripple, Slopes, reference_cube, slopes
from fakes.truth.machine import load_machine
from fakes.truth.transforms import Array

URAD = 1e-6


def cube(name: str = "hard") -> tuple[Loads, Array]:
    machine = load_machine(name)
    design = machine.chain((98.0, 0.0, 127.0))
    joints_rad = reference_cube(machine, design)[1]
    return Loads(design, joints_rad), joints_rad


def test_hard_has_a_harmonic_outside_every_list() -> None:
    sizes = load_machine("hard").transmission
    for seed in range(10):
        ripple = Ripple(sizes, np.random.default_rng(seed))
        np.testing.assert_allclose(ripple.amplitude_rad[:, -1], 11 * URAD)
        beside = ripple.cycles[:, -1]
        assert ((beside > sizes.pins[1]) & (beside < sizes.ratios[0])).all()
        assert np.abs(beside - np.round(beside)).min() > 1e-6


def test_paper_has_no_such_harmonic() -> None:
    ripple = Ripple(load_machine("paper").transmission, np.random.default_rng(1))
    assert not ripple.amplitude_rad[:, -1].any()


def test_loads_span_their_range_over_the_cube_and_no_more() -> None:
    loads, joints_rad = cube()
    over_cube = loads(joints_rad)
    np.testing.assert_allclose(over_cube[:, :4].min(axis=0), -1.0)
    np.testing.assert_allclose(over_cube[:, :4].max(axis=0), 1.0)
    assert np.abs(over_cube[:, 4:]).max() < 1e-6  # one orientation: the hand's lever stays
    stretched = loads(np.zeros(6))
    assert stretched[1] == 1.0  # heavier than anywhere in the cube


def test_slopes_are_those_of_the_links() -> None:
    """The paper's robot counts a level upper arm as 0, the other make an upright one."""
    paper = slopes(load_machine("paper").chain((0.0, 0.0, 0.0)))
    six_r = slopes(load_machine("six-r").chain((0.0, 0.0, 0.0)))
    assert np.degrees([paper.upper_rad, six_r.upper_rad]) == pytest.approx([0.0, -90.0])
    assert np.degrees(paper.fore_rad) == pytest.approx(-np.degrees(np.arctan2(115, 1220)))
    assert np.degrees(six_r.fore_rad) == pytest.approx(-np.degrees(np.arctan2(120, 640)))


def test_gravity_bends_a_level_arm_most() -> None:
    sizes = load_machine("paper").errors
    level, upright = np.zeros(6), np.radians([0.0, -90.0, 0.0, 0.0, 0.0, 0.0])
    for seed in range(10):
        drawn = Deflection.drawn(sizes, np.random.default_rng(seed))
        gravity = Deflection(drawn.gravity_rad, drawn.harmonics_rad * 0.0, drawn.elastic_rad)
        bent = [gravity(joints, Slopes(0.0, 0.0))[1] for joints in (level, upright)]
        assert bent[0] > abs(bent[1])


def test_elasticity_follows_both_links() -> None:
    """Not a sum of functions of one angle each: its mixed difference does not vanish."""
    zero = np.zeros(6)
    bent = Deflection(zero, np.zeros((6, 2)), 1e-4)
    level = Slopes(0.0, 0.0)

    def axis_2(a2_deg: float, a3_deg: float) -> float:
        return float(bent(np.radians([0.0, a2_deg, a3_deg, 0.0, 0.0, 0.0]), level)[1])

    mixed = axis_2(-60, 80) - axis_2(-60, 40) - axis_2(-20, 80) + axis_2(-20, 40)
    assert abs(mixed) > 1e-5
    assert axis_2(-90, 20) == pytest.approx(0.0, abs=1e-12)
