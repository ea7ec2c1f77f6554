"""Every fault that the simulated cell knows, really injected: the run's alarm names it.

The engine runs in this process, against a simulated cell in another; only the drivers' patience
on a dead wire is shortened.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from drivers.canopen import drive, rail_setup
from drivers.kuka import robot as kuka_robot
from drivers.leica.tracker_emscon import LeicaEmsconTracker
from fakes.faults import KNOWN
from hilcell.alarms import Alarm, alarms_of, catalogue
from hilcell.commands.cli import main
from hilcell.journal.runs import read_log
from tests.whole.bench import Simulation, sets, simulation
from tests.whole.kuka_faults import KUKA_ENDS

# Effect of each fault on the run: its alarm, and the value with which it strikes.
# Where a strip freezes or the backlash grows, the first alarm depends on where the slide stands.
ENDS: dict[str, tuple[str, object]] = {
    "rail.vanish": ("HC-R01", True),
    "rail.wrong_identity": ("HC-R08", 0x999),
    "rail.heartbeat_loss": ("HC-R10", 5),
    "rail.node_reset": ("HC-R03", 5),
    "rail.emcy": ("HC-R24", 0x7305),
    "rail.fault": ("HC-R21", 0x2310),
    "rail.limit_switch": ("HC-R32", -1),
    "rail.no_acknowledge": ("HC-R31", True),
    "rail.overspeed": ("HC-R33", 1.5),
    "rail.bus_off": ("HC-R05", True),
    "rail.second_node": ("HC-R45", 5),
    "rail.sdo_abort": ("HC-R09", 0x06020000),
    "rail.sdo_timeout": ("HC-R05", True),
    "rail.late_reply": ("HC-R05", 0.45),
    "rail.late_tpdo": ("HC-R07", 1.5),
    "rail.strip_frozen": ("HC-S02 HC-S03", True),
    "rail.missing_magnet": ("HC-S01", True),
    "rail.backlash": ("HC-S04 HC-S02 HC-S03", 0.5),
    "rail.slip": ("HC-S03", 5.0),
    "rail.eof": ("HC-R01", True),
    "rail.garbage": ("HC-R05", True),
    "rail.nack": ("HC-R05", True),
    "rail.stalled": ("HC-R05", True),
    "robot.vanish": ("HC-B02", True),
    **KUKA_ENDS,
    "robot.failure_footer": ("HC-B03", 0),
    "robot.restarted": ("HC-B03", True),
    "robot.late_reply": ("HC-B02", 3.0),
    "robot.lost_zero": ("HC-T11", 5.0),
    "robot.lost_zero_2": ("HC-T11", 5.0),
    "robot.lost_zero_3": ("HC-T11", 5.0),
    "tracker.vanish": ("HC-T02", True),
    "tracker.wrong_identity": ("HC-T03", True),
    "tracker.beam_break_before": ("HC-T11", True),
    "tracker.beam_break_after": ("HC-T10", True),
    "tracker.no_reflector": ("HC-T11", True),
    "tracker.no_result": ("HC-T13", True),
    "tracker.wrong_reflector": ("HC-T12", True),
    "tracker.not_warmed_up": ("HC-T19", True),
    "robot.wrong_turn": ("HC-B24", True),
    "tracker.no_distance": ("HC-T11", True),
    "tracker.init_lost": ("HC-T04", True),
    "tracker.drift_step": ("HC-T15 HC-T16", 5.0),
    "tracker.noisy": ("HC-T15", 1.0),
    "tracker.metres": ("HC-T18", True),
    "tracker.left_handed": ("HC-T16", True),
    "tracker.no_weather": ("HC-T05", True),
    "tracker.bad_number": ("HC-T14", "nan"),
    "tracker.length_zero": ("HC-T02", True),
    "tracker.length_huge": ("HC-T02", True),
    "tracker.eof": ("HC-T02", True),
    "tracker.wrong_target": ("HC-T16", 500.0),
}
# A driver that is sound goes through these; how often they strike, and with what.
SURVIVED: dict[str, tuple[int, object]] = {
    "rail.early_target_reached": (1000, True),
    "rail.strip_jitter": (20, True),
    "rail.double_frame": (2, True),
    "rail.swapped_frames": (2, True),
    "rail.wrong_mode": (2, 3),
    "robot.split_reply": (20, True),
    "robot.stale_position": (2, True),
    "tracker.late_result": (1, True),
    "tracker.spike": (1, 0.05),
    "tracker.busy": (2, True),
    "tracker.status_storm": (2, 100),
    "tracker.split_packet": (1000, True),
    "tracker.glued_packets": (1000, True),
}
# Traces of these faults stay, or come late, so the next fault gets another cell.
LASTING = (
    ".vanish",
    ".backlash",
    ".slip",
    ".lost_zero",
    ".lost_zero_2",
    ".lost_zero_3",
    ".drift_step",
    ".limit_switch",
    ".late_tpdo",
    ".late_reply",
)
SPECIFIC = {entry.code for entry in catalogue().values() if entry.specific}


class Cells:
    """The simulated cell that stands, or a new one."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._cell: Simulation | None = None

    def standing(self) -> Simulation:
        if self._cell is None:
            self._cell = self._stack.enter_context(simulation())
        return self._cell

    def close(self) -> None:
        self._stack.close()
        self._cell = None


@pytest.fixture(scope="module")
def cells() -> Iterator[Cells]:
    cells = Cells()
    yield cells
    cells.close()


@pytest.fixture
def injected(
    cells: Cells, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, request: pytest.FixtureRequest
) -> list[Alarm]:
    """Run a small procedure that uses all three devices under one fault; return its alarms."""
    name, value, count = request.param
    monkeypatch.setattr(rail_setup, "FIND_S", 0.5)
    monkeypatch.setattr(drive, "STALL_S", 1.0)
    monkeypatch.setattr(kuka_robot, "STALL_S", 1.0)
    monkeypatch.setattr(kuka_robot, "REST_S", 1.0)
    monkeypatch.setattr(LeicaEmsconTracker, "RESULT_S", 0.5)
    if name.endswith(".vanish"):
        cells.close()  # where the fault before left the slide moving, it would vanish at once
    cell = cells.standing()
    cell.ask(do="fault", name=name, value=value, count=count)
    words = {
        "simulation.address": cell.control,
        "base_frame.points": "4",
        "layout.nest_samples": "2",
        "plan.unattended_wait_s": "0",
    }
    main(
        ["run", "base-frame", "--unattended", "--runs", str(tmp_path), "--name", "x", *sets(words)]
    )
    cell.ask(do="clear")
    if name.endswith(LASTING):
        cells.close()
    return alarms_of(read_log(tmp_path / "x"), "x", live=False)


@pytest.mark.parametrize(
    ("injected", "codes"),
    [((name, value, 1000), codes) for name, (codes, value) in ENDS.items()],
    ids=ENDS,
    indirect=["injected"],
)
def test_a_fault_that_ends_a_run_is_named(injected: list[Alarm], codes: str) -> None:
    fault = injected[-1]
    assert fault.code in codes.split(), injected
    assert fault.severity == "fault"
    assert fault.where
    assert fault.found
    assert len(fault.do) >= 2
    assert "space" in fault.do[-1] or "Start a new run" in fault.do[-1]
    assert {alarm.code for alarm in injected} <= SPECIFIC


@pytest.mark.parametrize(
    "injected",
    [(name, value, count) for name, (count, value) in SURVIVED.items()],
    ids=SURVIVED,
    indirect=True,
)
def test_a_fault_that_is_survived_is_a_notice_at_most(injected: list[Alarm]) -> None:
    assert {alarm.severity for alarm in injected} <= {"notice"}, injected
    assert {alarm.code for alarm in injected} <= SPECIFIC


def test_no_fault_is_left_out() -> None:
    streamed = {"tracker.stream_break"}  # no procedure streams; tests of the driver break one
    wrists = {f"robot.lost_zero_{axis}" for axis in (4, 5, 6)}
    # No device sees these: `test_disturbances` does, and `test_known_length`.
    silent = {
        "robot.mount_slip",
        "rail.strip_jump",
        "tracker.scale_ppm",
        "robot.lost_motion",
    }
    # Their alarm depends on the moment: `campaigns.faults` strikes them in each phase.
    timely = {"rail.pushed", "rail.reference_lost"}
    timely |= {"tracker.nest_lifted", "tracker.warmer", "tracker.wrong_offset"}
    eki = {"robot.xml_bomb", "robot.no_end", "robot.glued_reply"}  # `test_kuka_eki` strikes them
    # Those of a slide that is the robot's axis: `test_external_axis` strikes them.
    # A total station's: `test_total_station` strikes them.
    geocom = {f"tracker.geocom_{what}" for what in ("code", "number", "noise")}
    t2sa = {  # those of SpatialAnalyzer's bridge: `test_t2sa` strikes them
        f"tracker.t2sa_{what}"
        for what in ("code", "inches", "nominal", "old_result", "renamed", "simulation")
    }
    slide = {"robot.no_slide", "robot.slide_unmastered", "robot.slide_fast", "rail.strip_silent"}
    struck = set(ENDS) | set(SURVIVED)
    assert struck | streamed | silent | wrists | timely | geocom | t2sa | eki | slide == set(KNOWN)
    assert not set(ENDS) & set(SURVIVED)
