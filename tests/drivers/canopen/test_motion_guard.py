"""Drives in other units and rails of other scales, on the wire: stopped on the way, and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.canopen.motion_guard import Limits, MotionGuard
from drivers.canopen.process_image import Snapshot
from drivers.canopen.rail import CanopenRail
from drivers.scale_guard import ScaleGuard
from drivers.standstill import Windows
from tests.drivers.canopen.can_peer import CanPeer
from tests.drivers.canopen.rail_bed import RailTime, connected, peer, rail, time
from tests.drivers.peers import figure, refusal

__all__ = ["peer", "rail", "time"]

START = 500_000  # counts, as everywhere in this peer
RAMP_MM_S2 = 400.0  # of a quick stop


def runs(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch, unit: float = 1.0,
    most: float = 250_000.0, ramp: float = 200_000.0, shown: float = 1.0,
) -> None:  # fmt: skip
    """Let the slide move in the cell's time as a drive moves it whose speeds are in ``unit``.

    It reaches ``most`` counts/s with ``ramp`` counts/s^2; an obedient drive reaches 250 000.
    606Ch is in ``shown`` of that unit.
    """
    axis = peer.axis
    speed, ramp = min(250_000.0 * unit, most), min(200_000.0 * unit, ramp)
    began: list[tuple[float, int]] = []

    def step() -> None:
        if not axis.steps:
            began.clear()
            return
        if not began:
            began.append((time.now_s(), axis.position))
        began_s, start = began[0]
        passed_s, gap = time.now_s() - began_s, axis.target - start
        ramp_s = min(passed_s, speed / ramp)
        way = ramp * ramp_s**2 / 2 + speed * (passed_s - ramp_s)
        axis.speed = round(ramp * ramp_s / unit / shown)
        if way >= abs(gap):
            axis.position, axis.steps = axis.target, 0
            axis.bits |= 0x1400 if axis.homing else 0x400
        else:
            axis.position = start + round(way if gap > 0 else -way)

    monkeypatch.setattr(axis, "step", step)


def gone_mm(peer: CanPeer) -> float:
    return abs(peer.axis.position - START) / 1000.0


@pytest.mark.parametrize(
    ("unit", "true_mm_s", "stops_mm"),
    [(10_000 / 60, 500.0, 50.0), (1000.0, 500.0, 50.0), (0.1, 25.0, 10.0)],
)
@pytest.mark.parametrize("homing", [False, True])
def test_a_drive_in_another_unit_is_stopped_on_its_first_way_and_named_with_its_factor(
    peer: CanPeer,
    time: RailTime,
    monkeypatch: pytest.MonkeyPatch,
    unit: float,
    true_mm_s: float,
    stops_mm: float,
    homing: bool,
) -> None:
    with connected(peer, time) as rail:
        runs(peer, time, monkeypatch, unit, most=500_000.0, ramp=2_000_000.0)
        found = refusal(rail.home if homing else lambda: rail.move_to(2500.0))
        assert found.code == "HC-R46"
        assert figure(found, "factor") == pytest.approx(unit, rel=0.15)
        assert 0.0 < figure(found, "speed_mm_s") < true_mm_s
        ratio = figure(found, "speed_mm_s") / figure(found, "drive_speed_mm_s")
        assert ratio == pytest.approx(figure(found, "factor"))
        peer.quick_stopped.wait()
        speed_mm_s = peer.axis.speed * unit / 1000.0
        assert 0.0 < gone_mm(peer) + speed_mm_s**2 / 2 / RAMP_MM_S2 < stops_mm


def test_a_drive_in_the_right_unit_goes_its_way(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    with connected(peer, time) as rail:
        runs(peer, time, monkeypatch)
        rail.home()
        rail.move_to(1500.0)
        assert rail.read().position_mm == 1500.0


def test_a_slide_that_is_too_fast_by_its_positions_is_stopped(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By 1.35: its drive says less, within the 1.5 of a unit that is right."""
    with connected(peer, time) as rail:
        runs(peer, time, monkeypatch, 1.35, most=337_500.0)
        found = refusal(lambda: rail.move_to(2500.0))
        assert found.code == "HC-R33"
        assert figure(found, "allowed_mm_s") == pytest.approx(300.0)
        assert 300.0 < figure(found, "speed_mm_s") < 340.0
        peer.quick_stopped.wait()


@pytest.mark.parametrize("homing", [False, True])
@pytest.mark.parametrize(
    ("option", "value", "ratio"),
    [
        ("strip_counts_per_mm", 200.0, 0.5),
        ("strip_counts_per_mm", 80.0, 1.25),
        ("counts_per_mm", 2000.0, 2.0),
    ],
)
def test_scales_that_differ_are_named_on_the_way(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch,
    option: str, value: float, ratio: float, homing: bool,
) -> None:  # fmt: skip
    if option.startswith("strip"):
        del peer.objects[6][0x6005, 1]  # it does not tell its step
        peer.abort[0x6005, 0] = 0x06020000
    with connected(peer, time, **{option: value}) as rail:
        runs(peer, time, monkeypatch)
        found = refusal(rail.home if homing else lambda: rail.move_to(1250.0))
        assert found.code == "HC-R47"
        assert figure(found, "ratio") == pytest.approx(ratio, rel=0.01)
        assert figure(found, "drive_mm") * (-1 if homing else 1) > 0.0
        peer.quick_stopped.wait()
        assert gone_mm(peer) < 250.0


@pytest.mark.parametrize("homing", [False, True])
def test_scales_that_differ_are_named_by_three_looks_at_a_motion(
    peer: CanPeer, time: RailTime, homing: bool
) -> None:
    """As a simulated cell moves; homing sets the reference by the last one."""
    with connected(peer, time, counts_per_mm=2000.0) as rail:
        found = refusal(rail.home if homing else lambda: rail.move_to(1250.0))
        assert found.code == "HC-R47"
        assert figure(found, "ratio") == pytest.approx(2.0, rel=0.01)


def test_a_speed_that_is_only_shown_in_another_unit_is_no_overspeed(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """606Ch in 0.1 counts/s of a drive that obeys 6081h in counts/s."""
    with connected(peer, time) as rail:
        runs(peer, time, monkeypatch, shown=0.1)
        found = refusal(lambda: rail.move_to(2500.0))
        assert found.code == "HC-R46"
        assert figure(found, "factor") == pytest.approx(0.1, rel=0.15)


@pytest.mark.parametrize("at", ["start", "way"])
def test_a_slide_that_slips_or_a_strip_that_jumps_is_no_matter_of_scale(
    rail: CanopenRail, peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    runs(peer, time, monkeypatch)

    def jump() -> None:
        if peer.axis.steps and (at == "start" or gone_mm(peer) > 100.0):
            peer.strip_offset = 8000

    peer.on_sync = jump
    rail.move_to(1500.0)
    assert rail.read().strip_mm == 1580.0


@pytest.mark.parametrize("polls", [3, 10_000])
def test_a_strip_that_is_frozen_is_no_matter_of_scale(
    rail: CanopenRail, peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch, polls: int
) -> None:
    """Where it stays so, the run finds that once the slide stands."""
    runs(peer, time, monkeypatch)
    frozen: list[bytes] = []

    def freeze(line: bytes) -> list[bytes]:
        if line.startswith(b"t186") and gone_mm(peer) > 100.0 and len(frozen) < polls:
            frozen.append(frozen[0] if frozen else line)
            return frozen[-1:]
        return [line]

    peer.tamper = freeze
    rail.move_to(1500.0)
    assert len(frozen) >= 3


def test_a_strip_on_a_wire_of_its_own_is_read_a_little_later() -> None:
    def way_mm(now_s: float) -> float:
        ramp_s = min(max(now_s, 0.0), 1.25)
        return 100.0 * ramp_s**2 + 250.0 * max(0.0, now_s - 1.25)

    guard = ScaleGuard(still_mm=0.02, speed_mm_s=250.0, together=False)
    for now_s in np.arange(0.0, 4.0, 0.02):
        guard.take(way_mm(now_s), way_mm(now_s - 0.09))
        assert guard.contradiction() is None


def test_a_stepped_cell_lets_a_strip_on_its_own_wire_go_ahead_of_its_drive() -> None:
    """And homing sets the reference by the last look."""
    guard = ScaleGuard(still_mm=0.02, speed_mm_s=250.0, together=False)
    for drive_mm, strip_mm in ((0.0, 639.9), (-212.2, 190.7), (0.0, 0.0)):
        guard.take(drive_mm, strip_mm)
        assert guard.contradiction() is None


def test_a_strip_that_counts_the_other_way_is_a_matter_of_direction() -> None:
    guard = ScaleGuard(0.02, 250.0, together=True)
    for place_mm in range(0, 200, 10):
        guard.take(float(place_mm), -float(place_mm))
    assert "opposite directions" in str(refusal(lambda: guard.check("move")))


@pytest.mark.parametrize(("moves", "words"), [(0.0, "does not follow"), (0.1, "unit of speed")])
def test_a_position_that_does_not_follow_is_no_unit_of_speed(moves: float, words: str) -> None:
    windows = Windows(speed=500.0, spread=10, strip_spread=2, dwell_s=0.4)
    limits = Limits(
        counts_per_mm=1000.0, strip_counts_per_mm=100.0, strip_at_sync=True, lowest=0,
        highest=3_000_000, speed=250_000.0, acceleration=200_000.0, homing_s=60.0, window=50,
        windows=windows,
    )  # fmt: skip
    at = Snapshot(0, 0, 0, 0, True, 0.0, 0x0027, 1)
    guard = MotionGuard(limits, at, 0.0)
    for look in range(1, 80):
        passed_s = 0.02 * look
        place = round(100_000 * moves * passed_s)
        guard.take(replace(at, position=place, velocity=100_000, strip=place // 10), passed_s)
    assert words in str(refusal(lambda: guard.check_unit("move", at)))
