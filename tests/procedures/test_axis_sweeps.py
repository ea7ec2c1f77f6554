"""The act of axis sweeps on devices in memory: what is swept, kept, made again and left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.cell.devices import Devices
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply, inverse
from hilcell.identification.axis_motion import SweepStream
from hilcell.identification.sweeps import transmission_curve
from hilcell.ports import Array, HilcellError, JointSample, NoReading, RobotReading, StreamBlock
from hilcell.run import mover
from procedures import axis_sweeps
from procedures.axis_sweeps import AxisSweeps, CubeJoints, haste, left_out
from tests.hilcell.identification.axis_streams import Axis, periodic
from tests.hilcell.run.bed import CELL, Bed
from tests.hilcell.run.rig import DeskRail, DeskRobot, DeskTracker, procedure
from tests.procedures.results import result_of

SWEPT = load_cell("paper", {"settle.robot_s": "0.0", "settle.rail_s": "0.0", "sweeps.axes": "[1]"})
AXIS = Axis(0, periodic(np.random.default_rng(5), 45e-6))
EVERY = 12  # of the joints' readings: the desk answers at once


class DeskSweep:
    """Satisfies `hilcell.ports.Sweep` and, for the same sweep, `hilcell.ports.Stream`."""

    speed_rad_s, rate_hz = float(np.radians(1.0)), 20.0

    def __init__(self, robot: DeskRobot, stream: SweepStream) -> None:
        self._robot, self._stream = robot, stream
        rows = zip(stream.joints_rad[::EVERY], stream.asked_s[::EVERY], strict=True)
        self._joints = [JointSample(q, float(at[0]), float(at[1])) for q, at in rows]

    @property
    def ended(self) -> bool:
        return not self._joints

    def kickoff(self) -> None: ...

    def collect(self) -> JointSample:
        return self._joints.pop(0)

    def complete(self) -> RobotReading:
        return self._robot.read()


class DeskStream:
    rate_hz = 20.0

    def __init__(self, blocks: list[StreamBlock], lost: bool) -> None:
        self._blocks, self._lost = blocks, lost

    def kickoff(self) -> None: ...

    def collect(self) -> list[StreamBlock]:
        if self._lost:
            raise NoReading("HC-T10", "Tracker", "stream", "the beam broke")
        return []

    def complete(self) -> list[StreamBlock]:
        return self._blocks


class SweepingRobot(DeskRobot):
    way = 1.0
    spoil: Callable[[SweepStream], SweepStream] = staticmethod(lambda stream: stream)

    @contextmanager
    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> Iterator[DeskSweep]:
        yield DeskSweep(self, AXIS.stream(self.way))


class StreamingTracker(DeskTracker):
    def __init__(self, robot: SweepingRobot) -> None:
        super().__init__(robot.clock)
        self.robot, self.streams, self.lost = robot, 0, 0

    @contextmanager
    def stream(self, near_mm: Array, reflector: str, rate_hz: float) -> Iterator[DeskStream]:
        self.streams += 1
        self.lost -= 1
        self.robot.way = 1.0 if self.robot.joints_rad[0] < 0 else -1.0
        found = self.robot.spoil(AXIS.stream(self.robot.way))
        yield DeskStream(blocks(found), self.lost >= 0)


def blocks(stream: SweepStream) -> list[StreamBlock]:
    station = SWEPT.reference
    T_L_B = inverse(SWEPT.tracker.pose.matrix()) @ SWEPT.layout.nominal_base(station.rail_mm)
    xyz_mm = apply(T_L_B, stream.xyz_mm)
    cuts = np.flatnonzero(np.diff(stream.window_s[:, 1])) + 1
    parts = [np.split(each, cuts) for each in (stream.device_s, xyz_mm, stream.window_s)]
    return [
        StreamBlock(at, mm, float(window[0, 0]), float(window[0, 1]))
        for at, mm, window in zip(*parts, strict=True)
    ]


@pytest.fixture
def bed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bed:
    monkeypatch.setattr(mover.Mover, "JOINT_POLL_S", 0.0)
    made = Bed(tmp_path, cell=SWEPT)
    robot = SweepingRobot(SWEPT, made.clock)
    made.devices = Devices(DeskRail(SWEPT, made.clock), robot, StreamingTracker(robot))
    return made


def parts(bed: Bed) -> tuple[SweepingRobot, StreamingTracker]:
    robot, tracker = bed.devices.robot, bed.devices.tracker
    assert isinstance(robot, SweepingRobot)
    assert isinstance(tracker, StreamingTracker)
    return robot, tracker


class Connected(AxisSweeps):
    def perform(self, session: Any) -> None:
        session.reach("connect")
        super().perform(session)


ACT = procedure(Connected())


def test_a_curve_is_journalled_as_data_and_never_swept_for_again(bed: Bed) -> None:
    assert bed.run(ACT) == 0
    log = bed.log()
    assert log.curves[1].holds, log.curves[1].reason
    assert set(log.streams) == {"sweep/A1/up", "sweep/A1/down"}
    curve = transmission_curve(log.curves[1])
    q = np.linspace(curve.low_rad, curve.high_rad, 400)
    assert np.std(curve.evaluate(q) - AXIS.ripple(q)) < 2e-6
    (figures,) = result_of(AxisSweeps(), log)["sweeps"]["axes"]
    assert figures["used"]
    assert figures["axis"] == 1
    assert AxisSweeps.table(result_of(AxisSweeps(), log)).rows[0][:2] == ["A1", "yes"]
    assert bed.run(ACT) == 0
    assert parts(bed)[1].streams == 2


def test_a_beam_that_breaks_is_tried_again_and_a_finished_sweep_is_kept(bed: Bed) -> None:
    _, tracker = parts(bed)
    tracker.lost = 1
    assert bed.run(ACT) == 0
    assert tracker.streams == 3
    assert [body["tries"] for body in bed.events("no reading")] == [1]


def test_after_a_fault_the_sweep_that_was_finished_is_not_repeated(bed: Bed) -> None:
    _, tracker = parts(bed)
    assert bed.run(procedure(UpAlone())) == 0
    tracker.lost = 3
    assert bed.run(ACT) == 3
    assert not bed.log().curves
    assert bed.run(ACT) == 0
    assert tracker.streams == 1 + 3 + 1
    assert bed.log().curves[1].holds


class UpAlone(Connected):
    def perform(self, session: Any) -> None:
        session.reach("connect")
        self._sweep(session, CubeJoints.of(CELL), 1, "up")


def late(stream: SweepStream) -> SweepStream:
    """Return the stream with a gap of 2 s, which makes it useless."""
    return replace(stream, device_s=stream.device_s + 2.0 * (np.arange(len(stream.device_s)) > 300))


def test_a_stream_that_cannot_be_used_is_an_alarm_and_no_curve(bed: Bed) -> None:
    parts(bed)[0].spoil = late
    assert bed.run(ACT) == 0
    log = bed.log()
    assert len(log.streams) == 4  # both sweeps were made again
    assert not log.curves[1].holds
    assert log.curves[1].reason
    assert not result_of(AxisSweeps(), log)["sweeps"]["axes"][0]["used"]


def test_an_axis_is_swept_again_where_the_first_sweeps_cannot_be_used(bed: Bed) -> None:
    robot, tracker = parts(bed)
    robot.spoil = lambda stream: late(stream) if tracker.streams == 1 else stream
    assert bed.run(ACT) == 0
    assert bed.log().curves[1].holds
    assert "sweep/A1/down/2" in bed.log().streams


@pytest.mark.parametrize(
    ("streams", "sweeps", "named"),
    [(False, True, "leica-emscon"), (True, False, "kuka-c3"), (True, True, "")],
)
def test_devices_that_cannot_are_named(
    streams: bool, sweeps: bool, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    able = {"tracker_streams": streams, "robot_sweeps": sweeps}
    monkeypatch.setattr(axis_sweeps, "abilities", lambda cell: able)
    assert named in left_out(CELL)
    assert bool(named) == bool(left_out(CELL))


def test_a_cell_without_volumes_or_axes_sweeps_nothing() -> None:
    robot = msgspec.structs.replace(CELL.robot, envelope=None)
    assert "robot.envelope" in left_out(msgspec.structs.replace(CELL, robot=robot, keep_out=[]))
    assert "sweeps.axes" in left_out(load_cell("paper", {"sweeps.axes": "[]"}))


def test_each_axis_turns_alone_over_what_the_cube_needs() -> None:
    cube = CubeJoints.of(CELL)
    for axis in AxisSweeps.axes(CELL):
        up, down = cube.ends_rad(CELL, axis, "up"), cube.ends_rad(CELL, axis, "down")
        moving = np.flatnonzero(up[0] != up[1])
        assert moving.tolist() == [axis - 1]
        assert up[0][axis - 1] < up[1][axis - 1]
        np.testing.assert_array_equal(up, down[::-1])


def test_the_plan_states_how_long_the_sweeps_take() -> None:
    step, cube = AxisSweeps().plan(CELL, 1), CubeJoints.of(CELL)
    turned_deg = sum(
        2 * float(np.degrees(np.ptp(cube.ends_rad(CELL, axis, "up"), axis=0)).max())
        for axis in AxisSweeps.axes(CELL)
    )
    assert turned_deg < step.duration_s < turned_deg + 60.0
    assert step.spans[0].measured == 8
    quick = AxisSweeps().plan(load_cell("paper", {"plan.quick": "true"}), 1)
    assert quick.duration_s < 0.5 * step.duration_s


def test_a_quick_plan_sweeps_faster_with_as_many_samples_a_degree() -> None:
    """But no sweep is so short that the joints' readings are too few."""
    quick = load_cell("paper", {"plan.quick": "true", "sweeps.speed_deg_s": "0.5"})
    assert haste(CELL, 60.0) == 1.0
    assert haste(quick, 60.0) == 3.0
    assert haste(quick, 6.0) == pytest.approx(12.0 / 5.0)
    assert haste(quick, 2.0) == 1.0


def test_a_sweep_beyond_a_joints_limit_is_refused() -> None:
    cell = load_cell("paper", {"sweeps.margin_deg": "30.0"})
    with pytest.raises(HilcellError, match=r"swept (up|down)"):
        AxisSweeps().plan(cell, 1)
